"""Loops and couplings by Newton's method: from a start that a polynomial of the joints before gives.

All solutions over the ranges of the joints that the loops follow are tracked from the stated posture, along straight
lines; a polynomial is fitted to them, and as many steps of Newton's method are taken from it as bring every sample to
rounding. The number of steps is fixed, so that positions are one expression, whose derivatives are exact as well.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from itertools import combinations_with_replacement
from typing import Any, NamedTuple

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from hydroopt.machine.closures import Closure
from hydroopt.machine.geometry import Geometry
from hydroopt.machine.loops import Coupling, Loop, Statement
from hydroopt.machine.machine import Machine
from hydroopt.machine.quantity import ImpossibleError
from hydroopt.spatial.evenly_spread import halton
from hydroopt.spatial.inertia import Array

CLOSED = 1e-5
"""Equations [m or rad] that leave more than this before the last step make positions that are not numbers."""
NEARLY, ROUNDING = 1e-8, 1e-12
"""Errors [rad or m] of positions that are allowed before the last step and after it."""
CALIBRATED = 0.03
"""How far [rad or m] calibrated geometry may move positions from those of the machine file."""
SAMPLES = {1: 96, 2: 256}
DEGREES = {1: 14, 2: 8, 3: 5}
"""Samples, and the highest degree of the polynomial, by how many variables it has; 512 and 3 where these are more."""
FEW, MOST = 3, 6
"""Newton's steps that are enough, and their greatest number."""
ALONG, CORRECTIONS = 32, 3
"""Steps of the tracking from the posture to a sample, and Newton's steps in each of them."""
MOBILE = 1e-9
"""Volume of `GeneralAssembly.solved` below which loops determine nothing."""
WITHIN = np.radians(45.0)
"""A posture is near to the one that closes if no joint is farther from it than this angle [rad]."""


class Start(NamedTuple):
    """A polynomial in u = (q − middle)/half of the joints that loops follow: a start of Newton's method.

    Attributes:
        middle, half: (n,) of the ranges.
        powers: which variables each term is the product of.
        coefficients: (m, terms).
    """

    middle: tuple[float, ...]
    half: tuple[float, ...]
    powers: tuple[tuple[int, ...], ...]
    coefficients: Array

    @classmethod
    def fitted(cls, degree: int, q: Array, values: Array) -> Start:
        """The polynomial of a degree nearest to every second sample (m, N) at q (n, N)."""
        middle, half = (q.max(axis=1) + q.min(axis=1)) / 2, np.ptp(q, axis=1) / 2
        powers = tuple(each for k in range(degree + 1) for each in combinations_with_replacement(range(len(q)), k))
        shape = cls(tuple(middle.tolist()), tuple(half.tolist()), powers, np.zeros((len(values), len(powers))))
        found = np.linalg.lstsq(np.array(shape.terms(q))[:, ::2].T, values[:, ::2].T, rcond=1e-9)[0]
        return shape._replace(coefficients=found.T)

    def at(self, q: Sequence[ca.SX]) -> ca.SX:
        """Values (m,) at symbols (n,)."""
        terms = self.terms(q)
        return ca.vertcat(*(sum((float(a) * term for a, term in zip(row, terms, strict=True)), ca.SX(0))
                            for row in self.coefficients))

    def terms(self, q: Any) -> list[Any]:
        """The terms at joint positions (n,), be they numbers, arrays or symbols."""
        u = [(q[k] - self.middle[k]) / self.half[k] for k in range(len(self.middle))]
        made: dict[tuple[int, ...], Any] = {(): 0 * u[0] + 1.0}
        for each in self.powers[1:]:
            made[each] = u[each[-1]] if len(each) == 1 else made[each[:-1]] * u[each[-1]]
        return [made[each] for each in self.powers]


def newton_start(q: Array, values: Array, moved: Callable[[Start], Array],
                 step: Callable[[Array], Array]) -> tuple[Start, int] | None:
    """A polynomial, and the fewest steps of Newton's method that lead from it to the values; None if it needs too many.

    Args:
        q: samples (n, N) of its variables, see `spread`.
        values: (m, N) there.
        moved: where the steps begin (m, N) with other geometry.
        step: one step of Newton's method (m, N).
    """
    best: tuple[Start, int] | None = None
    for degree in range(1, DEGREES.get(len(q), 3) + 1):
        start = Start.fitted(degree, q, values)
        at, error = moved(start), np.inf
        for count in range(1, best[1] if best else MOST + 1):
            before, at = error, step(at)
            error = float(np.max(np.abs(at - values)))
            if before < NEARLY and error < ROUNDING * (1 + float(np.max(np.abs(values)))):
                best = start, count
                break
        if best and best[1] <= FEW:
            break
    return best


class GeneralAssembly(NamedTuple):
    """A closure as it is assembled: a start, and the number of Newton's steps from it; without `start` it is linear."""

    closure: Closure
    start: Start | None = None
    steps: int = 1

    def solved(self, geometry: Geometry, q: Mapping[str, Any]) -> tuple[dict[str, Any], ca.SX | None]:
        """Positions of its joints from those before, by name, not a number where it cannot close; and a sine.

        The sine is that of the angle between the directions in which its joints move its pin, or the volume that these
        directions span: 1 at best, 0 at a dead point. Couplings have none.
        """
        own, x = self.closure.joints, ca.SX.sym("x", len(self.closure.joints))
        at = {**q, **dict(zip(own, ca.vertsplit(x), strict=True))}
        equations = closure_equations(geometry, self.closure.statements, at)
        J, found = ca.jacobian(equations, x), ca.SX.zeros(len(own))
        if self.start is not None:
            found = self.start.at([q[joint] for joint in self.closure.follows])
        for left in reversed(range(self.steps)):
            gap, slope = ca.substitute([equations, J], [x], [found])
            step = ca.solve(slope, gap)
            if self.start is not None and not left:
                step *= ca.sqrt(1 - (ca.sumsqr(gap) / CLOSED**2)**2)
            found -= step
        volume = None if self.start is None else ca.substitute(_volume(geometry, self.closure, at, J, x), x, found)
        return dict(zip(own, ca.vertsplit(found), strict=True)), volume

    def why_open(self, geometry: Geometry, q: Mapping[str, Any]) -> str:
        """Why it cannot close, in words."""
        return "no positions of its joints near those of its posture bring its ends together"

    def dead(self, geometry: Geometry) -> str:
        """What happens at a dead point, in words."""
        return f"it no longer determines {' and '.join(self.closure.joints)}"


def closure_equations(geometry: Geometry, statements: Sequence[Statement], q: Mapping[str, Any]) -> ca.SX:
    """Equations (m,) [m, or the unit of a coupling's joint] of loops and couplings at positions of all joints by name.

    They are zero where these close. A pin has two in the loop's plane, a ball three, and a rod of length L with the
    vector g between its ends has (g·g − L²)/2L.
    """
    rows = []
    for each in statements:
        if isinstance(each, Coupling):
            following = sum((geometry.value[f"{each.name}.ratio.{joint}"] * q[joint] for joint in each.ratios),
                            geometry.value[f"{each.name}.offset"])
            rows.append(q[each.joint] - following)
            continue
        gap = geometry.loop_gap(each, q)
        if each.closed_by == "rod":
            length = geometry.value[f"{each.name}.length"]
            gap = (ca.sumsqr(gap) - length**2) / (2 * length)
        rows.append(gap[:2] if each.closed_by == "pin" else gap)
    return ca.vertcat(*rows)


def _volume(geometry: Geometry, closure: Closure, at: Mapping[str, Any], J: ca.SX, x: ca.SX) -> ca.SX:
    """Determinant of the equations' Jacobian over the lengths of the directions in which each joint moves the ends: of
    a rod the whole vector between them."""
    ends = [geometry.loop_gap(each, at) if isinstance(each, Loop) and each.closed_by == "rod"
            else closure_equations(geometry, (each,), at) for each in closure.statements]
    ways, volume = ca.jacobian(ca.vertcat(*ends), x), ca.det(J)
    for k in range(ways.size2()):
        volume /= ca.norm_2(ways[:, k])
    return volume


class _Problem(NamedTuple):
    """Equations of loops as a function of their joints (m, N) and those that they follow (n, N)."""

    geometry: Geometry
    closure: Closure
    function: ca.Function

    def values(self, x: Array, q: Array) -> tuple[Array, Array, Array]:
        """Equations (N, m), Jacobian (N, m, m) and volume (N,)."""
        count, size = x.shape[1], x.shape[0]
        gap, slope, volume = (np.array(value) for value in self.function.map(count)(x, q))
        return gap.T, slope.reshape(size, count, size).transpose(1, 0, 2), volume.ravel()

    def step(self, x: Array, q: Array) -> Array:
        """One step of Newton's method (m, N)."""
        gap, slope, _ = self.values(x, q)
        usable: NDArray[np.bool_] = np.logical_and(np.isfinite(slope).all(axis=(1, 2)), np.isfinite(gap).all(axis=1))
        slope = np.where(usable[:, None, None], slope, np.eye(len(x)))
        gap = np.where(usable[:, None], gap, 0.0)
        try:
            found = np.linalg.solve(slope, gap[..., None])[..., 0]
        except np.linalg.LinAlgError:  # somewhere exactly singular
            found = np.einsum("nij,nj->ni", np.linalg.pinv(slope, rcond=1e-12), gap)
        return np.asarray(x - np.where(usable[:, None], found, np.nan).T)

    def tracked(self, x: Array, begin: Array, ends: Array) -> Array:
        """Positions (m, N) at `ends` (n, N), by small steps from x (m,) at `begin` (n,); NaN where they get lost."""
        count = ends.shape[1]
        q = np.tile(begin[:, None], count)
        at = before = np.tile(x[:, None], count)
        sign = np.sign(self.values(at[:, :1], q[:, :1])[2])
        for share in np.linspace(0, 1, ALONG + 1)[1:]:
            q = begin[:, None] + share * (ends - begin[:, None])
            guess, before = 2 * at - before, at
            for _ in range(CORRECTIONS):
                guess = self.step(guess, q)
            gap, _, volume = self.values(guess, q)
            lost = ~(np.max(np.abs(gap), axis=1) < CLOSED) | (np.sign(volume) != sign)
            at = np.where(lost, np.nan, guess)
        for _ in range(CORRECTIONS):
            at = self.step(at, q)
        return at


def assembled(geometry: Geometry, closure: Closure, posture: Mapping[str, float],
              before: Mapping[str, ca.SX], follows: ca.SX) -> GeneralAssembly:
    """Loops as a posture states that they are assembled.

    Args:
        geometry: its numbers.
        closure: the loops.
        posture: positions of all joints that they determine or follow.
        before: positions of the joints before, in the symbols (n,) of those that the loops `follow`.

    Raises:
        ImpossibleError: they do not close near the posture or over the range, or determine nothing.
    """
    machine, own = geometry.machine, closure.joints
    x = ca.SX.sym("x", len(own))
    at = {**before, **dict(zip(own, ca.vertsplit(x), strict=True))}
    equations = closure_equations(geometry, closure.statements, at)
    J = ca.jacobian(equations, x)
    problem = _Problem(geometry, closure, ca.Function("equations", [x, follows], [
        equations, ca.densify(J), _volume(geometry, closure, at, J, x)]))
    begin = np.array([posture[joint] for joint in closure.follows])
    here = _closed(problem, posture, begin)
    ranges = np.array([machine.link(joint).joint.range for joint in closure.follows])
    q = spread(ranges)
    positions = problem.tracked(here, begin, q)
    if (lost := np.flatnonzero(~np.isfinite(positions).all(axis=0))).size:
        away = (q[:, lost] - begin[:, None]) / np.ptp(ranges, axis=1)[:, None]
        nearest = lost[np.argmin(np.linalg.norm(away, axis=0))]
        words = machine.in_words(dict(zip(closure.follows, q[:, nearest].tolist(), strict=True)))
        raise ImpossibleError(f"{closure} cannot close, or only beyond a dead point, on the way from its "
                              f"posture to {words}", "correct its pins and lengths, or narrow the joints' limits",
                              closure.statements[0].place)
    def moved(start: Start) -> Array:
        at = start.coefficients @ np.array(start.terms(q))
        return np.asarray(at + CALIBRATED * moved_aside(at))

    if found := newton_start(q, positions, moved, lambda at: problem.step(at, q)):
        return GeneralAssembly(closure, *found)
    raise ImpossibleError(f"{closure} would come too near to a dead point in the range of "
                          f"{', '.join(closure.follows)} for Newton's method", "narrow the joints' limits",
                          closure.statements[0].place)


def spread(ranges: Array) -> Array:
    """Samples (n, N) of ranges (n, 2): corners and middles, and more between them, denser towards the ends, as the
    nodes of Chebyshev's polynomials."""
    n = len(ranges)
    count = SAMPLES.get(n, 512)
    corners = np.array(np.meshgrid(*[[-1.0, 0.0, 1.0]] * n, indexing="ij")).reshape(n, -1)[:, :count]
    u = np.hstack([corners, np.sin(np.pi / 2 * (2 * halton(n, count).T - 1))])
    return np.asarray(ranges.mean(axis=1)[:, None] + np.ptp(ranges, axis=1)[:, None] / 2 * u)


def moved_aside(values: Array) -> Array:
    """Signs, of the shape of samples, by which calibrated geometry may move them: neighbours to different sides."""
    return np.asarray(1 - 2 * (np.arange(values.size).reshape(values.shape) % 3 % 2))


def _closed(problem: _Problem, posture: Mapping[str, float], begin: Array) -> Array:
    """Positions (m,) near those of a posture that close the loops."""
    machine, closure = problem.geometry.machine, problem.closure
    where = f"{closure.statements[0].place}.posture"
    words = machine.in_words({joint: posture[joint] for joint in closure.follows})
    here = np.array([[posture[joint]] for joint in closure.joints])
    for _ in range(50):
        step = problem.step(here, begin[:, None]) - here
        # no joint jumps farther than a posture may be off
        here = here + step * min(1.0, 0.3 / max(float(np.max(np.abs(step))), 1e-300))
    gap, _, volume = problem.values(here, begin[:, None])
    if not np.max(np.abs(gap)) < 1e-9:
        raise ImpossibleError(f"{closure} cannot close near the posture of '{closure.statements[0].name}', "
                              f"{words}", "correct pins and lengths, or the posture", where)
    if not abs(float(volume[0])) > MOBILE:
        raise ImpossibleError(f"{closure} cannot hold {', '.join(closure.joints)}: they can move while "
                              f"{', '.join(closure.follows)} rest", "correct its pins, let one of them move by itself, "
                              "or remove a loop that repeats another one", closure.statements[0].place)
    for joint, value in zip(closure.joints, here[:, 0].tolist(), strict=True):
        if machine.turns(joint) and apart(machine, joint, value, posture[joint]) > WITHIN:
            stands = machine.in_words(dict(zip(closure.joints, here[:, 0].tolist(), strict=True)))
            raise ImpossibleError(f"{closure} would close away from its posture: at {words} stands {stands}",
                                  "state the posture that the machine has", where)
    return np.asarray(here[:, 0])


def apart(machine: Machine, joint: str, one: float, other: float) -> float:
    """How far two positions [rad or m] of a joint are apart; whole turns do not count."""
    if not machine.turns(joint):
        return abs(one - other)
    return float(abs(np.arctan2(np.sin(one - other), np.cos(one - other))))
