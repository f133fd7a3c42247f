"""Gain and phase margins, Nyquist distances and damping ratios of the loops of a sampled controller."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.interpolate import CubicSpline, PPoly

from hydroopt.control.linear_system import LinearSystem, closed_loop
from hydroopt.results.tables import number
from hydroopt.spatial.inertia import Array

FREQUENCIES = 400
"""Number of frequencies at which loops are analysed, up to half the sampling rate."""
SLOWEST = 2e-4
"""The lowest of these frequencies, as a part of the sampling rate."""
LITTLE_DAMPING, WIDTHS = 0.1, np.tan(np.radians(np.arange(-87.0, 88.0, 3.0)))
"""Damping ratio below which a pole is a resonance, and frequencies about it in damping ratios from its own: equal steps
along the circle of its Nyquist curve."""
STANDING = 1e-4
"""Distance from 1 within which a pole is that of a position, which stands still where nothing moves it."""


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
        damping_at: frequency of that pole [rad/s].
        undisturbed: smallest damping ratio of the plant's own poles, without any feedback.
        disk: disk margin α (Seiler, Packard and Gahinet 2020, balanced): gain may change by any factor between
            (2 − α)/(2 + α) and its inverse, and the phase at the same time within the same disk.
    """

    point: str
    loop: str
    gain: float
    gain_at: float
    phase: float
    phase_at: float
    distance: float
    damping: float
    damping_at: float
    undisturbed: float
    disk: float

    @property
    def growth(self) -> float:
        """Rate at which errors of an unstable loop grow [1/s]; zero where it is stable."""
        return max(-self.damping * self.damping_at, 0.0)

    def as_dict(self) -> dict[str, str | float | None]:
        """The entry of a table, in dB, degrees and Hz; None where a number does not exist."""
        return {"loop": self.loop, "point": self.point, "gain_margin_db": number(20 * np.log10(self.gain)),
                "gain_crossing_hz": number(self.gain_at / (2 * np.pi)),
                "phase_margin_deg": number(np.degrees(self.phase)),
                "phase_crossing_hz": number(self.phase_at / (2 * np.pi)), "sensitivity": number(1 / self.distance),
                "damping": self.damping, "damping_hz": number(self.damping_at / (2 * np.pi)),
                "damping_without_feedback": self.undisturbed, "disk_margin": number(self.disk)}


def frequencies(period: float) -> Array:
    """[rad/s] at which loops are analysed."""
    return np.geomspace(2 * np.pi * SLOWEST, np.pi, FREQUENCIES) / period


def with_resonances(omega: Array, systems: Sequence[LinearSystem]) -> Array:
    """Frequencies [rad/s], and those about the resonances of sampled systems between the first and the last of them."""
    found = [omega]
    for system in systems:
        poles = system.poles.astype(complex)
        roots = np.log(poles[np.abs(poles) > 0]) / system.period
        size, damping = np.abs(roots), np.abs(roots.real) / np.maximum(np.abs(roots), 1e-12)
        light = (damping < LITTLE_DAMPING) & (roots.imag > 0)
        found.append((size[light, None] * (1 + damping[light, None] * WIDTHS)).ravel())
    every = np.unique(np.concatenate(found))
    return np.asarray(every[(every >= omega[0]) & (every <= omega[-1])])


def responses(plant: LinearSystem, feedback: LinearSystem, omega: Array) -> Array:
    """L(jω) (n, ω) of each loop, cut at its command while all others are closed; negative feedback."""
    z = np.exp(1j * omega * plant.period)
    return one_by_one(feedback.response(z) @ plant.response(z))


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


def margins(plant: LinearSystem, feedback: LinearSystem, names: Sequence[str],
            where: str) -> tuple[list[Margin], Array, Array]:
    """Margins of all loops, with the frequencies [rad/s] and L(jω) (n, ω) that they were read from."""
    omega = frequencies(plant.period)
    L = responses(plant, feedback, omega)
    damping = (*_least_damping(closed_loop(plant, feedback)), _least_damping(plant, STANDING)[0])
    # cubic splines over the logarithm of the frequency
    curves = CubicSpline(np.log(omega), np.stack([
        L.real, L.imag, np.log(np.maximum(np.abs(L), 1e-300)), np.abs(1 + L)]), axis=-1)
    nearest, disk = np.min(np.abs(1 + L), axis=1), _disks(L)
    return [_margin(where, name, [PPoly.construct_fast(curves.c[..., k, i], curves.x) for k in range(4)],
                    float(nearest[i]), damping, float(disk[i])) for i, name in enumerate(names)], omega, L


def disk_margins(plant: LinearSystem, feedback: LinearSystem) -> Array:
    """The disk margins (n,) of `margins` alone; zero where the closed loop is not stable."""
    stable = _least_damping(closed_loop(plant, feedback))[0] > 0
    return _disks(responses(plant, feedback, frequencies(plant.period))) * stable


def _disks(L: Array) -> Array:
    """Disk margins (n,) of loops L(jω) (n, ω)."""
    return np.asarray(np.min(2 * np.abs(1 + L) / np.maximum(np.abs(1 - L), 1e-300), axis=1))


def _least_damping(system: LinearSystem, standing: float = 0.0) -> tuple[float, float]:
    """Least damping ratio of the poles of a sampled system, and the frequency [rad/s] of that pole; poles within
    `standing` of 1 do not count."""
    poles = system.poles.astype(complex)
    roots = np.log(poles[np.abs(poles - 1) >= standing] + 1e-300)
    if not len(roots):
        return 1.0, 0.0
    size = np.maximum(np.abs(roots), 1e-12)
    least = int(np.argmin(-roots.real / size))
    return float(-roots.real[least] / size[least]), float(size[least] / system.period)


def _margin(where: str, name: str, curves: Sequence[PPoly], nearest: float, damping: tuple[float, float, float],
            disk: float) -> Margin:
    """The margins of a loop L(jω) by curves of its real and imaginary parts, log |L| and |1 + L|, the least of which at
    the frequencies themselves is `nearest`."""
    real, imaginary, size, distance = curves
    at_180 = imaginary.roots(extrapolate=False)
    at_180 = at_180[real(at_180) < 0]
    gains = -1 / real(at_180)
    # for an unstable loop the factor that would stabilise it
    own = (gains > 1) == (damping[0] >= 0)
    gain, gain_at = _nearest(gains[own], at_180[own], np.abs(np.log(gains[own])))
    at_one = size.roots(extrapolate=False)
    phases = np.abs(np.angle(-real(at_one) - 1j * imaginary(at_one)))
    phase, phase_at = _nearest(phases, at_one, phases)
    turning = distance.derivative().roots(extrapolate=False)
    least = float(np.min(distance(turning), initial=nearest))
    return Margin(where, name, gain, gain_at, phase, phase_at, least, *damping, disk)


def _nearest(margin: Array, at: Array, measure: Array) -> tuple[float, float]:
    """The margin with the least measure, and its frequency; infinite where there is none."""
    if not len(measure):
        return np.inf, np.nan
    k = int(np.argmin(measure))
    return float(margin[k]), float(np.exp(at[k]))
