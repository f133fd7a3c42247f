"""Cylinders that share oil, by name: a slave follows a master, as the links, loops and coupling that they stand for.

Oil that is shut in between two chambers keeps its volume: with the areas A of the chambers and a sign s of +1 at a
head's and −1 at a rod's side, s_m·A_m·Δl_m + s_s·A_s·Δl_s = 0. Its pressure does no work over both cylinders
together, so that no equation of motion contains it.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any, Literal

from pydantic import Field, field_validator

from hydroopt.errors import MachineError
from hydroopt.machine.links import Attachment, JointFriction
from hydroopt.machine.quantity import ImpossibleError, Length, Name, Noun, Position
from hydroopt.units import to_si

Line = Literal["head to head", "head to rod", "rod to head", "rod to rod"]
"""From a chamber of the master to one of the slave."""
ALIKE = 0.01
"""Two lines between the same cylinders must displace alike but for this part."""


class OilCylinder(Noun):
    """A cylinder that shares oil with another one."""

    name: Name
    """Name; `NAME_barrel`, `NAME_length` and `NAME_rod` are its links."""
    barrel: Attachment
    """Where its barrel is pinned."""
    rod: Attachment
    """Where its rod is pinned."""
    bore: Length
    """Diameter of the piston."""
    rod_diameter: Length
    """Diameter of the rod."""
    length: Length
    """Length between its pins while the other cylinder has its stated length."""
    dead_length: Length | None = None
    """Length when retracted."""
    stroke: Length | None = None
    """How much longer it can be; checked over the whole range, with `dead_length`."""
    friction: JointFriction | None = None
    """Friction along it."""

    def _mistakes(self) -> Iterator[ImpossibleError]:
        if not 0 < self.rod_diameter < self.bore:
            yield ImpossibleError("the rod is not thinner than the bore", "correct the two", "rod_diameter")
        if (self.dead_length is None) != (self.stroke is None):
            missing = "stroke" if self.stroke is None else "dead_length"
            yield ImpossibleError(f"'{missing}' is missing", "state dead_length and stroke, or neither")

class OilLink(Noun):
    """A slave cylinder that follows a master, since oil is shut in between chambers of the two; links, loops and a
    coupling stand for them."""

    name: Name
    """Name, also of the coupling."""
    lines: tuple[Line, ...] = Field(min_length=1, max_length=2)
    """Which chambers share oil, from the master's to the slave's: one or two of `head to head`, `head to rod`,
    `rod to head`, `rod to rod`."""
    master: OilCylinder
    """The cylinder that drives."""
    slave: OilCylinder
    """The cylinder that follows; it moves a joint that the file states as dependent."""
    posture: dict[str, Position]
    """Positions of joints near a posture in which the loops are closed."""

    @field_validator("lines", mode="before")
    @classmethod
    def _lines(cls, stated: Any) -> Any:
        return (stated,) if isinstance(stated, str) else stated


def expand(data: dict[str, Any], where: str) -> dict[str, str]:
    """Put links, loops and couplings in the place of the oil links of a description that was validated.

    A cylinder ``leveller`` becomes the barrel ``leveller_barrel``, which turns, and the rod ``leveller_rod`` behind the
    joint ``leveller_length``, which slides. The joint that the slave moves is one that the file states as dependent.

    Returns:
        Which place of the machine stands where in the file.

    Raises:
        MachineError: a link does not exist, or two lines contradict each other.
    """
    moved: dict[str, str] = {}
    for link in data.pop("oil_links", []):
        own = f"oil_links[{link['name']}]"
        at = f"{where}: {own}"
        names, loops = [], data.setdefault("loops", [])
        for role in ("master", "slave"):
            cylinder = link[role]
            name = cylinder["name"]
            between = _between(data, cylinder, f"{at}.{role}")
            posture = {joint: value for joint, value in link["posture"].items() if joint in between or role == "slave"}
            if role == "master":
                posture[f"{name}_length"] = cylinder["length"]
            data["links"] += _links(data, cylinder, name, between, _limits(cylinder))
            loops.append({"name": name, "link": f"{name}_rod", "posture": posture,
                          "to": {"link": cylinder["rod"]["link"], "pin": cylinder["rod"]["pin"]}})
            moved |= {f"loops[{name}].to.pin": f"{own}.{role}.rod.pin", f"loops[{name}].posture": f"{own}.posture",
                      f"loops[{name}]": f"{own}.{role}", f"links[{name}_barrel]": f"{own}.{role}",
                      f"links[{name}_seat]": f"{own}.{role}.barrel", f"links[{name}_length]": f"{own}.{role}"}
            names.append(name)
        ratio = _ratio(link, at)
        lengths = [_metres(link[role], "length") for role in ("master", "slave")]
        data.setdefault("couplings", []).append({
            "name": link["name"], "joint": f"{names[1]}_length", "ratios": {f"{names[0]}_length": f"{ratio!r}"},
            "offset": f"{lengths[1] - ratio * lengths[0]!r} m"})
        moved[f"couplings[{link['name']}]"] = own
    return moved


def _links(data: Mapping[str, Any], cylinder: Mapping[str, Any], name: str, between: list[str],
           limits: Mapping[str, str]) -> list[dict[str, Any]]:
    """Barrel, slide and rod; the frames of barrel and rod have x along the centre line from barrel pin to rod pin."""
    barrel, rod = cylinder["barrel"], cylinder["rod"]
    carrier: dict[str, Any] = next((link for link in data["links"] if link.get("name") == barrel["link"]), {})
    after = next(link for link in data["links"] if link.get("name") in between)
    # the axis of a joint at its parent's far end stands as this far end does
    turn: dict[str, Any] = {}
    if after.get("parent") == barrel["link"] and "pin" not in after:
        turn = {key: carrier["joint"][key] for key in ("alpha", "beta") if key in carrier.get("joint", {})}
    own = {"body": barrel["body"]} if "body" in barrel else {}
    end = {"body": rod["body"]} if "body" in rod else {}
    rubs = {"friction": cylinder["friction"]} if "friction" in cylinder else {}
    return [{"name": f"{name}_seat", "parent": barrel["link"], "pin": barrel["pin"],
             "joint": {"type": "locked", **turn}},
            {"name": f"{name}_barrel", "parent": f"{name}_seat", **own,
             "joint": {"type": "revolute", "dependent": True, "beta": "90 deg"}},
            {"name": f"{name}_length", "parent": f"{name}_barrel",
             "joint": {"type": "prismatic", "dependent": True, "beta": "-90 deg", **limits, **rubs}},
            {"name": f"{name}_rod", "parent": f"{name}_length", "joint": {"type": "locked"}, **end}]


def _limits(cylinder: Mapping[str, Any]) -> dict[str, str]:
    """Shortest and longest that a cylinder can be, where it states its stroke."""
    if "stroke" not in cylinder:
        return {}
    dead, stroke = (_metres(cylinder, key) for key in ("dead_length", "stroke"))
    return {"lower": f"{dead!r} m", "upper": f"{dead + stroke!r} m"}


def _between(data: Mapping[str, Any], cylinder: Mapping[str, Any], where: str) -> list[str]:
    """Links on the way between those that a cylinder is pinned to, in the order of the file."""
    parents = {link.get("name"): link.get("parent") for link in data.get("links", [])}
    chains = []
    for end in ("barrel", "rod"):
        name, chain = cylinder[end]["link"], []
        if name != "base" and name not in parents:
            raise MachineError(f"'{name}' does not exist", where=f"{where}.{end}.link",
                               remedy="name a link or the base")
        while name in parents and name not in chain:
            chain.append(name)
            name = parents[name]
        chains.append(chain)
    apart = set(chains[0]) ^ set(chains[1])
    if not apart:
        raise MachineError("no moving joint lies between the two ends", where=where,
                           remedy="pin its ends to links that move relative to each other")
    return [name for name in parents if name in apart]


def _ratio(link: Mapping[str, Any], at: str) -> float:
    """What the slave lengthens per lengthening of the master."""
    areas = []
    for role in ("master", "slave"):
        bore, rod = (_metres(link[role], key) for key in ("bore", "rod_diameter"))
        areas.append({"head": bore**2, "rod": bore**2 - rod**2})
    lines = link["lines"] if isinstance(link["lines"], list) else [link["lines"]]
    signs = {"head": 1.0, "rod": -1.0}
    ends = [line.split(" to ") for line in lines]
    ratios = [-signs[one] * areas[0][one] / (signs[other] * areas[1][other]) for one, other in ends]
    if abs(ratios[-1] - ratios[0]) > ALIKE * abs(ratios[0]):
        raise MachineError(f"the two lines contradict each other: per metre of the master the slave lengthens "
                           f"{ratios[0]:.3f} m by '{lines[0]}', {ratios[1]:.3f} m by '{lines[1]}'",
                           where=f"{at}.lines", remedy="correct bores and rods, or remove the line that is not shut in")
    return ratios[0]


def _metres(table: Mapping[str, Any], key: str) -> float:
    stated = table[key]["value"] if isinstance(table[key], dict) else table[key]
    return to_si(stated, "m", where=key)
