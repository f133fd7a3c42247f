"""Block bootstrap: the scatter of an identification under resampled residuals.

Residuals of the estimate are resampled in blocks that are long enough to keep their autocorrelation, added to the
forces that the estimate predicts, and identified again (Künsch 1989; circular blocks: Politis and Romano 1992). The
method assumes nothing about the residuals' distribution. The priors of the machine file are not resampled: a parameter
that a prior determines, rather than the data, scatters less than its σ.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hydroopt.estimation.dynamic.experiment import Experiment
from hydroopt.estimation.dynamic.identify import Method, identify
from hydroopt.estimation.dynamic.problem import IdentificationProblem, identification_problem
from hydroopt.estimation.dynamic.regressor_qr import predict
from hydroopt.logs.log import Log
from hydroopt.machine.machine import Machine
from hydroopt.spatial.inertia import Array
from hydroopt.study.study import Study, Values, seeds
from hydroopt.study.table import Table, spread


@dataclass(frozen=True, eq=False)
class Resampling:
    """One cell: an identification with resampled residuals.

    Attributes:
        machine, logs, method: inputs of the estimate.
        names: of the parameters that have a value, at `positions`; `base` names the base parameters.
        psi: (p,) parameters of the prediction; `grouping` (r, p) maps them to base parameters.
        value, std: of the parameters, followed by the base parameters.
        blocks: (n,) length of the blocks of each actuator's residuals, in samples.
        widening: (n,) factors on the residuals, which the fit has made smaller than the errors.
    """

    machine: Machine
    logs: tuple[Log, ...]
    method: Method
    names: tuple[str, ...]
    positions: NDArray[np.intp]
    base: tuple[str, ...]
    psi: Array
    grouping: Array
    value: Array
    std: Array
    blocks: NDArray[np.intp]
    widening: Array

    def __call__(self, *, seed: int) -> Values:
        """Values of the parameters and of the base parameters.

        Raises:
            HydrooptError: the identification gives no estimate.
        """
        problem, experiments, predicted = _prepared(self)
        of_blocks, of_sampling = seeds(seed, 2)
        rng = np.random.default_rng(of_blocks)
        forces = [np.array(force) for force in predicted]
        for k, (block, widening) in enumerate(zip(self.blocks, self.widening, strict=True)):
            used = [e.inside & e.known[:, k] for e in experiments]
            residuals = [(e.force - force)[rows, k] for e, force, rows in zip(experiments, predicted, used,
                                                                         strict=True)]
            drawn = widening * redrawn(np.concatenate(residuals), int(block), rng)
            for force, rows, new in zip(forces, used, np.split(drawn, np.cumsum([len(x) for x in residuals])[:-1]),
                                        strict=True):
                force[rows, k] += new
        forces = [force if e.calm is None else
                  force + _of_holds(np.where(e.inside[:, None] & e.calm, e.force - fitted, 0.0), rng)
                  for e, force, fitted in zip(experiments, forces, predicted, strict=True)]
        again = replace(problem, experiments=tuple(replace(e, force=force) for e, force in
                                                   zip(experiments, forces, strict=True)))
        psi = identify(again, self.method, seed=of_sampling).psi
        values = np.concatenate([psi[self.positions], self.grouping @ psi])
        return dict(zip((*self.names, *(f"base {name}" for name in self.base)), values.tolist(), strict=True))


def _of_holds(residual: Array, rng: np.random.Generator) -> Array:
    """Residuals (N, n), zero but in holds, with a random sign for each hold, whose friction is one unknown number."""
    borders = np.diff(residual != 0, axis=0, prepend=False)
    signs = rng.choice([-1.0, 1.0], borders.shape)
    latest = np.maximum.accumulate(np.where(borders, np.arange(len(residual))[:, None], 0), axis=0)
    return np.asarray(residual * np.take_along_axis(signs, latest, axis=0))


def redrawn(residual: Array, block: int, rng: np.random.Generator) -> Array:
    """Circular blocks of residuals (m,), each from a random start: m values about the residuals' mean."""
    count = len(residual)
    starts = rng.integers(0, max(count, 1), -(-count // block))
    indices = (starts[:, None] + np.arange(block)).ravel()[:count] % max(count, 1)
    return np.asarray((residual - residual.mean())[indices] if count else residual)


def block_length(time: float, samples: int) -> int:
    """Samples in a block that minimise the error of the bootstrap's variance.

    For circular blocks and a first-order process (Politis and White 2004) this is ``(√6·ρ/(1 − ρ²))^⅔·N^⅓``, with ρ
    from the integrated autocorrelation time ``τ = (1 + ρ)/(1 − ρ)``.

    >>> block_length(1.0, 1000), block_length(9.0, 1000)
    (1, 31)

    Args:
        time: τ in samples, see `correlation_time`.
        samples: N.
    """
    rho = (time - 1) / (time + 1)
    best = (np.sqrt(6) * rho / (1 - rho**2)) ** (2 / 3) * samples ** (1 / 3)
    return int(np.clip(np.ceil(best), 1, max(samples // 4, 1)))


@cache
def _prepared(resampling: Resampling) -> tuple[IdentificationProblem, tuple[Experiment, ...], list[Array]]:
    problem = identification_problem(resampling.machine, resampling.logs)
    held = problem.experiments
    return problem, held, [predict(problem.model, e, resampling.psi) for e in held]


def bootstrap(machine: Machine, logs: Sequence[Log], *, cells: int, seed: int = 0, method: Method = "sdp") -> Study:
    """A bootstrap of an identification.

    Args:
        machine: nominal description.
        logs: training logs.
        cells: number of resamplings.
        seed: of the study.
        method: of identification.

    Raises:
        HydrooptError: the logs give no estimate whose residuals could be resampled.
    """
    problem = identification_problem(machine, logs)
    found = identify(problem, method, seed=seed)
    held = problem.experiments
    samples = np.sum([np.sum(e.inside[:, None] & e.known, axis=0) for e in held], axis=0)
    valued = np.flatnonzero(np.isfinite(found.value))
    n = len(machine.balances)
    work = Resampling(
        machine, tuple(logs), method, tuple(problem.parameters.names[k] for k in valued), valued,
        tuple(problem.parameters.names[k] for k in found.identifiability.basis), found.psi,
        found.identifiability.grouping,
        np.concatenate([found.psi[valued], found.base_value]), np.concatenate([found.std[valued], found.base_std]),
        np.array([block_length(t, int(m)) for t, m in zip(found.correlation_time, samples, strict=True)]),
        np.sqrt(samples / np.maximum(samples - found.identifiability.rank / n, 1.0)))
    settings = {"machine": machine.name, "machine_sha256": machine.sha256, "method": method, "seed": seed,
                "logs": [{"path": log.path or log.name, "sha256": log.sha256} for log in logs]}
    return Study("bootstrap", work, tuple({"seed": own} for own in seeds(seed, cells)), settings)


def summary(study: Study, table: Table) -> dict[str, Any]:
    """Scatter of the refits and the stated σ, for parameters and base parameters, as JSON."""
    work: Any = study.function
    problem = _prepared(work)[0]
    units = [problem.parameters.units[problem.parameters.index(name)] for name in (*work.names, *work.base)]
    rows = []
    for k, name in enumerate((*work.names, *(f"base {name}" for name in work.base))):
        refits, value, std = table.column(name), float(work.value[k]), float(work.std[k])
        rows.append({"name": name.removeprefix("base "), "unit": units[k], "value": value, "cells": len(refits),
                     **spread(refits - value, np.array([std]))})
    return {"cells": len(table), **table.failed,
            "block_samples": {each.name: size for each, size in zip(work.machine.balances, work.blocks.tolist(),
                                                                    strict=True)},
            "parameters": rows[: len(work.names)], "base_parameters": rows[len(work.names):]}
