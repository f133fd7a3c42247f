"""`hydroopt models`: the machines that come with hydroopt."""

from __future__ import annotations

import json
import shutil
import textwrap
from typing import TYPE_CHECKING

from hydroopt.cli.options import AsJson
from hydroopt.cli.terminal import echo

if TYPE_CHECKING:
    from hydroopt.machine.machine import Machine


def models(as_json: AsJson = False) -> None:
    """List the machines that come with hydroopt: joints, actuators, and how much of each file is assumed.

    Their names can be used wherever a command takes MACHINE.

    Example: hydroopt models
    """
    from hydroopt.machine.machine_file import bundled, load_machine

    rows = [_row(load_machine(name)) for name in bundled()]
    if as_json:
        echo(json.dumps(rows, indent=1))
        return
    width = max(60, shutil.get_terminal_size(fallback=(160, 24)).columns)
    for row in rows:
        joints = f"{row['joints']} joint{'s' * (row['joints'] != 1)}, {row['moved_by']}"
        echo(f"{row['name']:<20} {joints}; {row['assumed']} of {row['stated']} sources are assumptions\n"
             + textwrap.fill(str(row["description"]), width, initial_indent=" " * 21, subsequent_indent=" " * 21))
    echo("Show one: hydroopt show NAME. Begin with your own: hydroopt new.")


def _row(machine: Machine) -> dict[str, str | int]:
    counts = (("cylinder", len(machine.cylinders)), ("motor", len(machine.motors)), ("drive", len(machine.drives)))
    moved = ", ".join(f"{count} {noun}{'s' * (count != 1)}" for noun, count in counts if count)
    sourced = [note.source for note in machine.notes.values() if note.source]
    assumed = sum(source.startswith("assumed") for source in sourced)
    return {"name": machine.name, "joints": len(machine.joints), "moved_by": moved, "assumed": assumed,
            "stated": len(sourced), "description": machine.description}
