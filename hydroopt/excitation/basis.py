"""Motions that are linear in few coefficients: Fourier series and B-splines, from rest to rest.

Every joint moves as ``q(t) = B(t)·c`` with the same functions B. A motion has an entry, in which it gains speed, the
part that repeats or the spline, and an exit, in which it comes to rest.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from scipy.interpolate import BSpline

from hydroopt.errors import ProblemError
from hydroopt.inertia import Array

DEGREE = 5
"""Of the splines: acceleration and jerk are continuous."""


class Rows(NamedTuple):
    """The functions and their first and second derivatives (N, m) at N times."""

    position: Array
    speed: Array
    acceleration: Array


@dataclass(frozen=True)
class Fourier:
    """A mean and `harmonics` sines and cosines of `period` [s], repeated `repeats` times (Swevers et al. 1997).

    Before and after it a polynomial of the fifth degree leads within `blend` [s] from rest at the mean into the series,
    and back.
    """

    period: float
    harmonics: int
    repeats: int = 1
    blend: float = 2.0

    @property
    def duration(self) -> float:
        """Of the whole motion [s]."""
        return self.repeats * self.period + 2 * self.blend

    @property
    def fastest(self) -> float:
        """The highest frequency [Hz]."""
        return self.harmonics / self.period

    @property
    def names(self) -> tuple[str, ...]:
        """Of the coefficients of a joint: mean, sines, cosines."""
        return ("mean", *(f"{kind}{k}" for kind in ("sin", "cos") for k in range(1, self.harmonics + 1)))

    def rows(self, t: Array) -> Rows:
        """The functions at times t (N,) [s] from 0 to `duration`."""
        t = np.clip(np.asarray(t, dtype=float), 0, self.duration)
        made = self._series(t - self.blend)
        if self.blend <= 0:
            return made
        for inside, s, sign in ((t < self.blend, t / self.blend, 1.0),
                                (t > self.duration - self.blend, (self.duration - t) / self.blend, -1.0)):
            entry = self._entry(s[inside], sign)
            for whole, part in zip(made, entry, strict=True):
                whole[inside] = part
        return made

    def _series(self, t: Array) -> Rows:
        k = np.arange(1, self.harmonics + 1)
        omega = 2 * np.pi / self.period * k
        sin, cos = np.sin(np.outer(t, omega)), np.cos(np.outer(t, omega))
        one, none = np.ones((len(t), 1)), np.zeros((len(t), 1))
        return Rows(np.hstack([one, sin, cos]), np.hstack([none, cos * omega, -sin * omega]),
                    np.hstack([none, -sin * omega**2, -cos * omega**2]))

    def _entry(self, s: Array, sign: float) -> Rows:
        """From rest at the mean (s = 0) into the state in which the series begins (s = 1); backwards for sign −1."""
        start = self._series(np.zeros(1))
        mean = np.zeros((1, 1 + 2 * self.harmonics))
        mean[0, 0] = 1.0
        T = self.blend
        # p(s) = a·s³ + b·s⁴ + c·s⁵ has p = Δ, p' = v, p'' = w at s = 1
        delta, v, w = start.position - mean, sign * T * start.speed, T**2 * start.acceleration
        a, b, c = 10 * delta - 4 * v + w / 2, -15 * delta + 7 * v - w, 6 * delta - 3 * v + w / 2
        s = s[:, None]
        return Rows(mean + a * s**3 + b * s**4 + c * s**5, sign * (3 * a * s**2 + 4 * b * s**3 + 5 * c * s**4) / T,
                    (6 * a * s + 12 * b * s**2 + 20 * c * s**3) / T**2)


@dataclass(frozen=True)
class Spline:
    """A spline of the fifth degree through `pieces` stretches of equal length, at rest at both ends."""

    duration: float
    pieces: int

    @property
    def fastest(self) -> float:
        """Frequency [Hz] that a spline of these knots carries: half a period takes a stretch or more."""
        return self.pieces / (2 * self.duration)

    @property
    def names(self) -> tuple[str, ...]:
        """Of the control points of a joint; the first and the last stand for the three that rest at each end."""
        return tuple(f"point{k}" for k in range(self.pieces + DEGREE - 4))

    @cached_property
    def _splines(self) -> tuple[BSpline, BSpline, BSpline]:
        inner = np.linspace(0, self.duration, self.pieces + 1)
        knots = np.concatenate([np.zeros(DEGREE), inner, np.full(DEGREE, self.duration)])
        count = self.pieces + DEGREE
        tie = np.zeros((count, count - 4))  # three equal points at an end: no speed, no acceleration
        tie[np.arange(count), np.clip(np.arange(count) - 2, 0, count - 5)] = 1.0
        spline = BSpline(knots, tie, DEGREE)
        return spline, spline.derivative(1), spline.derivative(2)

    def rows(self, t: Array) -> Rows:
        """The functions at times t (N,) [s] from 0 to `duration`."""
        t = np.clip(np.asarray(t, dtype=float), 0, self.duration)
        return Rows(*(np.asarray(spline(t)) for spline in self._splines))


Basis = Fourier | Spline


def check(basis: Basis, bandwidth: float | None) -> None:
    """Refuse a motion that has no time, or that is faster than the valves follow.

    Raises:
        ProblemError: what is asked for, and what would do.
    """
    count = basis.harmonics if isinstance(basis, Fourier) else basis.pieces
    if not (0 < basis.duration < 1e6 and 1 <= count <= 1000) or (isinstance(basis, Fourier) and not (
            basis.period > 0 and basis.repeats >= 1 and basis.blend >= 0)):
        raise ProblemError("the motion has no duration, or no functions to be made of", where="excitation",
                           remedy="give a positive duration, period and number of harmonics")
    if bandwidth is not None and basis.fastest > bandwidth * (1 + 1e-9):
        raise ProblemError(f"the motion reaches {basis.fastest:.3g} Hz, but the machine follows up to its bandwidth of "
                           f"{bandwidth:.3g} Hz only", where="excitation",
                           remedy="give fewer harmonics or a longer period")
