"""`hydroopt map`: propose a column map of a log for a machine."""

from __future__ import annotations

import json
import os
import shlex
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from hydroopt.cli.options import AsJson, MachineName
from hydroopt.cli.terminal import echo
from hydroopt.errors import ProblemError

if TYPE_CHECKING:
    from hydroopt.logs.map_proposal import MapProposal


def map(
    log: Annotated[Path, typer.Argument(metavar="LOG", help="A log, or a directory of logs of one recording.")],
    machine: MachineName,
    to: Annotated[Path | None, typer.Option("--to", metavar="FILE", help=(
        "TOML file that receives the map; printed if not given. An existing one is not replaced."))] = None,
    as_json: AsJson = False,
) -> None:
    """Propose a column map of a log: which of its columns are which channels of a machine, and how sure that is.

    A channel that is only guessed is written as a comment.

    Example: hydroopt map log.csv cat215b --to map.toml
    """
    from hydroopt.logs.map_proposal import propose_map
    from hydroopt.machine.machine_file import load_machine
    from hydroopt.support.files import write_file

    if to is not None and os.path.exists(to):
        raise ProblemError("there is such a file already", where=str(to), remedy="name another one, or remove it")
    found = propose_map(log, load_machine(machine))
    if to is not None:
        write_file(to, found.toml().encode())
    if as_json:
        echo(json.dumps({"proposals": [_row(each) for each in found.proposals], "missing": found.missing,
                         "unused": found.unused, "possible": found.possible}, indent=1))
        return
    if to is None:
        echo(found.toml())
    else:
        for each in found.proposals:
            echo(f"{each.sureness:6}  {each.channel} = '{each.column.label}' [{each.unit or 'date'}]: {each.reason}")
        for label in found.possible:
            echo(f"open    '{label}': {found.question(label)}")
        if found.missing:
            echo(f"without a column: {', '.join(found.missing)}")
        if unused := [label for label in found.unused if label not in found.possible]:
            echo(f"not used: {', '.join(repr(header) for header in unused)}")
    _next(found, log, machine, to)


def _row(each: Any) -> dict[str, str]:
    return {"channel": each.channel, "column": each.column.header, "group": each.column.sheet.name, "unit": each.unit,
            "sureness": each.sureness, "reason": each.reason}


def _next(found: MapProposal, log: Path, machine: str, to: Path | None) -> None:
    """What to do next."""
    counts = {each: sum(p.sureness == each for p in found.proposals) for each in ("sure", "likely", "guess")}
    echo(f"{counts['sure']} sure, {counts['likely']} likely, {counts['guess']} guessed (commented out), "
         f"{len(found.missing)} of the usual channels without a column.")
    path = str(to) if to is not None else "map.toml"
    command = f"hydroopt check {shlex.quote(machine)} {shlex.quote(str(log))} --map {shlex.quote(path)}"
    again = f"hydroopt map {shlex.quote(str(log))} {shlex.quote(machine)} --to map.toml"
    timed = found.own_stamps or any(p.channel == "t" for p in found.proposals)
    questions = {"decide the guesses": counts["guess"], "name the column of the time": not timed,
                 "write the columns of the channels that have none": found.missing and found.unused}
    open_ones = [text for text, asked in questions.items() if asked]
    if to is None:
        echo(f"Next: {again}")
    elif open_ones:
        todo = " and ".join(filter(None, (", ".join(open_ones[:-1]), open_ones[-1])))
        echo(f"Next: in {path}, {todo}. Then {command}")
    else:
        echo(f"Next: {command}")
