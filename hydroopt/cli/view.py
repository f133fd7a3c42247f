"""`hydroopt view`: a machine in space, from its file or from a folder of results."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from hydroopt.cli.terminal import echo


def view(
    shown: Annotated[str, typer.Argument(metavar="MACHINE|DIR", help=(
        "A bundled machine's name, a .toml, .urdf, .sdf or .xml (MJCF) file, or a folder that a command wrote."))],
    output: Annotated[Path | None, typer.Option("-o", "--output", help=(
        "Directory that receives everything: view.html; out/view/MACHINE if not given."))] = None,
    show_now: Annotated[bool, typer.Option("--open", help="Show it in the browser.")] = False,
) -> None:
    """Show a machine in space: joints by sliders, linkages and cylinders that follow, and what an answer says of it.

    Example: hydroopt view cat215b --open
    """
    from hydroopt.viewing import view as page_of

    page = page_of(shown)
    folder = output or Path("out/view") / page.machine_name
    file = page.open(folder) if show_now else page.save(folder)
    echo(str(file))
