"""Tests of the data against the priors of the machine file, and of both against each statement that a user adds."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtrc, ndtr

from hydroopt.spatial.inertia import Array

WIDE = 1e3
"""Standard deviation, in scales, of parameters without a prior."""
CONFLICT = 1e-3
"""p-value of agreement below which a statement, a prior or a group of stated numbers is contradicted, and the answer
is suspect."""
INFORMED = 1.0
"""Ratio of the prior's variance to that of the data above which a direction is tested."""


class Statement(NamedTuple):
    """A linear sum of parameters that a user states: ``row·ψ = value ± sigma``, or at least `value`.

    Attributes:
        name: of the constraint, of the prior, or of the parameter that is fixed.
        row: (p,) factors in SI, the largest of size one.
        value: of the sum [SI].
        sigma: one standard deviation; zero for a constraint.
        at_least: whether the sum may be larger.
    """

    name: str
    row: Array
    value: float
    sigma: float = 0.0
    at_least: bool = False


class Refuted(NamedTuple):
    """A statement that machine file and data contradict: they give ``value ± std``, `z` standard deviations away."""

    statement: Statement
    value: float
    std: float
    z: float
    p_value: float


class Conflict(NamedTuple):
    """A test of a group of parameters: are their nominal values all wrong by one factor?

    Attributes:
        group: its name.
        factor, std: the factor that the data find, and its standard deviation.
        p_value: of the hypothesis that the factor is 1.
    """

    group: str
    factor: float
    std: float
    p_value: float


class PriorTest(NamedTuple):
    """Tests of data against priors.

    Attributes:
        p_value: of all directions that the data know better than the priors.
        directions: their number.
        groups: the tests of groups, the clearest conflict first.
    """

    p_value: float
    directions: int
    groups: tuple[Conflict, ...]

    @property
    def worst(self) -> Conflict | None:
        """The clearest conflict, its p-value corrected for the number of groups (Bonferroni); None without groups."""
        if not self.groups:
            return None
        return self.groups[0]._replace(p_value=min(1.0, len(self.groups) * self.groups[0].p_value))


def prior_test(R: Array, r: Array, prior: tuple[Array, Array], scale: Array, nominal: Array,
               groups: Mapping[str, NDArray[np.intp]]) -> PriorTest:
    """Test whether ``R·ψ − r`` is as priors about ψ make probable.

    Under both, ``y = r − R·ψ_prior`` is normal with covariance ``I + R·P·Rᵀ``: along the eigenvectors of R·P·Rᵀ
    with eigenvalues λ, z = u/√(1 + λ) are standard normal. A body that is wrong as a whole moves y along R·ψ_body,
    whose score test sees what is spread over many directions.

    >>> found = prior_test(10 * np.eye(1), np.array([90.0]), (np.eye(1), np.zeros(1)), np.ones(1), np.ones(1), {})
    >>> round(found.p_value, 6)  # the data say 9 ± 0.1, the prior 0 ± 1
    0.0

    Args:
        R, r: (m, p) and (m,) rows of unit variance.
        prior: rows and right-hand side of the priors.
        scale, nominal: (p,) of the parameters.
        groups: positions of the parameters of each group.
    """
    rows = np.vstack([prior[0] * scale, np.eye(len(scale)) / WIDE])
    right = np.concatenate([prior[1] - prior[0] @ nominal, np.zeros(len(scale))])
    left, singular, axes = np.linalg.svd(rows, full_matrices=False)
    root = scale[:, None] * axes.T / singular
    y = r - R @ (nominal + root @ (left.T @ right))
    directions, sizes, _ = np.linalg.svd(R @ root, full_matrices=False)
    u, spread = directions.T @ y, 1 + sizes**2
    tested = sizes**2 > INFORMED
    square = float(np.sum(u[tested] ** 2 / spread[tested]))
    found = []
    for name, at in groups.items():
        column = R[:, at] @ nominal[at]
        along = directions.T @ column
        beside = column - directions @ along
        information = float(np.sum(along**2 / spread) + beside @ beside)
        if information > INFORMED:
            score = float(np.sum(along * u / spread) + beside @ y)
            found.append(Conflict(name, 1 + score / information, information**-0.5,
                                  float(2 * ndtr(-abs(score) / np.sqrt(information)))))
    return PriorTest(float(chdtrc(np.sum(tested), square)) if np.any(tested) else 1.0,
                     int(np.sum(tested)), tuple(sorted(found, key=lambda one: one.p_value)))


def refuted(statements: Sequence[Statement], value: Array, std: Array) -> tuple[Refuted, ...]:
    """The statements with a p-value below `CONFLICT`, the clearest first.

    Args:
        statements: k of them.
        value, std: (k,) of their sums by the machine file and the data, without any of the statements.

    >>> scales = Statement("scales", np.array([1.0]), 16.0, sigma=0.5)
    >>> [found] = refuted([scales], np.array([10.0]), np.array([1.2]))
    >>> round(found.z, 1)
    4.6
    """
    found = []
    for statement, here, spread in zip(statements, value.tolist(), std.tolist(), strict=True):
        z = (statement.value - here) / np.hypot(spread, statement.sigma)
        p_value = float(ndtr(-z) if statement.at_least else 2 * ndtr(-abs(z)))
        if p_value < CONFLICT:
            found.append(Refuted(statement, here, spread, float(abs(z)), p_value))
    return tuple(sorted(found, key=lambda one: one.p_value))
