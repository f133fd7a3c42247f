"""What a calibrator is built of: a bracket, links in series, a sensor at each joint, a ball on the ground."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from hydroopt.errors import ProblemError
from hydroopt.machine.links import Note
from hydroopt.machine.machine import Machine

BRACKET = "calibrator_bracket"
"""Name of the rigid part that carries the first joint."""
DESIGNED = "designed by hydroopt"
"""Source of the numbers of a designed calibrator."""


class SensorOffer(NamedTuple):
    """A joint sensor that can be bought: its accuracy [rad], the bound of a uniform error, and its cost.

    >>> import hydroopt
    >>> offers = hydroopt.SensorOffer(1.7e-3, cost=120.0), hydroopt.SensorOffer(2e-4, cost=900.0)
    >>> hydroopt.calibrator_problem("cat215b", 20, links=(3, 4), sensors=offers).links
    (3, 4)
    """

    accuracy: float
    cost: float = 1.0


class Construction(NamedTuple):
    """A kind of calibrator: which axes cross at right angles the one before, and the sensor of each joint."""

    crossing: tuple[bool, ...]
    sensors: tuple[SensorOffer, ...]

    @property
    def links(self) -> int:
        """Number of links, each with a joint and its sensor."""
        return len(self.crossing)

    @property
    def names(self) -> tuple[str, ...]:
        """Of the links, and of their joints."""
        return tuple(f"calibrator_{k + 1}" for k in range(self.links))


class Size(NamedTuple):
    """A number of a calibrator that is chosen: its address, its unit, and the range that it is chosen from."""

    name: str
    unit: str
    lower: float
    upper: float


@dataclass(frozen=True)
class Workshop:
    """What may be built, and how accurately.

    Attributes:
        longest: greatest length and offset of a link [m]; `bracket` that of the bracket.
        span: by how much a joint can turn in all [rad].
        length_error, angle_error: standard deviations to which lengths [m], and twists and zeros of the encoders [rad],
            are known after assembly; 0 where they are exact.
        site: lower and upper corner (3,) [m] in the base frame of where the ball may stand.
        clearance: least height of the calibrator's joints above ground [m].

    >>> import hydroopt
    >>> workshop = hydroopt.Workshop(longest=2.5, site=((2, 0, -1.4), (4, 0, -0.3)), length_error=5e-4)
    >>> hydroopt.calibrator_problem("cat215b", 20, workshop=workshop).workshop.longest
    2.5
    """

    longest: float
    site: tuple[tuple[float, float, float], tuple[float, float, float]]
    bracket: float = 0.3
    span: float = float(np.radians(200.0))
    length_error: float = 0.0
    angle_error: float = 0.0
    clearance: float = 0.1


def sizes(construction: Construction, workshop: Workshop, fixture: str) -> Iterator[Size]:
    """Everything that is chosen of a calibrator whose ball stands in a fixture."""
    for name, most in ((BRACKET, workshop.bracket), *((name, workshop.longest) for name in construction.names)):
        yield Size(f"{name}.theta", "rad", -np.pi, np.pi)
        yield Size(f"{name}.d", "m", -most, most)
        yield Size(f"{name}.a", "m", 0.0, most)
    for axis, low, high in zip("xyz", *workshop.site, strict=True):
        yield Size(f"{fixture}.{axis}", "m", low, high)


def fixture_of(machine: Machine) -> str:
    """Name of the fixture that holds the ball."""
    return machine.fixtures[0].name if machine.fixtures else "ball"


def carrying(machine: Machine, construction: Construction, values: Mapping[str, float], workshop: Workshop,
             keep: Sequence[str] = (), parent: str = "") -> Machine:
    """A machine that carries a calibrator of a construction instead of its own.

    Args:
        machine: any; of its own calibrator the links `keep` stay, in their order.
        construction: what is built.
        values: of its sizes [rad, m] by address.
        workshop: how accurately.
        keep: links of the machine's own calibrator that belong to the machine, such as a grapple.
        parent: link that carries the calibrator, by default the one that carries the machine's own.

    Raises:
        ProblemError: no such link, or none that carries a calibrator.
        MachineError: no machine can have these numbers.
    """
    old = machine.calibrator
    own = {link.name: link for link in old.links} if old else {}
    for name in keep:
        if name not in own:
            raise ProblemError("the machine's own calibrator has no such link", where=f"keep '{name}'",
                               remedy=f"use {', '.join(own)}" if own else "leave it out")
    carrier = parent or (old.parent if old else "")
    if carrier not in {link.name for link in machine.links}:
        raise ProblemError(f"the machine has no link '{carrier}'" if carrier else "it states no calibrator",
                           where=f"machine '{machine.name}'", remedy="name the link that carries the calibrator")
    links: list[dict[str, Any]] = [own[name].model_dump() for name in own if name in keep]
    before = links[-1]["name"] if links else carrier
    twist = [0.5 * np.pi * crossing for crossing in construction.crossing] + [0.0]
    half = workshop.span / 2
    for k, name in enumerate((BRACKET, *construction.names)):
        joint = {"type": "revolute", "lower": -half, "upper": half} if k else {"type": "locked"}
        links.append({"name": name, "parent": before, "joint": joint | {
            "alpha": twist[k], **{key: values[f"{name}.{key}"] for key in ("theta", "d", "a")}}})
        before = name
    gone, fixture = set(own) - set(keep), fixture_of(machine)
    fixtures = {each.name for each in machine.fixtures} - {fixture}
    data = machine.model_dump(exclude={"notes"})
    place = tuple(values[f"{fixture}.{axis}"] for axis in "xyz")
    data |= {"calibrator": {"parent": carrier, "links": links}, "fixtures": [{"name": fixture, "position": place}],
             "distances": [each for each in data["distances"] if not fixtures & {*each["between"]}],
             "sensors": _sensors(data["sensors"], gone, construction), "stages": _without(data["stages"], gone)}
    lost = {each.name for each in machine.distances} - {each["name"] for each in data["distances"]}
    notes = {path: note for path, note in machine.notes.items()
             if path.partition(".")[0] not in {*gone, *lost, "sensors", "calibrator"}}
    notes |= {f"{name}.joint.{key}": Note(sigma=sigma or None, source=DESIGNED)
              for name in (BRACKET, *construction.names)
              for key, sigma in (("theta", workshop.angle_error), ("alpha", workshop.angle_error),
                                 ("d", workshop.length_error), ("a", workshop.length_error))
              if (name, key) != (construction.names[-1], "alpha")}
    notes.setdefault(f"{fixture}.position", Note(sigma=0.1, source=DESIGNED))
    return Machine.model_validate(data | {"notes": notes})


def _sensors(stated: Sequence[Mapping[str, Any]], gone: set[str], construction: Construction) -> list[dict[str, Any]]:
    """Sensors without those of joints that are gone, and with the construction's; resolution as those that are gone."""
    kept, steps = [], [0.0]
    for sensor in stated:
        channels = tuple(each for each in sensor["channels"] if each.removesuffix(".q") not in gone)
        if len(channels) < len(sensor["channels"]):
            steps.append(sensor["resolution"])
        if channels:
            kept.append({**sensor, "channels": channels})
    return kept + [{"channels": (f"{name}.q",), "accuracy": offer.accuracy, "resolution": max(steps)}
                   for name, offer in zip(construction.names, construction.sensors, strict=True)]


def _without(stages: Sequence[Mapping[str, Any]], gone: set[str]) -> list[dict[str, Any]]:
    """Stages without joints that are gone."""
    return [{**stage, "moves": tuple(name for name in stage["moves"] if name not in gone),
             "locked": {name: angle for name, angle in stage["locked"].items() if name not in gone}}
            for stage in stages]
