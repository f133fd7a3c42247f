"""Changes of parameters over sessions as coordinates of variance 1, and tests of subspaces of these."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple, TypeVar

import numpy as np
from scipy import stats

from hydroopt.estimation.inference.band_variances import MANY, combined, f_test
from hydroopt.estimation.inference.identifiability import RANK_TOLERANCE
from hydroopt.estimation.inference.least_squares import orthonormal, without
from hydroopt.spatial.inertia import Array

C = TypeVar("C")
SEPARABLE = 1e-6
"""Part of a change's effect that no other change may explain, at least, for it to be identifiable by itself."""


class Shape(NamedTuple):
    """How a parameter changes over the sessions: a step at a session, or a drift, linear in the session's number.

    >>> Shape(3).course(4), Shape(None).course(3)
    (array([0., 0., 1., 1.]), array([0. , 0.5, 1. ]))
    """

    session: int | None
    """The first session with the new value, counted from 1; None for a drift."""

    def course(self, count: int) -> Array:
        """Its values (count,) over the sessions, per unit of change from the first session to the last."""
        if self.session is None:
            return np.linspace(0.0, 1.0, count)
        return (np.arange(1, count + 1) >= self.session).astype(float)

    def __str__(self) -> str:
        return "a drift over all sessions" if self.session is None else f"a step at session {self.session}"


class SubspaceTest(NamedTuple):
    """A subspace in which something may have changed: orthonormal `basis` (k, d), p-value and degrees of freedom.

    `onto` (k, d) is what the basis is in coordinates in which sessions do not scatter.
    """

    basis: Array
    onto: Array
    p_value: float
    freedom: float

    @property
    def rank(self) -> int:
        """Its dimension d."""
        return int(self.basis.shape[1])

    def critical(self, limit: float) -> float:
        """The squared projection (Hotelling's) whose p-value is `limit`."""
        freedom = min(self.freedom, MANY)
        return float(stats.f.isf(limit, self.rank, freedom)) * self.rank * (freedom + self.rank - 1) / freedom


@dataclass(frozen=True, eq=False)
class ChangeSpace:
    """Changes of parameters over N sessions, less what unchanged parameters explain, in k coordinates of variance 1.

    Attributes:
        effects: (k, c, N−1) of a unit of each parameter's change in each later session.
        sizes: (c, N−1) lengths of these effects before unchanged parameters explained a part of them.
        sums: (k,) the measured coordinates, zero on average where nothing changed.
        rows, freedom: (m, k) the coordinates by independent rows of variance 1, and degrees of freedom (m,) of these.
        solution: (c, N−1, k) least squares δ from `sums`; NaN where not identifiable.
        whitening: (k, k) by which coordinates in which sessions do not scatter became these.
    """

    effects: Array
    sizes: Array
    sums: Array
    rows: Array
    freedom: Array
    solution: Array
    whitening: Array

    @property
    def count(self) -> int:
        """Number of sessions N."""
        return int(self.effects.shape[2]) + 1

    @property
    def parameters(self) -> int:
        """Number of parameters c that may have changed."""
        return int(self.effects.shape[1])

    @cached_property
    def shapes(self) -> tuple[Shape, ...]:
        """A step at each later session, and a drift."""
        return (*map(Shape, range(2, self.count + 1)), Shape(None))

    def scattered(self, directions: Array, variance: float, freedom: float) -> ChangeSpace:
        """The same changes where random effects (k, ·) of a variance add to the measurements."""
        values, axes = np.linalg.eigh(np.eye(len(self.sums)) + variance * directions @ directions.T)
        W, inverse = (axes * values**power @ axes.T for power in (-0.5, 0.5))
        return replace(
            self, effects=np.tensordot(W, self.effects, 1), sums=W @ self.sums,
            rows=np.vstack([self.rows @ W, np.sqrt(variance) * directions.T @ W]),
            freedom=np.append(self.freedom, np.full(directions.shape[1], freedom)),
            solution=self.solution @ inverse, whitening=self.whitening @ W)

    def along(self, parameter: int, shape: Shape) -> Array:
        """Effect (k,) of a unit of change of one parameter."""
        return np.asarray(self.effects[:, parameter] @ shape.course(self.count)[1:])

    def tested(self, basis: Array) -> SubspaceTest:
        """The test that nothing changed within a subspace."""
        onto = self.whitening @ basis
        if not basis.shape[1]:
            return SubspaceTest(basis, onto, 1.0, np.inf)
        result = f_test(basis.T @ self.sums, (self.rows @ basis) ** 2, self.freedom)
        return SubspaceTest(basis, onto, result.p_value, result.freedom)

    @cached_property
    def whole(self) -> SubspaceTest:
        """Of any change at all: each session has values of its own."""
        return self.tested(np.eye(len(self.sums)))

    def together(self, shape: Shape) -> SubspaceTest:
        """Of a change of all parameters at once."""
        return self.tested(orthonormal(np.column_stack([self.along(j, shape) for j in range(self.parameters)])))

    def separate(self, parameter: int) -> dict[Shape, SubspaceTest]:
        """Of one parameter's change by shape, whatever the others do; none where the others could explain it."""
        return dict(self._separate(parameter))

    def _separate(self, parameter: int) -> Iterator[tuple[Shape, SubspaceTest]]:
        others = self.others(parameter)
        for shape in self.shapes:
            test = self.alone(parameter, shape, others)
            if test is not None:
                yield shape, test

    def own(self, parameter: int) -> SubspaceTest:
        """Of values of each session's own of one parameter, whatever the others do; of rank 0 where there are none."""
        block = without(self.others(parameter), self.effects[:, parameter])
        kept = np.linalg.norm(block, axis=0) > SEPARABLE * self.sizes[parameter]
        return self.tested(orthonormal(block[:, kept]) if np.any(kept) else block[:, :0])

    def others(self, parameter: int) -> Array:
        """Basis (k, ·) of all changes of all other parameters."""
        return self.all_of([j for j in range(self.parameters) if j != parameter])

    def alone(self, parameter: int, shape: Shape, given: Array) -> SubspaceTest | None:
        """Of a change of one parameter, if only it and those that span `given` (k, ·) changed; None where it has no
        effect of its own."""
        own = without(given, self.along(parameter, shape))
        length = float(np.linalg.norm(own))
        visible = length > SEPARABLE * np.linalg.norm(self.sizes[parameter] * shape.course(self.count)[1:])
        return self.tested(own[:, None] / length) if visible else None

    def all_of(self, parameters: Sequence[int]) -> Array:
        """Basis (k, ·) of all changes of some parameters."""
        columns = self.effects[:, list(parameters)].reshape(len(self.sums), -1)
        return orthonormal(columns) if np.any(columns) else np.zeros((len(self.sums), 0))

    def left_over(self, part: SubspaceTest | Array, whole: Array | None = None) -> SubspaceTest:
        """What a subspace leaves of another that contains it, or of all changes."""
        basis = part.basis if isinstance(part, SubspaceTest) else part
        rest = without(basis, np.eye(len(self.sums)) if whole is None else whole)
        left, size, _ = np.linalg.svd(rest, full_matrices=False)
        return self.tested(left[:, size > 0.5])  # the rest of an orthonormal basis: each is 0 or 1

    def explanations(self, candidates: Mapping[C, SubspaceTest], within: SubspaceTest, level: float) -> dict[C, float]:
        """Candidates that leave nothing significant of a subspace, with their probabilities among all candidates, the
        likeliest first; none where the likeliest of all leaves something.

        All are equally probable before, and have as many sizes to estimate. The likelihood of what they leave is
        Student's, since its variance is estimated.
        """
        freedom, rank = min(within.freedom + within.rank - 1, MANY), within.rank
        whole = float(np.sum((within.basis.T @ self.sums) ** 2))
        left = {each: max(whole - float(np.sum((test.basis.T @ self.sums) ** 2)), 0.0)
                for each, test in candidates.items()}
        logs = {each: -(freedom + rank) / 2 * float(np.log1p(one / freedom)) for each, one in left.items()}
        weights = {each: float(np.exp(log - max(logs.values()))) for each, log in logs.items()}
        total, kept = sum(weights.values()), dict[C, float]()
        for each in sorted(weights, key=lambda one: -weights[one]):
            if self.left_over(candidates[each], within.basis).p_value >= level:
                kept[each] = weights[each] / total
            elif not kept:
                break
        return kept

    def size(self, parameter: int, shape: Shape, test: SubspaceTest) -> tuple[float, float, float]:
        """Change of a parameter by a shape, from first to last session; its standard deviation and degrees of freedom.
        """
        unit = test.basis[:, 0]
        length = float(unit @ self.along(parameter, shape))
        return float(unit @ self.sums) / length, 1 / abs(length), test.freedom

    def values(self, parameter: int, given: Array | None = None) -> tuple[Array, Array, Array]:
        """Changes since the first session (N,), their standard deviations, and degrees of freedom of these.

        Args:
            parameter: its position.
            given: (k, ·) spanned by the changes of the only other parameters that changed; whatever all others do, if
                it is not given.
        """
        solution = self.solution[parameter]
        if given is not None:
            block, size = without(given, self.effects[:, parameter]), np.maximum(self.sizes[parameter], 1e-300)
            solution = np.linalg.pinv(block / size, rcond=RANK_TOLERANCE) / size[:, None]
            solution[~np.any(block, axis=0)] = np.nan
        std = np.linalg.norm(solution, axis=1)
        shares = (self.rows @ np.nan_to_num(solution).T / np.where(std > 0, std, 1.0)) ** 2
        freedom = np.where(np.isfinite(std), combined(shares, self.freedom), np.nan)
        return np.append(0.0, solution @ self.sums), np.append(0.0, std), np.append(1.0, freedom)
