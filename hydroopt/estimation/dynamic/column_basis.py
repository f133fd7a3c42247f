"""Columns of a regressor from which the others follow at every motion, since bodies are fixed to each other."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import casadi as ca
import numpy as np
from numpy.typing import NDArray
from scipy.linalg import qr, solve_triangular

from hydroopt.estimation.inference.identifiability import PRESSURES, random_states
from hydroopt.model.model import Model
from hydroopt.spatial.inertia import Array

STATES = 400
"""Random states that tell the columns from which others follow, and as many more that tell which do."""
INDEPENDENT, DEPENDENT = 1e-6, 1e-12
"""What other columns leave of one that is independent of them, and of one that follows, as parts of its size. One that
is between is kept."""
NO_SHARE = 1e-8
"""Share of one column in another, in units of their sizes, that is a rounding error: what is zero at rest stays so."""


@dataclass(frozen=True, eq=False)
class ColumnBasis:
    """The regressor of one actuator: ``K[:, own] = K[:, kept] @ mixing`` with (c,), (k,) and (k, c)."""

    own: NDArray[np.intp]
    kept: NDArray[np.intp]
    mixing: Array

    @classmethod
    def whole(cls, own: NDArray[np.intp]) -> ColumnBasis:
        """That in which every column is kept."""
        return cls(own, own, np.eye(len(own)))

    @property
    def columns(self) -> NDArray[np.intp]:
        """Those of [K, f], where f comes last."""
        return np.append(self.own, -1)

    def rows(self, K: Array, force: Array, actuator: int) -> Array:
        """Kept columns of K (N, n, p) and forces (N, n) of an actuator, as rows (k+1, N)."""
        made = np.empty((len(self.kept) + 1, len(force)))
        for row, column in zip(made, self.kept.tolist(), strict=False):
            row[:] = K[:, actuator, column]
        made[-1] = force[:, actuator]
        return made

    def spread(self, sums: Array) -> Array:
        """Sums (c,) of all columns from those of the kept ones (k,)."""
        return sums if len(self.kept) == len(self.own) else sums @ self.mixing

    @cached_property
    def expander(self) -> Array:
        """(k+1, c+1): all columns of [K, f] from the kept ones."""
        made = np.zeros((len(self.kept) + 1, len(self.own) + 1))
        made[:-1, :-1], made[-1, -1] = self.mixing, 1.0
        return made


class KeptRows:
    """Rows [K_i, f_i] of each actuator of a linear model in some columns of K_i alone: the others are not computed."""

    def __init__(self, model: Model, columns: Sequence[NDArray[np.intp]]) -> None:
        given = model.regressor.sx_in()
        K = model.regressor.call(given)[0]
        self._model, self._sizes = model, [len(own) for own in columns]
        # the last row of each is the place of f
        self._function = ca.Function("kept_columns", given, [
            ca.densify(ca.vertcat(K[i, own.tolist()].T, 0)) for i, own in enumerate(columns)])

    def __call__(self, inputs: Sequence[Array], force: Array,
                 out: list[Array] | None = None) -> tuple[list[Array], list[Array]]:
        """Rows (k_i + 1, N) of each actuator at inputs of the regressor and forces (N, n), and the memory that they
        are in: a later call may write over that of as many samples."""
        made = self._model.over(self._function, *inputs, out=out)
        rows = [values[:, :, 0].T for values in made]
        for own, values in zip(rows, force.T, strict=True):
            own[-1] = values
        return rows, made


def column_bases(model: Model) -> list[ColumnBasis]:
    """The basis of each actuator of a model that is linear, found at random states and confirmed at others.

    >>> from hydroopt.model.model import model_of
    >>> [(len(each.own), len(each.kept)) for each in column_bases(model_of("patu655_lift", "the example"))]
    [(21, 5)]
    """
    rng = np.random.default_rng(0)
    states: tuple[Array, ...] = random_states(model, 2 * STATES, rng)
    if model.needs_pressure:
        states = (*states, rng.uniform(*PRESSURES, states[0].shape))
    K = model.over(model.regressor, *states)[0]
    return [_basis(K[:STATES, i], K[STATES:, i], np.flatnonzero(row)) for i, row in enumerate(model.regressor_pattern)]


def _basis(K: Array, others: Array, own: NDArray[np.intp]) -> ColumnBasis:
    size = np.maximum(np.linalg.norm(K[:, own], axis=0), np.finfo(float).tiny)
    K, others = K[:, own] / size, others[:, own] / size
    R, order = qr(K, mode="r", pivoting=True)
    diagonal = np.abs(np.diag(R))
    rank = int(np.sum(diagonal > INDEPENDENT * diagonal.max(initial=0.0)))
    weights = solve_triangular(R[:rank, :rank], R[:rank, rank:])
    weights[np.abs(weights) < NO_SHARE] = 0.0
    left = np.linalg.norm(others[:, order[:rank]] @ weights - others[:, order[rank:]], axis=0)
    follows = left <= DEPENDENT * np.linalg.norm(others[:, order[rank:]], axis=0)
    kept = np.concatenate([order[:rank], order[rank:][~follows]])
    mixing = np.zeros((len(kept), len(own)))
    mixing[np.arange(len(kept)), kept] = 1.0
    mixing[:rank, order[rank:][follows]] = weights[:, follows] * size[order[rank:][follows]] / size[kept[:rank], None]
    return ColumnBasis(own, own[kept], mixing)
