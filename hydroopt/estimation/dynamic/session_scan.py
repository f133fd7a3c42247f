"""Several sessions in time order in one least squares: which parameter changed, at which session, or drifted.

In session s: f = K·(ψ + Σ_j e_j·δ_js), with δ_j1 = 0. All sessions and the machine file's priors share ψ; what it
explains is projected out. What is left depends on the changes δ alone and has as many coordinates of unit variance as
combinations of changes are identifiable. Steps and drifts are subspaces of it, whose squared projections are tested:
against residuals, and against how much sessions differ without any order (`session_scatter`). Sessions enter by their
compressed information; no log is fitted again.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from scipy import special

from hydroopt.errors import IdentifiabilityError
from hydroopt.estimation.dynamic.change_space import SEPARABLE, ChangeSpace, Shape, SubspaceTest
from hydroopt.estimation.dynamic.problem import IdentificationProblem
from hydroopt.estimation.dynamic.session_scatter import NONE, UNEQUAL, SessionScatter, random_amounts
from hydroopt.estimation.dynamic.stored_information import StoredInformation
from hydroopt.estimation.inference.identifiability import RANK_TOLERANCE
from hydroopt.estimation.inference.least_squares import orthonormal, without
from hydroopt.model.model import Model
from hydroopt.spatial.inertia import Array

DRAWS = 10_000
"""Draws of measurements in which nothing changed, for the distribution of the smallest of many p-values."""
FEW = 10
"""Draws below which Bonferroni's bound replaces their count."""
FEWER = 2_000
"""Draws for the smallest detectable change."""
POWER = 0.95
"""Probability of detecting the smallest detectable change."""


@dataclass(frozen=True, eq=False)
class SessionScan:
    """Tests of steps and drifts of parameters over sessions.

    Attributes:
        names: (c,) of the parameters that may have changed.
        residual: their changes, where only residuals are random.
        scatter: of friction and offsets from session to session.
        partners: (c,) positions of the parameters whose changes cannot be separated from each.
        seed: of the draws.
    """

    names: tuple[str, ...]
    residual: ChangeSpace
    scatter: SessionScatter
    partners: tuple[tuple[int, ...], ...]
    seed: int = field(default=0, repr=False)

    @property
    def rank(self) -> int:
        """Number k of identifiable combinations of changes."""
        return len(self.residual.sums)

    @property
    def tests(self) -> int:
        """Number of tests."""
        return sum(map(len, self._families))

    @cached_property
    def _explained(self) -> dict[Shape, Array]:
        """Basis (k, ·) of each step and drift of all parameters, where only residuals are random."""
        return {shape: self.residual.together(shape).basis for shape in self.residual.shapes}

    def variance(self, shape: Shape, parameter: int | None = None) -> float:
        """κ² outside of a step or drift: of all parameters, or of those other than one, whatever that one did."""
        explained = self._explained[shape]
        if parameter is None:
            return self.scatter.variance(explained, NONE)
        return self.scatter.variance(orthonormal(np.hstack([explained, self.residual.all_of([parameter])])), 0.0)

    def space(self, shape: Shape, parameter: int | None = None) -> ChangeSpace:
        """The changes where sessions scatter as much as `variance` says."""
        return self.residual.scattered(self.scatter.directions, self.variance(shape, parameter), UNEQUAL)

    @cached_property
    def together(self) -> dict[Shape, SubspaceTest]:
        """Of a change of all parameters at once, by shape."""
        return {shape: self.space(shape).together(shape) for shape, basis in self._explained.items() if basis.shape[1]}

    @cached_property
    def separate(self) -> list[dict[Shape, SubspaceTest]]:
        """Of each parameter's change by shape, whatever the others do; none where the others could explain it."""
        return [dict(self._separate(j)) for j in range(len(self.names))]

    def _separate(self, parameter: int) -> Iterator[tuple[Shape, SubspaceTest]]:
        for shape in self.residual.shapes:
            space = self.space(shape, parameter)
            test = space.alone(parameter, shape, space.others(parameter))
            if test is not None:
                yield shape, test

    @property
    def likeliest(self) -> Shape:
        """The step or drift of all parameters that sessions contradict least."""
        return min(self.together, key=lambda shape: self.together[shape].p_value)

    def space_of(self, parameter: int) -> ChangeSpace:
        """The changes where sessions scatter as they do outside of one parameter's likeliest step or drift."""
        tests = self.separate[parameter]
        return self.space(min(tests, key=lambda shape: tests[shape].p_value) if tests else self.likeliest, parameter)

    @cached_property
    def _families(self) -> list[list[SubspaceTest]]:
        """Tests of all parameters together, and of each."""
        each = [test for tests in self.separate for test in tests.values()]
        return [family for family in (list(self.together.values()), each) if family]

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
                special.chdtrc(test.rank, np.sum((self._draws @ test.basis) ** 2, axis=1))
                for tests in self._families for test in tests}

    @cached_property
    def p_value(self) -> float:
        """Of no step or drift, by all tests: the smaller chance that the smallest p-value of all parameters together,
        or of single ones, is as small as it is, twice."""
        chances = [_chance(self._least(tests), min(test.p_value for test in tests), len(tests))
                   for tests in self._families]
        return min(1.0, len(chances) * min(chances))

    @cached_property
    def p_values(self) -> Array:
        """(c,) of no change of each parameter, corrected for all parameters and shapes by Holm's steps; NaN where it is
        not separable."""
        observed = np.array([min((test.p_value for test in tests.values()), default=np.nan) for tests in self.separate])
        corrected, so_far = np.full(len(observed), np.nan), 0.0
        left = [int(j) for j in np.argsort(observed) if np.isfinite(observed[j])]
        while left:
            tests = [test for j in left for test in self.separate[j].values()]
            so_far = max(so_far, _chance(self._least(tests), observed[left[0]], len(tests)))
            corrected[left.pop(0)] = so_far
        return corrected

    def detectable(self, level: float) -> tuple[Array, Array]:
        """The step of each parameter at each later session (c, N−1) that is detected with a probability of 95 %: one
        that is put down to this parameter, and one that raises an alarm at all; infinite where none is.
        """
        space, tests = self.residual, [test for family in self._families for test in family]
        limits = np.concatenate([np.full(len(family), np.quantile(self._least(family), level / len(self._families)))
                                 for family in self._families])
        owners = np.repeat(np.arange(-1, len(self.names)), [len(self.together), *map(len, self.separate)])
        starts = np.cumsum([0, *(test.rank for test in tests)])[:-1]
        onto, drawn = (np.hstack([getattr(test, key) for test in tests]) for key in ("onto", "basis"))
        drawn = self._draws[:: DRAWS // FEWER] @ drawn
        margin = (np.array([test.critical(limit) for test, limit in zip(tests, limits, strict=True)])
                  - np.add.reduceat(drawn**2, starts, axis=1))
        named, alarm = np.full(space.sizes.shape, np.inf), np.full(space.sizes.shape, np.inf)
        for j, k in np.ndindex(*space.sizes.shape):
            own = onto.T @ space.along(j, space.shapes[k])
            length = np.add.reduceat(own**2, starts)
            seen = length > SEPARABLE**2 * np.sum((space.sizes[j] * space.shapes[k].course(space.count)[1:]) ** 2)
            middle = -np.add.reduceat(drawn * own, starts, axis=1)[:, seen] / length[seen]
            inside = middle**2 + margin[:, seen] / length[seen]
            size = np.maximum(middle + np.sqrt(np.maximum(inside, 0.0)), 0.0)
            for found, of in ((named, owners[seen] == j), (alarm, np.full(size.shape[1], True))):
                if np.any(of):
                    found[j, k] = np.quantile(np.min(size[:, of], axis=1), POWER)
        return named, alarm


def _chance(null: Array, observed: float, count: int) -> float:
    """Probability that the smallest of so many p-values is at most the observed one."""
    found = float(np.mean(null <= observed))
    return found if found * len(null) >= FEW else min(count * observed, FEW / len(null))


def session_scan(model: Model, names: Sequence[str], sessions: Sequence[StoredInformation], *,
                 seed: int = 0) -> SessionScan:
    """What several sessions say about changes of some parameters.

    Args:
        model: of all sessions.
        names: parameters that may have changed.
        sessions: in time order.
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
    columns = np.zeros((len(rows), len(places), len(K)))
    for k, block in enumerate(K):
        columns[starts[k] : starts[k + 1], :, k] = block[:, places]
    wide = columns[:, :, 1:].reshape(len(rows), -1)
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
    unit = np.sqrt(_within_logs(sessions))
    space = ChangeSpace(effects.reshape(-1, *shape) / unit, size.reshape(shape) / unit, left.T @ rest / unit, left,
                        freedom, solution.reshape(*shape, -1) * unit, np.eye(left.shape[1]))
    random = columns * random_amounts(model, places, sessions)[:, None] / unit
    return SessionScan(tuple(names), space,
                       SessionScatter(left.T @ without(U, random.reshape(len(rows), -1)), space.sums),
                       tuple(tuple(int(i) for i in np.flatnonzero(row) if i != j) for j, row in enumerate(blocks)),
                       seed)


def _within_logs(sessions: Sequence[StoredInformation]) -> float:
    """φ by which squared differences exceed what residuals explain, where they do so between the halves of a log."""
    return 1.0 if all(one.steady for one in sessions) else float(np.mean([one.split_half for one in sessions]))
