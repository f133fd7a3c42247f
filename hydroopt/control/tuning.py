"""Gains of the cascade: as high as the required robustness allows at every point."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from hydroopt.control.cascade import Gains
from hydroopt.control.loop_margins import frequencies
from hydroopt.control.python_control import control
from hydroopt.control.sampled_plant import Point
from hydroopt.control.valve_inversion import Valves
from hydroopt.errors import ProblemError
from hydroopt.spatial.inertia import Array

SENSITIVITY = 1.3
"""Largest sensitivity |1/(1 + L)| of a loop: 1.3 keeps a gain margin of 12.7 dB and a phase margin of 45 degrees."""
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


class _Loops:
    """Responses of the plant at all points, and of all loops with given gains."""

    def __init__(self, plants: Sequence[control.StateSpace], points: Sequence[Point], valves: Valves) -> None:
        self.period = float(plants[0].dt)
        omega = frequencies(self.period)
        self.z = np.exp(1j * omega * self.period)
        n = self.n = len(points[0].q)
        response = np.array([np.asarray(control.frequency_response(plant, omega, squeeze=False).complex)
                             for plant in plants]).transpose(0, 3, 1, 2)
        slopes = [valves.slopes(point.speed, point.length, point.pressure, point.supply) for point in points]
        to_speed = np.array([slope.speed for slope in slopes])[:, None, :, None]
        lengths = np.array([point.lever_arm for point in points])[:, None] @ response[:, :, :n]
        self.length, self.force = to_speed * lengths, to_speed * response[:, :, n:2 * n]
        self.supply = np.array([slope.supply for slope in slopes])[:, None, :, None] * response[:, :, 2 * n:]

    def feedback(self, gains: Gains) -> tuple[Array, Array]:
        """Responses (ω, n) from lengths and from forces to speeds."""
        pole = np.exp(-self.period / np.maximum(gains.filter_time, 1e-9))
        low_pass = (1 - pole) * self.z[:, None] / (self.z[:, None] - pole)
        integral = self.period / gains.integral_time / (self.z[:, None] - 1)
        return -low_pass * gains.position * (1 + integral), -low_pass * gains.force

    def cut(self, gains: Gains, k: int) -> _Loop:
        """One loop, all others closed."""
        by_length, by_force = (part[:, :, None] for part in self.feedback(gains))
        G = self.supply + by_length * self.length + by_force * self.force
        others = [j for j in range(self.n) if j != k]
        # response of all commands to a unit command of this loop
        along = np.zeros((*G.shape[:2], self.n, 1), dtype=complex)
        along[..., k, 0] = 1.0
        along[..., others, :] = np.linalg.solve(np.eye(self.n - 1) - G[..., others, :][..., others],
                                                G[..., others, k][..., None])
        return _Loop(*((part[..., [k], :] @ along)[..., 0, 0] for part in (self.supply, self.length, self.force)))


class _Loop(NamedTuple):
    """Responses (points, ω) of supply pressure, length and force to one command, all other loops closed."""

    supply: Array
    length: Array
    force: Array

    def sensitivity(self, by_length: Array, by_force: Array) -> float:
        """Largest |1/(1 + L)| over points and frequencies, for the responses (ω,) of the feedback."""
        return float(1 / np.min(np.abs(1 - self.supply - by_length * self.length - by_force * self.force)))


def tuned(plants: Sequence[control.StateSpace], points: Sequence[Point], valves: Valves,
          largest: float = SENSITIVITY) -> Gains:
    """Position and force gains with the fastest position loops whose sensitivity stays below `largest`.

    Each actuator in turn, with all other loops closed, gets the force gain that admits the highest position gain. The
    limits that the sensitivity sets to the margins are those of Åström and Hägglund 2006: a gain margin of at least
    M/(M − 1) and a phase margin of at least 2·arcsin(1/(2·M)).

    Args:
        plants: sampled, with delays, at each point.
        points: at which the robustness has to hold.
        valves: with the parameters that the controller uses.
        largest: sensitivity that is allowed.

    Raises:
        ProblemError: an actuator has no gains that are robust enough.
    """
    loops, full = _Loops(plants, points, valves), valves.speed_per_force
    n = loops.n
    gains = Gains(np.zeros(n), np.zeros(n), np.full(n, INTEGRAL_RATIO / SLOWEST_LOOP), np.zeros(n))

    def robust(k: int, position: float, force: float, filter_time: float) -> bool:
        gains.position[k], gains.force[k], gains.filter_time[k] = position, force, filter_time
        gains.integral_time[k] = INTEGRAL_RATIO / max(position, SLOWEST_LOOP)
        return loop.sensitivity(*(part[:, k] for part in loops.feedback(gains))) <= largest

    for _ in range(SWEEPS):
        for k, name in enumerate(valves.plant.inputs):
            loop, best = loops.cut(gains, k), (0.0, 0.0, 0.0)
            for filter_time in FILTER_TIMES:
                for part in FORCE_GAINS:
                    # upwards step by step, since the sensitivity may be low again beyond instability
                    if not robust(k, 0.0, part * full[k], filter_time):
                        break
                    position = SLOWEST_LOOP
                    while robust(k, position, part * full[k], filter_time):
                        best = max(best, (position, part * full[k], filter_time))
                        position *= 1 + STEP
            if best[0] <= 0:
                raise ProblemError(f"no gains make the loop of '{name.removesuffix('.u')}' robust enough",
                                   where="control", remedy="raise the rate, or allow a higher --sensitivity")
            robust(k, *best)
    return gains
