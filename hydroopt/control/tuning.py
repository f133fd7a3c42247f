"""Gains of the cascade: as high as the required robustness allows at every point."""

from __future__ import annotations

import copy
import math
from collections.abc import Sequence
from functools import cached_property
from typing import NamedTuple

import control
import numpy as np
from control import StateSpace

from hydroopt.control.axes import Axes
from hydroopt.control.cascade import Gains, linear_feedback
from hydroopt.control.linear_plant import Point
from hydroopt.control.loops import STANDING, frequencies, response, responses
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


class _Loops:
    """Responses of the plant at all points, and of all loops with given gains."""

    def __init__(self, plants: Sequence[StateSpace], points: Sequence[Point], valves: Valves) -> None:
        self.plants, self.points, self.valves, self.period = plants, points, valves, plants[0].dt
        self.z = np.exp(1j * frequencies(plants) * self.period)
        n, self.axes = len(points[0].q), Axes(valves.plant)
        moved = np.array([response(plant, self.z) for plant in plants])
        slopes = [valves.slopes(point.speed, point.length, point.pressure, point.supply) for point in points]
        to_speed = np.array([slope.speed for slope in slopes])[:, None, :, None]
        self.shares = to_speed * np.array([self.axes.shares(point.lever_arm) for point in points])[:, None]
        self.position = np.array([self.axes.slopes(point.lever_arm) for point in points])[:, None] @ moved[:, :, :n]
        self.force = to_speed * moved[:, :, n:-1]
        self.supply = np.array([slope.supply for slope in slopes])[:, None, :, None] * moved[:, :, -1:]

    @cached_property
    def growth(self) -> float:
        """Of errors that grow steadily without feedback, at the point where they do so fastest [1/s]; zero if none do.
        """
        return max(_growth(poles[np.abs(poles.imag) < STANDING], self.period) for poles in
                   (plant.poles() for plant in self.plants))

    @cached_property
    def free_growth(self) -> float:
        """Of all errors that grow without feedback, oscillating ones as well [1/s]."""
        return max(_growth(plant.poles(), self.period) for plant in self.plants)

    def hold(self, gains: Gains, k: int, growth: float, largest: float, complementary: float) -> bool:
        """Whether errors grow at no point faster than `growth` [1/s] with all loops closed, where zero asks that they
        die away, and both sensitivities of an axis' loops stay below their limits at the resonances, too, that the
        feedback makes."""
        for plant, point in zip(self.plants, self.points, strict=True):
            feedback = linear_feedback(self.axes, self.valves, gains, self.period, point)
            closed = control.feedback(plant, feedback, sign=1)
            if _growth(closed.poles(), self.period) > growth:
                return False
            L = responses(plant, feedback, frequencies([plant, closed]))[list(self.axes.actuators[k])]
            if np.max(1 / np.abs(1 + L)) > largest or np.max(np.abs(L / (1 + L))) > complementary:
                return False
        return True

    def feedback(self, gains: Gains) -> tuple[Array, Array]:
        """Responses from positions to speeds of the axes (ω, m), and from forces to speeds of the actuators (ω, a)."""
        m = len(self.axes.names)
        own = [self.of_axis(gains, k) for k in range(m)]
        by_force = np.zeros((len(self.z), len(self.axes.of)), dtype=complex)
        for k, places in enumerate(self.axes.actuators):
            by_force[:, list(places)] = own[k][1]
        return np.stack([each[0] for each in own], axis=1), by_force

    def of_axis(self, gains: Gains, k: int) -> tuple[Array, Array]:
        """The same of one axis: (ω,) from its position, and (ω, g) from the forces of its actuators."""
        pole = np.exp(-self.period / max(gains.filter_time[k], 1e-9))
        low_pass = (1 - pole) * self.z / (self.z - pole)
        integral = self.period / gains.integral_time[k] / (self.z - 1)
        return (-low_pass * gains.position[k] * (1 + integral),
                -low_pass[:, None] * gains.force[list(self.axes.actuators[k])])

    def cut(self, gains: Gains, k: int) -> _Loop:
        """The loop of one axis, all others closed."""
        by_position, by_force = (part[:, None] for part in self.feedback(gains))
        G = self.supply + self.shares * by_position @ self.position + np.swapaxes(by_force, 1, 2) * self.force
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


def _growth(poles: Array, period: float) -> float:
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


class _Tuner:
    """Gains of all axes, which are tuned one after the other.

    Attributes:
        gains: as they are.
        ceiling: above which no position gain may be (m,), since another axis found none beside faster loops.
    """

    def __init__(self, loops: _Loops, largest: float) -> None:
        self.loops, self.largest, m = loops, largest, len(loops.axes.names)
        self.speed_per_force = np.where(loops.axes.measured, loops.valves.speed_per_force, 0.0)
        self.gains = Gains(np.zeros(m), np.zeros(len(self.speed_per_force)), np.full(m, INTEGRAL_RATIO / SLOWEST_LOOP),
                           np.zeros(m))
        self.ceiling = np.full(m, np.inf)

    def tune(self, k: int, growth: float) -> bool:
        """Give an axis the fastest gains with which errors grow no faster than this [1/s]; whether there are any.

        What is given up in turn, where there are none: speed of the other loops, a part of the robustness, and at last
        that all errors die away, where another loop is unstable at a point, whatever this one does.
        """
        return (self._fastest(k, growth) or self._beside_slower(k)
                or any(self._fastest(k, 0.0, slack) or self._beside_slower(k, slack) for slack in SLACKS)
                or self._fastest(k, self.loops.free_growth))

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
        loops, gains, own = self.loops, self.gains, list(self.loops.axes.actuators[k])
        loop, entry = loops.cut(gains, k), ENTRY * loops.growth
        limits = slack * self.largest, slack * COMPLEMENTARY_SENSITIVITY

        def robust(position: float, part: float, filter_time: float) -> bool:
            gains.position[k], gains.force[own] = position, part * self.speed_per_force[own]
            gains.filter_time[k] = filter_time
            gains.integral_time[k] = INTEGRAL_RATIO / max(position, SLOWEST_LOOP)
            return loop.robust(*loops.of_axis(gains, k), *limits)

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
                                              and loops.hold(gains, k, growth, *limits)):
                        best = (position, part, filter_time)
                        break
        robust(*best)
        return best[0] > 0


def tuned(plants: Sequence[StateSpace], points: Sequence[Point], valves: Valves,
          largest: float = SENSITIVITY, progress: Progress = silent) -> Gains:
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
        plants: sampled, with delays, at each point.
        points: at which the robustness has to hold.
        valves: with the parameters that the controller uses.
        largest: sensitivity |1/(1 + L)| that is allowed.
        progress: receives the axes, and the part of them that is done.

    Raises:
        ProblemError: an axis has no gains that are robust enough.
    """
    tuner = _Tuner(_Loops(plants, points, valves), largest)
    names = tuner.loops.axes.names
    for sweep in range(SWEEPS):
        for k, name in enumerate(names):
            progress(f"tuning {name}", (sweep + k / len(names)) / SWEEPS)
            if not tuner.tune(k, 0.0 if sweep == SWEEPS - 1 else math.inf):
                raise ProblemError(f"no gains make the loop of '{name}' robust enough",
                                   where="closed loop", remedy="raise --rate, or allow a higher --sensitivity")
    return tuner.gains
