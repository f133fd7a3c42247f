"""Motions that are linear in few coefficients: Fourier series and B-splines, from rest to rest.

Every joint moves as ``q(t) = B(t)·c`` with the same functions B. A motion has an entry, in which it gains speed, the
part that repeats or the spline, and an exit, in which it comes to rest.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, replace
from functools import cached_property
from math import factorial, perm
from typing import NamedTuple, Self

import casadi as ca
import numpy as np
from scipy.interpolate import BSpline

from hydroopt.errors import ProblemError
from hydroopt.spatial.inertia import Array

DEGREE = 5
"""Of the splines: acceleration and jerk are continuous."""
SMOOTH = 4
"""How many derivatives are continuous where a blend begins and ends, the position among them: a step of the jerk, which
smoothing takes away, would stand out of the residuals of an accurate encoder."""


class Rows(NamedTuple):
    """The functions and their first and second derivatives (N, m) at N times."""

    position: Array
    speed: Array
    acceleration: Array


@dataclass(frozen=True)
class Basis(ABC):
    """Functions of time, of which every joint's motion is a sum."""

    @property
    @abstractmethod
    def duration(self) -> float:
        """Of the whole motion [s]."""

    @property
    @abstractmethod
    def fastest(self) -> float:
        """The highest frequency [Hz]."""

    @property
    @abstractmethod
    def names(self) -> tuple[str, ...]:
        """Of the coefficients of a joint."""

    @property
    @abstractmethod
    def text(self) -> str:
        """What it is, in a few words."""

    @abstractmethod
    def at_pace(self, pace: float) -> Self:
        """Those of the same path in a longer time: at a part of its pace, above 0 and at most 1."""

    @abstractmethod
    def expressions(self, t: ca.SX) -> tuple[ca.SX, ca.SX, ca.SX]:
        """The functions and their derivatives (m, 1) at a time t, constant before the start and after the end.

        They are made of sums in which each term comes to rest outside of its own stretch of time, so that they need no
        branches, neither here nor in generated code.
        """

    @cached_property
    def _function(self) -> ca.Function:
        t = ca.SX.sym("t")
        return ca.Function("basis", [t], [ca.densify(each) for each in self.expressions(t)])

    def rows(self, t: Array) -> Rows:
        """The functions at times t (N,) [s] from 0 to `duration`."""
        return Rows(*(np.ascontiguousarray(np.asarray(each).T) for each in self._function(np.atleast_2d(t))))


@dataclass(frozen=True)
class Fourier(Basis):
    """A mean and `harmonics` sines and cosines of `period` [s], repeated `repeats` times (Swevers et al. 1997).

    Before and after it a polynomial of the seventh degree leads within `blend` [s] from rest at the mean into the
    series, and back; without a blend it begins and ends in motion.
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
        """The highest frequency [Hz]: of the series, or of a blend, which is half a period at least."""
        return max(self.harmonics / self.period, 1 / (2 * self.blend) if self.blend > 0 else 0.0)

    @property
    def text(self) -> str:
        """Harmonics, period and repetitions."""
        return f"{self.harmonics} harmonics of {self.period:.4g} s, {self.repeats}×"

    @property
    def names(self) -> tuple[str, ...]:
        """Of the coefficients of a joint: mean, sines, cosines."""
        return ("mean", *(f"{kind}{k}" for kind in ("sin", "cos") for k in range(1, self.harmonics + 1)))

    def at_pace(self, pace: float) -> Fourier:
        """As in `Basis`."""
        return replace(self, period=self.period / pace, blend=self.blend / pace)

    def expressions(self, t: ca.SX) -> tuple[ca.SX, ca.SX, ca.SX]:
        """As in `Basis`."""
        turns = _clamp(t - self.blend, self.repeats * self.period) / self.period
        series, start = self._series(2 * ca.pi * (turns - ca.floor(turns))), self._series(ca.DM(0))
        if self.blend <= 0:
            return series
        entry = self._entry(_clamp(t, self.blend) / self.blend, 1)
        leave = self._entry(_clamp(self.duration - t, self.blend) / self.blend, -1)
        first, second, third = (a + b + c - 2 * d for a, b, c, d in zip(entry, series, leave, start, strict=True))
        return first, second, third

    def _series(self, angle: ca.SX | ca.DM) -> tuple[ca.SX, ca.SX, ca.SX]:
        sines, cosines = [ca.sin(angle)], [ca.cos(angle)]
        for _ in range(1, self.harmonics):  # by the addition theorems
            s, c = sines[-1], cosines[-1]
            sines.append(s * cosines[0] + c * sines[0])
            cosines.append(c * cosines[0] - s * sines[0])
        sin, cos = ca.vertcat(*sines), ca.vertcat(*cosines)
        omega = ca.DM(2 * np.pi / self.period * np.arange(1, self.harmonics + 1))
        return ca.vertcat(1, sin, cos), ca.vertcat(0, cos * omega, -sin * omega), ca.vertcat(
            0, -sin * omega**2, -cos * omega**2)

    def _entry(self, s: ca.SX, sign: int) -> tuple[ca.SX, ca.SX, ca.SX]:
        """From rest at the mean (s = 0) into the state in which the series begins (s = 1); backwards for sign −1."""
        multiple = np.arange(1, self.harmonics + 1)
        # of mean, sines and cosines at the start of the series, order by order, from the mean and in units of the blend
        start = np.array([[0.0, *(np.sin(order * np.pi / 2) * multiple**order),
                           *(np.cos(order * np.pi / 2) * multiple**order)] for order in range(SMOOTH)])
        start *= (sign * 2 * np.pi * self.blend / self.period) ** np.arange(SMOOTH)[:, None]
        powers = range(SMOOTH, 2 * SMOOTH)
        coefficients = np.linalg.solve([[float(perm(power, order)) for power in powers] for order in range(SMOOTH)],
                                       start)
        made = [ca.SX(ca.DM([1.0, *[0.0] * (2 * self.harmonics)])), ca.SX(1 + 2 * self.harmonics, 1),
                ca.SX(1 + 2 * self.harmonics, 1)]
        for order in range(3):
            total = ca.SX(1 + 2 * self.harmonics, 1)
            for power, c in zip(reversed(powers), reversed(coefficients), strict=True):
                total = total * s + ca.sparsify(ca.DM(perm(power, order) * c))
            made[order] += (sign / self.blend) ** order * total * s ** (SMOOTH - order)
        first, second, third = made
        return first, second, third


@dataclass(frozen=True)
class Spline(Basis):
    """A spline of the fifth degree through `pieces` stretches of equal length that takes `time` [s], from rest to rest.
    """

    time: float
    pieces: int

    @property
    def duration(self) -> float:
        """Of the whole motion [s]."""
        return self.time

    @property
    def fastest(self) -> float:
        """Frequency [Hz] that a spline of these knots carries: half a period takes a stretch or more."""
        return self.pieces / (2 * self.time)

    @property
    def text(self) -> str:
        """Number of control points."""
        return f"spline of {len(self.names)} points"

    @property
    def names(self) -> tuple[str, ...]:
        """Of the control points of a joint; the first and the last stand for the three that rest at each end."""
        return tuple(f"point{k}" for k in range(self.pieces + DEGREE - 4))

    def at_pace(self, pace: float) -> Spline:
        """As in `Basis`.

        >>> half = Spline(10.0, 4).at_pace(0.5)
        >>> half.duration, half.fastest
        (20.0, 0.1)
        """
        return replace(self, time=self.time / pace)

    def expressions(self, t: ca.SX) -> tuple[ca.SX, ca.SX, ca.SX]:
        """As in `Basis`."""
        inner = np.linspace(0, self.time, self.pieces + 1)
        knots = np.concatenate([np.zeros(DEGREE), inner, np.full(DEGREE, self.time)])
        count = self.pieces + DEGREE
        tie = np.zeros((count, count - 4))  # three equal points at an end: no speed, no acceleration
        tie[np.arange(count), np.clip(np.arange(count) - 2, 0, count - 5)] = 1.0
        curve = BSpline(knots, tie, DEGREE)
        # Taylor coefficients (m,) of each stretch at its beginning, of every power
        taylor = [curve.derivative(power)(inner[:-1]) / factorial(power) for power in range(DEGREE + 1)]
        step = [_clamp(t - start, self.time / self.pieces) for start in inner[:-1]]
        first, second, third = (self._sum([perm(power, order) * c for power, c in enumerate(taylor)][order:], step)
                                for order in range(3))
        return first, second, third

    def _sum(self, taylor: list[Array], step: list[ca.SX]) -> ca.SX:
        """Where a curve begins, and what each stretch adds (m, 1)."""
        total = ca.SX(ca.DM(taylor[0][0]))
        for k, h in enumerate(step):
            added = ca.SX(len(self.names), 1)
            for power in reversed(taylor[1:]):
                added = (added + ca.sparsify(ca.DM(power[k]))) * h
            total += added
        return total


def _clamp(t: ca.SX, most: float) -> ca.SX:
    return ca.fmin(ca.fmax(t, 0), most)


def check(basis: Basis, bandwidth: float | None) -> None:
    """Refuse a motion that has no time, or that is faster than the valves follow.

    Raises:
        ProblemError: the functions have no duration, or are too fast; the sentence states a remedy.
    """
    sound = basis.pieces >= 1 if isinstance(basis, Spline) else not isinstance(basis, Fourier) or (
        basis.period > 0 and basis.harmonics >= 1 and basis.repeats >= 1 and basis.blend >= 0)
    if not (sound and 0 < basis.duration < 1e6 and len(basis.names) <= 1000):
        raise ProblemError("the motion has no duration, or no functions to be made of", where="excitation",
                           remedy="give a positive duration, period and number of harmonics")
    if bandwidth is not None and basis.fastest > bandwidth * (1 + 1e-9):
        raise ProblemError(f"the motion reaches {basis.fastest:.3g} Hz, but the machine follows up to its bandwidth of "
                           f"{bandwidth:.3g} Hz only", where="excitation",
                           remedy="give fewer pieces or more time" if isinstance(basis, Spline) else
                           "give fewer harmonics or more time, or a longer blend")
