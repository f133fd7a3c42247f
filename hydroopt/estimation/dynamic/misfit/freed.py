"""Faults freed as parameters: logs corrected by the likeliest sizes, and residuals that share what is left of them.

Residuals f − K·ψ with an effect S·δ have the covariance W⁻¹ + S·Σ·Sᵀ, with Σ that of δ as all data and δ's prior leave
it, ψ unknown. They move the least squares of weights W by (KᵀWK)⁻¹·KᵀWS·δ, so that the compressed residuals R·ψ − r
have the covariance I + T·Σ·Tᵀ with T = R·(KᵀWK)⁻¹·KᵀWS.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from hydroopt.errors import ProblemError
from hydroopt.estimation.dynamic.experiment import Experiment
from hydroopt.estimation.dynamic.folding import triangle
from hydroopt.estimation.dynamic.misfit.hypotheses import Fault, listed, one_after_another, stated_size
from hydroopt.estimation.dynamic.misfit.readings import ForceReadings
from hydroopt.estimation.dynamic.misfit.view import View
from hydroopt.estimation.dynamic.problem import IdentificationProblem
from hydroopt.estimation.dynamic.weighted_residuals import WeightedResiduals
from hydroopt.estimation.inference.hypotheses import LinearModel
from hydroopt.results.tables import number
from hydroopt.spatial.inertia import Array

UNCERTAIN: Mapping[str, float] = {"gain": 0.02, "offset": np.radians(0.5), "tilt": np.radians(1.0), "delay": 0.01}
"""Standard deviations [SI] of the faults that 'instruments' frees, where the machine file states none."""
WIDE = 3.0
"""Standard deviation of a fault that is freed by name, as a multiple of its usual size: it is believed to be there."""
WEAKER = 1e-4
"""Information of priors of ψ, as a part of it, where sizes are to rest on data and leave priors to what follows."""
ROUNDS = 4
"""Gauss-Newton steps of the sizes of freed faults."""


@dataclass(frozen=True, eq=False)
class Freed:
    """Faults with the sizes (k,) and covariance (k, k) [SI] that data and priors give them about parameters ψ (p,).

    Without priors of ψ these would be `apart` (k,) larger, with the covariance `alone` (k, k).
    """

    faults: tuple[Fault, ...]
    size: Array
    covariance: Array
    apart: Array
    alone: Array
    psi: Array

    @property
    def std(self) -> Array:
        """Standard deviations (k,) of the sizes [SI]."""
        return np.asarray(np.sqrt(np.diag(self.covariance)))

    def corrected(self, problem: IdentificationProblem) -> IdentificationProblem:
        """The problem with all forces corrected by the effects at these sizes."""
        train, held_out = ([self._corrected(data) for data in some]
                           for some in (problem.experiments, problem.validation))
        return replace(problem, experiments=tuple(train), validation=tuple(held_out), freed=())

    def given(self, problem: IdentificationProblem, psi: Array) -> Freed:
        """The same with the likeliest sizes beside parameters ψ (p,): together they predict what neither does alone.

        Where a fault and a parameter do nearly the same, only their sum is known.
        """
        model = ForceReadings(problem, psi).model(_held(self.faults, self.size))
        x = np.zeros(len(model.prior))
        x[: len(psi)] = psi - problem.parameters.nominal
        weight, own = 1 / model.fit.variance, slice(-len(self.size), None)
        products = np.tensordot(weight, model.products[:, own], 1) + model.prior[own]
        return replace(self, size=self.size + np.linalg.solve(
            products[:, own], weight @ model.scores[:, own] + model.pull[own] - products @ x))

    def as_dicts(self) -> list[dict[str, Any]]:
        """The entries of a JSON file; sizes as printed, in the unit of each fault."""
        return [{"fault": fault.name, "words": fault.words, "unit": fault.unit,
                 "prior_std": number(fault.scale * fault.factor), "size": number(size * fault.factor),
                 "std": number(own * fault.factor)}
                for fault, size, own in zip(self.faults, self.size.tolist(), self.std.tolist(), strict=True)]

    def _corrected(self, data: Experiment) -> Experiment:
        view, n = View.of(data, self.psi), data.force.shape[1]
        force, added, known = data.force, np.zeros((*data.force.shape, len(self.psi))), data.known
        for fault, size in zip(self.faults, self.size.tolist(), strict=True):
            change = fault.by_parameters(view, size)
            force, known = force - fault.effect(view, size)[:, :n], known & ~fault.unsteady(view, size)[:, :n]
            added = added if change is None else added + change[:, :n]
        force = force + added @ self.psi
        return replace(data, force=force, known=known, added=added if data.added is None else data.added + added)

    def widened(self, weighted: WeightedResiduals[IdentificationProblem]) -> WeightedResiduals[IdentificationProblem]:
        """The weighted residuals with what remains uncertain about the sizes in their covariance."""
        p = len(weighted.r)
        cross = np.zeros((p, len(self.faults)))
        weight = 1 / (weighted.sigma**2 * weighted.correlation_time)
        for data in weighted.problem.experiments:
            view, n = View.of(data, self.psi), data.force.shape[1]
            S = np.stack([f.sensitivity(view, s)[:, :n] for f, s in zip(self.faults, self.size, strict=True)], axis=2)
            taken = (data.inside[:, None] & data.known) * weight
            cross += np.einsum("Nnp,Nn,Nnk->pk", view.regressor[:, :n], taken, S, optimize=True)
        scale = np.maximum(np.linalg.norm(weighted.plain[0], axis=0), 1e-300)
        inverse = np.linalg.pinv(weighted.plain[0] / scale, rcond=1e-9)
        T = weighted.R / scale @ (inverse @ (inverse.T @ (cross / scale[:, None])))
        values, vectors = np.linalg.eigh(np.eye(p) + T @ self.alone @ T.T)
        root = (vectors / np.sqrt(np.maximum(values, 1.0))) @ vectors.T
        R = triangle(np.column_stack([root @ weighted.R, root @ (weighted.r - T @ self.apart)]))
        full = np.zeros((p + 1, p + 1))
        full[: len(R)] = R
        full[p, p] = np.hypot(full[p, p], np.sqrt(weighted.rest))
        return replace(weighted, R=full[:p, :p], r=full[:p, p], rest=float(full[p, p] ** 2), triangles=full[None],
                       scores=())


def chosen_faults(view: View, words: Sequence[str]) -> tuple[Fault, ...]:
    """The faults that words stand for: a group such as ``tilt``, a group and subject such as ``delay boom.q``, or
    ``instruments`` for gains, offsets, tilt and delay within what good instruments err.

    Of delays, lags and clocks the group alone means that of all forces.

    Raises:
        ProblemError: there is no such fault of this machine and its logs.
    """
    every = [fault for fault in listed(view) if fault.free]
    found: dict[Fault, None] = {}
    for word in words:
        if word == "instruments":
            usual = [f for group in UNCERTAIN for f in _of_group(every, group)]
            found |= dict.fromkeys(f if stated_size(view, f) else f.scaled(UNCERTAIN[f.group]) for f in usual)
            continue
        some = _of_group(every, word) or [f for f in every if f.name == word]
        if not some:
            groups = dict.fromkeys(f.group for f in every)
            raise ProblemError(f"'{word}' is no fault that can be freed", where=f"faults of {view.model.machine.name}",
                               remedy=f"use instruments, {', '.join(groups)}, or one with its subject such as "
                                      f"'{every[-1].name}'")
        found |= dict.fromkeys(f if stated_size(view, f) else f.scaled(WIDE * f.scale) for f in some)
    return tuple(found)


def _of_group(every: Sequence[Fault], group: str) -> list[Fault]:
    some = [f for f in every if f.group == group]
    return [f for f in some if f.subject == ("forces",)] or some


def free(problem: IdentificationProblem, psi: Array, last: Freed | None = None) -> Freed:
    """The likeliest sizes of a problem's freed faults about parameters ψ, these and the geometry unknown.

    The `last` sizes are where the search begins.

    Raises:
        ProblemError: a fault that does not exist.
    """
    data = ForceReadings(problem, psi)
    plain = chosen_faults(data.views[0], problem.freed)
    sizes = np.zeros(len(plain)) if last is None else last.size
    for _ in range(ROUNDS if any(not fault.linear for fault in plain) else 1):
        found, covariance = _amounts(data.model(_held(plain, sizes)))
        step, sizes = found - sizes, found
        if np.all(np.abs(step) < 0.05 * np.sqrt(np.diag(covariance))):
            break
    model = data.model(_held(plain, sizes))
    own = np.where(np.arange(len(model.prior)) < len(model.prior) - len(sizes), np.sqrt(WEAKER), 1.0)
    apart, alone = _amounts(replace(model, prior=own[:, None] * model.prior * own, pull=own**2 * model.pull))
    return Freed(one_after_another(plain, sizes.tolist()), sizes, _amounts(model)[1], apart - sizes, alone, psi)


def _held(faults: Sequence[Fault], sizes: Array) -> list[tuple[Fault, Array]]:
    return [(fault, np.array([size])) for fault, size in zip(faults, sizes.tolist(), strict=True)]


def _amounts(model: LinearModel[Fault]) -> tuple[Array, Array]:
    """Likeliest amounts (k,) of all hypotheses that hold, and their covariance (k, k)."""
    own = slice(len(model.prior) - len(model.about), None)
    return model.about + model.fit.x[own], model.fit.covariance[own, own]
