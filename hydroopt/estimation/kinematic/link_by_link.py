"""The thesis's estimator: link by link from the tip, each stage by Levenberg-Marquardt with truncated singular values.

While one joint i moves unsensed and those before it stand still, the fixture stays on a circle about the joint's axis,
and of its position only the radius ρ and the height p_z matter: r = (√(s_x² + s_y²) − ρ, s_z + d_i − p_z) = 0, where
s is the tip in the frame before the joint (Eqs. 3.24, 3.25, 3.28). So a stage needs nothing but the links from i to the
tip, and of these only what stages before it have not identified. It takes d_i as given: p_z hides it.
A joint with nothing locked before it closes the whole loop and identifies the fixture; so do poses whose joints are all
sensed, with the loop's gap and all their parameters at once.

What no stage identified, such as the angles at which inner joints were locked while others moved, is at last fitted to
the whole loops of all poses; combinations that these do not show either stay as near to the start as the loops allow.
All rows weigh the same, readings of angles are taken as exact, priors and the play of fixtures do not count.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any, NamedTuple

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from hydroopt.errors import ProblemError
from hydroopt.estimation.inference.certificate import AT_BOUND
from hydroopt.estimation.inference.gauss_newton import DenseRows, minimise
from hydroopt.estimation.inference.identifiability import NULL_SHARE, PREDICTED_TOLERANCE, significant
from hydroopt.estimation.kinematic.problem import CalibrationProblem
from hydroopt.parameters.parameter_set import ParameterKind
from hydroopt.results.tables import number
from hydroopt.spatial.inertia import Array


class StageResult(NamedTuple):
    """What a stage gave; the last one, named 'all', is what the loops of all stages gave together.

    Attributes:
        stage: its name.
        joint: the joint that moved unsensed; '' if all were sensed.
        unknowns: parameters that no stage before had identified, with the circle's two (Eq. 3.28).
        identified: names of those that this stage identified.
        iterations: steps of Eq. 3.43 that were made, the columns "No. of Iterations" of Tables 4 to 7 and 9.
        truncation: part p of the largest singular value below which the last step zeroed singular values.
        rank: singular values that it kept.
        rms: root mean square of the rows [m].
    """

    stage: str
    joint: str
    unknowns: int
    identified: tuple[str, ...]
    iterations: int
    truncation: float
    rank: int
    rms: float

    def __str__(self) -> str:
        moved = f", {self.joint} moves" if self.joint else ""
        return (f"{self.stage}{moved}: {self.iterations} iterations, {len(self.identified)} of {self.unknowns} "
                f"unknowns identified, rank {self.rank} at a truncation of {100 * self.truncation:.1e} %, "
                f"RMS {1e3 * self.rms:.3f} mm")

    def as_dict(self) -> dict[str, Any]:
        """The entry of a JSON file."""
        return {**self._asdict(), "identified": list(self.identified), "rms": number(self.rms)}


FIRST, LAST = 5e-2, 5e-11
"""Singular values below this part of the largest are zeroed: at first, and after tenfold reductions at last."""
SETTLED = 1e-10
"""Relative decrease of the sum of squares below which an iteration has converged."""
ROUNDOFF = 1e-14
"""Smallest predicted decrease [m], as a root mean square, for which a step is made."""
EXACT_WEIGHT = 100.0
"""Weight of the best known distance between fixtures against a gap: loops must not shrink to shrink their noise."""
Rows = Callable[[Array], tuple[Array, Array]]
"""x -> residuals (R,) [m] and their Jacobian (R, size of x)."""


class Hierarchy(NamedTuple):
    """Parameters (P,), joint vectors (N, n) [rad, m], and what each stage contributed, in the order of the stages."""

    parameters: Array
    q: Array
    stages: tuple[StageResult, ...]


def sequential_least_squares(problem: CalibrationProblem, start: Array, own: Array) -> Hierarchy:
    """Stage by stage: sensed angles as read, unsensed ones from the closed loops.

    Args:
        problem: what to solve.
        start: (P,) initial parameters.
        own: (N, n) angles, used only where a joint moves and nothing closes the loop.

    Raises:
        ProblemError: the problem holds what this method cannot use, or the answer lies outside of the bounds.
    """
    _refuse(problem)
    theta = np.array(start, dtype=float)
    for name, value in problem.fixed.items():
        theta[problem.parameters.index(name)] = value
    left = problem.free
    parts = _parts(problem)
    results: list[StageResult] = []

    def settle(stage: str, joint: str, rows: Rows, locals_: Array, unit: float) -> None:
        x, unknown = np.concatenate([theta, locals_]), np.concatenate([left, np.full(len(locals_), True)])
        scale = np.concatenate([problem.parameters.scale, np.full(len(locals_), unit)])
        answer = _minimise(rows, x, np.flatnonzero(unknown), scale)
        theta[:], found = answer.x[: len(theta)], answer.identified[answer.identified < len(theta)]
        left[found] = False
        results.append(StageResult(
            stage, joint, int(unknown.sum()), tuple(problem.parameters.names[k] for k in found), answer.iterations,
            answer.truncation, answer.rank, answer.rms))

    for stage, joint, part in parts:
        unit = float(problem.parameters.scale[part.layout.fixture[0, 0]])
        if joint and _stands_still(part, joint):
            rows, circle = _about_axis(part, joint, theta)
            settle(stage, joint, rows, circle, unit)
        else:
            settle(stage, joint, _whole_loop(part), np.zeros(0), unit)
    if np.any(left) and (len(parts) > 1 or parts[0][1]):
        settle("all", "", _whole_loop(problem.without(~problem.layout.held)), np.zeros(0), 1.0)
    _check_bounds(problem, theta)
    closed = _closed(problem, theta)
    loose = problem.layout.moving & ~problem.layout.held[:, None]
    return Hierarchy(theta, np.where(loose, own, closed), tuple(results))


def _parts(problem: CalibrationProblem) -> list[tuple[str, str, CalibrationProblem]]:
    """Stage, moving joint and poses of each stage in the order of measurement; all sensed ones count as one."""
    layout, joints = problem.layout, problem.model.joints
    held = layout.held
    keys = np.array([(str(stage), joints[int(np.argmax(moves))]) if np.any(moves) else ("", "")
                     for stage, moves in zip(problem.poses.stage, layout.moving, strict=True)])
    parts = []
    for stage, joint in dict.fromkeys((str(name), str(moves)) for name, moves in keys[held]):
        own = held & (keys == (stage, joint)).all(axis=1)
        name = stage if joint else " + ".join(dict.fromkeys(map(str, problem.poses.stage[own])))
        parts.append((name, joint, problem.without(~own)))
    return parts


def _stands_still(part: CalibrationProblem, joint: str) -> bool:
    """Whether the fixture's place in the frame before a joint is constant but unknown: locked joints, none sensed."""
    model = part.model
    chain = [link.name for link in model.machine.chain]
    inner = chain[: chain.index(joint)] if joint in chain else []
    before = [model.joints.index(name) for name in inner if name in model.joints]
    locked = np.isin(part.layout.locked[0] % len(model.joints), before)
    return bool(np.any(locked)) and not np.any(part.layout.sensed[:, before])


def _about_axis(part: CalibrationProblem, joint: str, theta: Array) -> tuple[Rows, Array]:
    """Eq. 3.28 for poses of one stage, and (ρ, p_z) (2f,) [m] of its f fixtures to begin with, the unknowns after θ.

    Seen from before the joint the tip is s + (0, 0, d_i), turned by θ_i, which the radius does not depend on.
    """
    model, layout, total = part.model, part.layout, len(part.parameters)
    g, q = ca.SX.sym("g", len(model.parameters)), ca.SX.sym("q", len(model.joints))
    tip = model.tip_in_frame(joint)(g, q)
    circle = ca.vertcat(ca.norm_2(tip[:2]), tip[2])
    function = ca.Function("circle", [g, q], [circle, ca.jacobian(circle, g), ca.jacobian(circle, q)])
    place = np.unique(layout.fixture[:, 0], return_inverse=True)[1]
    poses, fixtures = np.arange(len(place)), int(place.max()) + 1
    offset = part.parameters.positions.get(f"{joint}.d")
    where, which, factor = layout.locked

    def compute(theta: Array) -> tuple[Array, Array, Array]:
        value, by_g, by_q = model.over(function, theta[: len(model.parameters)], part.angles(theta, layout.reading))
        return value[:, :, 0], by_g, by_q

    def rows(x: Array) -> tuple[Array, Array]:
        value, by_g, by_q = compute(x[:total])
        jacobian = np.zeros((len(place), total + 2 * fixtures, 2))
        jacobian[:, : by_g.shape[2]] = by_g.transpose(0, 2, 1)
        pose, turned = np.divmod(where, len(model.joints))
        np.add.at(jacobian, (pose, which), factor[:, None] * by_q[pose, :, turned])
        if offset is not None:
            jacobian[:, offset] = 0.0
        for k in range(2):
            jacobian[poses, total + 2 * place + k, k] = -1.0
        residual = value - x[total:].reshape(-1, 2)[place]
        return residual.ravel(), jacobian.transpose(0, 2, 1).reshape(residual.size, -1)

    value = compute(theta)[0]
    return rows, np.concatenate([value[place == k].mean(axis=0) for k in range(fixtures)])


def _whole_loop(part: CalibrationProblem) -> Rows:
    """Gaps of poses, and known distances between their fixtures.

    Where a joint moves unsensed, it is turned to where the gap is smallest and what it moves is projected out. What is
    left are the two rows of Eq. 3.28, in the base frame and with the fixture's ρ and p_z as its position gives them.
    """
    known, visited = part.distances, np.unique(part.layout.fixture)
    both = [k for k, ends in enumerate(known.ends) if np.isin(ends, visited).all()]

    def rows(x: Array) -> tuple[Array, Array]:
        gap, jacobian, by_q = (each[:, :3] for each in part.rows(x, _closed(part, x)))
        blind = np.sum(by_q * part.layout.moving[:, None, :], axis=2)
        blind /= np.maximum(np.linalg.norm(blind, axis=1, keepdims=True), 1e-300)
        across = np.eye(3) - blind[:, :, None] * blind[:, None, :]
        residuals = [(across @ gap[:, :, None]).ravel()]
        slopes = [(across @ jacobian).reshape(-1, len(x))]
        for k in both:
            weight = EXACT_WEIGHT * known.sigma[both].min() / known.sigma[k]
            one, other = known.ends[k]
            apart = x[one] - x[other]
            slope = np.zeros((1, len(x)))
            slope[0, one], slope[0, other] = (sign * weight * apart / np.linalg.norm(apart) for sign in (1, -1))
            residuals.append(np.array([weight * (np.linalg.norm(apart) - known.length[k])]))
            slopes.append(slope)
        return np.concatenate(residuals), np.vstack(slopes)
    return rows


def _closed(part: CalibrationProblem, theta: Array) -> Array:
    """Joint vectors (N, n) whose moving angle brings the tip nearest to the fixture (Eqs. 3.24a, b).

    The tip runs on a circle: its squared distance from the fixture is a cosine of the angle, known from three places.
    """
    layout, model = part.layout, part.model

    def turned(turn: Array | float) -> Array:
        return part.angles(theta, np.where(layout.moving, turn, layout.reading))

    first, quarter, half = (
        np.sum(model.over(model.closure, theta[: len(model.parameters)], turned(turn), part.places(theta)[:, :3])[0]**2,
               axis=(1, 2)) for turn in (0.0, np.pi / 2, np.pi))
    mean = (first + half) / 2
    return turned(np.arctan2(mean - quarter, mean - first)[:, None])


class _Minimum(NamedTuple):
    """x, which of the unknown ones are identified, and how they were found, see `StageResult`."""

    x: Array
    identified: NDArray[np.intp]
    iterations: int
    truncation: float
    rank: int
    rms: float


def _minimise(rows: Rows, x: Array, unknown: NDArray[np.intp], scale: Array) -> _Minimum:
    """Least squares by Eqs. 3.42 and 3.43.

    Singular values below a part p of the largest are zeroed; p shrinks once the iteration has converged, until this
    frees directions without a gain. A step that increases the sum is repeated with more damping.
    """
    def of_unknown(own: Array) -> tuple[Array, Array]:
        every = x.copy()
        every[unknown] = own
        residual, jacobian = rows(every)
        return residual, jacobian[:, unknown]

    place, p, iterations, rank = DenseRows(of_unknown, x[unknown], 1 / scale[unknown]), FIRST, 0, 0
    truncation, taken = p, 0  # of the last step
    while p >= LAST:
        before = place.cost
        found = minimise(replace(place, truncation=p), tolerance=ROUNDOFF * np.sqrt(len(place.linearised[0])),
                         relative=SETTLED)
        place, iterations = found.place, iterations + found.steps
        if found.steps:
            truncation, taken = p, found.last.rank
        if found.last.rank > rank > 0 and place.cost > (1 - SETTLED) * before:
            break
        p, rank = p / 10, found.last.rank
    residual, jacobian = place.linearised
    _, s, vt = np.linalg.svd(jacobian * scale[unknown])
    null_space = vt[int(np.sum(significant(s, PREDICTED_TOLERANCE))) :]
    identified = unknown[np.linalg.norm(null_space, axis=0) < NULL_SHARE]
    solution = x.copy()
    solution[unknown] = place.x
    return _Minimum(solution, identified, iterations, truncation, taken, float(np.sqrt(np.mean(residual**2))))


def _refuse(problem: CalibrationProblem) -> None:
    """Refuse what this method cannot use."""
    layout, model, where = problem.layout, problem.model, f"poses of {problem.poses.name}"
    other = "use the method 'joint'"
    if not np.any(layout.held):
        raise ProblemError("no pose holds the tip in a fixture, so that no loop closes", where=where, remedy=other)
    read, rows = np.flatnonzero(layout.present.any(axis=0)), model.loop_rows
    if np.any(layout.present[:, :rows] != layout.held[:, None] & (np.arange(rows) < 3)):
        raise ProblemError("the link-by-link method knows balls only, no fixture of another kind", where=where,
                           remedy=other)
    if np.any(read >= rows):
        raise ProblemError(f"the link-by-link method closes loops only and cannot use '{model.channels[read[-1]]}'",
                           where=where, remedy=f"{other} or leave the channel out")
    if problem.loss != "squares":
        raise ProblemError(f"the link-by-link method knows least squares only, not the loss '{problem.loss}'",
                           where=where, remedy=f"{other} or the loss 'squares'")
    for name, kind in zip(problem.parameters.names, problem.parameters.kinds, strict=True):
        if kind is ParameterKind.DRIFT and problem.fixed.get(name) != 0:
            raise ProblemError("the link-by-link method takes locked joints as still and cannot estimate their drift",
                               where=f"parameter '{name}'", remedy=f"{other}, or hold the parameter at 0")
    kinds = {link.name: link.joint.type for link in model.links}
    for stage, moving in zip(problem.poses.stage, layout.moving, strict=True):
        names = [model.joints[k] for k in np.flatnonzero(moving)]
        if len(names) > 1:
            raise ProblemError(f"{' and '.join(names)} move unsensed at the same time, the link-by-link method "
                               "eliminates one joint a stage", where=f"stage '{stage}'",
                               remedy=f"{other}, move one at a time, or record '{names[0]}.q'")
        if names and kinds[names[0]] != "revolute":
            raise ProblemError(f"'{names[0]}' slides unsensed, the link-by-link method eliminates angles only",
                               where=f"stage '{stage}'", remedy=f"{other}, or record '{names[0]}.q'")
    if np.any(layout.moving) and any(link.joint.compliance is not None for link in model.links):
        raise ProblemError("joints give way, so that the tip's path about an unsensed joint is no circle",
                           where=f"machine '{model.machine.name}'", remedy=f"{other}, or state no compliance")


def _check_bounds(problem: CalibrationProblem, theta: Array) -> None:
    """Raise where the answer, which knows no bounds, lies outside of them by more than a residue."""
    own, residue = problem.parameters, AT_BOUND * problem.parameters.scale
    for k in np.flatnonzero(problem.free & ((theta < own.lower - residue) | (theta > own.upper + residue))):
        raise ProblemError(f"the link-by-link method found {theta[k]:.4g} {own.units[k]}, outside of the bounds "
                           f"{own.lower[k]:.4g} to {own.upper[k]:.4g}, which it cannot keep to",
                           where=f"parameter '{own.names[k]}'",
                           remedy="use the method 'joint', measure more poses or fix the parameter")
