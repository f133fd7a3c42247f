"""Pose planning for kinematic calibration: the poses that tell most about the geometry (left open in Section 5.3).

Of many random closed postures those are chosen that are best by one of the criteria that serve motions, too: D, A or E
of the covariance of all parameters or of those in focus, or the condition number. All stages share their parameters and
are chosen together. Directions that no posture shows (ball.y with the locked swing of the CAT 215B) are projected out.
Collisions are not modelled.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hydroopt.errors import ProblemError
from hydroopt.estimation.kinematic.observability import SHARE, Linearised, Observability, linearise, observability
from hydroopt.estimation.kinematic.problem import CalibrationProblem, calibration_problem
from hydroopt.excitation.criteria import checked
from hydroopt.logs.poses import Poses, Texts
from hydroopt.machine.machine import Machine
from hydroopt.model.closed_chain import KinematicModel
from hydroopt.simulation import postures
from hydroopt.spatial.inertia import Array

FAINT = 1e-6
"""What is known before the first pose, in units of what an average pose tells: makes every determinant positive."""
HELPS = 1e-9
"""Relative gain of the criterion from which on an exchange of two poses helps."""
PROMISING = 64
"""Candidates whose eigenvalues are looked at."""
TRIES = 30
"""Random postures of which one at least must close within all limits."""
BATCH = 500
"""Random postures tried at once, at least."""


class Group(NamedTuple):
    """Poses measured one after another: a stage (none where all joints are sensed) at a fixture (none with a tracker).

    `moves` are the joints that move unsensed, `locked` those that stand, and where [rad]; with `drift` these creep.
    """

    stage: str
    fixture: str
    moves: tuple[str, ...]
    locked: dict[str, float]
    drift: bool

    def __str__(self) -> str:
        named = (("stage", self.stage), ("fixture", self.fixture))
        return ", ".join(f"{kind} '{name}'" for kind, name in named if name) or "open chain"


@dataclass(frozen=True, eq=False)
class PosePlan:
    """Poses to measure, in the order of measuring, and what they will tell.

    Attributes:
        machine: what they were planned for.
        groups: stages and fixtures, one after another.
        joints: names of the n joints of machine and calibrator; `channels` are those read.
        stage: (N,) labels; `fixture` (N,) as well.
        q: (N, n) joint vectors [rad, m]; `lengths` (N, c) of all cylinders [m].
        names: of the f estimated parameters; `units` (f,) and `std` (f,) their expected standard deviations, infinite
            where these poses do not tell a parameter.
        condition_number: of the scaled, whitened Jacobian; `noise_amplification_index` as well.
        log_det: logarithm of the determinant of the scaled information over the identifiable directions.
    """

    machine: Machine
    groups: tuple[Group, ...]
    joints: tuple[str, ...]
    channels: tuple[str, ...]
    stage: Texts
    fixture: Texts
    q: Array
    lengths: Array
    names: tuple[str, ...]
    units: tuple[str, ...]
    std: Array
    condition_number: float
    noise_amplification_index: float
    log_det: float

    def write(self, path: str | Path) -> None:
        """Write all joint angles as a table of poses, CSV or Parquet by extension, which `read_poses` reads.

        Raises:
            LogError: another extension, or the file cannot be written.
        """
        channels = {f"{joint}.q": self.q[:, k] for k, joint in enumerate(self.joints)}
        Poses(name=f"plan for {self.machine.name}", stage=self.stage, fixture=self.fixture, channels=channels,
              units={name: self.machine.channel_units[name] for name in channels}).write(path)

    def sheet(self) -> str:
        """The measuring sheet as plain text: what to lock, what to move where, and the readings to expect."""
        text = [f"{len(self.q)} poses for {self.machine.name}"]
        for group in self.groups:
            rows = np.flatnonzero((self.stage == group.stage) & (self.fixture == group.fixture))
            columns: dict[str, list[str]] = {}
            for joint in (*group.moves, *(name.removesuffix(".q") for name in self.channels if name.endswith(".q"))):
                unit, shown = self._shown(joint)
                columns[f"{joint} [{unit}]"] = shown
                columns |= {f"{cylinder.name} [mm]": [f"{1e3 * length:.0f}" for length in self.lengths[:, k]]
                            for k, cylinder in enumerate(self.machine.cylinders)
                            if joint in group.moves and self.machine.axis_of(cylinder) == joint}
            held = [(joint, *self._shown(joint)) for joint in group.locked]
            lock = ", ".join(f"{joint} at {at[rows[0]]} {unit}" for joint, unit, at in held)
            move = ", ".join(group.moves) or "all joints"
            text += ["", f"{group}", f"  lock: {lock or 'nothing'}", f"  move: {move}", "",
                     "  pose  " + "  ".join(columns)]
            text += [f"  {row + 1:4d}  " + "  ".join(f"{shown[row]:>{len(title)}}" for title, shown in columns.items())
                     for row in rows]
        return "\n".join(text) + "\n"

    def _shown(self, joint: str) -> tuple[str, list[str]]:
        """Unit and texts (N,) of a joint's variable."""
        values = self.q[:, self.joints.index(joint)]
        if self.machine.channel_units[f"{joint}.q"] == "m":
            return "mm", [f"{1e3 * value:.0f}" for value in values]
        return "deg", [f"{np.round(np.degrees(value), 1) + 0.0:.1f}" for value in values]


def plan_poses(machine: Machine, count: int, *, stages: Sequence[str] | None = None, candidates: int = 2000,
               criterion: str | None = None, focus: Sequence[str] = (), priors: bool = False,
               fixed: Mapping[str, float] | None = None, seed: int = 0) -> PosePlan:
    """Choose poses for a machine's calibration, around the geometry of its file.

    A greedy start is followed by exchanges of single poses (Fedorov 1972, in the order of Cook and Nachtsheim 1980)
    until none helps. No posture is chosen twice.

    Args:
        machine: states calibrator, sensors, limits, and fixtures or a tracker.
        count: poses of every stage at every fixture.
        stages: those to measure, by default all; without stages all sensed joints move.
        candidates: random postures of every stage and fixture to choose from.
        criterion: ``D``, ``A``, ``E`` or ``condition``, of parameters in units of their scales; by default D,
            or A of the focus.
        focus: parameters that alone count.
        priors: whether the machine file's confidences count as measurements.
        fixed: parameters that are held; the plan is made at the nominal values.
        seed: of the random postures.

    Raises:
        ProblemError: no calibrator, an unknown stage, criterion or parameter, no posture within the limits, or too few
            poses.
    """
    criterion = criterion or ("A" if focus else "D")
    checked(criterion, focus)
    groups, model = _groups(machine, stages), KinematicModel(machine)
    channels = tuple(_channels(model))
    if not 1 <= count <= candidates:
        raise ProblemError(f"{count} poses cannot be chosen from {candidates} candidates", where="plan_poses",
                           remedy="ask for at least one pose and no more than there are candidates")
    rng = np.random.default_rng(seed)
    at = np.array([_feasible(model, group, candidates, rng) for group in groups])
    everything = _linearised(model, np.concatenate(at), *_labels(groups, candidates), priors, fixed)
    design = _Design(*everything, criterion, focus, len(groups))
    chosen = design.best(count)
    q, (stage, fixture) = at[chosen], _labels(groups, count)
    problem, linear = _linearised(model, q, stage, fixture, priors, fixed)
    seen = observability(problem, linear)
    units = dict(zip(problem.parameters.names, problem.parameters.units, strict=True))
    return PosePlan(machine, groups, model.joints, channels, stage, fixture, q, _lengths(model, q), seen.names,
                    tuple(units[name] for name in seen.names), seen.std, seen.condition_number,
                    seen.noise_amplification_index, design.log_det(chosen))


def expected_uncertainty(machine: Machine, q: Array, stage: Sequence[str] | Texts, fixture: Sequence[str] | Texts, *,
                         priors: bool = False, fixed: Mapping[str, float] | None = None) -> Observability:
    """What poses will tell, before they are measured: joint vectors (N, n) [rad, m] with their N stages and fixtures.

    Raises:
        ProblemError: poses and machine do not fit together.
    """
    return observability(*_linearised(KinematicModel(machine), np.asarray(q), stage, fixture, priors, fixed))


def _groups(machine: Machine, stages: Sequence[str] | None) -> tuple[Group, ...]:
    if machine.calibrator is None or not (machine.fixtures or machine.tracker):
        raise ProblemError("nothing holds or sees the machine's tip, so that no pose tells anything",
                           where=f"machine '{machine.name}'",
                           remedy="state a calibrator with a fixture or a tracker in the machine file")
    known = {stage.name: stage for stage in machine.stages}
    for name in known if stages is None else stages:
        if name not in known:
            raise ProblemError("the machine file has no such stage", where=f"stage '{name}'",
                               remedy=f"use {', '.join(known)}" if known else "leave it out: all joints are sensed")
    fixtures = [fixture.name for fixture in machine.fixtures] or [""]
    return tuple(Group(stage.name, fixture, stage.moves, stage.locked, stage.drift > 0) for stage in machine.stages
                 for fixture in fixtures if stages is None or stage.name in stages) or tuple(
                     Group("", fixture, (), {}, False) for fixture in fixtures)


def _labels(groups: Sequence[Group], count: int) -> tuple[Texts, Texts]:
    return np.repeat([group.stage for group in groups], count), np.repeat([group.fixture for group in groups], count)


def _sensed(model: KinematicModel) -> list[int]:
    """Joints that are read: in stages those of a calibrator that has any, else all with a sensor."""
    own = postures.sensed_joints(model) if model.machine.stages else []
    return own or [k for k, joint in enumerate(model.joints) if model.machine.sensor(f"{joint}.q")]


def _channels(model: KinematicModel) -> list[str]:
    """What is read in every pose."""
    tips = [f"tip.{axis}" for axis in "xyz"] if model.machine.tracker else []
    read = [f"{model.joints[k]}.q" for k in _sensed(model)] + [tip for tip in tips if model.machine.sensor(tip)]
    if not read:
        raise ProblemError("no sensor reads a joint or the tip", where=f"machine '{model.machine.name}'",
                           remedy="state sensors with their accuracy in the machine file")
    return read


def _lengths(model: KinematicModel, q: Array) -> Array:
    """(N, c) of all cylinders [m]."""
    return model.over(model.lengths, model.parameters.nominal, q)[0][:, :, 0]


def _feasible(model: KinematicModel, group: Group, count: int, rng: np.random.Generator) -> Array:
    """Random closed postures (count, n) within the limits of joints and strokes, in the order of measuring.

    That order is the moving joint's, else the first sensed one's, so that there is little driving. Where locked joints
    drift, every second posture waits for the way back: else drift and moving joint could not be told apart.
    """
    cylinders, (low, high) = model.machine.cylinders, postures.limits(model)
    short, stroke = (np.array([getattr(each, key) for each in cylinders]) for key in ("dead_length", "stroke"))
    held = {model.joints.index(joint): angle for joint, angle in group.locked.items()}
    moving = [model.joints.index(joint) for joint in group.moves]
    free = [k for k in _sensed(model) if k not in held and k not in moving]
    place = [each.position for each in model.machine.fixtures if each.name == group.fixture]
    found, tried, batch = np.empty((0, len(low))), 0, max(count, BATCH)
    while tried <= 3 * batch or len(found) * TRIES >= tried:
        q = rng.uniform(low, high, (batch, len(low)))
        q[:, list(held)] = list(held.values())
        good = np.ones(batch, dtype=bool)
        if place:
            q, good = postures.close(model, model.parameters.nominal, q, free, np.array(place[0]))
        lengths = _lengths(model, q)
        good &= np.all((lengths >= short) & (lengths <= short + stroke), axis=1)
        good &= np.all(((q >= low) & (q <= high))[:, free + moving], axis=1)
        found, tried = np.concatenate([found, q[good]]), tried + batch
        if len(found) >= count:
            order = np.argsort(found[:count, (moving + free or [0])[0]], kind="stable")
            return np.asarray(found[np.concatenate([order[::2], order[1::2][::-1]]) if group.drift else order])
    raise ProblemError(f"only {len(found)} of {tried} random postures close within their limits",
                       where=f"{group}", remedy="move the fixture, widen limits and strokes, or lock joints elsewhere")


def _linearised(model: KinematicModel, q: Array, stage: Sequence[str] | Texts, fixture: Sequence[str] | Texts,
                priors: bool, fixed: Mapping[str, float] | None) -> tuple[CalibrationProblem, Linearised]:
    poses = postures.record(model, q, list(map(str, stage)), list(map(str, fixture)), geometry=model.parameters.nominal,
                            channels=_channels(model), seed=None, name="plan")
    problem = calibration_problem(model.machine, poses, fixed=fixed, priors=priors)
    return problem, linearise(problem, problem.parameters.nominal, q)


class _Design:
    """What the candidates tell, in coordinates w (r,) of the identifiable directions.

    They are chosen so that an average candidate tells as much in every direction.

    Attributes:
        rows: (G, C, m, r) whitened Jacobians of C candidates in each of G groups; `rank` (G,) independent rows of one.
        before: (r, r) information of known distances and priors, and a faint one of everything; `open` directions need
            poses.
        focus: (s, r) what counts by w, in units of the parameters' scales; none if it is all and D-optimal.
    """

    def __init__(self, problem: CalibrationProblem, linear: Linearised, criterion: str, focus: Sequence[str],
                 groups: int) -> None:
        self.criterion = criterion
        free = np.flatnonzero(problem.free)
        if not np.any(linear.jacobian[:, :, free]):
            raise ProblemError("no parameter is left that a pose could tell", where="plan_poses",
                               remedy="fix fewer, or state the confidence of lengths and angles in the machine file")
        seen = observability(problem, linear)
        # what priors tell need not be told by a pose
        total = Observability(seen.names, seen.scale, seen.information + seen.prior, 0 * seen.prior)
        hidden = total.unseen.shape[1]
        basis = seen.scale[:, None] * np.linalg.qr(total.unseen, mode="complete")[0][:, hidden:]
        factor = np.linalg.cholesky(basis.T @ total.information @ basis / len(linear.rank))
        self.offset = 2 * float(np.log(np.diag(factor)).sum())
        to_w = basis @ np.linalg.inv(factor).T
        # only as many rows as a pose has independent ones
        _, size, turned = np.linalg.svd(linear.jacobian[:, :, free] @ to_w, full_matrices=False)
        rows = (size[:, :, None] * turned)[:, : linear.rank.max()]
        shared = linear.shared[:, free] @ to_w
        self.rows: Array = rows.reshape(groups, -1, *rows.shape[1:])
        self.rank = linear.rank.reshape(groups, -1).max(axis=1)
        self.before = shared.T @ shared + FAINT * np.eye(len(factor))
        self.open = len(factor) - (int(np.linalg.matrix_rank(shared)) if len(shared) else 0)
        self.focus = (to_w / seen.scale[:, None])[_places(problem, total, focus)]
        if not focus and criterion != "D":
            self.focus = np.linalg.inv(factor).T

    def information(self, chosen: NDArray[np.bool_]) -> Array:
        """(r, r) of chosen candidates (G, C) and what is known before."""
        rows = self.rows[chosen].reshape(-1, len(self.before))
        return np.asarray(self.before + rows.T @ rows)

    def log_det(self, chosen: NDArray[np.bool_]) -> float:
        """Of the scaled information."""
        return float(np.linalg.slogdet(self.information(chosen))[1]) + self.offset

    def score(self, information: Array, group: int, pose: int = 0) -> Array:
        """Criterion (C,), up to a constant, after each candidate of a group is added to an information (r, r).

        It is −∞ for those that do little about the worst direction, but for `pose`.
        """
        rows, inverse = self.rows[group], np.linalg.inv(information)
        spread = rows @ inverse
        core = np.eye(rows.shape[1]) + spread @ rows.transpose(0, 2, 1)
        if not len(self.focus):
            return np.asarray(np.linalg.slogdet(core)[1])
        seen = spread @ self.focus.T
        before = self.focus @ inverse @ self.focus.T
        after = before - seen.transpose(0, 2, 1) @ np.linalg.solve(core, seen)
        match self.criterion:
            case "A":
                return np.asarray(-np.log(np.trace(after, axis1=1, axis2=2)))
            case "D":
                return np.asarray(-np.linalg.slogdet(after)[1])
        # eigenvalues take long: only of those that do most about the direction that is worst now
        worst = np.linalg.eigh(before)[1][:, -1]
        promising = np.append(np.argsort((after @ worst) @ worst)[:PROMISING], pose)
        values = np.maximum(np.linalg.eigvalsh(after[promising]), 1e-300)
        score = np.full(len(rows), -np.inf)
        score[promising] = -np.log(values[:, -1] / (values[:, 0] if self.criterion == "condition" else 1.0))
        return score

    def best(self, count: int) -> NDArray[np.bool_]:
        """The chosen candidates (G, C), `count` of each group."""
        if count * self.rank.sum() < self.open:
            raise ProblemError(f"{count} poses of each stage have {count * self.rank.sum()} rows for {self.open} "
                               "parameters", where="plan_poses",
                               remedy=f"ask for {-(-self.open // self.rank.sum())} poses or more, or fix parameters")
        chosen = np.zeros(self.rows.shape[:2], dtype=bool)
        for _ in range(count):
            for group, taken in enumerate(chosen):
                score = self.score(self.information(chosen), group)
                taken[np.argmax(np.where(taken, -np.inf, score))] = True
        helped = True
        while helped:
            helped = False
            for group, taken in enumerate(chosen):
                for pose in np.flatnonzero(taken):
                    taken[pose] = False
                    score = np.where(taken, -np.inf, self.score(self.information(chosen), group, int(pose)))
                    better = np.max(score) > score[pose] + HELPS
                    taken[np.argmax(score) if better else pose] = True
                    helped |= bool(better)
        if np.linalg.eigvalsh(self.information(chosen))[0] < 2 * FAINT:
            raise ProblemError(f"{count} poses of each stage leave open what more would tell", where="plan_poses",
                               remedy="ask for more poses, or fix parameters")
        return chosen


def _places(problem: CalibrationProblem, seen: Observability, focus: Sequence[str]) -> list[int]:
    """Positions of the parameters in focus among the free ones."""
    for name in focus:
        problem.parameters.index(name)
        if name not in seen.names:
            raise ProblemError("it is fixed", where=f"focus '{name}'", remedy="leave it out")
        if np.linalg.norm(seen.unseen[seen.names.index(name)]) > SHARE:
            together = next((", ".join(group) for group in seen.combinations if name in group), "")
            raise ProblemError("no pose tells it", where=f"focus '{name}'",
                               remedy=f"fix one of {together}" if together else "leave it out")
    return [seen.names.index(name) for name in focus]
