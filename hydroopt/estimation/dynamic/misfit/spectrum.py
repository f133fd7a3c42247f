"""What residuals hold that is faster than the motion: oscillations of one frequency, and motion that smoothing takes
away."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from hydroopt.estimation.dynamic.misfit.view import UNKNOWN, View
from hydroopt.spatial.inertia import Array

SLOWEST_LINE, CLEAR = 3.0, 1e-6
"""Lines are looked for above this frequency [Hz]; probability below which one is no noise."""
MOSTLY = 0.5
"""Part of what residuals hold beyond white noise that is faster than the bandwidth, from which on the motion is."""
CHANCE = 5.0
"""Standard deviations of white noise's own power, beyond which power faster than the bandwidth is no chance."""
FEW = 64
"""Samples of a stretch that a spectrum needs."""


class Line(NamedTuple):
    """An oscillation in a reading's residuals: frequency [Hz], amplitude and its unit."""

    hertz: float
    amplitude: float
    unit: str


class Fast(NamedTuple):
    """Residuals faster than smoothing passes: their part of what is beyond white noise, the frequency [Hz] where they
    are largest, and that which smoothing passes by half."""

    part: float
    hertz: float
    bandwidth: float


def lines(view: View) -> Iterator[tuple[str, Line]]:
    """Frequencies that stand out of the residuals' spectrum (Fisher's test), faster than the motion."""
    units = (*view.model.force_units, *["m"] * len(view.lengths))
    for k, hertz, power, size in _spectra(view):
        fast = hertz > max(SLOWEST_LINE, 2 * float(np.max(view.motion.bandwidth)))
        if np.sum(fast) < 16:
            continue
        top = int(np.argmax(power[fast]))
        excess = power[fast][top] * np.log(2) / max(float(np.median(power[fast])), 1e-300)
        amplitude = float(2 * np.sqrt(power[fast][top]) / size)
        # of so many exponentially distributed powers
        if excess > np.log(np.sum(fast) / CLEAR) and amplitude > UNKNOWN * view.of_motion[k]:
            yield view.names[k], Line(float(hertz[fast][top]), amplitude, units[k])


def faster(view: View) -> Iterator[tuple[str, Fast]]:
    """Forces whose residuals, beyond white noise, are mostly faster than what smoothing passes.

    White noise's power scatters as much as it is large, so that its mean is taken from sums and not from each
    frequency: what is left of single frequencies above it would be fast, since most frequencies are.
    """
    band = float(np.max(view.motion.bandwidth))
    for k, hertz, power, size in _spectra(view):
        if k >= len(view.model.machine.balances):
            break
        white = size * view.noise[k] ** 2
        quick, slow = hertz > band, (hertz > 0) & (hertz <= band)
        fast, rest = (float(np.sum(power[of] - white)) for of in (quick, slow))
        if fast < CHANCE * white * np.sqrt(np.sum(quick)) or fast < MOSTLY * (fast + max(rest, 0.0)):
            continue
        calm = np.convolve(np.maximum(power - white, 0.0), np.ones(9) / 9, mode="same")  # of single lines, their part
        yield view.names[k], Fast(fast / (fast + max(rest, 0.0)),
                                  float(hertz[int(np.argmax(np.where(quick, calm, 0.0)))]), band)


def _spectra(view: View) -> Iterator[tuple[int, Array, Array, int]]:
    """Of each reading of a sensor: its place, frequencies [Hz], power of residuals in the longest stretch, and how many
    of its samples take part."""
    motion = view.motion
    longest = int(np.argmax(np.bincount(motion.segment - motion.segment[0]))) + motion.segment[0]
    at = np.flatnonzero((motion.segment == longest) & motion.interior)
    if at.size < FEW:
        return
    hertz = np.fft.rfftfreq(at.size, float(np.median(np.diff(motion.t[at]))))
    for k in np.flatnonzero(view.read).tolist():
        r = np.where(view.taken[at, k], view.residual[at, k], 0.0)
        power = np.abs(np.fft.rfft(r - r.mean())) ** 2
        yield k, np.asarray(hertz, dtype=float), power, max(int(np.sum(view.taken[at, k])), 1)
