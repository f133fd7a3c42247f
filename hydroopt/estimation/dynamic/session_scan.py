"""Several sessions in time order in one least squares: which parameter changed, at which session, or drifted.

In session s: f = K·(ψ + Σ_j e_j·δ_js), with δ_j1 = 0. All sessions and the machine file's priors share ψ; what it
explains is projected out. What is left depends on the changes δ alone and has as many coordinates of unit variance as
combinations of changes are identifiable. A step at a session, a drift, and values of each session's own are subspaces
of it, whose squared projections are tested. Sessions enter by their compressed information; no log is fitted again.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import NamedTuple, TypeVar

import numpy as np
from scipy import special, stats

from hydroopt.errors import IdentifiabilityError
from hydroopt.estimation.dynamic.problem import IdentificationProblem
from hydroopt.estimation.dynamic.stored_information import StoredInformation
from hydroopt.estimation.inference.band_variances import MANY, combined, f_test
from hydroopt.estimation.inference.identifiability import RANK_TOLERANCE
from hydroopt.estimation.inference.least_squares import orthonormal, without
from hydroopt.model.model import Model
from hydroopt.spatial.inertia import Array

C = TypeVar("C")
SEPARABLE = 1e-6
"""Part of a change's effect that no other change may explain, at least, for it to be identifiable by itself."""
DRAWS = 10_000
"""Draws of measurements in which nothing changed, for the distribution of the smallest of many p-values."""
FEW = 10
"""Draws below which Bonferroni's bound replaces their count."""
FEWER = 2_000
"""Draws for the smallest detectable change."""
POWER = 0.95
"""Probability of detecting the smallest detectable change."""


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
    """A subspace in which something may have changed: orthonormal `basis` (k, d), p-value and degrees of freedom."""

    basis: Array
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
class SessionScan:
    """Changes of parameters over N sessions, less what unchanged parameters explain, in k coordinates of variance 1.

    Attributes:
        names: (c,) of the parameters that may have changed.
        effects: (k, c, N−1) of a unit of each parameter's change in each later session.
        sizes: (c, N−1) lengths of these effects before unchanged parameters explained a part of them.
        sums: (k,) the measured coordinates, zero on average where nothing changed.
        rows, freedom: (m, k) the coordinates by rows of the sessions, and degrees of freedom (m,) of these.
        solution: (c, N−1, k) least squares δ from `sums`; NaN where not identifiable.
        partners: (c,) positions of the parameters whose changes cannot be separated from each.
        phi: factor on squared differences: how much more parts of one session differ than residuals explain.
        seed: of the draws.
    """

    names: tuple[str, ...]
    effects: Array
    sizes: Array
    sums: Array
    rows: Array
    freedom: Array
    solution: Array
    partners: tuple[tuple[int, ...], ...]
    phi: float = 1.0
    seed: int = field(default=0, repr=False)

    @property
    def count(self) -> int:
        """Number of sessions N."""
        return int(self.effects.shape[2]) + 1

    @property
    def tests(self) -> int:
        """Number of tests."""
        return len(self._family)

    @property
    def rank(self) -> int:
        """Number k of identifiable combinations of changes."""
        return len(self.sums)

    @cached_property
    def shapes(self) -> tuple[Shape, ...]:
        """A step at each later session, and a drift."""
        return (*map(Shape, range(2, self.count + 1)), Shape(None))

    def along(self, parameter: int, shape: Shape) -> Array:
        """Effect (k,) of a unit of change of one parameter."""
        return np.asarray(self.effects[:, parameter] @ shape.course(self.count)[1:])

    def tested(self, basis: Array) -> SubspaceTest:
        """The test that nothing changed within a subspace."""
        if not basis.shape[1]:
            return SubspaceTest(basis, 1.0, np.inf)
        result = f_test(basis.T @ self.sums / np.sqrt(self.phi), (self.rows @ basis) ** 2, self.freedom)
        return SubspaceTest(basis, result.p_value, result.freedom)

    @cached_property
    def whole(self) -> SubspaceTest:
        """Of any change at all: each session has values of its own."""
        return self.tested(np.eye(self.rank))

    @cached_property
    def together(self) -> dict[Shape, SubspaceTest]:
        """Of a change of all parameters at once, by shape."""
        found = {shape: orthonormal(np.column_stack([self.along(j, shape) for j in range(len(self.names))]))
                 for shape in self.shapes if any(np.any(self.along(j, shape)) for j in range(len(self.names)))}
        return {shape: self.tested(basis) for shape, basis in found.items()}

    @cached_property
    def separate(self) -> list[dict[Shape, SubspaceTest]]:
        """Of each parameter's change by shape, whatever the others do; none where the others could explain it."""
        return [dict(self._separate(j)) for j in range(len(self.names))]

    def _separate(self, parameter: int) -> Iterator[tuple[Shape, SubspaceTest]]:
        others = self._others(parameter)
        for shape in self.shapes:
            own = without(others, self.along(parameter, shape))
            length = float(np.linalg.norm(own))
            if length > SEPARABLE * np.linalg.norm(self.sizes[parameter] * shape.course(self.count)[1:]) > 0:
                yield shape, self.tested(own[:, None] / length)

    @cached_property
    def own(self) -> list[SubspaceTest | None]:
        """Of values of each session's own of one parameter, whatever the others do; None where it is not separable."""
        found: list[SubspaceTest | None] = []
        for j in range(len(self.names)):
            block = without(self._others(j), self.effects[:, j])
            kept = np.linalg.norm(block, axis=0) > SEPARABLE * self.sizes[j]
            found.append(self.tested(orthonormal(block[:, kept])) if np.any(kept) and self.separate[j] else None)
        return found

    def _others(self, parameter: int) -> Array:
        return self.all_of([j for j in range(len(self.names)) if j != parameter])

    def alone(self, parameter: int, shape: Shape, given: Array) -> SubspaceTest | None:
        """Of a change of one parameter, if only it and those that span `given` (k, ·) changed; None where it has no
        effect of its own."""
        effect = self.along(parameter, shape)
        own = without(given, effect)
        length = float(np.linalg.norm(own))
        visible = length > SEPARABLE * np.linalg.norm(self.sizes[parameter] * shape.course(self.count)[1:])
        return self.tested(own[:, None] / length) if visible else None

    @cached_property
    def _of_each(self) -> list[list[SubspaceTest]]:
        """All tests of each parameter by itself."""
        return [[*tests.values(), *([own] if own is not None else [])]
                for tests, own in zip(self.separate, self.own, strict=True)]

    @cached_property
    def _family(self) -> list[SubspaceTest]:
        """All tests: of all parameters together, then of each."""
        return [self.whole, *self.together.values(), *(test for tests in self._of_each for test in tests)]

    def _least(self, tests: Sequence[SubspaceTest]) -> Array:
        """The smallest p-value (draws,) of some tests where nothing changed."""
        return np.asarray(np.min([self._null[id(test)] for test in tests], axis=0))

    @cached_property
    def _draws(self) -> Array:
        return np.random.default_rng(self.seed).standard_normal((DRAWS, self.rank))

    @cached_property
    def _null(self) -> dict[int, Array]:
        """p-values (draws,) of each test in draws of measurements in which nothing changed."""
        return {id(test): special.erfc(np.abs(self._draws @ test.basis[:, 0]) / np.sqrt(2)) if test.rank == 1 else
                special.chdtrc(test.rank, np.sum((self._draws @ test.basis) ** 2, axis=1)) for test in self._family}

    @cached_property
    def p_value(self) -> float:
        """Of no change at any session, by all tests together: the probability that the smallest of their p-values is as
        small as it is."""
        return _chance(self._least(self._family), min(test.p_value for test in self._family), len(self._family))

    @cached_property
    def p_values(self) -> Array:
        """(c,) of no change of each parameter, corrected for all parameters and shapes by Holm's steps; NaN where it is
        not separable."""
        observed = np.array([min((test.p_value for test in tests), default=np.nan) for tests in self._of_each])
        corrected, so_far = np.full(len(observed), np.nan), 0.0
        left = [int(j) for j in np.argsort(observed) if np.isfinite(observed[j])]
        while left:
            tests = [test for j in left for test in self._of_each[j]]
            so_far = max(so_far, _chance(self._least(tests), observed[left[0]], len(tests)))
            corrected[left.pop(0)] = so_far
        return corrected

    def explanations(self, candidates: Mapping[C, SubspaceTest], within: SubspaceTest, level: float) -> dict[C, float]:
        """Candidates that leave nothing significant of a subspace, with their probabilities among all candidates, the
        likeliest first; none where the likeliest of all leaves something.

        All are equally probable before, and have as many sizes to estimate. The likelihood of what they leave is
        Student's, since its variance is estimated.
        """
        freedom, rank = min(within.freedom + within.rank - 1, MANY), within.rank
        whole = float(np.sum((within.basis.T @ self.sums) ** 2))
        left = {each: max(whole - float(np.sum((test.basis.T @ self.sums) ** 2)), 0.0) / self.phi
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

    def all_of(self, parameters: Sequence[int]) -> Array:
        """Basis (k, ·) of all changes of some parameters."""
        columns = self.effects[:, list(parameters)].reshape(self.rank, -1)
        return orthonormal(columns) if np.any(columns) else np.zeros((self.rank, 0))

    def left_over(self, part: SubspaceTest | Array, whole: Array | None = None) -> SubspaceTest:
        """What a subspace leaves of another that contains it, or of all changes."""
        basis = part.basis if isinstance(part, SubspaceTest) else part
        rest = without(basis, np.eye(self.rank) if whole is None else whole)
        left, size, _ = np.linalg.svd(rest, full_matrices=False)
        return self.tested(left[:, size > 0.5])  # the rest of an orthonormal basis: each is 0 or 1

    def size(self, parameter: int, shape: Shape, test: SubspaceTest) -> tuple[float, float, float]:
        """Change of a parameter by a shape, from first to last session; its standard deviation and degrees of freedom.
        """
        unit = test.basis[:, 0]
        length = float(unit @ self.along(parameter, shape))
        return float(unit @ self.sums) / length, float(np.sqrt(self.phi)) / abs(length), test.freedom

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
        return (np.append(0.0, solution @ self.sums), np.append(0.0, np.sqrt(self.phi) * std), np.append(1.0, freedom))

    def detectable(self, level: float) -> tuple[Array, Array]:
        """The step of each parameter at each later session (c, N−1) that is detected with a probability of 95 %: one
        that is put down to this parameter, and one that raises an alarm at all; infinite where none is.
        """
        limit, tests = float(np.quantile(self._least(self._family), level)), self._family
        owners = np.repeat(np.arange(-1, len(self.names)), [len(tests) - sum(map(len, self._of_each)),
                                                            *map(len, self._of_each)])
        starts = np.cumsum([0, *(test.rank for test in tests)])[:-1]
        bases, draws = np.hstack([test.basis for test in tests]), self._draws[:: DRAWS // FEWER]
        drawn = draws @ bases
        margin = np.array([test.critical(limit) for test in tests]) - np.add.reduceat(drawn**2, starts, axis=1)
        named, alarm = np.full(self.sizes.shape, np.inf), np.full(self.sizes.shape, np.inf)
        for j, k in np.ndindex(*self.sizes.shape):
            own = bases.T @ self.along(j, self.shapes[k])
            length = np.add.reduceat(own**2, starts)
            seen = length > SEPARABLE**2 * np.sum((self.sizes[j] * self.shapes[k].course(self.count)[1:]) ** 2)
            middle = -np.add.reduceat(drawn * own, starts, axis=1)[:, seen] / length[seen]
            inside = middle**2 + margin[:, seen] / length[seen]
            size = np.maximum(middle + np.sqrt(np.maximum(inside, 0.0)), 0.0)
            for found, of in ((named, owners[seen] == j), (alarm, np.full(size.shape[1], True))):
                if np.any(of):
                    found[j, k] = np.sqrt(self.phi) * np.quantile(np.min(size[:, of], axis=1), POWER)
        return named, alarm


def _chance(null: Array, observed: float, count: int) -> float:
    """Probability that the smallest of so many p-values is at most the observed one."""
    found = float(np.mean(null <= observed))
    return found if found * len(null) >= FEW else min(count * observed, FEW / len(null))


def session_scan(model: Model, names: Sequence[str], sessions: Sequence[StoredInformation], *, phi: float = 1.0,
                 seed: int = 0) -> SessionScan:
    """What several sessions say about changes of some parameters.

    Args:
        model: of all sessions.
        names: parameters that may have changed.
        sessions: in time order.
        phi: factor on squared differences.
        seed: of the draws by which p-values are corrected.

    Raises:
        IdentifiabilityError: no change of any of these parameters is identifiable.
    """
    p, problem, places = len(model.parameters), IdentificationProblem(model, ()), model.parameters.select(names)
    prior, right = problem.prior_rows
    K = [session.triangles[:, :, :p].reshape(-1, p) for session in sessions]
    rest = np.concatenate([*(session.triangles[:, :, p].ravel() for session in sessions), right])
    rows = np.vstack([*K, prior])
    U = orthonormal(rows * model.parameters.scale)
    rest = without(U, rest - rows @ model.parameters.nominal)
    starts = np.cumsum([0, *map(len, K)])
    columns = np.zeros((len(rows), len(places), len(K) - 1))
    for k, block in enumerate(K[1:], 1):
        columns[starts[k] : starts[k + 1], :, k - 1] = block[:, places]
    wide = columns.reshape(len(rows), -1)
    size = np.linalg.norm(wide, axis=0)
    effect = size * np.repeat(model.parameters.scale[places], len(K) - 1)
    touched = np.flatnonzero(effect > 1e-12 * np.max(effect, initial=0.0))
    left, singular, axes = np.linalg.svd(without(U, wide[:, touched] / size[touched]), full_matrices=False)
    known = singular > RANK_TOLERANCE
    if not np.any(known):
        raise IdentifiabilityError("these logs do not identify a change of these parameters",
                                   where=f"comparison of sessions of {model.machine.name}",
                                   remedy="drive longer motions that excite them, in every session")
    left, shape = left[:, known], (len(places), len(K) - 1)
    effects, solution = np.zeros((left.shape[1], len(size))), np.full((len(size), left.shape[1]), np.nan)
    effects[:, touched] = singular[known, None] * axes[known] * size[touched]
    effects[:, np.linalg.norm(effects, axis=0) <= SEPARABLE * size] = 0.0
    hidden = axes[~known].T @ axes[~known]
    alone = np.diag(hidden) < SEPARABLE
    solution[touched[alone]] = (axes[known].T / singular[known] / size[touched][:, None])[alone]
    mixed = np.zeros((len(size), len(size)))
    mixed[np.ix_(touched, touched)] = np.abs(hidden)
    blocks = mixed.reshape(*shape, *shape).max(axis=(1, 3)) > 1e-3
    freedom = np.concatenate([*(session.freedom.ravel() for session in sessions), np.full(len(prior), np.inf)])
    return SessionScan(tuple(names), effects.reshape(-1, *shape), size.reshape(shape), left.T @ rest, left, freedom,
                       solution.reshape(*shape, -1),
                       tuple(tuple(int(i) for i in np.flatnonzero(row) if i != j) for j, row in enumerate(blocks)),
                       phi, seed)
