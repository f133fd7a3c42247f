"""Sets of inertial parameters that a machine file states beside each other, of which one is chosen."""

from __future__ import annotations

from typing import Any

from hydroopt.errors import MachineError
from hydroopt.machine.links import Body
from hydroopt.machine.quantity import Noun


class CylinderBodies(Noun):
    """The bodies of a cylinder in a set of inertial parameters; of a link a set states the body itself."""

    barrel: Body | None = None
    """Its barrel's."""
    rod: Body | None = None
    """Its rod's."""


def expand(data: dict[str, Any], wanted: str | None, where: str) -> dict[str, str]:
    """Put the chosen bodies in their places of a description that was validated.

    Returns:
        Which place of the machine stands where in the file.

    Raises:
        MachineError: there is no such set, or any of the sets names a part that there is not, or one of the other kind.
    """
    sets, default = data.pop("parameter_sets", {}), data.pop("default_parameter_set", "")
    chosen, moved = wanted or default, dict[str, str]()
    if chosen and chosen not in sets:
        raise MachineError(f"there is no parameter set '{chosen}'", where=where,
                           remedy=f"the file has: {', '.join(sets) or 'none'}")
    links, cylinders = ({part["name"]: part for part in data.get(kind, [])} for kind in ("links", "cylinders"))
    for given, bodies in sets.items():
        for name, stated in bodies.items():
            there = f"parameter_sets.{given}.{name}"
            ends = stated.keys() <= CylinderBodies.model_fields.keys()
            if name not in (cylinders if ends else links):
                other = {True: "a link: state its body", False: "a cylinder: state the bodies of 'barrel' and 'rod'"}
                raise MachineError(f"parameter set '{given}' names '{name}', which does not exist"
                                   if name not in {*links, *cylinders} else f"'{name}' is {other[ends]}",
                                   where=f"{where}: {there}", remedy="name a link or a cylinder, and what it has")
            if given == chosen and not ends:
                links[name]["body"] = stated
                moved[f"links[{name}].body"] = there
            for end, body in stated.items() if given == chosen and ends else ():
                cylinders[name][end]["body"] = body
                moved[f"cylinders[{name}].{end}.body"] = f"{there}.{end}"
    if chosen:
        data["parameter_set"] = chosen
    return moved
