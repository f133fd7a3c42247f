"""What was typed, and what commands print: without characters that would drive the terminal."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextvars import ContextVar
from typing import Any

import typer

from hydroopt.errors import visible

WORDS: ContextVar[tuple[str, ...]] = ContextVar("words", default=())
"""Name and arguments of the command that runs, as typed; empty where none runs."""


def echo(text: str, *, err: bool = False) -> None:
    """Print a text, which may quote names and descriptions from files.

    Args:
        text: one line or several.
        err: on the error stream.
    """
    typer.echo(visible(text, keep="\n"), err=err)


def print_table(title: str, rows: Sequence[Mapping[str, Any]]) -> None:
    """Print rows of equal keys as a table; cells of words wrap, and where the terminal is too narrow a list is printed.

    No word and no number is ever cut.
    """
    from rich import box
    from rich.console import Console
    from rich.markup import escape
    from rich.table import Table

    console = Console()
    cells = [[f"{value:.6g}" if isinstance(value, float) else visible(str(value)) for value in row.values()]
             for row in rows]
    columns = [*zip(rows[0], *cells, strict=True)]
    widths = [max(map(len, column)) for column in columns]
    words = [max(len(word) for cell in column for word in cell.split() or [""]) for column in columns]
    frame = 3 * len(columns) - 1
    while sum(widths) + frame > console.width and widths != words:  # the widest column that can wrap gives way
        k = max((k for k in range(len(widths)) if widths[k] > words[k]), key=widths.__getitem__)
        widths[k] -= 1
    if sum(widths) + frame > console.width:
        echo(title)
        for row in cells:
            filled = [f"    {key}: {cell}" for key, cell in zip([*rows[0]][1:], row[1:], strict=True) if cell]
            echo("\n".join([f"  {row[0]}", *filled]))
        return
    table = Table(title=title, title_justify="left", header_style="bold", box=box.SIMPLE_HEAD, show_edge=False)
    for key, width in zip(rows[0], widths, strict=True):
        table.add_column(escape(key), width=width)
    for row in cells:
        table.add_row(*map(escape, row))
    console.print(table)
