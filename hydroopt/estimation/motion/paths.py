"""Joint positions over time as quintic splines, and postures at rest: coefficients that meet only their neighbours."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hydroopt.estimation.motion.banded import Rows
from hydroopt.logs.spline import Basis, Grid
from hydroopt.spatial.inertia import Array

ORDERS = 4
"""Positions and three derivatives; the third one is how accelerations change with a delay."""


class Support(NamedTuple):
    """Which coefficients give the motion at N times: values and derivatives [per s^k] of the `width` splines that are
    not zero there, (ORDERS, N, width), and the number (N,) of the first one."""

    values: Array
    first: NDArray[np.intp]

    def along(self, by_motion: Sequence[Array]) -> Array:
        """Derivatives (N, m, width·n) by coefficients, of those (N, m, n) by positions, speeds, and so on."""
        made = sum(np.einsum("kw,kmn->kmwn", values, by)
                   for values, by in zip(self.values, by_motion, strict=False))
        return np.asarray(made).reshape(*by_motion[0].shape[:2], -1)


@dataclass(frozen=True, eq=False)
class Spline:
    """The motion of n joints over an uninterrupted stretch; coefficients (k, n)."""

    basis: Basis
    coefficients: Array
    width: int = field(default=6, init=False)

    @classmethod
    def over(cls, t: Array, intervals: int, joints: int) -> Spline:
        """Of joints that rest at zero, with three knot intervals or more over the samples' times `t` (N,)."""
        basis = Basis(t, Grid(float(t[0]), float(t[-1] - t[0]), intervals, 1.0))
        return cls(basis, np.zeros((basis.intervals + 5, joints)))

    def near(self, times: Array, positions: Array) -> Spline:
        """About as given at some times (M,), positions (M, n)."""
        # a coefficient is about the position where its spline is greatest
        knots = self.basis.start + (np.arange(len(self.coefficients)) - 2.0) * self.basis.spacing
        return replace(self, coefficients=np.column_stack([np.interp(knots, times, column) for column in positions.T]))

    def support(self, t: Array) -> Support:
        """At times (N,); those beyond the ends count as the ends."""
        x = self.basis.places(t)
        values = np.stack([self.basis.values(x, order) / self.basis.spacing**order for order in range(ORDERS)])
        return Support(values, self.basis.cells(x).astype(np.intp))

    @property
    def roughness(self) -> Array:
        """∫ q'''² dt in band storage (6, k): of joints alike."""
        return np.asarray(self.basis.penalty / self.basis.spacing**5)

    def jerk(self, stiffness: Array, common: int) -> Rows:
        """Residuals with ``Σ left² = ∫ |stiffness·q'''|² dt``, stiffness (n,): the third derivative as white noise."""
        values, first = self.basis.jerk
        support = Support(values[None] * self.basis.spacing**-2.5, first)
        by_jerk = np.tile(np.diag(stiffness), (len(first), 1, 1))
        return Rows.of_path(-stiffness * motion(self, support)[0], support.along([by_jerk]), common,
                            first * len(stiffness))

    def moved(self, step: Array) -> Spline:
        """With other coefficients, by `step` (k, n)."""
        return replace(self, coefficients=self.coefficients + step)


@dataclass(frozen=True, eq=False)
class Postures:
    """Joint positions (N, n) of N postures at rest."""

    coefficients: Array
    width: int = field(default=1, init=False)

    def support(self, t: Array) -> Support:
        """At the postures `t` (N,), by their numbers."""
        values = np.zeros((ORDERS, t.size, 1))
        values[0] = 1.0
        return Support(values, t.astype(np.intp))

    def moved(self, step: Array) -> Postures:
        """With other positions, by `step` (N, n)."""
        return replace(self, coefficients=self.coefficients + step)


Path = Spline | Postures


def motion(path: Path, support: Support) -> list[Array]:
    """q, qd, qdd and the third derivative (N, n) at the times of a support."""
    around = path.coefficients[support.first[:, None] + np.arange(path.width)]
    return [np.einsum("mk,mkj->mj", values, around) for values in support.values]
