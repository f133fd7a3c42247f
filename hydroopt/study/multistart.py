"""Multistart: do random initial guesses of a kinematic calibration all lead to one geometry?

The calibration is the one nonlinear problem whose answer could depend on its initial guess without a sign: the design
of a motion reports its criterion, and a dynamic identification is convex.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np

from hydroopt.errors import ProblemError
from hydroopt.estimation.kinematic.observability import linearise, observability
from hydroopt.estimation.kinematic.optimum import optimum, random_start, solvable
from hydroopt.estimation.kinematic.problem import CalibrationProblem, calibration_problem
from hydroopt.estimation.kinematic.solution import SAME
from hydroopt.estimation.kinematic.unsensed_angles import closed_angles
from hydroopt.logs.poses import Poses
from hydroopt.machine.machine import Machine
from hydroopt.study.study import Study, Values, seeds
from hydroopt.study.summary import failed
from hydroopt.study.table import Table


@dataclass(frozen=True, eq=False)
class Start:
    """One cell: the optimum that a solver reaches from one initial guess."""

    machine: Machine
    poses: Poses
    method: str
    fixed: Mapping[str, float]

    def __call__(self, *, seed: int, nominal: int) -> Values:
        """The sum of squared errors in units of the stated σ, ``cost``, and all parameters.

        Raises:
            SolverError: the solver did not converge.
        """
        problem = _problem(self)
        start = problem.start if nominal else random_start(problem, np.random.default_rng(seed))
        found = optimum(problem, self.method, start)
        return {"cost": float(found.cost), **dict(zip(problem.parameters.names, found.theta.tolist(), strict=True))}


@cache
def _problem(start: Start) -> CalibrationProblem:
    return solvable(calibration_problem(start.machine, start.poses).fixing(**start.fixed), start.method)


def multistart(machine: Machine, poses: Poses, *, cells: int, seed: int = 0, method: str = "joint",
               fixed: Mapping[str, float] | None = None) -> Study:
    """A multistart study of a calibration; the first start is the nominal machine.

    Args:
        machine: nominal description; its priors are the distribution of the starts.
        poses: training poses.
        cells: number of starts.
        seed: of the starts.
        method: ``joint`` or ``hierarchical``.
        fixed: parameters held [SI].

    Raises:
        ProblemError: the poses cannot determine the parameters.
    """
    if cells < 1:
        raise ProblemError(f"the number of cells is {cells}", where="--cells", remedy="give at least 1")
    work = Start(machine, poses, method, fixed or {})
    _problem(work)  # refuse now what cannot be solved
    settings = {"machine": machine.name, "machine_sha256": machine.sha256, "method": method, "seed": seed,
                "fixed": dict(work.fixed), "poses": dict(poses.sha256)}
    table = tuple({"nominal": int(k == 0), "seed": own} for k, own in enumerate(seeds(seed, cells)))
    return Study("multistart", work, table, settings)


def summary(study: Study, table: Table) -> dict[str, Any]:
    """The optima that were found, the best first, and how far apart the parameters are, as JSON.

    Two starts reach the same optimum if no free parameter differs by more than a tenth of its standard deviation.
    """
    work: Any = study.function
    problem = _problem(work)
    names = [name for name, free in zip(problem.parameters.names, problem.free, strict=True) if free]
    cost, found = table.column("cost"), np.column_stack([table.column(name) for name in names])
    best = int(np.argmin(cost))
    theta = np.array([table.results[best][name] for name in problem.parameters.names], dtype=float)
    _, theta, q, _ = optimum(problem, work.method, theta)
    std = observability(problem, linearise(problem, theta, closed_angles(problem, theta, q))).std
    size = np.where(np.isfinite(std) & (std > 0), std, np.inf)
    optima: list[dict[str, Any]] = []
    left = np.argsort(cost, kind="stable")
    while left.size:
        same = np.all(np.abs(found[left] - found[left[0]]) <= SAME * size, axis=1)
        optima.append({"cost": float(cost[left[0]]), "starts": int(same.sum()),
                       "farthest_std": float(np.max(np.abs(found[left[0]] - found[best]) / size))})
        left = left[~same]
    units = dict(zip(problem.parameters.names, problem.parameters.units, strict=True))
    rows = [{"name": name, "unit": units[name], "value": float(found[best, k]),
             "std": float(std[k]) if np.isfinite(std[k]) else None, "lowest": float(found[:, k].min()),
             "highest": float(found[:, k].max()),
             "lowest_std": float((found[:, k].min() - found[best, k]) / size[k]),
             "highest_std": float((found[:, k].max() - found[best, k]) / size[k])} for k, name in enumerate(names)]
    return {"cells": len(table), **failed(table), "optima": optima, "parameters": rows}
