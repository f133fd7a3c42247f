"""Gains of the cascade: as high as the required robustness allows at every point."""

from __future__ import annotations

import copy
import math
from collections.abc import Sequence
from functools import cached_property
from typing import NamedTuple

import control
import numpy as np

from hydroopt.control.axes import Axes
from hydroopt.control.cascade import Feedback, Gains
from hydroopt.control.linear_plant import Point
from hydroopt.control.loops import STANDING, Loops, frequencies, response
from hydroopt.control.valve_inversion import Valves
from hydroopt.errors import ProblemError
from hydroopt.spatial.inertia import Array
from hydroopt.support.progress import Progress, silent

SENSITIVITY = 1.6
"""Largest sensitivity |1/(1 + L)| of a loop: 1.6 keeps a gain margin of 8.5 dB and a phase margin of 36 degrees."""
COMPLEMENTARY_SENSITIVITY = 1.3
"""Largest complementary sensitivity |L/(1 + L)| of a loop: 1.3 keeps a phase margin of 45 degrees."""
INTEGRAL_RATIO = 5.0
"""Integral time in time constants of the position loop."""
FORCE_GAINS = (0.0, *np.geomspace(0.01, 1.0, 9))
"""Force gains that are tried, as parts of the speed at full flow per largest force."""
FILTER_TIMES = (0.0, 0.1, 0.2, 0.4, 0.8)
"""Time constants [s] of low passes that are tried: they suppress feedback at resonances that it cannot damp."""
SWEEPS = 2
SLOWEST_LOOP = 0.1
"""Position gain [1/s] from which on gains are tried, each higher than the one before by `STEP`."""
STEP = 0.15
YIELD = 1.5
"""By which the position gains of all other loops are divided as long as an axis finds none."""
SLACKS = (1.05, 1.1, 1.2)
"""By which both sensitivities may exceed their limits, in turn, where an axis finds no gains even so."""
ENTRY = 10.0
"""Position gains up to which a loop may be less robust than with a higher one, in parts of the plant's fastest growth:
where a load lightens along the motion, errors of the position grow unless the gain is higher than that growth."""


class _Tuner:
    """Gains of all axes, which are tuned one after the other, and responses of the plant at all points.

    Attributes:
        gains: as they are.
        ceiling: above which no position gain may be (m,), since another axis found none beside faster loops.
    """

    def __init__(self, points: Sequence[Point], valves: Valves, largest: float) -> None:
        self.points, self.valves, self.largest, self.period = points, valves, largest, points[0].system.dt
        self.axes = Axes(valves.plant)
        self.law, (a, m), n = Feedback(self.axes, self.period), self.axes.own.shape, len(points[0].q)
        self.speed_per_force = np.where(self.axes.measured, valves.speed_per_force, 0.0)
        self.gains = Gains(np.zeros(m), np.zeros(a), np.full(m, INTEGRAL_RATIO / SLOWEST_LOOP), np.zeros(m))
        self.ceiling = np.full(m, np.inf)
        self.z = np.exp(1j * frequencies([point.system for point in points]) * self.period)
        moved = np.array([response(point.system, self.z) for point in points])
        slopes = [valves.slopes(point.speed, point.length, point.pressure, point.supply) for point in points]
        to_speed = np.array([slope.speed for slope in slopes])[:, None, :, None]
        self.shares = to_speed * np.array([self.axes.shares(point.lever_arm) for point in points])[:, None]
        self.position = np.array([self.axes.slopes(point.lever_arm) for point in points])[:, None] @ moved[:, :, :n]
        self.force = to_speed * moved[:, :, n:-1]
        self.supply = np.array([slope.supply for slope in slopes])[:, None, :, None] * moved[:, :, -1:]

    def tune(self, k: int, growth: float) -> bool:
        """Give an axis the fastest gains with which errors grow no faster than this [1/s]; whether there are any.

        What is given up in turn, where there are none: speed of the other loops, a part of the robustness, and at last
        that all errors die away, where another loop is unstable at a point, whatever this one does.
        """
        return (self._fastest(k, growth) or self._beside_slower(k)
                or any(self._fastest(k, 0.0, slack) or self._beside_slower(k, slack) for slack in SLACKS)
                or self._fastest(k, self._free_growth))

    def _beside_slower(self, k: int, slack: float = 1.0) -> bool:
        """The same beside loops that yield; where that does not help, they are as they were."""
        others, before = np.arange(len(self.gains.position)) != k, copy.deepcopy((self.gains, self.ceiling))
        while np.any(self.gains.position[others] > SLOWEST_LOOP):
            self.gains.position[others] = self.ceiling[others] = np.maximum(self.gains.position[others] / YIELD,
                                                                            SLOWEST_LOOP)
            self.gains.integral_time[others] = INTEGRAL_RATIO / self.gains.position[others]
            if self._fastest(k, 0.0, slack):
                return True
        self.gains, self.ceiling = before
        return False

    def _fastest(self, k: int, growth: float, slack: float = 1.0) -> bool:
        """The same beside loops as they are, with sensitivities up to `slack` times their limits."""
        gains, own = self.gains, list(self.axes.actuators[k])
        loop, entry = self._cut(k), ENTRY * self._growth
        limits = slack * self.largest, slack * COMPLEMENTARY_SENSITIVITY

        def robust(position: float, part: float, filter_time: float) -> bool:
            gains.position[k], gains.force[own] = position, part * self.speed_per_force[own]
            gains.filter_time[k] = filter_time
            gains.integral_time[k] = INTEGRAL_RATIO / max(position, SLOWEST_LOOP)
            return loop.robust(*self._of_axis(k), *limits)

        best, parts = (0.0, 0.0, 0.0), FORCE_GAINS if np.any(self.speed_per_force[own]) else FORCE_GAINS[:1]
        for filter_time in FILTER_TIMES:
            for part in parts:
                # upwards step by step, since the sensitivity may be low again beyond instability
                if not robust(0.0, part, filter_time):
                    break
                if best[0] >= max(entry, SLOWEST_LOOP) and not robust(best[0], part, filter_time):
                    continue  # it would not come as far
                position, passed = SLOWEST_LOOP, list[float]()
                while position <= self.ceiling[k] and ((one := robust(position, part, filter_time))
                                                       or position < entry):
                    passed += [position] if one else []
                    position *= 1 + STEP
                for position in reversed(passed):
                    if (position, part, filter_time) <= best:
                        break
                    if math.isinf(growth) or (robust(position, part, filter_time)
                                              and self._hold(k, growth, *limits)):
                        best = (position, part, filter_time)
                        break
        robust(*best)
        return best[0] > 0

    @cached_property
    def _growth(self) -> float:
        """Of errors that grow steadily without feedback, at the point where they do so fastest [1/s]; zero if none do.
        """
        return max(_rate(poles[np.abs(poles.imag) < STANDING], self.period) for poles in
                   (point.system.poles() for point in self.points))

    @cached_property
    def _free_growth(self) -> float:
        """Of all errors that grow without feedback, oscillating ones as well [1/s]."""
        return max(_rate(point.system.poles(), self.period) for point in self.points)

    def _hold(self, k: int, growth: float, largest: float, complementary: float) -> bool:
        """Whether errors grow at no point faster than `growth` [1/s] with all loops closed, where zero asks that they
        die away, and both sensitivities of an axis' loops stay below their limits at the resonances, too, that the
        feedback makes."""
        for at in self.points:
            loops = Loops.about(at, self.axes, self.law.about(at, self.valves, self.gains))
            if _rate(loops.poles, self.period) > growth:
                return False
            L = loops.cut[list(self.axes.actuators[k])]
            if np.max(1 / np.abs(1 + L)) > largest or np.max(np.abs(L / (1 + L))) > complementary:
                return False
        return True

    def _of_axis(self, k: int) -> tuple[Array, Array]:
        """Responses of the law of one axis: (ω,) from its position to its speed, and (ω, g) from the forces of its
        actuators to theirs."""
        (a, m), own = self.axes.own.shape, list(self.axes.actuators[k])
        by_before, by_errors = self.law.linear(self.axes.own, self.gains)
        kept = [*own, a + k]
        A, B = by_before[np.ix_(kept, kept)], by_errors[np.ix_(kept, [k, *(m + i for i in own)])]
        found = -response(control.ss(A, B, A[:-1], B[:-1], self.period), self.z)
        return found[:, 0, 0], np.diagonal(found[:, :, 1:], axis1=1, axis2=2)

    def _cut(self, k: int) -> _Loop:
        """The loop of one axis, all others closed."""
        G = self.supply.copy()
        for i, places in enumerate(self.axes.actuators):
            by_position, by_force = self._of_axis(i)
            G += self.shares[..., [i]] * by_position[:, None, None] @ self.position[..., [i], :]
            G[..., list(places), :] += by_force[..., None] * self.force[..., list(places), :]
        own = list(self.axes.actuators[k])
        others = [j for j in range(G.shape[-1]) if j not in own]
        # responses of all commands to unit commands of this loop
        along = np.zeros((*G.shape[:-1], len(own)), dtype=complex)
        along[..., own, :] = np.eye(len(own))
        along[..., others, :] = np.linalg.solve(np.eye(len(others)) - G[..., others, :][..., others],
                                                G[..., others, :][..., own])
        span = np.array([abs(self.axes.plant.actuators[i].valve.span) for i in own])
        scale = span / span[:, None]
        return _Loop(scale * (self.supply[..., own, :] @ along), self.shares[..., own, k, None], self.position[
            ..., [k], :] @ along, self.force[..., own, :] @ along, scale)


class _Loop(NamedTuple):
    """Responses to the commands (g,) of one axis, all other loops closed, at points and frequencies.

    That of the commands by the supply pressure (..., g, g), those by which a speed of the axis becomes commands
    (..., g, 1), of the position (..., 1, g) and of what the force's error makes of each command (..., g, g). Entries of
    two commands are multiplied by `scale` (g, g), which counts each in parts of its valve's range.
    """

    supply: Array
    share: Array
    position: Array
    force: Array
    scale: Array

    def robust(self, by_position: Array, by_force: Array, largest: float, complementary: float) -> bool:
        """Whether both sensitivities stay below their limits, for the responses (ω,) and (ω, g) of the feedback.

        At all points and frequencies |1/(1 + L)| is at most `largest`, and |L/(1 + L)| at most `complementary`. Of
        several commands they are the largest singular values of (1 + L)⁻¹ and L·(1 + L)⁻¹: how robust the loop is where
        all of them change at once, and each by itself.
        """
        loop = self.supply + self.scale * (self.share * by_position[:, None, None] * self.position
                                           + by_force[:, :, None] * self.force)
        returned = np.eye(len(self.scale)) - loop
        if 1 / np.min(_singular_values(returned)[0]) > largest:
            return False
        complement = loop / returned if len(self.scale) == 1 else loop @ np.linalg.inv(returned)
        return bool(np.max(_singular_values(complement)[1]) <= complementary)


def _rate(poles: Array, period: float) -> float:
    """Of the fastest of a sampled system's states that grow [1/s]; zero where none does."""
    moving = np.abs(poles[np.abs(poles - 1) >= STANDING])
    return float(np.log(np.max(moving, initial=1.0)) / period)


def _singular_values(matrix: Array) -> tuple[Array, Array]:
    """Least and greatest of square matrices (..., g, g); of small ones in closed form, since tuning asks for millions.
    """
    match matrix.shape[-1]:
        case 1:
            size = np.abs(matrix[..., 0, 0])
            return size, size
        case 2:
            squares = np.sum(np.abs(matrix) ** 2, axis=(-2, -1))
            determinant = np.abs(matrix[..., 0, 0] * matrix[..., 1, 1] - matrix[..., 0, 1] * matrix[..., 1, 0])
            greatest = np.sqrt((squares + np.sqrt(np.maximum(squares**2 - 4 * determinant**2, 0.0))) / 2)
            least: Array = determinant / np.maximum(greatest, np.finfo(float).tiny)
            return least, greatest.astype(float)
        case _:
            values: Array = np.linalg.svd(matrix, compute_uv=False).astype(float)
            return values[..., -1], values[..., 0]


def tuned(points: Sequence[Point], valves: Valves, largest: float = SENSITIVITY,
          progress: Progress = silent) -> Gains:
    """Position and force gains with the fastest position loops whose sensitivities stay below their limits.

    Each axis in turn, with all other loops closed, gets the force gain that admits the highest position gain. Several
    actuators of a joint get the same part of what each can do, and zero where a force is not measured. The limits that
    the sensitivity M sets to the margins are those of Åström and Hägglund 2006: a gain margin of at least M/(M − 1) and
    a phase margin of at least 2·arcsin(1/(2·M)). The complementary sensitivity, at most `COMPLEMENTARY_SENSITIVITY`,
    sets the second one too: 45 degrees, however large M is. Where a load lightens along the motion, an open valve lets
    errors of the position grow: such a loop is stable with high gains only, so that low ones may be less robust
    (`ENTRY`). Where an axis finds no gains, the loops of the others get slower (`YIELD`); where that does not help,
    sensitivities exceed their limits a little (`SLACKS`). Where errors grow at a point whatever the gains, they grow no
    faster than without feedback.

    Args:
        points: at which the robustness has to hold.
        valves: with the parameters that the controller uses.
        largest: sensitivity |1/(1 + L)| that is allowed.
        progress: receives the axes, and the part of them that is done.

    Raises:
        ProblemError: an axis has no gains that are robust enough.
    """
    tuner = _Tuner(points, valves, largest)
    names = tuner.axes.names
    for sweep in range(SWEEPS):
        for k, name in enumerate(names):
            progress(f"tuning {name}", (sweep + k / len(names)) / SWEEPS)
            if not tuner.tune(k, 0.0 if sweep == SWEEPS - 1 else math.inf):
                raise ProblemError(f"no gains make the loop of '{name}' robust enough",
                                   where="closed loop", remedy="raise --rate, or allow a higher --sensitivity")
    return tuner.gains
