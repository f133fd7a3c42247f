"""Least squares on base parameters, and the thesis's two ways around a singular regressor (Eq. 4.58 to 4.60)."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.linalg import svd

from hydroopt.estimation.inference.identifiability import (
    RANK_TOLERANCE,
    ROUNDING_TOLERANCE,
    Identifiability,
    analyse,
    significant,
)
from hydroopt.parameters.parameter_set import ParameterSet
from hydroopt.spatial.inertia import Array

ROUNDING = 1e-10
"""Part of the largest singular value below which a direction is rounding error, and has no variance of its own."""


def base_least_squares(R: Array, r: Array, names: tuple[str, ...],
                       tolerance: float = RANK_TOLERANCE, found: Identifiability | None = None
                       ) -> tuple[Array, Array, Identifiability]:
    """Least squares on the base parameters (Eq. 4.58).

    Returns:
        ψ (p,) with every parameter outside the basis at zero, which predicts what the base parameters predict;
        the covariance (r, r) of the base parameters for unit weights; what is identifiable.
    """
    found = found or analyse(R, names, tolerance=tolerance)
    basis = list(found.basis)
    scale = np.linalg.norm(R[:, basis], axis=0)
    Q, T = np.linalg.qr(R[:, basis] / scale)
    psi = np.zeros(R.shape[1])
    psi[basis] = np.linalg.solve(T, Q.T @ r) / scale if basis else 0.0
    inverse = np.linalg.inv(T) / scale[:, None] if basis else np.zeros((0, 0))
    return psi, inverse @ inverse.T, found


def fitted(R: Array, r: Array, tolerance: float) -> tuple[Array, int]:
    """ψ (p,) that predicts what base parameters predict, and their number, where no more is asked of them."""
    size = np.linalg.norm(R, axis=0)
    size[~significant(size, ROUNDING_TOLERANCE)] = np.inf
    found, _, rank, _ = np.linalg.lstsq(R / size, r, rcond=tolerance)
    return found / size, int(rank)


def individual_values(psi: Array, covariance: Array, found: Identifiability) -> tuple[Array, Array]:
    """Values and standard deviations (p,) of the parameters identifiable alone, NaN for all others."""
    value, std = np.full(len(psi), np.nan), np.full(len(psi), np.nan)
    for i, j in enumerate(found.basis):
        if found.category[j] == "full":
            value[j], std[j] = psi[j], np.sqrt(covariance[i, i])
    return value, std


def nearest(parameters: ParameterSet, found: Identifiability, psi: Array) -> Array:
    """The ψ (p,) with the same base parameters that is nearest to the nominal one, in units of the priors' sizes.

    It predicts the same as `psi` wherever the data had something to say, and as the nominal model elsewhere.
    """
    change = found.grouping @ (psi - parameters.nominal)
    step = np.linalg.pinv(found.grouping * parameters.scale, rcond=1e-12) @ change
    return np.asarray(parameters.nominal + parameters.scale * step)


class RidgeStrength(NamedTuple):
    """λ of ridge regression (Eq. 4.59) over the largest eigenvalue of KᵀK, on columns of unit length, and over λ_min.

    λ_min is the smallest eigenvalue that is not zero. The estimate is nearly optimal if λ is much smaller than λ_min.

    >>> print(RidgeStrength(1e-6, 0.02))
    ridge strength λ: 1e-06 of the largest eigenvalue of KᵀK, λ/λ_min = 0.02
    """

    of_largest: float
    of_smallest: float

    def __str__(self) -> str:
        return (f"ridge strength λ: {self.of_largest:.3g} of the largest eigenvalue of KᵀK, "
                f"λ/λ_min = {self.of_smallest:.3g}")


def ridge(R: Array, r: Array, strength: float | None = None, *, rows: float | None = None, rest: float = 0.0,
          tolerance: float = RANK_TOLERANCE) -> tuple[Array, RidgeStrength]:
    """Ridge regression on columns of unit length (Eq. 4.59); `strength` λ is relative to the largest eigenvalue of KᵀK.

    Without a strength, generalised cross-validation chooses it, for which the number of `rows` and the sum of squares
    outside of R (`rest`) must be given if R is a triangle that stands for more. Singular values below `tolerance` times
    the largest count as zero. Returns ψ (p,) and the λ used.
    """
    lengths = np.linalg.norm(R, axis=0)
    lengths[lengths == 0] = 1.0
    U, s, Vt = svd(R / lengths, full_matrices=False, lapack_driver="gesvd")
    projected = U.T @ r
    if strength is None:
        outside = rest + max(float(r @ r - projected @ projected), 0.0)
        idle = (len(r) if rows is None else rows) - len(s)
        grid = np.logspace(-16, 0, 257)
        shrunk = [grid_point / (s**2 / s[0] ** 2 + grid_point) for grid_point in grid]
        score = [(outside + np.sum((f * projected) ** 2)) / max(idle + np.sum(f), 1e-12) ** 2 for f in shrunk]
        strength = float(grid[int(np.argmin(score))])
    filtered = s / (s**2 + strength * s[0] ** 2) * projected
    smallest = np.min(s[significant(s, tolerance)], initial=s[0])
    return Vt.T @ filtered / lengths, RidgeStrength(strength, float(strength * (s[0] / smallest) ** 2))


def truncated_svd(R: Array, r: Array, tolerance: float) -> tuple[Array, int]:
    """Least squares in the directions whose singular value is at least `tolerance` of the largest (Eq. 4.60).

    Returns ψ (p,) of smallest scaled norm and the number of directions kept.
    """
    lengths = np.linalg.norm(R, axis=0)
    lengths[lengths == 0] = 1.0
    U, s, Vt = svd(R / lengths, full_matrices=False, lapack_driver="gesvd")
    kept = significant(s, tolerance)
    return Vt[kept].T @ ((U.T @ r)[kept] / s[kept]) / lengths, int(kept.sum())


def deviations(rows: Array, scale: Array) -> Array:
    """Standard deviation (p,) of parameters by rows (·, p) of unit variance; infinite where these are silent.

    >>> deviations(np.array([[0.5, 0.0]]), np.ones(2))
    array([ 2., inf])

    Args:
        rows: of their least squares.
        scale: (p,) sizes of the parameters.
    """
    _, sizes, axes = np.linalg.svd(rows * scale)
    known = np.append(sizes, np.zeros(len(axes)))[: len(axes)] > 1e-9 * sizes[0]
    silent = np.linalg.norm(axes[~known], axis=0) > 1e-6
    std = np.linalg.norm(axes[known] / sizes[known[: len(sizes)], None], axis=0)
    return np.asarray(scale * np.where(silent, np.inf, std))


def orthonormal(columns: Array) -> Array:
    """Orthonormal basis of a column space; columns are scaled to unit length first."""
    lengths = np.linalg.norm(columns, axis=0)
    scaled = columns[:, lengths > 0] / lengths[lengths > 0]
    U, s, _ = np.linalg.svd(scaled, full_matrices=False)
    return np.asarray(U[:, s > ROUNDING * s[0]])


def without(basis: Array, columns: Array) -> Array:
    """Columns less their projection; twice, so that they stay perpendicular to rounding."""
    for _ in range(2):
        columns = columns - basis @ (basis.T @ columns)
    return columns
