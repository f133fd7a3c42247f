"""Pose planning as an optimisation problem: which of many closed postures to measure."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import NamedTuple, Never

import numpy as np
from numpy.typing import NDArray

from hydroopt.errors import ProblemError
from hydroopt.estimation.inference.listing import named_row, table
from hydroopt.estimation.kinematic.observability import Linearised, Observability, linearise, observability
from hydroopt.estimation.kinematic.problem import CalibrationProblem, calibration_problem
from hydroopt.excitation.criteria import refuse_criterion
from hydroopt.limits.limits import courses
from hydroopt.limits.postures import PostureLimits, held_link
from hydroopt.limits.reserves import DEFAULT, Reserves
from hydroopt.limits.watch import IN_PRINT, Watch, in_print, reach, watch
from hydroopt.logs.poses import Poses, Texts
from hydroopt.machine.machine import Machine
from hydroopt.machine.machine_file import GivenMachine, machine_of
from hydroopt.model.closed_chain import KinematicModel
from hydroopt.parameters.parameter_set import ParameterSet
from hydroopt.results.tables import csv_text, number
from hydroopt.simulation import postures
from hydroopt.spatial.inertia import Array
from hydroopt.support.notebook_card import Shown

OBJECTIVES = {
    "D": "the log-determinant of the covariance", "A": "the sum of the variances",
    "E": "the largest variance of any combination",
    "condition": "the condition number of the scaled, whitened Jacobian"}
"""Objectives that the criteria stand for."""


class PoseGroup(NamedTuple):
    """Poses measured one after another: a stage (none where all joints are read) at a fixture (none with a tracker).

    `moves` are the joints that move without being read, `locked` those at rest, with their angles [rad]; with `drift`
    these creep. `setup` is the set-up of instruments whose pose is not known; `touch` names the datum and target, as
    ``floor.tooth``, that its poses bring together.
    """

    stage: str
    fixture: str
    moves: tuple[str, ...]
    locked: dict[str, float]
    drift: bool
    setup: str = ""
    touch: str = ""

    def held(self, machine: Machine) -> str:
        """The link that a fixture or a datum holds at the ground; '' if none is."""
        return held_link(machine, self.fixture, self.touch)

    def closed(self, machine: Machine) -> bool:
        """Whether something holds the tip, or the stage a passive joint, which else hangs."""
        stated = (*self.moves, *self.locked)
        return bool(self.fixture or self.touch) or any(
            name in stated and machine.link(name).joint.passive for name in machine.joints)

    @property
    def named(self) -> str:
        """In words; empty where it has no name."""
        named = (("stage", self.stage), ("fixture", self.fixture), ("set-up", self.setup), ("touching", self.touch))
        return ", ".join(f"{kind} '{name}'" for kind, name in named if name)

    def __str__(self) -> str:
        return self.named or "open chain"


class CombinatorialProblem(Shown):
    """A choice of measurements, which has neither a nonlinear nor a convex program."""

    def nlp(self) -> Never:
        """Refused.

        Raises:
            ProblemError: always.
        """
        raise ProblemError("the choice is combinatorial and has no nonlinear or convex program", where=repr(self),
                           remedy="use hydroopt.solve")

    cvxpy = nlp


@dataclass(frozen=True, eq=False)
class PoseProblem(CombinatorialProblem):
    """Which poses to measure for a kinematic calibration; solving never changes it.

    `hydroopt.solve(problem, seed=0, candidates=2000)` chooses them among random closed postures of each group. The
    choice is combinatorial, so there is neither a nonlinear nor a convex program of it.

    Attributes:
        machine: states calibrator, sensors, limits, and fixtures or a tracker.
        count: poses of each group.
        groups: stages and fixtures, one after another.
        criterion: ``D``, ``A``, ``E`` or ``condition``, of the covariance of the parameters in units of their scales.
        focus: parameters to which the criterion is restricted; all if empty.
        priors: whether the machine file's confidences count as measurements.
        fixed: parameters that are held, with their values [SI]; the plan is made at the nominal values.
        reserves: that each posture keeps of the machine's limits.

    >>> import hydroopt
    >>> problem = hydroopt.pose_problem(hydroopt.load_machine("cat215b"), 10, fixed={"ball.y": 0.0})
    >>> print(str(problem).splitlines()[0])
    pose plan of cat215b: 30 poses in 3 groups
    >>> dict(problem.fixing(**{"ball.z": 0.0}).fixed)
    {'ball.y': 0.0, 'ball.z': 0.0}
    >>> problem.nlp()
    Traceback (most recent call last):
    ...
    hydroopt.errors.ProblemError: <PoseProblem of cat215b: 10 poses in each of 3 groups, criterion D>: the choice is \
combinatorial and has no nonlinear or convex program; use hydroopt.solve.
    """

    machine: Machine
    count: int
    groups: tuple[PoseGroup, ...]
    criterion: str
    focus: tuple[str, ...] = ()
    priors: bool = False
    fixed: Mapping[str, float] = field(default_factory=dict)
    reserves: Reserves = DEFAULT

    @cached_property
    def limits(self) -> PostureLimits:
        """What each posture keeps."""
        return PostureLimits(self.model, self.reserves)

    @cached_property
    def model(self) -> KinematicModel:
        """Geometry of machine and calibrator."""
        return KinematicModel(self.machine)

    @cached_property
    def uncertain(self) -> Array:
        """(p,) standard deviations of the geometry; zero of what is held."""
        parameters = self.model.parameters
        return np.where([name in self.fixed for name in parameters.names], 0.0, parameters.scale)

    @cached_property
    def channels(self) -> tuple[str, ...]:
        """Channels that are read in each pose."""
        return postures.measured_channels(self.model)

    @cached_property
    def parameters(self) -> ParameterSet:
        """All parameters of the calibration."""
        return self._one_pose_each.parameters

    @cached_property
    def _one_pose_each(self) -> CalibrationProblem:
        middle = np.tile(self.model.ranges.mean(axis=1), (len(self.groups), 1))
        return Postures(self, middle).calibration

    def fixing(self, **values: float) -> PoseProblem:
        """The problem with parameters held, ``fixing(**{"ball.y": 0.0})`` [SI].

        Raises:
            ProblemError: there is no such parameter.
        """
        self.parameters.select(values)
        return replace(self, fixed={**self.fixed, **values})

    def __repr__(self) -> str:
        return (f"<PoseProblem of {self.machine.name}: {self.count} poses in each of {len(self.groups)} groups, "
                f"criterion {self.criterion}>")

    def __str__(self) -> str:
        parameters, known = self.parameters, self._one_pose_each.known
        held = self._one_pose_each.fixed
        rows = [named_row(name, unit, float("inf") if name in held or not root else 1 / root,
                          f"held at {held[name]:.6g}" if name in held else "in focus" if name in self.focus else "")
                for name, unit, root in zip(parameters.names, parameters.units, known, strict=True)]
        what = f", of {', '.join(self.focus)} only" if self.focus else ""
        return "\n".join([
            f"pose plan of {self.machine.name}: {self.count * len(self.groups)} poses in {len(self.groups)} groups",
            "variables", *(f"  {self.count} postures of {group}" for group in self.groups),
            f"minimise {OBJECTIVES[self.criterion]}{what}",
            "subject to", "  each posture closes its loop and is chosen once", "  limits of joints and strokes",
            "  reserves of the machine's other limits", f"measured channels: {', '.join(self.channels)}",
            "parameters", *table(("name", "unit", "prior std", ""), rows)])


def pose_problem(machine: GivenMachine, count: int, *, stages: Sequence[str] | None = None,
                 criterion: str | None = None, focus: Sequence[str] = (), priors: bool = False,
                 fixed: Mapping[str, float] | None = None, setups: Sequence[str] = ("",),
                 reserves: Reserves = DEFAULT) -> PoseProblem:
    """Which poses to measure for a machine's calibration, planned about the geometry of its file.

    Args:
        machine: states calibrator, sensors, limits, and fixtures or a tracker.
        count: poses of each stage at each fixture.
        stages: those to measure, by default all; without stages all joints with a sensor move.
        criterion: ``D``, ``A``, ``E`` or ``condition``, of parameters in units of their scales; by default D,
            or A of the focus.
        focus: parameters to which the criterion is restricted.
        priors: whether the machine file's confidences count as measurements.
        fixed: values [SI] of parameters that are held.
        setups: names of the set-ups in which instruments of unknown pose stand; each stage is measured in all of them.
        reserves: that each posture keeps of the machine's limits.

    Raises:
        ProblemError: no calibrator, no sensor, or an unknown stage, criterion or parameter.

    >>> import hydroopt
    >>> crane = hydroopt.load_machine("cat215b")
    >>> plan = hydroopt.solve(hydroopt.pose_problem(crane, 5, fixed={"ball.y": 0.0}), candidates=50)
    >>> len(plan.q)
    15
    """
    machine = machine_of(machine, "pose_problem")
    criterion = criterion or ("A" if focus else "D")
    refuse_criterion(criterion, focus)
    problem = PoseProblem(machine, count, _groups(machine, stages, setups), criterion, tuple(focus), priors,
                          dict(fixed or {}), reserves.checked())
    if count < 1:
        raise ProblemError(f"{count} poses cannot be planned", where="pose plan", remedy="ask for at least one pose")
    problem.parameters.select(problem.focus)  # refuses unknown names
    return problem


def expected_uncertainty(machine: Machine, q: Array, stage: Sequence[str] | Texts, fixture: Sequence[str] | Texts, *,
                         priors: bool = False, fixed: Mapping[str, float] | None = None) -> Observability:
    """What poses identify, before they are measured: joint vectors (N, n) [rad, m] with their N stages and fixtures.

    Raises:
        ProblemError: poses and machine do not fit together.
    """
    problem = PoseProblem(machine, len(q), _groups(machine, None, ("",)), "D", (), priors, dict(fixed or {}))
    known = [(group.stage, group.fixture) for group in problem.groups]
    labels = list(zip(map(str, stage), map(str, fixture), strict=True))
    if unknown := sorted({*labels} - {*known}):
        raise ProblemError("the machine file has no such stage or fixture", where=f"poses of {unknown[0]}",
                           remedy=f"use {', '.join(map(str, known))}")
    return observability(*Postures(problem, np.asarray(q), np.array(list(map(known.index, labels)))).linearised())


class Postures:
    """Some poses of a problem: N joint vectors of machine and calibrator, and what they belong to.

    Attributes:
        problem: which machine, groups and parameters.
        q: (N, n) [rad, m].
        group: (N,) places of their groups in the problem; by default as many of each, one group after another.
        stage, fixture, setup, touch: (N,) of their groups.
    """

    def __init__(self, problem: PoseProblem, q: Array, group: NDArray[np.intp] | None = None) -> None:
        own = np.repeat(np.arange(len(problem.groups)), len(q) // len(problem.groups)) if group is None else group
        self.problem, self.q, self.group = problem, q, own
        self.stage, self.fixture, self.setup, self.touch = (
            np.array([getattr(each, key) for each in problem.groups])[own]
            for key in ("stage", "fixture", "setup", "touch"))

    def __len__(self) -> int:
        return len(self.q)

    def at(self, places: Sequence[int] | NDArray[np.intp]) -> Postures:
        """Those at some places (K,)."""
        some = np.asarray(places, dtype=int)
        return Postures(self.problem, self.q[some], self.group[some])

    @property
    def groups(self) -> list[PoseGroup]:
        """The group that each belongs to."""
        return [self.problem.groups[k] for k in self.group]

    @cached_property
    def calibration(self) -> CalibrationProblem:
        """The calibration problem that measuring them without noise gives."""
        model = self.problem.model
        poses = postures.record(
            model, self.q, self.stage.tolist(), self.fixture.tolist(), geometry=model.parameters.nominal,
            channels=self.problem.channels, seed=None, name="plan", setup=self.setup.tolist(),
            touch=self.touch.tolist())
        return calibration_problem(model.machine, poses, fixed=self.problem.fixed, priors=self.problem.priors)

    def linearised(self) -> tuple[CalibrationProblem, Linearised]:
        """This problem, linearised about them at the nominal geometry."""
        calibration = self.calibration
        return calibration, linearise(calibration, calibration.parameters.nominal, self.q)

    def table_of(self, channels: Mapping[str, Array]) -> Poses:
        """A table of them with some channels (N,) [SI], and those of datums: zero where they are touched, else NaN."""
        touched = {channel: np.where(self.touch == each.name, 0.0, np.nan)
                   for each in self.problem.model.measurements if each.tool == "datum" for channel in each.channels}
        name, units = self.problem.machine.name, self.problem.machine.channel_units
        return Poses(name=f"plan for {name}", stage=self.stage, fixture=self.fixture,
                     setup=self.setup, channels={**channels, **touched},
                     units={each: units[each] for each in (*channels, *touched)})

    @property
    def table(self) -> Poses:
        """Where to drive: all joint angles, those that no sensor reads too, and which datums are touched."""
        return self.table_of({f"{joint}.q": self.q[:, k] for k, joint in enumerate(self.problem.model.joints)})

    @property
    def places(self) -> list[str]:
        """Where all joints stand, in the words of sheets."""
        units = [self.problem.machine.channel_units[f"{joint}.q"] for joint in self.problem.model.joints]
        return [", ".join(" ".join((joint, *in_print(value, unit))) for joint, value, unit in
                          zip(self.problem.model.joints, q, units, strict=True)) for q in self.q.tolist()]

    @property
    def watch(self) -> Watch:
        """What people keep beside the machine, which is driven there and rests."""
        limits, machine, groups = self.problem.limits, self.problem.machine, self.groups
        at_rest = limits.while_resting([joint for joint, angle in groups[0].locked.items()
                                        if all(group.locked.get(joint) == angle for group in groups)]).limits
        held = {f"{group.held(machine)} above ground" for group in groups}
        own = self.q[:, limits.places]
        uses = [each.use for each in courses(at_rest, own, 0 * own, 0 * own).values() if each.use.name not in held]
        ends = limits.chain.over(limits.chain.far_ends, limits.chain.parameters.nominal, self.q)[0].transpose(0, 2, 1)
        carried = machine.calibrator
        first = len(ends[0]) - 1 if carried is None else len(machine.ancestry(carried.parent)) - 1
        attached = np.linalg.norm(np.diff(ends[:, first:], axis=1), axis=2).sum(axis=1).max()
        return watch(at_rest.model, reach(at_rest.model, own), uses, self.problem.reserves, attached=float(attached))


def column_in_print(channel: str, unit: str) -> str:
    """Header of a channel in the units of sheets."""
    return f"{channel} [{IN_PRINT[unit][0] if unit in IN_PRINT else unit}]"


def csv_in_print(poses: Poses) -> str:
    """Text of a table in the units of sheets; cells are empty where nothing is known yet, and set-ups are left out
    where there are none."""
    setups = [{"setup": setup} for setup in poses.setup] if np.any(poses.setup != "") else [{}] * len(poses)
    return csv_text([{"stage": poses.stage[k], "fixture": poses.fixture[k], "pose": poses.pose[k], **setups[k],
                      **{column_in_print(name, poses.units[name]): number(
                          float(values[k]) * IN_PRINT.get(poses.units[name], ("", 1))[1])
                         for name, values in poses.channels.items()}} for k in range(len(poses))])


def measured_along(model: KinematicModel, group: PoseGroup) -> int:
    """Place in q of the joint along which a group's postures are measured one after another: the one that moves, else
    the first that is read."""
    moving = [joint for joint in (*group.moves, *model.machine.base_joints) if joint not in group.locked]
    read = [k for k in postures.read_joints(model) if model.joints[k] not in group.locked]
    return next(iter([*map(model.joints.index, moving), *read]), 0)


def _groups(machine: Machine, stages: Sequence[str] | None, setups: Sequence[str]) -> tuple[PoseGroup, ...]:
    seen = machine.calibrator is not None and (machine.fixtures or machine.tracker)
    if not seen and not machine.measuring and not any(
            machine.sensor(f"{cylinder.name}.length") for cylinder in machine.cylinders):
        raise ProblemError("nothing holds or tracks the machine's tip, and no cylinder's length is read, so that poses "
                           "identify nothing", where=f"machine '{machine.name}'",
                           remedy="state a calibrator with a fixture or a tracker, targets with an instrument, or the "
                           "sensor of a cylinder's length, in the machine file")
    known = {stage.name: stage for stage in machine.stages}
    for name in known if stages is None else stages:
        if name not in known:
            raise ProblemError("the machine file has no such stage", where=f"stage '{name}'",
                               remedy=f"use {', '.join(known)}" if known else "leave it out: all joints are read")
    fixtures = [fixture.name for fixture in machine.fixtures] or [""]
    once = tuple(PoseGroup(stage.name, fixture, stage.moves, stage.locked, stage.drift > 0) for stage in machine.stages
                 for fixture in fixtures if stages is None or stage.name in stages) or tuple(
                     PoseGroup("", fixture, (), {}, False) for fixture in fixtures)
    touches = [f"{datum.name}.{target}" for datum in machine.datums for target in machine.target_names
               if any(machine.sensor(f"{datum.name}.{target}.{axis}") for axis in datum.axes)]
    return tuple(group._replace(setup=setup, touch=touch) for setup in setups for touch in ("", *touches)
                 for group in once if not (touch and group.fixture))
