"""Calibrator and poses as one nonlinear program: the smallest deviations of the machine's lengths.

Variables are the sizes of the calibrator, the place of its ball, the angles of some poses, and how often each of these
is measured. Exact designs follow by rounding: the sum of weighted information is that of the approximate theory
(Kiefer and Wolfowitz 1960).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from hydroopt.estimation.inference.ipopt import improved
from hydroopt.estimation.kinematic.problem import CalibrationProblem
from hydroopt.excitation.selection.construction import Size
from hydroopt.excitation.selection.pose_problem import PoseProblem, calibration_of
from hydroopt.excitation.selection.shares import POWER, Shares, optimal_shares
from hydroopt.excitation.selection.whitened_rows import whitened_rows
from hydroopt.parameters.parameter_set import ParameterKind
from hydroopt.simulation import postures
from hydroopt.spatial.inertia import Array

CLOSE = 1e-4
"""By how much limits may be missed."""
STEPS = 120
"""Steps of the solver at most."""
FAINT = 1e-6
"""Information of every parameter in units of its scale: keeps the covariance finite."""
ASIDE, ROOM = float(np.radians(3.0)), 0.01
"""How far poses keep away from limits of joints [rad, m], and from all others (parts of a stroke, heights [m], the
dexterity, turns [rad]), while sizes are found: the best poses lie at limits, and would be lost once sizes are
rounded."""
STROKE = 0.1
"""Part of each stroke by which poses stay away from its ends."""
DEXTERITY = 0.1
"""Least determinant of J·Jᵀ over the cube of its mean eigenvalue, J (3, r) the motion of the ball by the calibrator's
joints: 1 where it moves alike in all directions, 0 in a singular pose."""
TURN, CERTAINTY = 0.2, 3.0
"""How far joints of the calibrator may turn, at most [rad], to reach the ball where the machine is so many standard
deviations off: a calibrator that is nearly stretched would not reach it."""

TINY = 1e-12
"""Variance [rad²] that keeps these turns differentiable where nothing is uncertain."""


@dataclass(frozen=True)
class Sized:
    """A calibrator with poses: sizes by address [rad, m], postures (G, m, n), their shares (G, m), and the logarithm of
    the largest deviation in units of what is asked for."""

    values: dict[str, float]
    q: Array
    share: Array
    worst: float


class JointProgram:
    """Sizes, poses and shares of a template machine, whose numbers they replace.

    Attributes:
        problem: poses of the template; `count` of each group.
        sizes: what is chosen of the calibrator; all are parameters of the template.
        targets: deviations [m] asked for by parameter.
        clearance: least height [m] of the joints of the calibrator above ground.
    """

    def __init__(self, problem: PoseProblem, sizes: Sequence[Size], targets: dict[str, float],
                 clearance: float) -> None:
        self.problem, self.sizes, self.targets, self.clearance = problem, tuple(sizes), targets, clearance

    @cached_property
    def calibration(self) -> CalibrationProblem:
        """One pose of each group; where locked joints drift one early and one late, as many more of them spread."""
        low, high = postures.limits(self.problem.model)
        each = 1 + any(group.drift for group in self.problem.groups)
        count = each * len(self.problem.groups)
        found = calibration_of(self.problem, np.repeat([(low + high) / 2], count, axis=0), self.problem.labels(each))
        where, which, factor = found.layout.locked
        drifts = np.array([kind is ParameterKind.DRIFT for kind in found.parameters.kinds])[which]
        spread = np.where(drifts, 0.5 + (factor - 0.5) / np.sqrt(3.0), factor)  # of even progress from 0 to 1
        return replace(found, layout=replace(found.layout, locked=(where, which, spread)))

    @cached_property
    def free(self) -> list[int]:
        """Parameters that are estimated."""
        return [int(k) for k in np.flatnonzero(self.calibration.free)]

    @cached_property
    def uncertain(self) -> Array:
        """(p,) standard deviations of the geometry; zero of what is exact."""
        parameters = self.problem.model.parameters
        return np.where([name in self.problem.fixed for name in parameters.names], 0.0, parameters.scale)

    @cached_property
    def rows(self) -> list[ca.Function]:
        """(theta, q) -> transposed white rows (f, u) of each group."""
        groups = len(self.problem.groups)
        each = len(self.calibration.poses) // groups
        found = []
        for k in range(groups):
            functions = [whitened_rows(self.calibration, k * each + j) for j in range(each)]
            theta, q = functions[0].mx_in()
            together = ca.horzcat(*(function(theta, q) for function in functions)) / np.sqrt(each)
            found.append(ca.Function("rows", [theta, q], [together], ["theta", "q"], ["rows"]))
        return found

    @cached_property
    def bounded(self) -> ca.Function:
        """(theta, q) -> gap (k,) that must vanish, strokes, heights, dexterity and turns that must not be negative."""
        calibration, model = self.calibration, self.problem.model
        theta, q = ca.SX.sym("theta", len(calibration.parameters)), ca.SX.sym("q", len(model.joints))
        layout = calibration.layout
        place = ca.vertcat(*(theta[int(which)] if which >= 0 else ca.SX(0) for which in layout.place[0]))
        g = theta[: len(model.parameters)]
        gap, by_q = model.loop_by_angles(g, q, place)
        closes = np.flatnonzero(layout.present[0, : model.loop_rows]).tolist()
        rest = []
        machine = model.machine
        if machine.cylinders:
            stroke = ca.DM([each.stroke for each in machine.cylinders])
            out = model.strokes(g, q)[0] / stroke
            rest += [out - STROKE, 1 - STROKE - out]
        if machine.ground is not None and machine.calibrator is not None:
            ends = model.far_ends(g, q)[2, len(machine.ancestry(machine.calibrator.parent)) - 1 : -1]
            rest.append(ends.T - machine.ground - self.clearance)
        motion = by_q[:3, postures.sensed_joints(model)]
        rest.append(dexterity(motion) - DEXTERITY)
        moved = ca.jacobian(gap[:3], g) @ ca.diag(ca.DM(self.uncertain))
        turned = motion.T @ ca.solve(motion @ motion.T, moved)
        rest.append(TURN - CERTAINTY * ca.sqrt(ca.sum2(turned**2) + TINY))
        return ca.Function("bounded", [theta, q], [gap[closes], ca.vertcat(*rest)], ["theta", "q"], ["gap", "rest"])

    def criterion(self, theta: Any, q: Sequence[Any], share: Sequence[Any]) -> Any:
        """Logarithm of the power mean of the targets' deviations in units of what is asked for, at poses (n, m) and
        shares (1, m) of each group."""
        scale, total = ca.DM(self.calibration.parameters.scale[self.free]), ca.diag(ca.DM(self._known))
        for rows, poses, part in zip(self.rows, q, share, strict=True):
            count = poses.shape[1]
            rows_of_one = rows.map(count)(ca.repmat(theta, 1, count), poses) * ca.repmat(
                scale, 1, count * rows.size2_out(0))
            each = ca.kron(part, ca.DM.ones(1, rows.size2_out(0)))
            total = total + self.problem.count * ((rows_of_one * ca.repmat(each, len(self.free), 1)) @ rows_of_one.T)
        pick = ca.DM(self._pick)
        variance = ca.sum1(pick * ca.solve(total, pick))
        return ca.logsumexp(POWER * ca.log(variance).T) / (2 * POWER)

    def theta(self, values: Mapping[str, float]) -> Array:
        """All parameters (P,) with numbers of the template replaced, by address."""
        theta = self.calibration.start
        theta[[self.calibration.parameters.index(name) for name in values]] = list(values.values())
        return theta

    def shares(self, values: Mapping[str, float], q: Array, steps: int = 60) -> Shares:
        """The best shares of closed postures (G, C, n)."""
        theta, free = self.theta(values), self.free
        scale = self.calibration.parameters.scale[free]
        rows = [np.asarray(each.map(len(some))(np.repeat(theta[:, None], len(some), axis=1), some.T))
                for each, some in zip(self.rows, q, strict=True)]
        rows = [scale * each.T.reshape(q.shape[1], -1, len(free)) for each in rows]
        return optimal_shares(np.array(rows), np.diag(self._known), self._pick, self.problem.count, steps)

    @cached_property
    def _known(self) -> Array:
        """Information (f,) beside the poses, in units of the parameters' scales."""
        scale = self.calibration.parameters.scale[self.free]
        return np.asarray((self.calibration.known[self.free] * scale) ** 2 + FAINT)

    @cached_property
    def _pick(self) -> Array:
        """(f, k) the targets, in units of what is asked for, by the parameters in units of their scales."""
        pick = np.zeros((len(self.free), len(self.targets)))
        for column, (name, target) in enumerate(self.targets.items()):
            k = self.calibration.parameters.index(name)
            pick[self.free.index(k), column] = self.calibration.parameters.scale[k] / target
        return pick

    def fits(self, values: Mapping[str, float], q: Array, free: Sequence[int], aside: float) -> NDArray[np.bool_]:
        """Which closed postures (N, n) keep limits of the joints `free`, strokes, heights and dexterity, and stay away
        from them by a part of what they do when sizes are found."""
        rest = self.bounded.map(len(q))(np.repeat(self.theta(values)[:, None], len(q), axis=1), q.T)[1]
        low, high = postures.limits(self.problem.model)
        within = np.minimum(q - low, high - q)[:, list(free)]
        return np.asarray(np.all(np.asarray(rest) >= aside * ROOM - CLOSE, axis=0)
                          & np.all(within >= aside * ASIDE - CLOSE, axis=1))

    def solve(self, values: Mapping[str, float], q: Array, shares: Array,
              steps: int = STEPS) -> tuple[dict[str, float], Array]:
        """Better sizes and postures near sizes and closed postures (G, m, n) with shares (G, m).

        Values that are no sizes stay as they are. The postures are closed as far as the solver got.
        """
        groups, count, n = q.shape
        places = [self.calibration.parameters.index(size.name) for size in self.sizes]
        theta = ca.MX(ca.DM(self.theta(values)))
        x = ca.MX.sym("x", len(places))
        theta[places] = x
        poses = [ca.MX.sym(f"q{k}", n, count) for k in range(groups)]
        share = [ca.MX.sym(f"share{k}", 1, count) for k in range(groups)]
        gaps, rests, sums = [], [], []
        for each, part in zip(poses, share, strict=True):
            gap, rest = self.bounded.map(count)(ca.repmat(theta, 1, count), each)
            gaps.append(ca.vec(gap))
            rests.append(ca.vec(rest))
            sums.append(ca.sum2(part) - 1)
        equal, rest = ca.vertcat(*gaps, *sums), ca.vertcat(*rests)
        low, high = self._range(q)
        bounds = [(size.lower, size.upper) for size in self.sizes]
        lower = np.concatenate([[each[0] for each in bounds], low.ravel(), np.zeros(groups * count)])
        upper = np.concatenate([[each[1] for each in bounds], high.ravel(), np.ones(groups * count)])
        start = np.concatenate([[values[size.name] for size in self.sizes], q.ravel(), shares.ravel()])
        least = np.concatenate([np.zeros(equal.numel()), np.full(rest.numel(), ROOM)])
        most = np.concatenate([np.zeros(equal.numel()), np.full(rest.numel(), np.inf)])
        found = improved({
            "x": ca.vertcat(x, *map(ca.vec, poses), *map(ca.vec, share)), "f": self.criterion(theta, poses, share),
            "g": ca.vertcat(equal, rest)}, np.clip(start, lower, upper), lower, upper, least, most, steps)
        sized = zip((size.name for size in self.sizes), found[: len(places)].tolist(), strict=True)
        return {**values, **dict(sized)}, found[len(places) : len(places) + q.size].reshape(q.shape)

    def _range(self, q: Array) -> tuple[Array, Array]:
        """Lower and upper limits (G, m, n) of the angles; those at rest stay."""
        low, high = (np.broadcast_to(each + sign * ASIDE, q.shape).copy() for each, sign in zip(
            postures.limits(self.problem.model), (1, -1), strict=True))
        layout = self.calibration.layout
        still = ~(layout.sensed | layout.moving)[:: len(self.calibration.poses) // len(q)]
        still = np.broadcast_to(still[:, None], q.shape)
        low[still], high[still] = q[still], q[still]
        return low, high


def dexterity(motion: Any) -> Any:
    """Of the motion (3, r) of the ball by the calibrator's joints: see `DEXTERITY`."""
    square = motion @ motion.T
    return ca.det(square) / (ca.trace(square) / 3) ** 3
