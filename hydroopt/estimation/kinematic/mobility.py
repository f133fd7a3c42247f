"""Mobility of closed chains, identifiability from their poses, and defects of a set-up (Sections 3.3.2 and 3.6.4).

Everything is derived from random closed postures of the machine file's nominal geometry, read without noise: mobility
from the rank of the loop's Jacobian, identifiability from that of the linearised calibration problem.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from hydroopt.errors import ProblemError
from hydroopt.estimation.inference.identifiability import RANK_TOLERANCE
from hydroopt.estimation.kinematic.observability import Linearised, linearise, observability
from hydroopt.estimation.kinematic.pose_checks import PLAY, has_length_scale, no_length_scale
from hydroopt.estimation.kinematic.problem import CalibrationProblem, calibration_problem
from hydroopt.logs.poses import joined
from hydroopt.machine.actuators import Cylinder
from hydroopt.machine.calibration_chain import Fixture, Stage
from hydroopt.machine.links import Note
from hydroopt.machine.machine import Machine
from hydroopt.model.closed_chain import KinematicModel, recent_chain
from hydroopt.simulation import postures
from hydroopt.spatial.inertia import Array

TRIES = 20
"""Random postures that are tried for each one wanted."""
POSES = "poses"
"""Name of the only stage of a machine that states none: all its sensed joints move."""


@dataclass(frozen=True, kw_only=True)
class Identified:
    """Which parameters poses without noise identify alone, which only together, and which not at all.

    `rank` is the number of independent combinations that they identify.
    """

    rank: int = 0
    full: tuple[str, ...] = ()
    combinations: tuple[tuple[str, ...], ...] = ()
    none: tuple[str, ...] = ()

    def lines(self) -> Iterator[str]:
        """In words."""
        groups = "; ".join(" with ".join((group[0], ", ".join(group[1:]))) for group in self.combinations)
        for title, names in (("alone", ", ".join(self.full)), ("in combination", groups),
                             ("no trace", ", ".join(self.none))):
            if names:
                yield f"  {title}: {names}"


@dataclass(frozen=True, kw_only=True)
class StageMobility(Identified):
    """A stage's chain, and what its poses identify once earlier stages have identified theirs (Section 3.6.4).

    Attributes:
        moves: joints that move without being read; `sensed` those that are read, `locked` those that stand.
        grubler: mobility by counting joints (Eq. 3.5, of which Eq. 3.1 is the condition that it exceeds zero).
        rank_mobility: mobility by the loop's Jacobian; None where no closed posture was found.
        unsensed: freedoms without a sensor, the fixture's included.
    """

    stage: str
    moves: tuple[str, ...]
    sensed: tuple[str, ...]
    locked: tuple[str, ...]
    grubler: int
    rank_mobility: int | None
    unsensed: int

    @property
    def remark(self) -> str:
        """Why the two mobilities differ, if they do."""
        if self.rank_mobility is None:
            return ", no closed posture found"
        lost = self.rank_mobility - self.grubler
        return "" if lost == 0 else (f", {self.rank_mobility} by the loop's Jacobian: in this special geometry nothing "
                                     f"moves the tip in {_count(lost, 'direction')}")

    def lines(self) -> Iterator[str]:
        """In words."""
        parts = (("moves", self.moves), ("senses", self.sensed), ("locks", self.locked))
        yield f"stage {self.stage}: " + "; ".join(f"{verb} {', '.join(names)}" for verb, names in parts if names)
        yield f"  mobility: {self.grubler} (Eq. 3.5){self.remark}; freedoms without a sensor: {self.unsensed}"
        yield from super().lines()


@dataclass(frozen=True)
class Mobility:
    """All stages of a machine, what they identify together, what each cylinder's readings identify, and obstacles.

    `surveyed` is what poses identify that instruments, datums, tapes between targets and inclination measure as well.
    """

    machine: Machine
    stages: tuple[StageMobility, ...]
    together: Identified | None
    cylinders: dict[str, Identified]
    obstacles: tuple[str, ...]
    surveyed: Identified | None = None

    def lines(self) -> list[str]:
        """Plain text for a screen; none for a machine without calibrator and length sensors."""
        text = [line for stage in self.stages for line in stage.lines()]
        if self.together is not None and len(self.stages) > 1:
            text += ["all stages together:", *self.together.lines()]
        if self.surveyed is not None:
            text += [f"poses measured by {', '.join(_surveyors(self.machine))} identify "
                     f"{_count(self.surveyed.rank, 'number')}", *self.surveyed.lines()]
        for name, found in self.cylinders.items():
            count = _count(found.rank, "number")
            text += [f"{name}: lengths and joint angles identify {count} of its geometry (Eq. 3.26)", *found.lines()]
        return text + [f"! {obstacle}" for obstacle in self.obstacles if self.machine.calibrator]

    def as_dict(self) -> dict[str, Any]:
        """The same for JSON."""
        return {"stages": [asdict(stage) for stage in self.stages],
                "together": None if self.together is None else asdict(self.together),
                "cylinders": {name: asdict(found) for name, found in self.cylinders.items()},
                "obstacles": list(self.obstacles),
                "surveyed": None if self.surveyed is None else asdict(self.surveyed)}


def grubler(n: int, *, p: int, d: int, extra: int, t: int = 3) -> int:
    """Mobility m (Eq. 3.5) of n joints, of which p are powered and d of these move, on a fixture of t freedoms.

    `extra` is the number l of joints that the calibrator adds.
    """
    return (n - p) + d + t + extra - 6


def obstacles(machine: Machine) -> tuple[str, ...]:
    """Why a set-up cannot work: one sentence with its remedy for every reason."""
    return mobility(machine).obstacles


def mobility(machine: Machine, *, count: int = 30, seed: int = 0) -> Mobility:
    """Mobility and identifiability of a machine's kinematic calibration, from `count` poses of every stage and
    fixture."""
    cylinders = {cylinder.name: _triangle(machine, cylinder, count) for cylinder in machine.cylinders
                 if _read(machine, *_triangle_channels(machine, cylinder))}
    surveyed = _surveyed(machine, count, seed) if _surveyors(machine) and not machine.fixtures else None
    if machine.calibrator is None or not (machine.fixtures or machine.tracker):
        if surveyed is not None and surveyed.rank:
            return Mobility(machine, (), None, cylinders, (), surveyed)
        return Mobility(machine, (), None, cylinders, (str(ProblemError(
            "nothing closes the chain, so that no pose identifies any of its links", where=f"machine '{machine.name}'",
            remedy="state a calibrator with a fixture or a tracker")),))
    still = tuple(stage.model_copy(update={"drift": 0.0}) for stage in machine.stages)
    model, rng = KinematicModel(machine.model_copy(update={"stages": still})), np.random.default_rng(seed)
    visits = [_Visit(model, stage, count, rng) for stage in still or (Stage(name=POSES),)]
    where: dict[tuple[str, str], list[str]] = {}  # a reason and its remedy: the stages that it concerns
    for visit in visits:
        for reason in visit.reasons():
            where.setdefault(reason, []).append(visit.stage.name)
    sentences = [str(ProblemError(what, where=_named("stage", names), remedy=remedy))
                 for (what, remedy), names in where.items()]
    found, together = [Identified() for _ in visits], None
    if any(len(visit.q) for visit in visits):
        try:
            survey = _Survey(visits)
            found, together = survey.in_turn([visit.stage.name for visit in visits]), survey.identified()
            if not has_length_scale(survey.problem, survey.linear):
                sentences.append(str(no_length_scale(
                    f"machine '{machine.name}'", "take a length as exact, the calibrator's, say, or state a distance "
                    "between two fixtures or the sensor of a tape, a tracker or a cylinder's length")))
        except ProblemError as error:
            sentences.append(str(error))
    stages = tuple(visit.described(own) for visit, own in zip(visits, found, strict=True))
    return Mobility(machine, stages, together, cylinders, tuple(sentences), surveyed)


def _surveyors(machine: Machine) -> list[str]:
    """Names of what measures poses without closing a chain: instruments, datums, tapes between targets, units."""
    parts = {each.name for each in machine.measuring}
    return list(dict.fromkeys(each.owner for each in recent_chain(machine).measurements
                              if each.owner in parts)) if parts else []


def _surveyed(machine: Machine, count: int, seed: int) -> Identified | None:
    """What so many random poses identify, and as many in which each target touches each datum that it is to touch; None
    where a joint is not read, so that only motion tells."""
    if not all(_read(machine, f"{joint}.q") for joint in machine.joints if joint not in machine.base_joints):
        return None
    model, rng = KinematicModel(machine), np.random.default_rng(seed)
    low, high = model.ranges.T
    q, touch = rng.uniform(low, high, (count, len(low))), [""] * count
    drive = [k for k in range(len(low)) if model.joints[k] not in machine.base_joints]
    channels = postures.measured_channels(model)
    for each in model.measurements:
        if each.tool == "datum" and set(each.channels) & set(channels):
            meeting, good = postures.close(model, model.parameters.nominal, q[:count], drive, each)
            q, touch = np.vstack([q, meeting[good]]), [*touch, *[each.name] * int(np.sum(good))]
    poses = postures.record(model, q, [POSES] * len(q), [""] * len(q), geometry=model.parameters.nominal, touch=touch,
                            channels=channels, seed=None)
    problem = calibration_problem(machine, poses, priors=False)
    problem = replace(problem, row_sigma=np.maximum(problem.row_sigma, PLAY))
    return _identified(problem, linearise(problem, problem.start, q), {
        name for name, hidden in zip(problem.parameters.names, problem.cylinder_parameters, strict=True) if hidden})


class _Visit:
    """A stage: what its joints do, and closed postures q (N, n) at the fixtures with the labels `fixture` (N,).

    Read are the calibrator's sensors and those of the machine's joints that the stage does not name, or all where the
    calibrator has none; tracker, tapes and cylinders' lengths too. `turning` are positions of joints that move,
    `unread` of those that are not read, `rows` of a pose's readings among the model's channels.
    """

    def __init__(self, model: KinematicModel, stage: Stage, count: int, rng: np.random.Generator) -> None:
        self.model, self.stage, self.fixtures = model, stage, model.machine.fixtures
        machine = model.machine
        self.chain = [model.joints.index(link.name) for link in machine.chain if link.joint.independent]
        sensed = [k for k in self.chain if machine.sensor(f"{model.joints[k]}.q")]
        moves, locked = ({model.joints.index(joint) for joint in joints} for joints in (stage.moves, stage.locked))
        self.read = [k for k in postures.read_joints(model, stage) if k in self.chain]
        self.turning = [k for k in self.chain if k in moves or (k in sensed and k not in locked)]
        self.unread = [k for k in self.turning if k not in self.read]
        powered = {model.joints.index(joint) for joint in machine.joints} & {*self.chain}
        moved = powered & {*self.turning}
        self.freedoms = min((fixture.freedoms for fixture in self.fixtures), default=6)
        self.grubler = grubler(len(powered), p=len(powered), d=len(moved), extra=len(self.turning) - len(moved),
                               t=self.freedoms)
        links = {model.joints[k] for k in self.chain}
        lengths = {f"{cylinder.name}.length" for cylinder in machine.cylinders
                   if links.issuperset(machine.moved_by(cylinder))}
        held = {row for fixture in self.fixtures for row in fixture.closes}
        self.rows = [i for i, name in enumerate(model.channels) if i in held
                     or (_read(machine, name) and (name in lengths or (name.startswith("tip.") and machine.tracker)
                                                   or (name.endswith(".distance") and self.fixtures)))]
        found = [self._closed(fixture, count, rng) for fixture in self.fixtures] or [self._random(count, rng)]
        self.q, size = np.concatenate(found), [len(q) for q in found]
        self.fixture = np.repeat([fixture.name for fixture in self.fixtures] or [""], size)
        self.lost = [fixture.name for fixture, q in zip(self.fixtures, found, strict=False) if not len(q)]
        self.channels = [f"{model.joints[k]}.q" for k in self.read] + [model.channels[i] for i in self.rows
                                                                     if i >= model.loop_rows]
        self.by_q = np.zeros((0, len(model.channels), len(model.joints)))
        if len(self.q):
            places = [model.place_of(fixture, len(q))
                      for fixture, q in zip(self.fixtures, found, strict=False)]
            self.by_q = model.over(model.observed_by_angles, model.parameters.nominal, self.q,
                                   np.concatenate(places or [np.zeros((len(self.q), model.place_size))]))[1]
            for fixture in self.fixtures:
                loose = [row for row in range(model.loop_rows) if row not in fixture.closes]
                self.by_q[np.ix_(self.fixture == fixture.name, loose)] = 0.0

    def _random(self, count: int, rng: np.random.Generator) -> Array:
        low, high = self.model.ranges.T
        q = rng.uniform(low, high, (count, len(low)))
        for joint, angle in self.stage.locked.items():
            q[:, self.model.joints.index(joint)] = angle
        return q

    def _closed(self, fixture: Fixture, count: int, rng: np.random.Generator) -> Array:
        """Up to so many postures, closed by all joints that move, including those that are not read."""
        if not self.turning:
            return np.zeros((0, len(self.model.joints)))
        return postures.closed_postures(
            self.model, count, rng, geometry=self.model.parameters.nominal, turning=self.turning,
            within_limits=self.turning, locked=self.stage.locked, held=fixture, batch=2 * count,
            give_up=lambda _, tried: tried >= TRIES * count)[0]

    def rank(self, joints: Sequence[int], rows: Sequence[int]) -> int:
        """Number of independent directions in which some joints change some rows, in general postures."""
        part = self.by_q[np.ix_(range(len(self.q)), rows, joints)]
        return int(np.linalg.matrix_rank(part, rtol=RANK_TOLERANCE).max()) if part.size else 0

    @property
    def rank_mobility(self) -> int | None:
        """Joints that move less the directions in which the fixture holds the tip."""
        held = self.rank(self.turning, range(self.model.loop_rows)) if self.fixtures else 0
        return len(self.turning) - held if len(self.q) else None

    def described(self, found: Identified) -> StageMobility:
        """The stage with what it identifies."""
        moves, sensed, locked = (tuple(self.model.joints[k] for k in positions) for positions in (
            self.unread, self.read, [k for k in self.chain if k not in self.turning and k not in self.read]))
        return StageMobility(**vars(found), stage=self.stage.name, moves=moves, sensed=sensed, locked=locked,
                             grubler=self.grubler, rank_mobility=self.rank_mobility,
                             unsensed=len(self.unread) + self.freedoms * bool(self.fixtures))

    def reasons(self) -> Iterator[tuple[str, str]]:
        """Defects of the chain (Sections 3.3.2 and 3.5.1), and remedies."""
        names = self.model.joints
        degrees = self.grubler if self.rank_mobility is None else self.rank_mobility
        if degrees < 1:
            yield (f"the chain cannot move: its mobility is {degrees} (Eq. 3.5)",
                   "add a joint to the calibrator or free one that is locked")
        elif self.lost:
            yield (f"within the joints' limits the tip does not reach {_named('fixture', self.lost)}",
                   "move what is out of reach nearer, widen the limits or lock the joints elsewhere")
        if not len(self.q):
            return
        unread, held = _named("joint", [names[k] for k in self.unread]), self.rank(self.unread, self.rows)
        if (loose := len(self.unread) - held) > 0:
            yield (f"with all readings held the chain can still move in {_count(loose, 'way')}, so that the "
                   f"position of {unread} is not determined", "sense or lock as many of them")
        if held == len(self.rows):
            yield (f"its poses identify nothing: {unread} and the fixture have more than five freedoms without a "
                   "sensor",
                   "sense or lock one of them")
        sensed = [k for k in self.read if k in self.turning]
        erring = [k for k in sensed if _read(self.model.machine, f"{names[k]}.q")]
        if len(sensed) >= 3 and self._flat(sensed):
            yield (f"the axes of {_named('joint', [names[k] for k in sensed])} are parallel and move the tip in planes "
                   "only", "turn one of them across, or sense another joint")
        elif any(fixture.play == 0 for fixture in self.fixtures) and self.rank(
                erring, range(self.model.loop_rows)) < 6 - self.freedoms:
            yield ("too few joints are sensed: they do not move the tip in all directions, so that nothing weighs the "
                   "loop's gap", "sense three joints with axes across each other, or state the fixture's play")

    def _flat(self, joints: Sequence[int]) -> bool:
        """Whether these joints move the tip in a plane only."""
        q = np.repeat(self.q[:1], 30, axis=0)
        q[:, joints] = self._random(30, np.random.default_rng(0))[:, joints]
        tip = self.model.over(self.model.tip, self.model.parameters.nominal, q)[0][:, :, 0]
        size = np.linalg.svd(tip - tip.mean(axis=0), compute_uv=False)
        return bool(size[2] <= RANK_TOLERANCE * size[0])


class _Survey:
    """The linearised calibration problem of all visits; `pins` marks parameters of cylinders, which are not listed."""

    def __init__(self, visits: Sequence[_Visit]) -> None:
        model, visits = visits[0].model, [visit for visit in visits if len(visit.q)]
        poses = joined([postures.record(
            model, visit.q, [visit.stage.name] * len(visit.q), list(map(str, visit.fixture)), seed=None,
            geometry=model.parameters.nominal, channels=visit.channels) for visit in visits])
        problem = calibration_problem(model.machine, poses, priors=False)
        self.problem = replace(problem, row_sigma=np.maximum(problem.row_sigma, PLAY))
        self.linear = linearise(self.problem, problem.start, np.concatenate([visit.q for visit in visits]))
        self.pins = problem.cylinder_parameters

    def identified(self, stage: str | None = None, known: Sequence[str] = ()) -> Identified:
        """What the poses of one stage, or of all, identify of the parameters they depend on that are not known."""
        rows = (self.problem.poses.stage == stage) | (stage is None)
        part, names = self.problem.without(~rows), self.problem.parameters.names
        touched = np.arange(len(names)) < len(part.model.parameters)
        layout = part.layout
        touched[np.concatenate([layout.locked[1], layout.place[layout.place >= 0]]).astype(int)] = True
        rest = {name: part.start[k] for k, name in enumerate(names) if not touched[k] or name in known}
        return _identified(part.fixing(**rest), replace(self.linear, jacobian=self.linear.jacobian[rows]),
                     {name for name, hidden in zip(names, self.pins, strict=True) if hidden})

    def in_turn(self, stages: Sequence[str]) -> list[Identified]:
        """What stage after stage identifies, where all that earlier ones identify alone counts as known."""
        found: list[Identified] = []
        for stage in stages:
            visited = stage in self.problem.poses.stage
            known = [name for before in found for name in before.full]
            found.append(self.identified(stage, known) if visited else Identified())
        return found


def _identified(problem: CalibrationProblem, linear: Linearised, hidden: Collection[str] = ()) -> Identified:
    """What is identifiable; parameters that are `hidden` are free but named only where they obscure a single one."""
    # what projections leave of a column that should vanish is rounding, and would count as a trace
    size = np.sqrt(np.sum(linear.jacobian**2, axis=(0, 1))) * problem.parameters.scale
    significant = np.where(size > RANK_TOLERANCE * size.max(), linear.jacobian, 0.0)
    data = observability(problem, replace(linear, jacobian=significant))
    full, none = (tuple(name for name, category in zip(data.names, data.category, strict=True)
                        if category == wanted and name not in hidden) for wanted in ("full", "none"))
    shown = [tuple(name for name in group if name not in hidden) for group in data.combinations]
    groups = tuple(own if len(own) > 1 else group for own, group in zip(shown, data.combinations, strict=True) if own)
    return Identified(rank=data.rank, full=full, combinations=groups, none=none)


def _read(machine: Machine, *channels: str) -> bool:
    """Whether all these channels have a sensor that states how well it reads."""
    return all((sensor := machine.sensor(channel)) is not None and sensor.std > 0 for channel in channels)


def _triangle_channels(machine: Machine, cylinder: Cylinder) -> list[str]:
    return [f"{cylinder.name}.length", *(f"{joint}.q" for joint in machine.moved_by(cylinder))]


def _triangle(machine: Machine, cylinder: Cylinder, count: int) -> Identified:
    """What readings of length and joint angles over the joints' ranges identify of pins and dead length (Eq. 3.26)."""
    keys = ("barrel.pin", "rod.pin", "dead_length")
    alone = machine.model_copy(update={
        "calibrator": None, "fixtures": (), "distances": (), "tracker": None, "stages": (),
        "notes": {f"{cylinder.name}.{key}": Note(sigma=0.01) for key in keys}})
    model, rng = KinematicModel(alone), np.random.default_rng(0)
    low, high = model.ranges.T
    q = rng.uniform(low, high, (count, len(low)))
    poses = postures.record(model, q, [""] * count, [""] * count, geometry=model.parameters.nominal, seed=None,
                            channels=_triangle_channels(alone, cylinder))
    problem = calibration_problem(alone, poses, priors=False)
    return _identified(problem, linearise(problem, problem.start, q))


def _count(number: int, noun: str) -> str:
    return f"{number} {noun}{'s' * (number != 1)}"


def _named(noun: str, names: Sequence[str]) -> str:
    return f"{noun}{'s' * (len(names) != 1)} " + ", ".join(f"'{name}'" for name in names)
