"""Suspects: stages, stretches of poses, sensors and joints that contradict the rest (Section 3.8.2), by name and row.

Each defect is a column that would explain part of the whitened residuals. Its test statistic is the drop of squared
errors that adding it to the linearised problem brings, in units of the errors' variance (a Lagrange multiplier test).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from enum import StrEnum
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from hydroopt.estimation.kinematic.observability import Linearised, Observability
from hydroopt.estimation.kinematic.problem import CalibrationProblem
from hydroopt.results.diagnostic import Diagnostic
from hydroopt.results.wording import Kind
from hydroopt.spatial.inertia import Array

FALSE_ALARM = 1e-3
"""Probability that sound data raise one alarm of a kind."""
LARGER = 2.0
"""How many times the others' typical error a stage must show: smaller differences are the model's, not the stage's."""
BEYOND = 3.0
"""How many times its stated standard deviation a sensor must be off: less is what was stated."""
EXACT = 1e-3
"""Least variance of the errors, in units of the stated one, so that nothing is suspect without noise."""
TURNED = 0.05
"""Range of angles [rad] over the poses from which on a joint counts as turning."""
TILTED = 0.05
"""Sine of the angle between two axes below which they count as parallel."""
SPLITS = 24
"""Places in the poses of a fixture at which a move of the fixture is tested."""
SHORTEST = 5
"""Fewest poses that count as a stretch."""


class SuspectKind(StrEnum):
    """What a suspect is; the value stands in JSON files."""

    PLANE = "plane"
    STAGE = "stage"
    STRETCH = "stretch"
    POSE = "pose"
    FIXTURE = "fixture"
    OFFSET = "offset"
    SCALE = "scale"
    BACKLASH = "backlash"

    @property
    def is_poses(self) -> bool:
        """Whether the suspect is poses, which can be left out."""
        return self in (SuspectKind.STAGE, SuspectKind.STRETCH, SuspectKind.POSE)


DIAGNOSTICS = {SuspectKind.PLANE: Kind.POSES_IN_ONE_PLANE, SuspectKind.STAGE: Kind.STAGE_CONTRADICTS,
               SuspectKind.STRETCH: Kind.STRETCH_CONTRADICTS, SuspectKind.POSE: Kind.POSE_CONTRADICTS,
               SuspectKind.FIXTURE: Kind.FIXTURE_MOVED, SuspectKind.OFFSET: Kind.SENSOR_OFFSET,
               SuspectKind.SCALE: Kind.SENSOR_SCALE, SuspectKind.BACKLASH: Kind.BACKLASH}
"""Kind of the diagnostic of each kind of suspect."""


@dataclass(frozen=True, eq=False)
class Suspect:
    """Something that contradicts the rest.

    Attributes:
        kind: what it is.
        name: of the stage, pose, fixture or joint.
        poses: (N,) poses it concerns; `place` says where they stand in their files.
        strength: root of the test statistic, or errors relative to the usual ones.
        size: of the defect [rad, m, or 1 for a scale]; NaN where it has none.
        stage: in which a sensor reads another zero.
    """

    kind: SuspectKind
    name: str
    poses: NDArray[np.bool_]
    place: str
    strength: float
    size: float = float("nan")
    stage: str = ""

    @property
    def diagnostic(self) -> Diagnostic:
        """The finding with its words."""
        evidence: dict[str, Any] = {"place": self.place, "strength": self.strength}
        match self.kind:
            case SuspectKind.OFFSET | SuspectKind.BACKLASH:
                evidence |= {"size_deg": float(np.degrees(self.size)), "stage": self.stage}
            case SuspectKind.SCALE:
                evidence |= {"size": self.size}
            case SuspectKind.FIXTURE:
                evidence |= {"size_mm": 1e3 * self.size}
        return Diagnostic(DIAGNOSTICS[self.kind], (self.name,) if self.name else (), evidence)


class _Defect(NamedTuple):
    """A defect of a joint's sensor: change of its angle per unit of the defect (N,), and the poses concerned (N,)."""

    kind: SuspectKind
    joint: str
    unit_change: Array
    poses: NDArray[np.bool_]
    stage: str = ""


def find_suspects(problem: CalibrationProblem, q: Array, linearised: Linearised,
                  identified: Observability) -> tuple[Suspect, ...]:
    """All suspects, the strongest of each kind first."""
    square, rank = linearised.pose_square, np.maximum(linearised.rank, 1)
    typical = _typical(square, rank)
    stages = _stages(problem, square, rank)
    stretches = () if stages else _stretches(problem, square / typical, rank)
    taken = np.any([s.poses for s in (*stages, *stretches)], axis=0) if stages or stretches else np.zeros(len(q), bool)
    return (*_one_plane(problem, q), *stages, *stretches, *_outliers(problem, square / typical, rank, taken),
            *_defects(problem, q, linearised, identified, typical))


def _one_plane(problem: CalibrationProblem, q: Array) -> tuple[Suspect, ...]:
    """All that turned between the poses turned about parallel axes."""
    model = problem.model
    closed = np.asarray(problem.layout.present[:, :3].all(axis=1))
    chain = model.closure_jacobian.sparsity_out(1)
    moves = [k for k in range(len(model.joints)) if chain.has_nz(0, k) or chain.has_nz(1, k) or chain.has_nz(2, k)]
    turning = [k for k in moves if np.any(closed) and np.ptp(q[closed, k]) > TURNED]
    if len(turning) < 2:
        return ()
    axes = model.over(model.axes, model.parameters.nominal, q[closed])[0][:, :, turning]
    across = np.linalg.norm(np.cross(axes, axes[:, :, :1], axis=1), axis=1)
    if np.max(across) > TILTED:
        return ()
    return (Suspect(SuspectKind.PLANE, "", closed, _place(problem, closed), float(len(turning))),)


def _typical(square: Array, rank: NDArray[np.int64]) -> float:
    """Variance of the errors in units of the stated one, from the median, which a few bad poses do not move."""
    ratio = np.median(square / stats.chi2.median(rank))
    return float(max(ratio, EXACT))


def _place(problem: CalibrationProblem, poses: NDArray[np.bool_]) -> str:
    rows, files = problem.poses.row[poses], problem.poses.file[poses]
    names = dict.fromkeys(str(f) for f in files)
    first, last = int(rows[0]), int(rows[-1])
    span = f"row {first}" if len(rows) == 1 else f"rows {first} to {last}"
    return span if len(names) > 1 or "" in names else f"{span} of {next(iter(names))}"


def _stages(problem: CalibrationProblem, square: Array, rank: NDArray[np.int64]) -> tuple[Suspect, ...]:
    labels = dict.fromkeys(str(s) for s in problem.poses.stage)
    if len(labels) < 3:
        return ()
    groups = {label: problem.poses.stage == label for label in labels}
    # by medians, so that a few bad poses do not make their whole stage suspect
    size = {label: float(np.sqrt(_typical(square[g], rank[g]))) for label, g in groups.items()}
    found = []
    for label, poses in groups.items():
        usual = float(np.median([value for other, value in size.items() if other != label]))
        ratio = size[label] / usual if usual else 1.0
        chance = stats.f.sf(ratio**2, rank[poses].sum(), rank[~poses].sum())
        if ratio > LARGER and chance < FALSE_ALARM / len(groups):
            found.append(Suspect(SuspectKind.STAGE, label, poses, _place(problem, poses), ratio))
    return tuple(sorted(found, key=lambda s: -s.strength))


def _stretches(problem: CalibrationProblem, square: Array, rank: NDArray[np.int64]) -> tuple[Suspect, ...]:
    """The worst run of neighbouring poses in every stage, if its errors are too large for chance."""
    found = []
    for label in dict.fromkeys(str(s) for s in problem.poses.stage):
        rows = np.flatnonzero(problem.poses.stage == label)
        total = np.concatenate([[0], np.cumsum(square[rows])])
        freedom = np.concatenate([[0], np.cumsum(rank[rows])])
        # lengths that grow by a quarter: all would take the square of the number of poses
        sizes = np.unique(np.round(SHORTEST * 1.25 ** np.arange(60)).astype(int))
        sizes = sizes[sizes <= len(rows) // 2]
        if not sizes.size:
            continue
        first = np.concatenate([np.arange(len(rows) - size + 1) for size in sizes])
        last = first + np.repeat(sizes, len(rows) - sizes + 1)
        chance = stats.chi2.logsf((total[last] - total[first]) / LARGER, freedom[last] - freedom[first])
        best = int(np.argmin(chance))
        if chance[best] < np.log(FALSE_ALARM / len(first)):
            poses = np.zeros(len(square), bool)
            poses[rows[first[best] : last[best]]] = True
            size = float(np.sqrt(square[poses].sum() / rank[poses].sum()))
            found.append(Suspect(SuspectKind.STRETCH, label, poses, _place(problem, poses), size))
    return tuple(found)


def _outliers(problem: CalibrationProblem, square: Array, rank: NDArray[np.int64],
              taken: NDArray[np.bool_]) -> tuple[Suspect, ...]:
    chance = stats.chi2.sf(square / LARGER, rank)
    odd = (chance < FALSE_ALARM / len(square)) & ~taken
    found = []
    for k in np.flatnonzero(odd):
        poses = np.zeros(len(square), bool)
        poses[k] = True
        size = float(np.sqrt(square[k] / rank[k]))
        found.append(Suspect(SuspectKind.POSE, str(problem.poses.pose[k]), poses, _place(problem, poses), size))
    return tuple(sorted(found, key=lambda s: -s.strength))


def _defects(problem: CalibrationProblem, q: Array, linearised: Linearised, identified: Observability,
             typical: float) -> tuple[Suspect, ...]:
    """Sensors that slipped in a stage, and backlash, each tested as one more column."""
    free = np.flatnonzero(problem.free)
    rows = linearised.jacobian[:, :, free].reshape(-1, len(free))
    stack = np.vstack([rows, linearised.shared[:, free]]) * identified.scale
    basis, s, _ = np.linalg.svd(stack, full_matrices=False)
    basis = basis[:, s > 1e-9 * s[0]] if s.size else basis
    residual = np.concatenate([linearised.residual.ravel(), linearised.shared_residual])
    moved = _moved_fixtures(problem, linearised, basis, residual, typical)
    candidates = list(_candidates(problem, q))
    found = []
    for defect in candidates:
        k, unit_change = problem.model.joints.index(defect.joint), defect.unit_change
        sigma = problem.angle_sigma[k]
        if sigma == 0:
            continue
        # `errors` holds the whitened rows' change by one σ of each sensed angle
        column = np.concatenate([(linearised.errors[:, :, k] * unit_change[:, None] / sigma).ravel(),
                                 np.zeros(len(linearised.shared_residual))])
        across = column - basis @ (basis.T @ column)
        size = float(across @ across)
        if size < 1e-9 * float(column @ column):
            continue
        amount = -float(across @ residual) / size
        drop = amount**2 * size / typical
        shift = abs(amount) * float(np.max(np.abs(unit_change)))
        if stats.chi2.sf(drop, 1) < FALSE_ALARM / len(candidates) and shift > BEYOND * sigma:
            found.append((drop, amount, defect))
    found.sort(key=lambda entry: -entry[0])
    named: dict[str, Suspect] = {}
    for drop, amount, defect in found:
        if defect.joint not in named:  # what is wrong with a joint shows in all its columns; the strongest names it
            named[defect.joint] = Suspect(defect.kind, defect.joint, defect.poses, _place(problem, defect.poses),
                                          float(np.sqrt(drop)), abs(amount), defect.stage)
    # a fixture that moved would accuse the sensors too
    return tuple(moved) or tuple(named.values())


def _moved_fixtures(problem: CalibrationProblem, linearised: Linearised, basis: Array, residual: Array,
                    typical: float) -> list[Suspect]:
    """Fixtures that stand elsewhere from some pose on: the position's columns, for the later poses alone."""
    found = []
    fixtures = problem.layout.fixture
    for columns in np.unique(fixtures[fixtures[:, 0] >= 0], axis=0):
        rows = np.flatnonzero(np.all(fixtures == columns, axis=1))
        best = (0.0, 0, 0.0)
        splits = np.unique(np.linspace(SHORTEST, len(rows) - SHORTEST, SPLITS).astype(int))
        for split in splits if len(rows) >= 2 * SHORTEST else ():
            later = np.zeros(linearised.jacobian.shape[0], dtype=bool)
            later[rows[split:]] = True
            step = (linearised.jacobian[:, :, columns] * later[:, None, None]).reshape(-1, 3)
            step = np.vstack([step, np.zeros((len(residual) - len(step), 3))])
            across = step - basis @ (basis.T @ step)
            values, vectors = np.linalg.eigh(across.T @ across)
            # of a swing that is not sensed, not the way along its circle
            visible = values > max(1e-6 * values[-1], 1e-9 * float(np.sum(step**2)))
            along = -(vectors.T @ (across.T @ residual))[visible] / values[visible]
            best = max(best, (float(np.sum(along**2 * values[visible]) / typical), int(split),
                              float(np.linalg.norm(along))))
        if stats.chi2.sf(best[0], 3) < FALSE_ALARM / SPLITS and best[2] > _stated_gap(problem):
            poses = np.zeros(len(fixtures), dtype=bool)
            poses[rows[best[1] :]] = True
            name = problem.parameters.names[columns[0]].removesuffix(".x")
            found.append(Suspect(SuspectKind.FIXTURE, name, poses, _place(problem, poses), float(np.sqrt(best[0])),
                                 best[2]))
    return found


def _stated_gap(problem: CalibrationProblem) -> float:
    """How far [m] stated errors let the tip miss its fixture."""
    reach = sum(abs(link.joint.a) + abs(link.joint.d) for link in problem.model.machine.chain)
    play = float(np.max(problem.row_sigma[:, :3], initial=0.0))
    return float(np.hypot(np.max(problem.angle_sigma, initial=0.0) * reach, play))


def _candidates(problem: CalibrationProblem, q: Array) -> Iterator[_Defect]:
    layout, labels = problem.layout, problem.poses.stage
    for k, joint in enumerate(problem.model.joints):
        sensed = layout.sensed[:, k]
        if not np.any(sensed):
            continue
        stages = list(dict.fromkeys(str(s) for s in labels))
        for label in stages if len(stages) > 1 else ():
            there = sensed & (labels == label)
            yield _Defect(SuspectKind.OFFSET, joint, there.astype(float), there, label)
        centred = np.where(sensed, q[:, k] - q[sensed, k].mean(), 0.0)
        yield _Defect(SuspectKind.SCALE, joint, centred, sensed)
        going = np.where(sensed, np.sign(_direction(q[:, k], labels)), 0.0)
        yield _Defect(SuspectKind.BACKLASH, joint, going / 2, sensed)


def _direction(angle: Array, labels: NDArray[np.str_]) -> Array:
    """Change (N,) from the pose before, within a stage."""
    step = np.diff(angle, prepend=angle[:1])
    step[np.concatenate([[True], labels[1:] != labels[:-1]])] = 0.0
    return step
