"""Whitening: coordinates in which residuals and priors are independent standard normal, before any constraint."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hydroopt.errors import ProblemError
from hydroopt.estimation.inference.conditions import Condition
from hydroopt.estimation.inference.problem import StatedProblem
from hydroopt.spatial.inertia import Array

WIDEST = 1e6
"""Width, in parameter scales, given to directions that neither data nor priors determine."""


@dataclass(frozen=True, eq=False)
class GaussianPosterior:
    """ψ = offset + slope·z with independent standard normal z (k,); the constrained estimate minimises ‖z‖².

    The columns of `slope` (p, k) are the principal axes, from the best determined
    direction to those that only priors determine, so that a solver scales each by its uncertainty.

    Where bodies have a log-det distance, z is only about normal, and the estimate minimises ``‖root·z − right‖²`` and
    these distances.
    """

    offset: Array
    slope: Array
    root: Array
    right: Array

    def conditioned_on(self, conditions: Sequence[Condition]) -> GaussianPosterior | None:
        """The Gaussian where those conditions hold that are equalities; None if these contradict each other.

        Redundant ones are allowed.

        Raises:
            ProblemError: they fix all parameters.
        """
        exact = [c for c in conditions if c.kind == "zero"]
        if not exact:
            return self
        E = np.vstack([c.rows for c in exact]) @ self.slope
        e = -np.concatenate([c.evaluate(self.offset) for c in exact])
        size = np.maximum(np.linalg.norm(E, axis=1), 1e-300)
        E, e = E / size[:, None], e / size
        U, s, Vt = np.linalg.svd(E, full_matrices=True)
        rank = int(np.linalg.matrix_rank(E))
        # the nearest point to the mean, so that what is left is again independent and standard normal
        nearest = Vt[:rank].T @ (U[:, :rank].T @ e / s[:rank])
        if np.max(np.abs(E @ nearest - e), initial=0.0) > 1e-7 * max(1.0, float(np.linalg.norm(nearest))):
            return None
        if rank == len(Vt):
            raise ProblemError("every parameter is fixed, and nothing is left to identify", where=exact[-1].name,
                               remedy="fix fewer parameters")
        return self.moved(nearest, Vt[rank:].T)

    def moved(self, origin: Array, axes: Array) -> GaussianPosterior:
        """In coordinates y with ``z = origin + axes·y``, which need not be standard normal."""
        return GaussianPosterior(self.offset + self.slope @ origin, self.slope @ axes, self.root @ axes,
                                 self.right - self.root @ origin)


def marginal(posterior: GaussianPosterior, some: slice) -> GaussianPosterior:
    """That of some of the parameters, by as many coordinates; without log-det distances."""
    root = np.asarray(np.linalg.qr(posterior.slope[some].T, mode="r")).T
    return GaussianPosterior(posterior.offset[some], root, np.eye(len(root)), np.zeros(len(root)))


def gaussian(rows: Array, right: Array, nominal: Array, scale: Array) -> GaussianPosterior:
    """The Gaussian ``exp(−½‖rows·ψ − right‖²)``, `WIDEST` scales (p,) wide about `nominal` (p,) where rows are silent.
    """
    A, b = _in_scales(rows, right, nominal, scale)
    U, s, Vt = np.linalg.svd(A, full_matrices=False)
    p = len(nominal)
    return GaussianPosterior(nominal + scale * (Vt.T @ (U.T @ b / s)), scale[:, None] * (Vt.T / s), np.eye(p),
                             np.zeros(p))


def gaussian_posterior(problem: StatedProblem, R: Array, r: Array, *, priors: bool = True) -> GaussianPosterior:
    """The Gaussian ``exp(−½‖R·ψ − r‖²)`` times the priors, or without them."""
    nominal, scale = problem.parameters.nominal, problem.parameters.scale
    rows, right = problem.prior_rows if priors else (np.zeros((0, len(nominal))), np.zeros(0))
    made = gaussian(np.vstack([R, rows]), np.append(r, right), nominal, scale)
    if problem.distance != "log-det":
        return made
    rows, right = problem.square_rows
    A, b = _in_scales(np.vstack([R, rows]), np.append(r, right), nominal, scale)
    p, (mean, slope) = len(nominal), ((made.offset - nominal) / scale, made.slope / scale[:, None])
    triangle = np.asarray(np.linalg.qr(np.column_stack([A @ slope, b - A @ mean]), mode="r"))
    return GaussianPosterior(made.offset, made.slope, triangle[:p, :p], triangle[:p, p])


def _in_scales(rows: Array, right: Array, nominal: Array, scale: Array) -> tuple[Array, Array]:
    """Rows and right-hand side for the distance of ψ from its nominal value in scales, which is at most `WIDEST`."""
    return (np.vstack([rows * scale, np.eye(len(scale)) / WIDEST]),
            np.append(right - rows @ nominal, np.zeros(len(scale))))


def whitened(block: Array, taken: NDArray[np.bool_], covariance: Array) -> Array:
    """Whitened rows (·, c), whose errors are independent with unit variance.

    Args:
        block: (m, n, c) rows of n actuators in m samples, whose errors have the covariance (n, n) in each sample.
        taken: (m, n) which of them count.
        covariance: (n, n), not singular.
    """
    return np.asarray((whitening(taken, covariance) @ np.where(taken[:, :, None], block, 0.0))[taken])


def whitening(taken: NDArray[np.bool_], covariance: Array) -> Array:
    """Matrices (m, n, n) that whiten the rows of each sample, as of `whitened`; rows that do not count become zero."""
    made = np.zeros((*taken.shape, taken.shape[1]))
    for pattern in np.unique(taken, axis=0):
        here = np.flatnonzero(pattern)
        if here.size:
            samples = np.flatnonzero(np.all(taken == pattern, axis=1))
            made[np.ix_(samples, here, here)] = np.linalg.inv(np.linalg.cholesky(covariance[np.ix_(here, here)]))
    return made
