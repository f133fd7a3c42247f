"""Which calibrator to build, and where its ball stands: a bracket, links in series, a sensor at each joint, a ball."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np

from hydroopt.errors import ProblemError
from hydroopt.excitation.selection.pose_problem import CombinatorialProblem
from hydroopt.limits.reserves import DEFAULT, Reserves
from hydroopt.machine.links import Note
from hydroopt.machine.machine import Machine
from hydroopt.machine.machine_file import GivenMachine, machine_of
from hydroopt.model.closed_chain import KinematicModel

BRACKET = "calibrator_bracket"
"""Name of the rigid part that carries the first joint."""
DESIGNED = "designed by hydroopt"
"""Source of the numbers of a designed calibrator."""
FEWEST = 3
"""Sensed joints without which the loop's error would not be known in all directions."""
MOST = 6
"""Links at most."""
NEAR = 1.0
"""How far [m] from the stated fixture the ball may stand, if nothing else is said."""
UNIT = 1e-3
"""Deviation [m] in which lengths are compared, if none is asked for."""


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
             keep: Sequence[str] = ()) -> Machine:
    """A machine that carries a calibrator of a construction instead of its own.

    Args:
        machine: that states a calibrator, of which the links `keep` stay, in their order.
        construction: what is built.
        values: of its sizes [rad, m] by address.
        workshop: how accurately.
        keep: links of the machine's own calibrator that belong to the machine, such as a grapple.

    Raises:
        MachineError: no machine can have these numbers.
    """
    old = machine.calibrator
    assert old is not None
    own = {link.name: link for link in old.links}
    links: list[dict[str, Any]] = [own[name].model_dump() for name in own if name in keep]
    before = links[-1]["name"] if links else old.parent
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
    data |= {"calibrator": {"parent": old.parent, "links": links}, "fixtures": [{"name": fixture, "position": place}],
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


@dataclass(frozen=True, eq=False)
class CalibratorProblem(CombinatorialProblem):
    """Which calibrator determines the machine's lengths well enough, at least cost; solving never changes it.

    Attributes:
        machine: states stages, what is uncertain, and the limits.
        count: poses of each stage.
        length_std: standard deviations [m] asked for by length; where `least` is set they only weigh, and the largest
            deviation in these units is made as small as possible.
        links: fewest and most links of the calibrator, each with a joint and a sensor.
        sensors: joint sensors that can be bought.
        link_cost: what a link costs, without its sensor.
        workshop: what can be built, and where the ball may stand.
        keep: links of the machine's own calibrator that belong to the machine, such as a grapple.
        priors: whether the machine file's confidences count as measurements.
        fixed: parameters that are held, with their values [SI].
        reserves: that each posture keeps of the machine's limits; the calibrator's joints keep its clearance, too.

    >>> import hydroopt
    >>> hydroopt.calibrator_problem(hydroopt.load_machine("cat215b"), 40, length_std=2e-3, keep=("grapple_swing",))
    <CalibratorProblem of cat215b: 3 to 6 links, 40 poses of each stage, lengths to 2 mm>
    """

    machine: Machine
    count: int
    length_std: Mapping[str, float]
    links: tuple[int, int]
    sensors: tuple[SensorOffer, ...]
    workshop: Workshop
    link_cost: float = 1.0
    keep: tuple[str, ...] = ()
    least: bool = False
    priors: bool = True
    fixed: Mapping[str, float] = field(default_factory=dict)
    reserves: Reserves = DEFAULT

    def constructions(self) -> Iterator[tuple[float, Construction]]:
        """Kinds of calibrators with one kind of sensor, with their cost, the cheapest first; which axes cross is left
        open."""
        found = [(self.cost(construction), construction) for count in range(self.links[0], self.links[1] + 1)
                 for offer in self.sensors for construction in (Construction((False,) * count, (offer,) * count),)]
        yield from sorted(found, key=lambda each: (each[0], each[1].links, each[1].sensors[0].accuracy))

    def cost(self, construction: Construction) -> float:
        """Of all links and sensors."""
        return construction.links * self.link_cost + sum(offer.cost for offer in construction.sensors)

    @property
    def asked(self) -> str:
        """What is asked for in words."""
        if self.least:
            return "largest deviation of a length as small as possible"
        sizes = {1e3 * each for each in self.length_std.values()}
        return (f"lengths to {sizes.pop():.3g} mm" if len(sizes) == 1 else
                ", ".join(f"{name} to {1e3 * each:.3g} mm" for name, each in self.length_std.items()))

    def __repr__(self) -> str:
        few, many = self.links
        return (f"<CalibratorProblem of {self.machine.name}: {few if few == many else f'{few} to {many}'} links, "
                f"{self.count} poses of each stage, {self.asked}>")

    def __str__(self) -> str:
        low, high = self.workshop.site
        return "\n".join([
            f"calibrator for {self.machine.name}: {self.asked}",
            "variables",
            f"  {self.links[0]} to {self.links[1]} links with length, offset, twist and zero of the encoder",
            f"  bracket up to {self.workshop.bracket:g} m, links up to {self.workshop.longest:g} m",
            "  sensors of " + ", ".join(f"{np.degrees(each.accuracy):.3g} deg ({each.cost:g})"
                                         for each in self.sensors),
            f"  ball within {', '.join(f'{a:.3g} to {b:.3g} m' for a, b in zip(low, high, strict=True))}",
            f"  {self.count} postures of each stage",
            "minimise", "  the largest deviation" if self.least else
            f"  cost: {self.link_cost:g} for a link, and its sensor",
            "subject to", "  each posture closes its loop", "  limits of joints and strokes",
            "  reserves of the machine's other limits",
            "  no singular pose of the calibrator"])


def calibrator_problem(machine: GivenMachine, count: int, *, length_std: float | Mapping[str, float] | None = None,
                       links: tuple[int, int] = (FEWEST, MOST), sensors: Sequence[SensorOffer] = (),
                       link_cost: float = 1.0, keep: Sequence[str] = (), workshop: Workshop | None = None,
                       priors: bool = True, fixed: Mapping[str, float] | None = None,
                       reserves: Reserves = DEFAULT) -> CalibratorProblem:
    """Which calibrator to build for a machine, with which poses.

    Args:
        machine: states a calibrator (its place on the machine counts, and its links `keep`), fixture, stages, limits,
            and what is uncertain.
        count: poses of each stage.
        length_std: standard deviation [m] to reach for all lengths of the machine's links, or for some by name; without
            it the largest is made as small as possible.
        links: fewest and most links that the calibrator gets.
        sensors: that can be bought; by default one as accurate as the machine's own calibrator has.
        link_cost: of a link, in the same currency as the sensors.
        keep: links of the machine's own calibrator that belong to the machine.
        workshop: what can be built where; by default links as long as those of the machine's own calibrator, exact, and
            a ball within 1 m of its fixture and above ground.
        priors: whether the machine file's confidences count as measurements.
        fixed: values [SI] of parameters that are held.
        reserves: that each posture keeps of the machine's limits.

    Raises:
        ProblemError: the machine states no calibrator or fixture, there is no such length or link, or a number is not
            positive.

    >>> import hydroopt
    >>> crane = hydroopt.load_machine("cat215b")
    >>> problem = hydroopt.calibrator_problem(crane, 30, length_std={"swing.a": 2e-3}, links=(4, 5))
    >>> [(cost, each.links) for cost, each in problem.constructions()]
    [(8.0, 4), (10.0, 5)]
    >>> problem.cost(next(problem.constructions())[1])
    8.0
    """
    machine = machine_of(machine, "calibrator_problem")
    where = f"machine '{machine.name}'"
    own = machine.calibrator
    if own is None:
        raise ProblemError("it states no calibrator, so that nothing says which link carries it", where=where,
                           remedy="state 'calibrator' with its 'parent', if need be without links")
    names = [link.name for link in own.links]
    made = {BRACKET, *(f"calibrator_{k}" for k in range(1, MOST + 1))}
    if taken := {link.name for link in machine.links} & made - set(names):
        raise ProblemError(f"it has a link '{taken.pop()}'", where=where, remedy="give the link another name")
    for name in keep:
        if name not in names:
            raise ProblemError("the machine's own calibrator has no such link", where=f"keep '{name}'",
                               remedy=f"use {', '.join(names) or 'none'}")
    own_sensors = sum(machine.sensor(f"{name}.q") is not None for name in keep)
    low, high = links
    if not 1 <= low <= high <= MOST or own_sensors + high < FEWEST:
        raise ProblemError(f"{low} to {high} links are not possible", where="links",
                           remedy=f"give a range within {max(1, FEWEST - own_sensors)} to {MOST}")
    low = max(low, FEWEST - own_sensors)
    chosen = tuple(sensors) or _own_offer(machine)
    workshop = workshop or usual_workshop(machine)
    _refuse(machine, count, link_cost, chosen, workshop)
    asked = _asked(machine, length_std, dict(fixed or {}))
    return CalibratorProblem(machine, count, asked, (low, high), chosen, workshop, link_cost,
                             tuple(keep), length_std is None, priors, dict(fixed or {}), reserves.checked())


def _refuse(machine: Machine, count: int, link_cost: float, sensors: Sequence[SensorOffer], workshop: Workshop) -> None:
    """Refuse numbers that nothing can be built by."""
    for positive, value, what in (
            (True, count, "poses"), (True, workshop.longest, "longest link"), (True, workshop.span, "span of a joint"),
            *((True, each.accuracy, "accuracy of a sensor") for each in sensors), (False, link_cost, "cost of a link"),
            *((False, each.cost, "cost of a sensor") for each in sensors),
            (False, workshop.length_error, "error of lengths"), (False, workshop.angle_error, "error of angles")):
        if not (np.isfinite(value) and value >= 0) or (positive and value == 0):
            raise ProblemError(f"{value:g} is not possible", where=what,
                               remedy=f"give a {'positive number' if positive else 'number from 0 on'}")
    for axis, low, high in zip("xyz", *workshop.site, strict=True):
        if not low <= high:
            raise ProblemError(f"{low:g} m is above {high:g} m", where=f"place of the ball along {axis}",
                               remedy="give the lower end first")
    if machine.ground is not None and workshop.site[1][2] < machine.ground:
        raise ProblemError(f"it lies below the ground, at {machine.ground:g} m", where="place of the ball along z",
                           remedy="give heights in the base frame")


def usual_workshop(machine: Machine) -> Workshop:
    """Links as long as those of the machine's own calibrator, exact, and a ball near its fixture and above ground.

    Raises:
        ProblemError: the machine states no fixture.
    """
    if not machine.fixtures:
        raise ProblemError("it states no fixture near which the ball could stand", where=f"machine '{machine.name}'",
                           remedy="state a fixture, or where the ball may stand")
    place, ground = machine.fixtures[0].position, -np.inf if machine.ground is None else machine.ground
    low = (place[0] - NEAR, place[1] - NEAR, max(place[2] - NEAR, ground))
    high = (place[0] + NEAR, place[1] + NEAR, place[2] + NEAR)
    own = machine.calibrator.links if machine.calibrator else ()
    longest = max((abs(value) for link in own for value in (link.joint.a, link.joint.d)), default=0.0)
    return Workshop(longest or 3.0, (low, high))


def _own_offer(machine: Machine) -> tuple[SensorOffer, ...]:
    """The sensor of the last joint of the machine's own calibrator."""
    own = machine.calibrator.links if machine.calibrator else ()
    found = [sensor for link in own if (sensor := machine.sensor(f"{link.name}.q")) is not None]
    if not found:
        raise ProblemError("the machine's own calibrator has no sensor", where=f"machine '{machine.name}'",
                           remedy="say which sensors can be bought")
    return (SensorOffer(found[-1].accuracy),)


def _asked(machine: Machine, length_std: float | Mapping[str, float] | None,
           fixed: Mapping[str, float]) -> dict[str, float]:
    """Standard deviations [m] by length."""
    parameters = KinematicModel(machine).parameters
    carried = set(machine.ancestry(machine.calibrator.parent)) if machine.calibrator else set()
    lengths = [name for name in parameters.names if name.rpartition(".")[2] in ("a", "d")
               and name.rpartition(".")[0] in carried and name not in fixed]
    if not lengths:
        raise ProblemError("it states no length as uncertain", where=f"machine '{machine.name}'",
                           remedy="state the 'sigma' of lengths 'a' or offsets 'd' of its links")
    asked = dict(length_std) if isinstance(length_std, Mapping) else dict.fromkeys(
        lengths, UNIT if length_std is None else length_std)
    for name, value in asked.items():
        if name not in lengths:
            raise ProblemError("this is not an uncertain length of a link", where=f"length '{name}'",
                               remedy=f"use {', '.join(lengths)}")
        if not (np.isfinite(value) and value > 0):
            raise ProblemError(f"the accuracy {value:g} m is not positive", where=f"length '{name}'",
                               remedy="give a positive length")
    return asked
