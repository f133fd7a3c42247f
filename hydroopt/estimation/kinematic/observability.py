"""Observability of parameters in poses: linearised information, covariance, and what is not identifiable.

Around a solution every pose's rows are r + A·δθ + B·δq = 0. Errors of the sensed angles give the rows the covariance
S = B·Σ·Bᵀ + R; directions in which an unsensed angle moves them are projected out. What is left is white, and its
Jacobian's square is the Fisher information of the joint problem, so that its inverse is the Cramér-Rao bound.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from hydroopt.errors import ProblemError
from hydroopt.estimation.inference.identifiability import INFORMATION_TOLERANCE, significant
from hydroopt.estimation.kinematic.pose_equations import PoseEquations
from hydroopt.model.closed_chain import KinematicModel
from hydroopt.spatial.inertia import Array

ROUNDING = 1e-7
"""Size of a scaled column, relative to the largest, that is rounding only."""
OPEN = 1e100
"""Rows of a pose in which a linkage cannot close: no search accepts it."""
FARTHEST = 0.2
"""Largest change [rad, m] of an unsensed angle in one step."""
SHARE = 1e-5
"""Part of a parameter's unit vector in the null space from which on it counts as part of a combination."""


@dataclass(frozen=True, eq=False)
class Linearised:
    """Whitened rows of all poses: residual (N, m), Jacobian (N, m, P) by all parameters, rank (N,) of each pose's rows.

    `kept` (N, m) is the part of each row's variance, 1, that is left where unsensed angles take away some of it.
    `shared` and `shared_residual` are those of known distances, then of what is known before. `whitening` (N, u, u)
    makes these rows of the raw rows at the channels `used`; `by_angles` (N, u, n) are their changes by each angle.
    `unsensed` (N, k, 1 + P + n) are the parts of rows, Jacobian and changes by angles that the k joints which somewhere
    move unsensed explain: minus their change that is most probable.
    """

    residual: Array
    jacobian: Array
    rank: NDArray[np.int64]
    kept: Array
    shared: Array
    shared_residual: Array
    whitening: Array
    used: NDArray[np.intp]
    by_angles: Array
    unsensed: Array | None = None

    def whitened(self, rows: Array) -> Array:
        """(N, u, c) whitened changes of raw changes (N, m, c) of all rows."""
        return np.asarray(self.whitening @ rows[:, self.used])

    def followed(self, problem: PoseEquations, q: Array, change: Array, given: Array | None = None) -> Array:
        """Joint vectors (N, n) that are most probable, from those of the rows, after a change (P,) of the parameters.

        `given` (N, n) is that of joints that are neither sensed nor move.
        """
        layout, moved = problem.layout, np.zeros(q.shape) if given is None else given
        error = self.residual + self.jacobian @ change + np.einsum("nuj,nj->nu", self.by_angles, moved)
        variance = np.where(layout.sensed, problem.angle_sigma, 0.0) ** 2
        own: Array = layout.reading - variance * np.einsum("nuj,nu->nj", self.by_angles, error)
        if self.unsensed is None:
            return own
        step = np.zeros(q.shape)
        first, by_numbers, by_given = np.split(self.unsensed, [1, 1 + len(change)], axis=2)
        step[:, layout.moving.any(axis=0)] = -np.clip(
            first[:, :, 0] + by_numbers @ change + np.einsum("nkj,nj->nk", by_given, moved), -FARTHEST, FARTHEST)
        return np.where(layout.moving, q + step, own)

    @property
    def pose_square(self) -> Array:
        """Squared error (N,) of each pose in standard deviations; expected to be its rank."""
        return np.asarray(np.sum(self.residual**2, axis=1))


def linearise(problem: PoseEquations, theta: Array, q: Array) -> Linearised:
    """Whitened rows around parameters (P,) and joint vectors (N, n).

    Raises:
        ProblemError: neither sensors nor fixtures state any error, so that nothing can be weighed.
    """
    layout = problem.layout
    used = np.flatnonzero(layout.present.any(axis=0))
    rows, jacobian, by_q = problem.rows(theta, q, used)
    if np.any(open_ := ~np.isfinite(rows).all(axis=1)):
        rows[open_], jacobian[open_], by_q[open_] = OPEN, 0.0, 0.0
    present, row_sigma = layout.present[:, used], problem.row_sigma[:, used]
    read = np.where(layout.sensed, layout.reading - q, 0.0)
    rows = rows + np.einsum("nij,nj->ni", by_q, read)
    weighted = by_q * np.where(layout.sensed, problem.angle_sigma, 0.0)[:, None, :]
    spread = weighted @ weighted.transpose(0, 2, 1)
    diagonal = np.where(present, row_sigma**2, 1.0)
    spread[:, np.arange(len(used)), np.arange(len(used))] += diagonal
    try:
        factor = np.linalg.cholesky(spread)
    except np.linalg.LinAlgError:
        raise ProblemError("the errors of the loops are not stated", where=f"poses of {problem.poses.name}",
                           remedy="state the accuracy of three sensed joints or more, or the play of the fixture"
                           ) from None
    own = np.broadcast_to(np.eye(len(used)), spread.shape) * present[:, None, :]
    white = np.linalg.solve(factor, np.concatenate(
        [rows[:, :, None], jacobian, by_q, by_q * np.where(layout.moving, 1.0, 0.0)[:, None, :], own], axis=2))
    total, n = 1 + len(problem.parameters), by_q.shape[2]
    blind = white[:, :, total + n : total + 2 * n]
    moving = layout.moving.any(axis=0)
    rank, kept_part, unsensed = present.sum(axis=1), present.astype(float), None
    if np.any(moving):
        u, s, v = np.linalg.svd(blind[:, :, moving], full_matrices=False)
        # a reading that no unread joint moves has rounding here, beside what parameters do to it
        largest = np.maximum(s[:, :1], np.linalg.norm(white[:, :, 1:total], axis=(1, 2))[:, None])
        kept = s > 1e-9 * np.maximum(largest, 1e-300)
        u = u * (kept & (s > 0))[:, None, :]
        inverse = (v.transpose(0, 2, 1) / np.where(s > 0, s, 1.0)[:, None, :]) @ u.transpose(0, 2, 1)
        unsensed = inverse @ white[:, :, : total + n]
        white = white - u @ (u.transpose(0, 2, 1) @ white)
        rank = rank - (kept & (s > 0)).sum(axis=1)
        kept_part -= np.sum(u**2, axis=2)
    extra, extra_residual = shared_rows(problem, theta)
    return Linearised(white[:, :, 0], white[:, :, 1:total], rank, kept_part, extra, extra_residual,
                      white[:, :, total + 2 * n :], used, white[:, :, total : total + n], unsensed)


def shared_rows(problem: PoseEquations, theta: Array) -> tuple[Array, Array]:
    """Rows (K, P) and residuals (K,) of known distances, then of what is known before, at parameters (P,)."""
    rows, residuals = [], []
    for ends, length, sigma in zip(problem.distances.ends, problem.distances.length, problem.distances.sigma,
                                   strict=True):
        apart = theta[ends[0]] - theta[ends[1]]
        row = np.zeros(len(theta))
        row[ends[0]], row[ends[1]] = apart / np.linalg.norm(apart) / sigma, -apart / np.linalg.norm(apart) / sigma
        rows.append(row)
        residuals.append((np.linalg.norm(apart) - length) / sigma)
    for k in np.flatnonzero(problem.known):
        rows.append(np.eye(len(theta))[k] * problem.known[k])
        residuals.append(problem.known[k] * (theta[k] - problem.parameters.nominal[k]))
    return np.array(rows).reshape(-1, len(theta)), np.array(residuals)


@dataclass(frozen=True, eq=False)
class Observability:
    """Which of the free parameters the rows identify, and how well.

    Attributes:
        names: of the free parameters, f of them; `scale` (f,) makes them comparable.
        information: (f, f) Fisher information of the data, known distances included; `prior` (f, f) that of the priors.
    """

    names: tuple[str, ...]
    scale: Array
    information: Array
    prior: Array

    @property
    def priors_as_data(self) -> Observability:
        """The same where priors count as data: it identifies what these determine, too."""
        return Observability(self.names, self.scale, self.information + self.prior, 0 * self.prior)

    @cached_property
    def _normalised(self) -> tuple[Array, Array, Array]:
        size = np.sqrt(np.diag(self.information))
        size = np.where(size > 0, size, 1.0)
        values, vectors = np.linalg.eigh(self.information / np.outer(size, size))
        return size, values, vectors

    @cached_property
    def null_space(self) -> Array:
        """(f, k) orthonormal directions, in units of `scale`, along which the data do not change."""
        size, values, vectors = self._normalised
        away = vectors[:, ~significant(values, INFORMATION_TOLERANCE)] / (size * self.scale)[:, None]
        return np.linalg.qr(away)[0] if away.shape[1] else away

    @property
    def identifiable(self) -> Array:
        """(f, r) directions by the parameters, orthonormal in units of `scale`, that the data identify."""
        hidden = self.null_space.shape[1]
        return np.asarray(self.scale[:, None] * np.linalg.qr(self.null_space, mode="complete")[0][:, hidden:])

    @property
    def rank(self) -> int:
        """Number of independent combinations that the data identify."""
        return len(self.names) - int(self.null_space.shape[1])

    @cached_property
    def category(self) -> tuple[str, ...]:
        """``full``, ``combination`` or ``none`` of every parameter, from the data alone."""
        touched = np.linalg.norm(self.null_space, axis=1) > SHARE
        blank = np.diag(self.information) == 0
        return tuple("none" if b else "combination" if t else "full" for b, t in zip(blank, touched, strict=True))

    @cached_property
    def combinations(self) -> tuple[tuple[str, ...], ...]:
        """Groups of parameters that the data show only together."""
        groups: list[set[int]] = []
        for column in _sparse_basis(self.null_space).T:
            members = {int(k) for k in np.flatnonzero(np.abs(column) > SHARE)}
            if len(members) < 2:
                continue
            for group in [g for g in groups if g & members]:
                members |= group
                groups.remove(group)
            groups.append(members)
        return tuple(tuple(self.names[k] for k in sorted(group)) for group in groups)

    @cached_property
    def covariance(self) -> Array:
        """(f, f) of the estimate; infinite where neither data nor priors determine it."""
        total = self.information + self.prior
        size = np.sqrt(np.maximum(np.diag(total), 1e-300))
        values, vectors = np.linalg.eigh(total / np.outer(size, size))
        good = significant(values, INFORMATION_TOLERANCE)
        half = vectors[:, good] / np.sqrt(values[good]) / size[:, None]
        covariance: Array = half @ half.T
        lost = np.linalg.norm(vectors[:, ~good], axis=1) > SHARE
        covariance[lost, lost] = np.inf
        return covariance

    @property
    def std(self) -> Array:
        """(f,) standard deviations."""
        return np.asarray(np.sqrt(np.diag(self.covariance)))

    def strongest(self, k: int) -> tuple[str, float]:
        """The parameter with the strongest correlation to the one at k, and that correlation."""
        std = self.std
        if not np.isfinite(std[k]) or len(self.names) < 2:
            return "", float("nan")
        other = np.where(np.isfinite(std), self.covariance[k] / (std * std[k]), 0.0)
        other[k] = 0.0
        best = int(np.argmax(np.abs(other)))
        return self.names[best], float(other[best])

    @property
    def condition_number(self) -> float:
        """Largest over smallest singular value of the scaled, whitened Jacobian, null space left out."""
        singular = self._singular
        return float(singular[0] / singular[-1])

    @property
    def noise_amplification_index(self) -> float:
        """σ_min²/σ_max of the same Jacobian (Nahvi and Hollerbach 1996): the larger the better the poses."""
        singular = self._singular
        return float(singular[-1] ** 2 / singular[0])

    @cached_property
    def _singular(self) -> Array:
        values = np.linalg.eigvalsh(self.information * np.outer(self.scale, self.scale))[::-1]
        return np.asarray(np.sqrt(np.maximum(values[: len(values) - self.null_space.shape[1]], 1e-300)))


def _sparse_basis(space: Array) -> Array:
    """The same space by columns that each have as few entries as elimination gives."""
    basis = space.T.copy()
    for row in range(len(basis)):
        pivot = int(np.argmax(np.abs(basis[row])))
        basis[row] /= basis[row, pivot]
        for other in range(len(basis)):
            if other != row:
                basis[other] -= basis[other, pivot] * basis[row]
    return np.asarray(basis.T)


def observability(problem: PoseEquations, linearised: Linearised) -> Observability:
    """Observability of a problem's free parameters in its linearised poses."""
    free = np.flatnonzero(problem.free)
    jacobian = linearised.jacobian[:, :, free].reshape(-1, len(free))
    known = len(problem.distances.length)
    jacobian = np.vstack([jacobian, linearised.shared[:known][:, free]])
    size = np.linalg.norm(jacobian * problem.parameters.scale[free], axis=0)
    jacobian[:, size < ROUNDING * np.max(size, initial=0.0)] = 0.0  # what projecting left of columns that vanish
    prior = linearised.shared[known:][:, free]
    names = tuple(problem.parameters.names[k] for k in free)
    return Observability(names, problem.parameters.scale[free], jacobian.T @ jacobian, prior.T @ prior)


def spread(model: KinematicModel, identified: Observability, by_g: Array) -> Array:
    """Root of the trace of a point's covariance (K,) [m], for its Jacobians by the geometry (K, 3, p).

    NaN where a parameter that moves the point is not known.
    """
    own = [k for k, name in enumerate(identified.names) if name in model.parameters.positions]
    by_own = by_g[:, :, model.parameters.select(identified.names[k] for k in own)]
    covariance = identified.covariance[np.ix_(own, own)]
    lost = ~np.isfinite(np.diag(covariance))
    blurred = np.any(np.abs(by_own[:, :, lost]) > 0, axis=(1, 2))
    covariance = np.where(lost[:, None] | lost, 0.0, covariance)
    variance = np.einsum("nik,kl,nil->n", by_own, covariance, by_own, optimize=True)
    return np.where(blurred, np.nan, np.sqrt(np.maximum(variance, 0.0)))
