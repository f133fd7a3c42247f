"""Sets of inertial parameters that a machine file states beside each other, of which one is chosen."""

from __future__ import annotations

from typing import Any

from hydroopt.errors import MachineError
from hydroopt.machine.links import Body
from hydroopt.machine.quantity import Noun
from hydroopt.machine.stated_tables import table


class CylinderBodies(Noun):
    """The bodies of a cylinder in a set of inertial parameters; of a link a set states the body itself."""

    barrel: Body | None = None
    """Its barrel's."""
    rod: Body | None = None
    """Its rod's."""


def expand(data: dict[str, Any], wanted: str | None, where: str) -> dict[str, str]:
    """Put the chosen bodies in their places; returns which place of the machine stands where in the file."""
    sets, default = data.pop("parameter_sets", {}), data.pop("default_parameter_set", None)
    chosen = wanted or default
    if chosen is None:
        return {}
    if not isinstance(sets, dict) or str(chosen) not in sets:
        have = ", ".join(sets) if isinstance(sets, dict) and sets else "none"
        raise MachineError(f"there is no parameter set '{chosen}'", where=where, remedy=f"the file has: {have}")
    data["parameter_set"] = chosen
    parts = [(kind, part) for kind in ("links", "cylinders") if isinstance(data.get(kind), list)
             for part in data[kind] if isinstance(part, dict)]
    moved = {}
    for name, stated in table(sets[chosen], f"{where}: parameter_sets.{chosen}").items():
        there = f"parameter_sets.{chosen}.{name}"
        found = [(kind, part) for kind, part in parts if part.get("name") == name]
        if not found:
            raise MachineError(f"parameter set '{chosen}' names '{name}', which does not exist", where=where,
                               remedy="name a link or a cylinder")
        if len(found) > 1:
            raise MachineError(f"the name '{name}' is used {len(found)} times", where=where,
                               remedy="give each part a name of its own")
        kind, part = found[0]
        table(stated, f"{where}: {there}")
        if kind == "links":
            part["body"] = stated
            moved[f"links[{name}].body"] = there
            continue
        for end, body in stated.items():
            if end not in CylinderBodies.model_fields:
                raise MachineError("this key is unknown", where=f"{where}: {there}.{end}",
                                   remedy="give the bodies of 'barrel' and 'rod'")
            if isinstance(part.get(end), dict):
                part[end]["body"] = body
                moved[f"cylinders[{name}].{end}.body"] = f"{there}.{end}"
    return moved
