"""Identifiability of parameters from a regressor: rank, base parameters, conditioning, collinearity."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import svd

from hydroopt.model.model import Model
from hydroopt.model.recent import KEPT
from hydroopt.spatial.inertia import Array

FULL, COMBINATION, NONE = "full", "combination", "none"
"""A parameter is identifiable alone, only together with others, or not at all."""

RANK_TOLERANCE = 1e-7
"""Singular value of a measured regressor with columns of unit length, relative to the largest, below which its
direction is not identifiable."""

STRUCTURAL_TOLERANCE = 1e-8
"""The same of a regressor without measurement errors: at random states, or of instruments."""

PREDICTED_TOLERANCE = 1e-9
"""The same of rows that are predicted or linearised about exact states, and whose columns have priors as units."""

INFORMATION_TOLERANCE = 1e-10
"""Eigenvalue of a normalised information matrix, a squared singular value, relative to the largest, below which its
direction is not identifiable."""

ROUNDING_TOLERANCE = 1e-12
"""Singular value or column length, relative to the largest, that is a rounding error."""

NULL_SHARE = 1e-6
"""Part of a parameter's unit vector in the null space below which it is identifiable alone."""

DETERMINED = 0.5
"""A number counts as identified whose standard deviation is less than this part of that of the machine file."""

PRESSURES = (1e6, 4e7)
"""Range of the sum of a cylinder's two pressures [Pa] under ideal motion."""


@dataclass(frozen=True, eq=False)
class Identifiability:
    """Which of p parameters, and which r combinations of them, a regressor determines.

    The basis is fixed by the order of the parameters: going through them once, a parameter joins it unless its column
    is a combination of those already there. Base parameter i is ``basis[i]`` plus dependent ones (Gautier 1991),
    ``β = grouping @ ψ`` with grouping (r, p). `category` (p,) holds `FULL`, `COMBINATION` or `NONE`.
    """

    names: tuple[str, ...]
    rank: int
    condition_number: float
    singular_values: Array
    category: tuple[str, ...]
    basis: tuple[int, ...]
    grouping: Array

    def count(self, category: str) -> int:
        """Number of parameters of a category."""
        return self.category.count(category)

    def expression(self, i: int) -> str:
        """Base parameter i in words, such as ``boom.mc_x + 5.18·stick.m``."""
        terms = [self.names[self.basis[i]]]
        for j, weight in enumerate(self.grouping[i]):
            if j != self.basis[i] and abs(weight) > 1e-9:
                size = "" if abs(abs(weight) - 1) < 1e-9 else f"{abs(weight):.4g}·"
                terms.append(f"{'+' if weight > 0 else '−'} {size}{self.names[j]}")
        return " ".join(terms)


def significant(values: Array, tolerance: float) -> NDArray[np.bool_]:
    """Which singular values or eigenvalues (k,) count: those above `tolerance` times the largest.

    Every rank decision calls this function with one of the tolerances above.

    >>> significant(np.array([5.0, 1e-3, 1e-9]), RANK_TOLERANCE)
    array([ True,  True, False])
    """
    return np.asarray(values > tolerance * np.max(values, initial=0.0))


def analyse(regressor: Array, names: Sequence[str], *, tolerance: float = STRUCTURAL_TOLERANCE) -> Identifiability:
    """Rank and base parameters of a regressor.

    Args:
        regressor: (rows, p), or its triangular factor; columns are scaled to unit length before any decision.
        names: of the parameters (p,).
        tolerance: a singular value of the scaled regressor below this part of the largest counts as zero, and so does a
            column below this part of its row space.
    """
    R: Array = np.asarray(np.linalg.qr(regressor, mode="r") if regressor.shape[0] > regressor.shape[1] else regressor)
    lengths = np.linalg.norm(R, axis=0)
    present = np.flatnonzero(significant(lengths, ROUNDING_TOLERANCE))
    scaled = R[:, present] / lengths[present]
    # divide and conquer, NumPy's way, now and then does not converge where singular values are but rounding errors
    _, singular, axes = svd(scaled, lapack_driver="gesvd") if scaled.size else (None, np.zeros(0), np.eye(len(present)))
    cut = tolerance * (singular[0] if singular.size else 1.0)
    rank = int(np.sum(significant(singular, tolerance)))
    chosen = _first_independent(scaled, rank, cut)
    dependent = [k for k in range(len(present)) if k not in chosen]
    grouping = np.zeros((rank, len(names)))
    basis = present[chosen]
    grouping[np.arange(rank), basis] = 1.0
    if dependent:
        weights = np.linalg.lstsq(scaled[:, chosen], scaled[:, dependent], rcond=None)[0]
        weights[np.abs(weights) < max(tolerance, 1e-9)] = 0.0
        grouping[:, present[dependent]] = weights * lengths[present[dependent]] / lengths[basis][:, None]
    alone = np.abs(axes[rank:]).max(axis=0, initial=0.0) < NULL_SHARE
    category = np.full(len(names), NONE, dtype=object)
    category[present] = np.where(alone, FULL, COMBINATION)
    condition = float(singular[0] / singular[rank - 1]) if rank else float("inf")
    return Identifiability(tuple(names), rank, condition, singular, tuple(category), tuple(int(b) for b in basis),
                           grouping)


def _first_independent(scaled: Array, rank: int, cut: float) -> list[int]:
    """Indices of the columns that are independent of those before them, `rank` many."""
    chosen: list[int] = []
    found = np.zeros(scaled.shape, order="F")
    distance = np.zeros(scaled.shape[1])
    for k in range(scaled.shape[1]):
        rest = scaled[:, k]
        for _ in range(2):  # projecting twice keeps the directions orthogonal to rounding
            rest = rest - found[:, : len(chosen)] @ (found[:, : len(chosen)].T @ rest)
        distance[k] = np.linalg.norm(rest)
        if distance[k] > cut and len(chosen) < len(scaled):
            found[:, len(chosen)] = rest / distance[k]
            chosen.append(k)
    if len(chosen) > rank:  # near the tolerance the two counts may differ: those nearest to others before them go
        chosen = sorted(sorted(chosen, key=lambda k: -distance[k])[:rank])
    elif len(chosen) < rank:  # the most distant of those left out complete the basis
        left = sorted(set(range(scaled.shape[1])) - set(chosen), key=lambda k: -distance[k])
        chosen = sorted(chosen + left[: rank - len(chosen)])
    return chosen


@lru_cache(maxsize=KEPT)
def structural(model: Model, *, samples: int = 400, seed: int = 0,
               tolerance: float = STRUCTURAL_TOLERANCE) -> Identifiability:
    """Identifiability of a model under ideal motion: random joint states within limits, no noise (Section 4.4.2)."""
    rng = np.random.default_rng(seed)
    states: tuple[Array, ...] = random_states(model, samples, rng)
    if model.needs_pressure:
        states = (*states, rng.uniform(*PRESSURES, states[0].shape))
    K = model.over(model.regressor, *states)[0]
    return analyse(K.reshape(K.shape[0] * K.shape[1], K.shape[2]), model.parameters.names, tolerance=tolerance)


def random_states(model: Model, samples: int, rng: np.random.Generator) -> tuple[Array, Array, Array]:
    """Joint states within the machine's limits, (samples, n) each; unit speed and acceleration where none is stated."""
    joints = [model.machine.link(name).joint for name in model.machine.joints]
    lower, upper = (np.array([getattr(j, key) for j in joints], dtype=float) for key in ("lower", "upper"))
    speed, acceleration = (np.array([getattr(j, key) or 1.0 for j in joints])
                           for key in ("max_speed", "max_acceleration"))
    shape = (samples, len(joints))
    return (rng.uniform(lower, upper, shape), rng.uniform(-speed, speed, shape),
            rng.uniform(-acceleration, acceleration, shape))


@dataclass(frozen=True)
class Confounded:
    """A base parameter that these data hardly separate from others.

    `inflation` is its variance over what it would be if the other base parameters were known (variance inflation
    factor); `partners` are the base parameters that can stand in for it, each named by its first parameter.
    """

    name: str
    inflation: float
    partners: tuple[str, ...]


def confounded(R: Array, found: Identifiability, *, threshold: float = 100.0) -> tuple[Confounded, ...]:
    """Base parameters whose columns the other base columns nearly reproduce.

    Args:
        R: (·, p) weighted regressor or its triangular factor.
        found: its base parameters.
        threshold: variance inflation from which on a parameter counts as confounded; 100 makes its σ ten times larger.
    """
    basis = np.array(found.basis, dtype=int)
    scaled = R[:, basis] / np.linalg.norm(R[:, basis], axis=0)
    inverse = np.linalg.pinv(np.linalg.qr(scaled, mode="r"), rcond=1e-14)
    covariance = inverse @ inverse.T
    result = []
    for i in np.flatnonzero(np.diag(covariance) > threshold):
        correlation = covariance[i] / np.sqrt(covariance[i, i] * np.diag(covariance))
        near = [j for j in np.argsort(-np.abs(correlation)) if j != i and abs(correlation[j]) > 0.9]
        partners = near or [j for j in np.argsort(-np.abs(correlation))[:2] if j != i]
        result.append(Confounded(found.names[basis[i]], float(covariance[i, i]),
                                 tuple(found.names[basis[j]] for j in partners[:4])))
    return tuple(result)
