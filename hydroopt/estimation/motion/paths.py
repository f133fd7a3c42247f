"""Joint positions over time as quintic splines, and postures at rest: coefficients that meet only their neighbours."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hydroopt.logs.spline import Basis, Grid
from hydroopt.spatial.inertia import Array

ORDERS = 4
"""Positions and three derivatives; the third one is how accelerations change with a delay."""


class Support(NamedTuple):
    """Which coefficients give the motion at N times: values and derivatives [per s^k] of the `width` splines that are
    not zero there, (ORDERS, N, width), and the number (N,) of the first one."""

    values: Array
    first: NDArray[np.intp]


@dataclass(frozen=True, eq=False)
class Spline:
    """The motion of n joints over an uninterrupted stretch; coefficients (k, n)."""

    basis: Basis
    coefficients: Array
    width: int = field(default=6, init=False)

    @classmethod
    def over(cls, t: Array, spacing: float, times: Array, positions: Array) -> Spline:
        """With knots about `spacing` [s] apart over the samples' times `t` (N,), near positions (M, n) at `times`."""
        duration = float(t[-1] - t[0])
        intervals = max(3, int(np.ceil(duration / spacing)))
        basis = Basis(t, Grid(float(t[0]), duration, intervals, 1.0))
        # a coefficient is about the position where its spline is greatest
        knots = basis.start + (np.arange(basis.intervals + 5) - 2.0) * basis.spacing
        return cls(basis, np.column_stack([np.interp(knots, times, column) for column in positions.T]))

    def support(self, t: Array) -> Support:
        """At times (N,); those beyond the ends count as the ends."""
        x = self.basis.places(t)
        values = np.stack([self.basis.values(x, order) / self.basis.spacing**order for order in range(ORDERS)])
        return Support(values, self.basis.cells(x).astype(np.intp))

    @property
    def roughness(self) -> Array:
        """∫ q'''² dt in band storage (6, k): of joints alike."""
        return np.asarray(self.basis.penalty / self.basis.spacing**5)

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

    @property
    def roughness(self) -> None:
        """Postures do not follow one another."""
        return None

    def moved(self, step: Array) -> Postures:
        """With other positions, by `step` (N, n)."""
        return replace(self, coefficients=self.coefficients + step)


Path = Spline | Postures


def motion(path: Path, support: Support) -> list[Array]:
    """q, qd, qdd and the third derivative (N, n) at the times of a support."""
    around = path.coefficients[support.first[:, None] + np.arange(path.width)]
    return [np.einsum("mk,mkj->mj", values, around) for values in support.values]
