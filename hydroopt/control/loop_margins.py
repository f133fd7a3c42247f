"""Gain and phase margins, Nyquist distances and damping ratios of the loops of a sampled controller."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from hydroopt.control.python_control import control
from hydroopt.results.tables import number
from hydroopt.spatial.inertia import Array

FREQUENCIES = 400
"""Number of frequencies at which loops are analysed, up to half the sampling rate."""
SLOWEST = 2e-4
"""The lowest of these frequencies, as a part of the sampling rate."""


class Margin(NamedTuple):
    """How far a loop is from instability.

    Attributes:
        point: name of the operating point.
        loop: the actuator at whose command the loop is cut, all others closed.
        gain: gain margin as a factor; infinite if there is none to reach, less than one where the loop is unstable.
        gain_at: its frequency [rad/s], where the phase crosses −180 degrees.
        phase: phase margin [rad]; infinite if the gain never reaches one.
        phase_at: its frequency [rad/s], where the gain crosses one.
        distance: smallest distance of the Nyquist curve from −1.
        damping: smallest damping ratio of the closed loop's poles; negative where it is unstable.
    """

    point: str
    loop: str
    gain: float
    gain_at: float
    phase: float
    phase_at: float
    distance: float
    damping: float

    def as_dict(self) -> dict[str, str | float | None]:
        """The entry of a table, in dB, degrees and Hz; None where a number does not exist."""
        return {"loop": self.loop, "point": self.point, "gain_margin_db": number(20 * np.log10(self.gain)),
                "gain_crossing_hz": number(self.gain_at / (2 * np.pi)),
                "phase_margin_deg": number(np.degrees(self.phase)),
                "phase_crossing_hz": number(self.phase_at / (2 * np.pi)), "sensitivity": number(1 / self.distance),
                "damping": self.damping}


def frequencies(period: float) -> Array:
    """[rad/s] at which loops are analysed."""
    return np.geomspace(2 * np.pi * SLOWEST, np.pi, FREQUENCIES) / period


def responses(plant: control.StateSpace, feedback: control.StateSpace, omega: Array) -> Array:
    """L(jω) (n, ω) of each loop, cut at its command while all others are closed; negative feedback."""
    both = control.series(plant, feedback)
    G = np.moveaxis(np.asarray(control.frequency_response(both, omega, squeeze=False).complex), 2, 0)
    return one_by_one(G)


def one_by_one(G: Array, which: Sequence[int] = ()) -> Array:
    """L (n, …) of each loop, or of some, from the responses (…, n, n) of all commands to commands through plant and
    controller."""
    n = G.shape[-1]
    loops = []
    for i in which or range(n):
        others = [j for j in range(n) if j != i]
        rest = np.eye(n - 1) - G[..., others, :][..., others]
        through = G[..., i, others][..., None, :] @ np.linalg.solve(rest, G[..., others, i][..., None])
        loops.append(-(G[..., i, i] + through[..., 0, 0]))
    return np.array(loops)


def poles(plant: control.StateSpace, feedback: control.StateSpace) -> Array:
    """Poles of the closed loop, in the z plane."""
    return np.asarray(control.feedback(plant, feedback, sign=1).poles())


def margins(plant: control.StateSpace, feedback: control.StateSpace, names: Sequence[str],
            where: str) -> tuple[list[Margin], Array, Array]:
    """Margins of all loops, with the frequencies [rad/s] and L(jω) (n, ω) that they were read from."""
    period = float(plant.dt)
    omega = frequencies(period)
    L = responses(plant, feedback, omega)
    roots = np.log(poles(plant, feedback).astype(complex) + 1e-300)
    damping = float(np.min(-roots.real / np.maximum(np.abs(roots), 1e-12)))
    found = []
    for name, loop in zip(names, L, strict=True):
        gains, phases, distances, gain_at, phase_at, _ = control.stability_margins(
            control.FrequencyResponseData(loop, omega, smooth=True), returnall=True)
        # for an unstable loop the factor that would stabilise it
        crossings = [(g, w) for g, w in zip(gains, gain_at, strict=True) if (g > 1) == (damping >= 0)]
        gain, frequency = min(crossings, key=lambda pair: abs(np.log(pair[0])), default=(np.inf, np.nan))
        phase, crossing = min(((abs((p + 180) % 360 - 180), w) for p, w in zip(phases, phase_at, strict=True)),
                              default=(np.inf, np.nan))
        found.append(Margin(where, name, float(gain), float(frequency), float(np.radians(phase)), float(crossing),
                            float(min(distances, default=np.inf)), damping))
    return found, omega, L
