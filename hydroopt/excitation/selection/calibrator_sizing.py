"""The sizes of a calibrator of one construction: random ones, then sizes and poses together, in turn with fresh poses.

Sizes and poses are one nonlinear program, of the smallest deviations of the machine's lengths. Its variables are the
sizes of the calibrator, the place of its ball, the angles of some poses, and how often each of these is measured. Exact
designs follow by rounding: the sum of weighted information is that of the approximate theory (Kiefer and Wolfowitz
1960). Shares (G, C) of the C candidates of each of G groups sum up to one in each group. The criterion is the largest
variance of some combinations, smoothed by a power mean; it is convex in the shares (Pukelsheim 2006), so that its
tangent is a lower bound over all shares: the equivalence theorem of Kiefer and Wolfowitz as an inequality.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from hydroopt.estimation.inference.ipopt import improved
from hydroopt.estimation.kinematic.problem import CalibrationProblem
from hydroopt.excitation.criteria import FAINT
from hydroopt.excitation.selection.calibrator_problem import (
    BRACKET,
    CalibratorProblem,
    Construction,
    carrying,
    fixture_of,
    sizes,
)
from hydroopt.excitation.selection.candidate_postures import Sieve
from hydroopt.excitation.selection.pose_problem import PoseGroup, PoseProblem, Postures, pose_problem
from hydroopt.limits.postures import LeftOut
from hydroopt.limits.uncertain import TINY
from hydroopt.parameters.parameter_set import ParameterKind
from hydroopt.simulation import postures
from hydroopt.simulation.postures import REACHED, RESERVE
from hydroopt.spatial.inertia import Array
from hydroopt.support.progress import Progress

CLOSE = 1e-4
"""By how much limits may be missed."""
STEPS = 120
"""Steps of the solver at most."""
ASIDE, ROOM = float(np.radians(3.0)), 0.01
"""How far poses keep away from limits of joints [rad, m], and from all others (parts of a stroke, heights [m], the
dexterity, turns [rad]), while sizes are found: the best poses lie at limits, and would be lost once sizes are
rounded."""
DEXTERITY = 0.1
"""Least determinant of J·Jᵀ over the cube of its mean eigenvalue, J (3, r) the motion of the ball by the calibrator's
joints: 1 where it moves alike in all directions, 0 in a singular pose."""
TURN = 0.2
"""How far joints of the calibrator may turn, at most [rad], to reach the ball where the machine is `REACHED` standard
deviations off: a calibrator that is nearly stretched would not reach it."""
FEW, MANY = 16, 150
"""Closed postures of each group by which sizes are judged at first, and from which the best are taken."""
SUPPORT = 12
"""Postures of each group that are moved together with the sizes."""
DRAWN = 40
"""Random calibrators for each start."""
ROUNDS = 3
"""Rounds with fresh postures."""
NEARLY = 0.95
"""Part of the distance from limits that closed postures of the solver keep."""
ABOUT = float(np.radians(1.0))
"""Standard deviation [rad, m] of postures that are measured instead of one posture again and again."""
DENSE = 4
"""Postures about one that are tried for each that is wanted."""
POWER = 6.0
"""Exponent of the mean that stands for the largest variance."""


@dataclass(frozen=True)
class Sized:
    """A calibrator with poses: sizes by address [rad, m], postures (G, m, n), their shares (G, m), and the logarithm of
    the largest deviation in units of what is asked for."""

    values: dict[str, float]
    q: Array
    share: Array
    worst: float


class Shares(NamedTuple):
    """Shares (G, C), variances (k,) of the combinations, the least that any shares could make of their largest, and the
    weights (k,) with which the sum of the variances has the same optimum."""

    share: Array
    variance: Array
    bound: float
    weight: Array


def optimal_shares(rows: Array, known: Array, pick: Array, count: float, steps: int) -> Shares:
    """Multiplicative steps (Silvey, Titterington and Torsney 1978) from even shares.

    Args:
        rows: (G, C, u, f) white rows.
        known: (f, f) information that counts beside them.
        pick: (f, k) combinations.
        count: poses of each group.
        steps: of the iteration.
    """
    groups, candidates = rows.shape[:2]
    share = np.full((groups, candidates), 1 / candidates)
    for step in range(steps + 1):
        weighted = np.sqrt(count * share)[:, :, None, None] * rows
        flat = weighted.reshape(-1, rows.shape[-1])
        towards = np.linalg.solve(known + flat.T @ flat, pick)
        variance = np.einsum("fk,fk->k", pick, towards)
        size = variance / np.max(variance)
        weight = size ** (POWER - 1) / np.sum(size**POWER) ** (1 - 1 / POWER)  # of the power mean's gradient
        gain = count * np.einsum("gcuk,k->gc", (rows @ towards) ** 2, weight)
        if step < steps:
            share = share * np.maximum(gain, 1e-300) ** (1 / (1 + POWER))
            share /= share.sum(axis=1, keepdims=True)
    mean = np.max(variance) * np.sum(size**POWER) ** (1 / POWER)
    least = mean - float(np.sum(gain.max(axis=1) - np.sum(gain * share, axis=1)))
    return Shares(share, variance, max(least, 0.0) / len(variance) ** (1 / POWER), weight)


class Sizing:
    """Sizes of one construction on one machine.

    Attributes:
        construction: what is built; which axes cross is left open here.
        sizes: what is chosen; all are parameters of the template.
        targets: deviations [m] asked for by parameter.
        clearance: least height [m] of the joints of the calibrator above ground.
        problem: poses of the template, a machine whose calibrator has sizes in the middle of their ranges.
        left_out: closed postures that were left out so far to keep reserves.
    """

    def __init__(self, asked: CalibratorProblem, construction: Construction) -> None:
        workshop, self.construction, self.fixture = asked.workshop, construction, fixture_of(asked.machine)
        self.sizes, self.targets = tuple(sizes(construction, workshop, self.fixture)), dict(asked.length_std)
        self.clearance = max(workshop.clearance, asked.reserves.clearance)
        # sizes are parameters of the template also where the workshop builds them exactly
        uncertain = replace(workshop, length_error=workshop.length_error or 1e-3,
                            angle_error=workshop.angle_error or 1e-3)
        middle = {size.name: (size.lower + size.upper) / 2 for size in self.sizes}
        template = carrying(asked.machine, construction, middle, uncertain, asked.keep)
        problem = pose_problem(template, asked.count, priors=asked.priors, fixed=asked.fixed, reserves=asked.reserves)
        exact, made = {"m": not workshop.length_error, "rad": not workshop.angle_error}, (BRACKET, *construction.names)
        held = {name: float(value) for name, unit, value in zip(
            problem.parameters.names, problem.parameters.units, problem.parameters.nominal, strict=True)
            if name.partition(".")[0] in made and exact[unit]}
        self.problem: PoseProblem = replace(problem, fixed={**held, **asked.fixed})
        self.left_out = LeftOut()
        self.twists = tuple(f"{name}.alpha" for name in made[:-1])

    def best(self, starts: int, rng: np.random.Generator, progress: Progress, done: tuple[float, float],
             effort: float = 1.0) -> Sized:
        """From some starts; `done` are the parts of all work before and after it."""
        begin, end = done
        drawn_each, rounds = max(2, round(DRAWN * effort)), max(1, round(ROUNDS * effort))
        steps = max(5, round(STEPS * min(effort, 1.0)))
        drawn = []
        for k in range(starts * drawn_each):
            if k % drawn_each == 0:
                progress(f"drawing calibrators of {self.construction.links} links",
                         begin + 0.3 * (end - begin) * k / (starts * drawn_each))
            values = self.random(rng)
            drawn.append((self.judged(values, rng), k, values))
        drawn.sort(key=lambda each: each[:2])
        found = []
        for k, (_, _, values) in enumerate(drawn[:starts]):
            progress(f"sizing calibrator {k + 1} of {starts} with {self.construction.links} links",
                     begin + (0.3 + 0.7 * k / starts) * (end - begin))
            if (sized := self.refined(values, rng, rounds, steps)) is not None:
                found.append(sized)
        return min(found, key=lambda each: each.worst, default=Sized({}, np.zeros(0), np.zeros(0), np.inf))

    def random(self, rng: np.random.Generator) -> dict[str, float]:
        """Sizes and twists."""
        values = {size.name: float(rng.uniform(size.lower, size.upper)) for size in self.sizes}
        return values | {name: np.pi / 2 * int(rng.integers(2)) for name in self.twists}

    def crossing(self, values: Mapping[str, float]) -> tuple[bool, ...]:
        """Which axes cross at right angles."""
        return tuple(values[name] > 0 for name in self.twists)

    def judged(self, values: Mapping[str, float], rng: np.random.Generator) -> float:
        """Logarithm of the largest deviation by a few postures; beyond all others where these do not close."""
        found = self.postures(values, FEW, rng)
        least = min(map(len, found))
        if least < FEW // 2:
            return 100.0 - sum(min(len(each), FEW) for each in found)
        q = np.array([each[:least] for each in found])
        return float(0.5 * np.log(np.max(self.shares(values, q, 30).variance)))

    def postures(self, values: Mapping[str, float], count: int, rng: np.random.Generator,
                 aside: float = 1.0) -> list[Array]:
        """Up to so many closed postures (K, n) of each group within all limits; fewer where they are rare."""
        model, found = self.problem.model, []
        for group in self.problem.groups:
            free = self._free(group)
            q, _ = postures.closed_postures(
                model, 8 * count, rng, geometry=self._geometry(values), turning=postures.sensed_joints(model),
                within_limits=free, locked=group.locked, held=self._ball(values),
                batch=4 * count, give_up=lambda closed, tried: tried >= 8 * count)
            found.append(self._fitting(values, group, q, aside)[:count])
        return found

    def _fitting(self, values: Mapping[str, float], group: PoseGroup, q: Array, aside: float) -> Array:
        """Of closed postures (N, n) of a group those (K, n) that keep limits and reserves, and stay away from limits of
        free joints, strokes, heights and dexterity by a part `aside` of what they do when sizes are found."""
        if not len(q):
            return q
        rest = self.bounded.map(len(q))(np.repeat(self.theta(values)[:, None], len(q), axis=1), q.T)[1]
        low, high = self.problem.model.ranges.T
        within = np.minimum(q - low, high - q)[:, self._free(group)]
        fits = np.all(np.asarray(rest) >= aside * ROOM - CLOSE, axis=0) & np.all(
            within >= aside * ASIDE - CLOSE, axis=1)
        sieve = Sieve(self.problem.limits, group)
        found = sieve(q[fits], self._geometry(values))
        self.left_out = self.left_out.with_more(sieve.left_out)
        return found

    def _free(self, group: PoseGroup) -> list[int]:
        """Places of the joints that are not locked."""
        model = self.problem.model
        return [*postures.sensed_joints(model), *map(model.joints.index, group.moves)]

    def refined(self, values: Mapping[str, float], rng: np.random.Generator, rounds: int,
                steps: int = STEPS) -> Sized | None:
        """Better sizes and poses near by in some rounds, without any the best poses; None where no postures close."""
        best: Sized | None = None
        near, moved = dict(values), None
        for k in range(rounds + 1):
            found = self.postures(near, MANY, rng)
            if moved is not None:
                found = [np.concatenate(pair) for pair in zip(moved, found, strict=True)]
            least = min(map(len, found))
            if least < SUPPORT:
                break
            support = self.support(near, np.array([each[:least] for each in found]))
            if best is None or support.worst < best.worst:
                best = support
            if k < rounds:
                near, q = self.improved(support.values, support.q, support.share, steps)
                moved = [self.closed(near, *each, NEARLY) for each in zip(self.problem.groups, q, strict=True)]
        return best

    def closed(self, values: Mapping[str, float], group: PoseGroup, q: Array, aside: float = 1.0) -> Array:
        """Of postures (N, n) of a group that nearly close, those (K, n) that can be closed within all limits."""
        model = self.problem.model
        closed, good = postures.close(model, self._geometry(values), q, postures.sensed_joints(model),
                                      self._ball(values))
        return self._fitting(values, group, closed[good], aside)

    def about(self, sized: Sized, count: int, rng: np.random.Generator) -> list[Array]:
        """Closed postures (K, n) of each group about those of a design, of each so many of `count` as its share says:
        a posture that counts much is measured often, each time a little elsewhere."""
        found = []
        for group, q, share in zip(self.problem.groups, sized.q, sized.share, strict=True):
            free, parts = self._free(group), []
            for middle, wanted in zip(q, np.ceil(count * share).astype(int).tolist(), strict=True):
                some = np.repeat(middle[None], 1 + DENSE * wanted, axis=0)
                some[1:, free] += rng.normal(0.0, ABOUT, (DENSE * wanted, len(free)))
                parts.append(self.closed(sized.values, group, some, 0.0)[: 1 + wanted])
            found.append(np.concatenate(parts))
        return found

    def support(self, values: Mapping[str, float], q: Array) -> Sized:
        """The postures (G, m, n) of many (G, C, n) that count most, with their shares."""
        shares = self.shares(values, q, 150)
        most = np.argsort(-shares.share, axis=1)[:, :SUPPORT]
        share = np.take_along_axis(shares.share, most, axis=1)
        return Sized(dict(values), np.take_along_axis(q, most[:, :, None], axis=1),
                     share / share.sum(axis=1, keepdims=True), float(0.5 * np.log(np.max(shares.variance))))

    @cached_property
    def calibration(self) -> CalibrationProblem:
        """One pose of each group; where locked joints drift one early and one late, as many more of them spread."""
        each = 1 + any(group.drift for group in self.problem.groups)
        count = each * len(self.problem.groups)
        middle = np.tile(self.problem.model.ranges.mean(axis=1), (count, 1))
        found = Postures(self.problem, middle).calibration
        where, which, factor = found.layout.locked
        drifts = np.array([kind is ParameterKind.DRIFT for kind in found.parameters.kinds])[which]
        spread = np.where(drifts, 0.5 + (factor - 0.5) / np.sqrt(3.0), factor)  # of even progress from 0 to 1
        return replace(found, layout=replace(found.layout, locked=(where, which, spread)))

    @cached_property
    def free(self) -> list[int]:
        """Parameters that are estimated."""
        return [int(k) for k in np.flatnonzero(self.calibration.free)]

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
            rest += [out - RESERVE, 1 - RESERVE - out]
        if machine.ground is not None and machine.calibrator is not None:
            ends = model.far_ends(g, q)[2, len(machine.ancestry(machine.calibrator.parent)) - 1 : -1]
            rest.append(ends.T - machine.ground - self.clearance)
        motion = by_q[:3, postures.sensed_joints(model)]
        rest.append(dexterity(motion) - DEXTERITY)
        moved = ca.jacobian(gap[:3], g) @ ca.diag(ca.DM(self.problem.uncertain))
        turned = motion.T @ ca.solve(motion @ motion.T, moved)
        rest.append(TURN - REACHED * ca.sqrt(ca.sum2(turned**2) + TINY))
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

    def _geometry(self, values: Mapping[str, float]) -> Array:
        """(p,) of the machine that carries a calibrator of some sizes."""
        return self.theta(values)[: len(self.problem.model.parameters)]

    def _ball(self, values: Mapping[str, float]) -> Array:
        """Place (3,) of the ball [m]."""
        return np.array([values[f"{self.fixture}.{axis}"] for axis in "xyz"])

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

    def improved(self, values: Mapping[str, float], q: Array, shares: Array,
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
            self.problem.model.ranges.T, (1, -1), strict=True))
        layout = self.calibration.layout
        still = ~(layout.sensed | layout.moving)[:: len(self.calibration.poses) // len(q)]
        still = np.broadcast_to(still[:, None], q.shape)
        low[still], high[still] = q[still], q[still]
        return low, high


def dexterity(motion: Any) -> Any:
    """Of the motion (3, r) of the ball by the calibrator's joints: see `DEXTERITY`."""
    square = motion @ motion.T
    return ca.det(square) / (ca.trace(square) / 3) ** 3


def whitened_rows(problem: CalibrationProblem, pose: int) -> ca.Function:
    """(theta (P,), q (n,)) -> transposed Jacobian (f, u) of one pose's white rows by the free parameters.

    Rows are those that the pose has; joints are sensed, locked or moving as they are in it. It is the differentiable
    twin of `hydroopt.estimation.kinematic.observability.linearise`, see there.
    """
    layout, model = problem.layout, problem.model
    theta, q = ca.SX.sym("theta", len(problem.parameters)), ca.SX.sym("q", len(model.joints))
    place = ca.vertcat(*(theta[int(which)] if which >= 0 else ca.SX(given)
                         for which, given in zip(layout.place[pose], layout.given[pose], strict=True)))
    _, by_g, by_q, by_place = model.observed_jacobians(theta[: len(model.parameters)], q, place)
    rows = np.flatnonzero(layout.present[pose]).tolist()
    by_q = ca.densify(by_q[rows, :])
    columns = ca.SX(len(rows), len(problem.parameters))
    columns[:, : len(model.parameters)] = by_g[rows, :]
    where, which, factor = layout.locked
    n = len(model.joints)
    for at, parameter, part in zip(where.tolist(), which.tolist(), factor.tolist(), strict=True):
        if at // n == pose:
            columns[:, parameter] += part * by_q[:, at % n]
    for axis, parameter in enumerate(layout.place[pose].tolist()):
        if parameter >= 0:
            columns[:, parameter] += by_place[rows, axis]
    spread = by_q @ ca.diag(ca.DM(np.where(layout.sensed[pose], problem.angle_sigma, 0.0)))
    lower = ca.chol(spread @ spread.T + ca.diag(ca.DM(problem.row_sigma[pose, rows] ** 2))).T
    moving = np.flatnonzero(layout.moving[pose]).tolist()
    white = ca.solve(lower, ca.horzcat(columns, by_q[:, moving]))
    for k in range(len(moving)):  # Gram-Schmidt: what each unsensed angle explains
        blind = white[:, len(problem.parameters) + k]
        blind = blind / ca.sqrt(ca.sumsqr(blind))
        white = white - blind @ (blind.T @ white)
    free = np.flatnonzero(problem.free).tolist()
    return ca.Function("whitened_rows", [theta, q], [ca.densify(white[:, free]).T], ["theta", "q"], ["rows"])
