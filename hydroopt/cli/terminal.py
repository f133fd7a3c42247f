"""What commands print, without characters that would drive the terminal."""

from __future__ import annotations

import typer

from hydroopt.errors import visible


def echo(text: str, *, err: bool = False) -> None:
    """Print a text, which may quote names and descriptions from files.

    Args:
        text: one line or several.
        err: on the error stream.
    """
    typer.echo(visible(text, keep="\n"), err=err)
