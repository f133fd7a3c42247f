"""The table of bundled machines, from their files."""

from __future__ import annotations

from extension.text import cell
from hydroopt.machine.machine_file import bundled, load_machine

HEAD = """# Bundled machines

Use a name wherever a command takes MACHINE; `hydroopt models` prints this list. Every number in a file has its source;
many are assumptions, which the last column counts.

| name | machine | joints | actuators | assumed sources |
|---|---|---|---|---|
"""


def pages() -> dict[str, str]:
    """Text of the page by its path below ``docs/generated``."""
    rows = []
    for name in bundled():
        machine = load_machine(name)
        sources = [note.source for note in machine.notes.values() if note.source]
        assumed = sum(source.startswith("assumed") for source in sources)
        rows.append(f"| `{name}` | {cell(machine.description)} | {len(machine.joints)} | {len(machine.actuators)} "
                    f"| {assumed} of {len(sources)} |")
    return {"machines.md": HEAD + "\n".join(rows) + "\n"}
