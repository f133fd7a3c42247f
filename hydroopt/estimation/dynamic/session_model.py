"""The linear mixed model of sessions, from their compressed information.

In session s: ``f = K·(ψ + x_s·δ + u_s)``. All sessions and the machine file's priors share ψ, which is projected out.
The fixed effect δ of all parameters that may have changed follows a shape x, a step at a session or a drift. The
random effects u_s are those of friction and offsets: in each session each is off by a random amount whose RMS force is
κ times the friction force of its actuator. Steps and drifts are held against residuals and against these; κ is
estimated from what the step or drift leaves, so that a change does not hide itself. Two sessions leave nothing.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import NamedTuple

import numpy as np
from scipy import special, stats

from hydroopt.errors import IdentifiabilityError
from hydroopt.estimation.dynamic.problem import IdentificationProblem
from hydroopt.estimation.dynamic.stored_information import StoredInformation
from hydroopt.estimation.inference.band_variances import MANY, f_test
from hydroopt.estimation.inference.identifiability import ROUNDING_TOLERANCE
from hydroopt.estimation.inference.least_squares import orthonormal, without
from hydroopt.estimation.inference.mixed_model import (
    SEPARABLE,
    FixedEffects,
    MixedModel,
    Projected,
    VarianceComponents,
    projected,
)
from hydroopt.model.model import Model
from hydroopt.parameters.parameter_set import ParameterKind
from hydroopt.spatial.inertia import Array

DRAWS = 10_000
"""Draws of measurements without a change: the smallest p-value of all tests is known to a tenth at 1 %."""
FEW = 10
"""Draws below which Bonferroni's bound replaces their count."""
SIGNIFICANT = 0.05
"""Level of 95 % intervals."""
POWER = 0.95
"""Probability of detecting the smallest detectable change."""


class Shape(NamedTuple):
    """How parameters change over the sessions: a step at a session, or a drift, linear in the session's number.

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


@dataclass(frozen=True, eq=False)
class SessionModel:
    """Steps and drifts of c parameters over N sessions, and tests of them.

    Attributes:
        names: (c,) of the parameters that may have changed.
        changes: of each parameter in each later session, by parameter and then by session.
        mixed: measurements with the random effects of sessions.
        within: φ by which squared differences exceed what residuals explain, as between the halves of a log.
        seed: of the draws.
    """

    names: tuple[str, ...]
    changes: Projected
    mixed: MixedModel
    within: float
    seed: int = field(default=0, repr=False)

    @property
    def count(self) -> int:
        """Number of sessions N."""
        return len(self.changes.sizes) // len(self.names) + 1

    @property
    def rank(self) -> int:
        """Number k of identifiable combinations of changes."""
        return len(self.mixed.sums)

    @cached_property
    def effects(self) -> Array:
        """(k, c, N−1) of a unit of each parameter's change in each later session."""
        return self.changes.effects.reshape(self.rank, len(self.names), -1)

    @cached_property
    def sizes(self) -> Array:
        """(c, N−1) lengths of these effects before unchanged parameters explained a part of them."""
        return self.changes.sizes.reshape(len(self.names), -1)

    @cached_property
    def shapes(self) -> dict[Shape, FixedEffects]:
        """A step at each later session, and a drift over three or more, of all parameters."""
        every = (*map(Shape, range(2, self.count + 1)), *((Shape(None),) if self.count > 2 else ()))
        moved = {shape: self.effects @ shape.course(self.count)[1:] for shape in every}
        return {shape: self._fixed(shape, self.mixed.components(columns)) for shape, columns in moved.items()
                if np.any(columns)}

    def _fixed(self, shape: Shape, components: VarianceComponents) -> FixedEffects:
        course = shape.course(self.count)[1:]
        return self.mixed.fixed(self.effects @ course, np.linalg.norm(self.sizes * course, axis=1), components)

    @cached_property
    def shares(self) -> dict[Shape, float]:
        """Probability of each shape, if the parameters follow one of them, the likeliest first.

        All are equally probable before, and sessions scatter as much as beside the shape with the least p-value. The
        likelihood of what a shape leaves is Student's, since its variance is estimated.
        """
        at = min(self.shapes.values(), key=lambda one: one.joint.p_value)
        whole = at.tested(np.eye(self.rank))
        freedom, logs = min(whole.freedom + whole.rank - 1, MANY), {}
        for shape in self.shapes:
            one = self._fixed(shape, at.components)
            left = max(float(one.sums @ one.sums - np.sum((one.basis.T @ one.sums) ** 2)), 0.0)
            logs[shape] = -(freedom + self.rank) / 2 * float(np.log1p(left / freedom))
        weights = {shape: float(np.exp(log - max(logs.values()))) for shape, log in logs.items()}
        return {shape: weights[shape] / sum(weights.values()) for shape in sorted(weights, key=lambda k: -weights[k])}

    @property
    def likeliest(self) -> Shape:
        """The step or drift of all parameters that sessions contradict least."""
        return next(iter(self.shares))

    @cached_property
    def _null(self) -> Array:
        """The smallest p-value of no change over all shapes, in draws in which nothing changed, in order."""
        draws = np.random.default_rng(self.seed).standard_normal((DRAWS, self.rank))
        return np.sort(np.min([special.chdtrc(one.joint.rank, np.sum((draws @ one.basis) ** 2, axis=1))
                               for one in self.shapes.values()], axis=0))

    @cached_property
    def p_value(self) -> float:
        """Of no step or drift of any parameter, corrected for all shapes."""
        least, count = min(one.joint.p_value for one in self.shapes.values()), len(self.shapes)
        below = int(np.searchsorted(self._null, least, side="right"))
        return least if count == 1 else below / DRAWS if below >= FEW else min(count * least, FEW / DRAWS)

    @cached_property
    def each(self) -> tuple[Array, Array, Array, Array]:
        """Change (c,) of each parameter by the likeliest shape whatever the others did, its standard deviation, p-value
        and half of its 95 % interval, both by Bonferroni's bound for all parameters."""
        one = self.shapes[self.likeliest]
        value, std, freedom = one.along(one.units)
        freedom, count = np.minimum(freedom, MANY), max(int(np.sum(np.isfinite(value))), 1)
        p_values = np.minimum(2 * count * stats.t.sf(np.abs(value) / std, freedom), 1.0)
        return value, std, p_values, stats.t.isf(SIGNIFICANT / 2 / count, freedom) * std

    def detectable(self, level: float) -> Array:
        """The step (c, N−1) of each parameter alone at each later session that is detected with a probability of 95 %,
        if sessions scatter as beside the likeliest shape; infinite where none is."""
        limit, found = float(np.quantile(self._null, level)), np.full(self.sizes.shape, np.inf)
        components = self.shapes[self.likeliest].components
        for shape in self.shapes:
            if shape.session is None:
                continue
            one = self._fixed(shape, components)
            rank, freedom = one.joint.rank, min(one.joint.freedom, MANY)
            squares = stats.f.isf(limit, rank, freedom) * rank * (freedom + rank - 1) / freedom
            length = np.linalg.norm(one.effects, axis=0)
            seen = length > SEPARABLE * one.sizes
            found[seen, shape.session - 2] = np.sqrt(special.chndtrinc(squares, rank, 1 - POWER)) / length[seen]
        return found

    @cached_property
    def values(self) -> tuple[Array, Array]:
        """Changes (c, N) since the first session where each session has values of its own, whatever the other
        parameters do, and their standard deviations by residuals alone, as `identify` states them for one session."""
        changes = (self.changes.solution @ self.mixed.sums).reshape(len(self.names), -1)
        std = np.linalg.norm(self.changes.solution, axis=1).reshape(changes.shape) / np.sqrt(self.within)
        first = np.zeros((len(self.names), 1))
        return np.hstack([first, changes]), np.hstack([first, std])

    def scatter(self, *, changed: bool) -> tuple[float, Array]:
        """p-values that sessions differ by residuals alone, and by the likeliest shape if it is stated: of all
        parameters or any, and (c,) of each whatever the others do, by Bonferroni's bound; NaN where nothing shows
        it."""
        course = self.likeliest.course(self.count)[1:] * changed
        each = np.full(len(self.names), np.nan)
        if self.count == 2 and (changed or self.within == 1):  # then it is the test of the change
            return np.nan, each
        for j in range(len(self.names)):
            others = np.delete(self.effects, j, axis=1).reshape(self.rank, -1)
            given = np.column_stack([others, self.effects[:, j] @ course])
            own = without(orthonormal(given), self.effects[:, j]) if np.any(given) else self.effects[:, j]
            each[j] = self._by_residuals(own[:, np.linalg.norm(own, axis=0) > SEPARABLE * self.sizes[j]])
        together = self._by_residuals(self.mixed.outside(self.effects @ course))
        each = np.minimum(each * np.sum(np.isfinite(each)), 1.0)
        return min(1.0, 2 * float(np.fmin(together, np.fmin.reduce(each)))), each

    def _by_residuals(self, columns: Array) -> float:
        """p-value that a subspace holds residuals alone; NaN for none."""
        if not columns.size:
            return np.nan
        basis, model = orthonormal(columns), self.mixed
        return f_test(np.sqrt(self.within) * basis.T @ model.sums, (model.rows @ basis) ** 2, model.freedom).p_value


def session_model(model: Model, names: Sequence[str], sessions: Sequence[StoredInformation], *,
                  seed: int = 0) -> SessionModel:
    """What sessions say about changes of some parameters.

    Args:
        model: of all sessions.
        names: parameters that may have changed.
        sessions: in time order.
        seed: of the draws by which p-values are corrected.

    Raises:
        IdentifiabilityError: no change of any of these parameters is identifiable.
    """
    p, places = len(model.parameters), model.parameters.select(names)
    prior, right = IdentificationProblem(model, ()).prior_rows
    K = [session.triangles[:, :, :p].reshape(-1, p) for session in sessions]
    rows = np.vstack([*K, prior])
    rest = np.concatenate([*(session.triangles[:, :, p].ravel() for session in sessions), right])
    columns = np.zeros((len(rows), len(places), len(K)))
    starts = np.cumsum([0, *map(len, K)])
    for k, block in enumerate(K):
        columns[starts[k] : starts[k + 1], :, k] = block[:, places]
    unit = np.sqrt(_within_logs(sessions))
    changes = projected(rows * model.parameters.scale / unit, columns[:, :, 1:].reshape(len(rows), -1) / unit,
                        (rest - rows @ model.parameters.nominal) / unit,
                        np.repeat(model.parameters.scale[places], len(K) - 1))
    if not len(changes.sums):
        raise IdentifiabilityError("these logs do not identify a change of these parameters",
                                   where=f"comparison of sessions of {model.machine.name}",
                                   remedy="drive longer motions that excite them, in every session")
    basis = orthonormal(rows * model.parameters.scale)
    amounts = random_amounts(model, places, sessions)
    random = changes.left.T @ without(basis, (columns * amounts[:, None] / unit).reshape(len(rows), -1))
    freedom = np.concatenate([*(session.freedom.ravel() for session in sessions), np.full(len(prior), np.inf)])
    mixed = MixedModel(changes.sums, changes.left, freedom, (random,))
    return SessionModel(tuple(names), changes, mixed, float(unit**2), seed)


def _within_logs(sessions: Sequence[StoredInformation]) -> float:
    """φ by which squared differences exceed what residuals explain, where they do so between the halves of a log."""
    return 1.0 if all(one.steady for one in sessions) else float(np.mean([one.split_half for one in sessions]))


def random_amounts(model: Model, places: Sequence[int], sessions: Sequence[StoredInformation]) -> Array:
    """Change (c,) of each parameter whose RMS force is that of its actuator's friction; zero for other parameters."""
    parameters, p = model.parameters, len(model.parameters)
    rows = np.concatenate([session.triangles for session in sessions], axis=1)
    K, prior = rows[:, :, :p], IdentificationProblem(model, ()).prior_rows
    A = np.vstack([K.reshape(-1, p), prior[0]]) * parameters.scale
    psi = parameters.scale * np.linalg.lstsq(A, np.append(rows[:, :, p].ravel(), prior[1]), rcond=ROUNDING_TOLERANCE)[0]
    friction = np.array([kind.is_friction for kind in parameters.kinds])
    varies = friction | np.array([kind is ParameterKind.FORCE_OFFSET for kind in parameters.kinds])
    force, size = np.linalg.norm(K @ (psi * friction), axis=1), np.linalg.norm(K, axis=1)[:, places]
    actuator, each = np.argmax(size, axis=0), np.arange(len(places))
    length = size[actuator, each]
    return np.where(varies[places] & (length > 0), force[actuator] / np.where(length > 0, length, 1.0), 0.0)
