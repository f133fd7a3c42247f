"""Kinematic calibration, solved: geometry with uncertainty, how well loops close, and what is in doubt."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray

from hydroopt.errors import ProblemError, SolverError
from hydroopt.estimation.kinematic import joint, link_by_link
from hydroopt.estimation.kinematic.column_checks import refuse_misread
from hydroopt.estimation.kinematic.observability import Linearised, Observability, linearise, observability
from hydroopt.estimation.kinematic.problem import CalibrationProblem, calibration_problem
from hydroopt.estimation.kinematic.suspects import Suspect, diagnose
from hydroopt.machine.components import Note
from hydroopt.machine.machine import Machine
from hydroopt.machine.parameter_kind import ParameterKind
from hydroopt.results.fit import Fit
from hydroopt.spatial.inertia import Array

CalibrationMethod = Literal["joint", "hierarchical"]
METHODS: tuple[CalibrationMethod, ...] = get_args(CalibrationMethod)
HOPELESS = 10.0
"""How many times the stated errors must be exceeded for an answer to be doubtful as a whole."""
SAME = 0.1
"""Distance in standard deviations within which two solutions are the same."""
TIGHT = 1e-11
"""Gap [m] of a loop that counts as closed."""
STEPS = 20
"""Steps of Newton's method towards the unsensed angles of the nominal machine."""
GUESSES = 24
"""Angles tried for a joint that moves unsensed, over its range."""


@dataclass(frozen=True, eq=False)
class Calibration:
    """A solved kinematic calibration.

    Attributes:
        problem: what was solved.
        method: how.
        theta: (P,) all parameters [SI]; `q` (N, n) joint vectors of the poses [rad, m].
        seen: what the data tell about the free parameters.
        noise_scale: root of the squared errors over the degrees of freedom; 1 where the stated σ are right. Intervals
            are widened by it where it is larger than 1, never narrowed.
        fit: by ``nominal``, ``train`` and ``validation``, then by channel: RMS and VAF (Eq. 3.44-3.46).
        suspects: joints, stages and poses that do not fit the rest.
        uniqueness: what solving from several starts showed.
    """

    problem: CalibrationProblem
    method: str
    theta: Array
    q: Array
    seen: Observability
    at: Linearised
    noise_scale: float
    fit: Mapping[str, Mapping[str, Fit]]
    suspects: tuple[Suspect, ...]
    uniqueness: str
    status: str = "ok"

    def __getitem__(self, name: str) -> float:
        """Value of a parameter [SI]."""
        return float(self.theta[self.problem.parameters.index(name)])

    @cached_property
    def std(self) -> Array:
        """(P,) standard deviations; NaN where neither data nor priors tell, at a bound, or where a value was fixed.

        All are NaN for the link-by-link method, which weighs nothing and whose errors add up from stage to stage.
        """
        std = np.full(len(self.theta), np.nan)
        if self.method != "joint":
            return std
        std[self.problem.free] = self.seen.std * max(1.0, self.noise_scale)
        std[~np.isfinite(std) | self.at_bound] = np.nan
        return std

    @property
    def at_bound(self) -> NDArray[np.bool_]:
        """(P,) which parameters are held back by a bound, where a symmetric interval would be wrong."""
        parameters = self.problem.parameters
        near = 1e-6 * parameters.scale
        bound: NDArray[np.bool_] = (self.theta < parameters.lower + near) | (self.theta > parameters.upper - near)
        return bound & self.problem.free

    @property
    def ci95(self) -> Array:
        """(P, 2) intervals."""
        return np.asarray(self.theta[:, None] + 1.959964 * self.std[:, None] * np.array([-1.0, 1.0]))

    def category(self, name: str) -> str:
        """``full``, ``combination`` or ``none`` by the data alone, or ``fixed``."""
        return "fixed" if name in self.problem.fixed else self.seen.category[self.seen.names.index(name)]

    @property
    def machine(self) -> Machine:
        """The machine with the calibrated geometry and its confidences.

        A vector keeps the largest of its confidences, and correlations are lost; angles of locked joints belong to the
        poses and are not written.
        """
        return _with_geometry(self)

    def __str__(self) -> str:
        lines = [f"{self.problem.model.machine.name} by {self.method}: {self.status}, {len(self.problem.poses)} poses, "
                 f"errors {self.noise_scale:.2f} times those stated"]
        for name, table in self.fit.items():
            for channel, fit in table.items():
                lines.append(f"  {name:<10} {channel:<24} RMS {1e3 * fit.rms:9.3f} mm  VAF {100 * fit.vaf:7.3f} %")
        return "\n".join(lines)


def calibrate(problem: CalibrationProblem, method: str = "joint", *, starts: int = 1, seed: int = 0) -> Calibration:
    """Solve a kinematic calibration.

    Args:
        problem: what to calibrate from which poses.
        method: ``joint`` or ``hierarchical``.
        starts: from how many places to solve; the first is the nominal machine, the others lie about it as its
            confidences say.
        seed: of the other starts.

    Raises:
        ProblemError: unknown method, or the poses cannot determine the parameters.
        SolverError: no trustworthy answer.
    """
    if starts < 1:
        raise ProblemError(f"{starts} starts are none", where="--starts", remedy="ask for one or more")
    problem = solvable(problem, method)
    rng = np.random.default_rng(seed)
    answers: list[tuple[float, Array, Array]] = []
    failed = 0
    for k in range(starts):
        try:
            answers.append(optimum(problem, method, random_start(problem, rng) if k else problem.start))
        except SolverError:
            if starts == 1 or (k == starts - 1 and not answers):
                raise
            failed += 1
    answers.sort(key=lambda answer: answer[0])
    _, theta, q = answers[0]
    at = linearise(problem, theta, closed_angles(problem, theta, q))
    seen = observability(problem, at)
    known = int(np.sum(np.isfinite(seen.std)))
    freedom = int(at.rank.sum()) + len(at.shared_residual) - known
    squares = float(at.pose_square.sum() + np.sum(at.shared_residual**2))
    scale = float(np.sqrt(squares / freedom)) if freedom > 0 else float("nan")
    nominal = follow_unsensed(problem, problem.start, guess_unsensed(problem, problem.start))
    fit = {"nominal": fit_of(problem, problem.start, nominal), "train": fit_of(problem, theta, q)}
    if problem.validation is not None:
        fit["validation"] = fit_of(*predicted(problem, theta, problem.validation))
    suspects = diagnose(problem, q, at, seen)
    return Calibration(problem, method, theta, q, seen, at, scale, fit, suspects,
                       _uniqueness(seen, answers, failed, problem.free), "doubtful" if scale > HOPELESS else "ok")


def solvable(problem: CalibrationProblem, method: str) -> CalibrationProblem:
    """The problem as a method solves it.

    Raises:
        ProblemError: unknown method, or the poses cannot determine the parameters.
    """
    if method not in METHODS:
        raise ProblemError(f"'{method}' is no method of kinematic calibration", where="--method",
                           remedy=f"use {' or '.join(METHODS)}")
    if method == "hierarchical":  # which knows no drift, as in the thesis
        drifts = problem.parameters.places(ParameterKind.DRIFT)
        problem = problem.fixing(**{problem.parameters.names[k]: 0.0 for k in drifts})
    if not np.any(problem.free):
        raise ProblemError("no number of the geometry states a confidence, so that nothing is calibrated",
                           where=f"machine '{problem.model.machine.name}'",
                           remedy="give a 'sigma' to the lengths, angles and pins that are in doubt")
    _refuse_too_few(problem)
    _refuse_without_scale(problem)
    refuse_misread(problem, guess_unsensed)
    return problem


def random_start(problem: CalibrationProblem, rng: np.random.Generator) -> Array:
    """Parameters (P,) about the nominal ones, as far as their confidences say."""
    parameters = problem.parameters
    away = rng.standard_normal(len(parameters)) * parameters.scale * problem.free
    return np.asarray(problem.start + away)


def optimum(problem: CalibrationProblem, method: str, start: Array) -> tuple[float, Array, Array]:
    """Squared errors, parameters (P,) and joint vectors (N, n) to which a start (P,), put within the bounds, leads.

    Raises:
        SolverError: to none.
    """
    solve = joint.maximum_likelihood if method == "joint" else link_by_link.sequential_least_squares
    start = np.clip(start, problem.parameters.lower, problem.parameters.upper)
    theta, q = solve(problem, start, guess_unsensed(problem, start))
    return _cost(problem, theta, q), theta, q


def _refuse_too_few(problem: CalibrationProblem) -> None:
    rows = int(problem.at.present.sum() - problem.at.moving.sum()) + len(problem.distances.length)
    unknown = int(np.sum(problem.free & (problem.known == 0)))
    if rows < unknown:
        raise ProblemError(f"{rows} equations of all poses are too few for {unknown} unknown parameters",
                           where=f"poses of {problem.poses.name}", remedy="measure more poses or fix parameters")


def _refuse_without_scale(problem: CalibrationProblem) -> None:
    """Angles alone fit a chain of any size (Section 3.6.4): without a known length all would shrink to nothing."""
    others = np.any(problem.at.present[:, 3:]) or len(problem.distances.length) or problem.priors
    chain = [link for link in problem.model.machine.chain if link.joint.type != "locked"]
    if others or not chain:
        return
    assert problem.model.machine.calibrator is not None
    # the first d only places the base frame, like the fixtures
    lengths = {f"{link.name}.{key}": getattr(link.joint, key) for k, link in enumerate(chain)
               for key in (("a", "d") if k else ("a",))}
    lengths |= zip(("tip.x", "tip.y", "tip.z"), problem.model.machine.calibrator.tip, strict=True)
    free = {name for name, estimated in zip(problem.parameters.names, problem.free, strict=True) if estimated}
    if not any(value for name, value in lengths.items() if name not in free):
        raise ProblemError("there is no length scale: the same angles fit a chain with all its lengths doubled",
                           where=f"poses of {problem.poses.name}", remedy="fix a length, know a distance between "
                           "fixtures, or read a tape, a tracker or a cylinder's length")


def _cost(problem: CalibrationProblem, theta: Array, q: Array) -> float:
    at = linearise(problem, theta, q)
    return float(at.pose_square.sum() + np.sum(at.shared_residual**2))


def _uniqueness(seen: Observability, answers: list[tuple[float, Array, Array]], failed: int,
                free: NDArray[np.bool_]) -> str:
    """What several starts showed, in plain words."""
    if seen.null_space.shape[1] and not np.any(seen.prior):
        return f"not unique: {seen.null_space.shape[1]} combinations leave no trace in the data"
    if len(answers) + failed == 1:
        return "not examined: solved from one start"
    std = np.where(np.isfinite(seen.std), seen.std, np.inf)
    best = answers[0]
    same = sum(bool(np.all(np.abs(theta - best[1])[free] < SAME * std)) for _, theta, _ in answers)
    others = [cost for cost, theta, _ in answers if np.any(np.abs(theta - best[1])[free] >= SAME * std)]
    words = f"{same} of {len(answers) + failed} starts lead to the same solution"
    if failed:
        words += f", {failed} to none"
    if others:
        words += f", {len(others)} to worse ones (the next by {min(others) - best[0]:.3g} in squared errors)"
    return words


def guess_unsensed(problem: CalibrationProblem, theta: Array) -> Array:
    """Joint vectors (N, n) to start with: readings, and for joints that move unsensed the angle that closes best."""
    at, model = problem.at, problem.model
    q = problem.angles(theta, at.reading)
    moving = np.flatnonzero(at.moving.any(axis=0))
    if not moving.size:
        return q
    ranges = np.array([link.joint.range for link in model.links if link.joint.type != "locked"])[moving]
    rng = np.random.default_rng(0)
    blind = at.moving.any(axis=1)
    loops_only = bool(np.all(at.present[blind, :3]))  # the gap tells the angle, and is quicker than all rows
    function, count = (model.closure, 3) if loops_only else (model.observed, at.present.shape[1])
    best, least = q.copy(), np.full(len(q), np.inf)
    for k in range(GUESSES * len(moving)):
        share = (k + 0.5) / GUESSES if len(moving) == 1 else rng.uniform(size=len(moving))
        trial = q.copy()
        trial[:, moving] = np.where(at.moving[:, moving], ranges[:, 0] + share * (ranges[:, 1] - ranges[:, 0]),
                                    q[:, moving])
        rows = model.over(function, theta[: len(model.parameters)], trial, problem.fixtures(theta))[0][:, :, 0]
        size = np.sum(((rows - at.target[:, :count]) * at.present[:, :count]) ** 2, axis=1)
        better = size < least
        best[better], least[better] = trial[better], size[better]
    return best


def closed_angles(problem: CalibrationProblem, theta: Array, q: Array) -> Array:
    """Joint vectors (N, n) with the loops closed by the smallest errors, in standard deviations, of sensed angles."""
    at, model = problem.at, problem.model
    strict = at.present[:, :3] & (problem.row_sigma[:, :3] == 0)
    weight = np.where(at.sensed, problem.angle_sigma, np.where(at.moving, 1.0, 0.0))
    for _ in range(STEPS if np.any(strict) else 0):
        gap, by_q = model.over(model.closure_jacobian, theta[: len(model.parameters)], q, problem.fixtures(theta))
        gap = gap[:, :, 0] * strict
        if np.max(np.abs(gap)) < TIGHT:
            break
        weighted = by_q * strict[:, :, None] * weight[:, None, :]
        q = q - weight * (np.linalg.pinv(weighted, rcond=1e-9) @ gap[:, :, None])[:, :, 0]
    return q


def follow_unsensed(problem: CalibrationProblem, theta: Array, q: Array) -> Array:
    """Joint vectors (N, n) whose unsensed angles close the loops as well as they can, the readings taken as exact."""
    at, model = problem.at, problem.model
    for _ in range(STEPS if np.any(at.moving) else 0):
        rows, by_q = model.over(model.observed_by_angles, theta[: len(model.parameters)], q, problem.fixtures(theta))
        rows = (rows[:, :, 0] - at.target) * at.present
        turn = _least_squares(by_q * at.present[:, :, None], at.moving, rows)
        q = q - np.clip(turn, -0.2, 0.2)
        if np.max(np.abs(turn)) < 1e-6:
            break
    return q


def _least_squares(by_q: Array, moving: NDArray[np.bool_], rows: Array) -> Array:
    """Change (N, n) of the unsensed angles that explains most of the rows (N, m)."""
    which = np.flatnonzero(moving.any(axis=0))
    change = np.zeros(moving.shape)
    blind = by_q[:, :, which] * moving[:, None, which]
    change[:, which] = (np.linalg.pinv(blind, rcond=1e-9) @ rows[:, :, None])[:, :, 0]
    return change


def predicted(problem: CalibrationProblem, theta: Array, poses: object) -> tuple[CalibrationProblem, Array, Array]:
    """Held-out poses under calibrated geometry: only what is new in them is fitted, such as where a fixture stood.

    Returns:
        Their problem, its parameters and joint vectors.
    """
    known = dict(zip(problem.parameters.names, theta.tolist(), strict=True))
    fresh = calibration_problem(problem.model.machine, poses, priors=False)  # type: ignore[arg-type]
    held = {name: known[name] for name in fresh.parameters.names if name in known and not (
        any(fixture.moves and name.startswith(f"{fixture.name}.") for fixture in problem.model.machine.fixtures))}
    trained = problem.angles(theta, problem.at.reading)
    for name in fresh.parameters.names:
        joint_name, locked, stage = name.partition(".locked.")
        rows = problem.poses.stage == stage
        if locked and name not in held and np.any(rows):
            # held back here under the name of a later stage than in the poses that were fitted
            held[name] = float(trained[rows, problem.model.joints.index(joint_name)].mean())
    fresh = fresh.fixing(**held)
    start = fresh.start
    own = guess_unsensed(fresh, start)
    if np.any(fresh.free) or np.any(fresh.at.moving):
        found, own = joint.maximum_likelihood(fresh, start, own)
        return fresh, found, own
    return fresh, start, fresh.angles(start, fresh.at.reading)


def gaps(problem: CalibrationProblem, theta: Array, q: Array) -> Array:
    """(N, m) [m] what the readings leave open in every row: sensed angles as read, unsensed ones as they close best."""
    at = problem.at
    model = problem.model
    rows, by_q = model.over(model.observed_by_angles, theta[: len(model.parameters)], q, problem.fixtures(theta))
    by_q = by_q * at.present[:, :, None]
    rows = (rows[:, :, 0] - at.target) * at.present
    rows = rows + np.einsum("nij,nj->ni", by_q, np.where(at.sensed, at.reading - q, 0.0))
    left: Array = rows - np.einsum("nij,nj->ni", by_q, _least_squares(by_q, at.moving, rows))
    return left


def fit_of(problem: CalibrationProblem, theta: Array, q: Array) -> dict[str, Fit]:
    """RMS [m] and VAF of the loops' gaps and of all other readings (Eq. 3.44-3.46).

    A gap is compared with how far the link that carries the calibrator travels over the poses.
    """
    left, at, model = gaps(problem, theta, q), problem.at, problem.model
    table: dict[str, Fit] = {}
    closed = at.present[:, :3].all(axis=1)
    if np.any(closed):
        chain = [link.name for link in model.machine.chain]
        assert model.machine.calibrator is not None
        ends = model.over(model.far_ends, theta[: len(model.parameters)], q)[0]
        travel = ends[closed][:, :, chain.index(model.machine.calibrator.parent)]
        table["gap"] = _fit(left[closed, :3], travel)
    columns = np.array([i for i, name in enumerate(model.channels) if name.startswith("tip.")])
    there = at.present[:, columns].all(axis=1)
    if np.any(there):
        table["tip"] = _fit(left[there][:, columns], at.target[there][:, columns])
    for i, name in enumerate(model.channels):
        if name.endswith((".length", ".distance")) and np.any(at.present[:, i]):
            there = at.present[:, i]
            table[name] = _fit(left[there, i : i + 1], at.target[there, i : i + 1])
    return table


def _fit(error: Array, signal: Array) -> Fit:
    square = float(np.sum(error**2))
    spread = float(np.sum((signal - signal.mean(axis=0)) ** 2))
    size = float(np.sqrt(np.sum(signal**2)))
    return Fit(float(np.sqrt(square / len(error))), 1 - square / spread if spread else float("nan"),
               np.sqrt(square) / size if size else float("inf"), "m")


def _with_geometry(calibration: Calibration) -> Machine:
    problem = calibration.problem
    machine = problem.model.machine
    source = f"calibrated by {calibration.method} from {problem.poses.name}"
    numbers, values, notes = machine.numbers, {}, {}
    of_paths = dict(machine.notes)
    written: dict[str, float] = {}
    for name, value, std in zip(problem.parameters.names, calibration.theta, calibration.std, strict=True):
        if name not in numbers:  # angles of locked joints, drifts, places of fixtures that move
            continue
        held = name in problem.fixed or calibration.at_bound[problem.parameters.index(name)]
        seen = calibration.category(name) == "full" or (calibration.category(name) == "combination"
                                                        and np.isfinite(std))
        if not (held or seen):  # an arbitrary number of an unseen combination is no result
            continue
        values[name] = float(value)
        if name in problem.fixed:
            continue
        path = numbers[name].path
        before = of_paths.get(path, Note())
        if np.isfinite(std) and std > 0:
            written[path] = max(written.get(path, 0.0), float(std))
            before = before.model_copy(update={"sigma": written[path], "relative": False})
        notes[name] = of_paths[path] = before.model_copy(update={"source": source})
    return machine.with_values(values, notes)
