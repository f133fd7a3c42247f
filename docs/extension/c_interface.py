"""The reference of the generated C, from what `hydroopt codegen` writes for one machine."""

from __future__ import annotations

from extension.text import cell
from hydroopt.codegen import parameter_source
from hydroopt.codegen.folder import Code

MACHINE = "cat215b"


def pages() -> dict[str, str]:
    """Table of the functions, and the header, by their paths below ``docs/generated``."""
    machine, origin = parameter_source.read(MACHINE)
    code = Code(machine, origin, single=True)
    rows = [f"| `{each.name}` | {cell(each.text)} | `{each.takes}`: {', '.join(each.reads)} → `{each.gives}` |"
            for each in code.routines.values()]
    table = [f"Names begin with that of the machine, here `{code.name}_`.", "",
             "| function | what it does | reads → writes |", "|---|---|---|", *rows, ""]
    return {"c_functions.md": "\n".join(table), f"{code.name}.h": code.header}
