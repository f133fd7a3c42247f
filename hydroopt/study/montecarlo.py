"""Monte Carlo: identification of random truths from random motions and sensor errors, also over a grid of conditions.

Each truth is drawn from the priors of the machine file, so that 95 % intervals that use the same priors must contain
it in 95 % of many cells.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from itertools import product
from typing import Any

import numpy as np

from hydroopt.errors import ProblemError
from hydroopt.estimation.dynamic.identify import Method, identify
from hydroopt.estimation.dynamic.problem import identification_problem
from hydroopt.logs.forces_from_pressures import force_noise, pressures
from hydroopt.machine.machine import Machine
from hydroopt.model.model import Model
from hydroopt.parameters.dynamic import carried
from hydroopt.simulation import simulate
from hydroopt.spatial.inertia import Array
from hydroopt.study.study import Study, Value, Values, seeds
from hydroopt.study.table import Table, quantiles, spread

DURATION = 33.28
"""Of a random motion [s]: the 1664 samples of the thesis."""
UNSEEN = (30.0, 50.0)
"""Duration [s] and rate [Hz] of the validation motion whose forces are predicted."""
VARIED = {"accuracy": "factor on the accuracy of all sensors", "duration": "of the motion [s]",
          "rate": "samples per second [Hz]"}
"""Conditions that a sweep can vary."""


@dataclass(frozen=True, eq=False)
class Trial:
    """One cell: simulates a log of a random truth, identifies it, and compares the estimate with the truth.

    All cells use `motion` if it is given; otherwise each has a random one.
    """

    machine: Machine
    method: Method
    motion: simulate.Trajectory | None
    unseen: simulate.Trajectory = field(repr=False)

    def __call__(self, *, seed: int, accuracy: float = 1.0, duration: float = DURATION,
                 rate: float | None = None) -> Values:
        """Truth, value, σ and whether the interval contains the truth, by parameter; validation error in σ by actuator.

        Raises:
            HydrooptError: the identification gives no estimate.
        """
        model, (of_truth, of_motion, of_noise, of_sampling) = _model(self, accuracy), seeds(seed, 4)
        truth = simulate.random_truth(model, of_truth)
        motion = self.motion or simulate.random_trajectory(
            model, duration=duration, rate=simulate.sampling_rate(self.machine) if rate is None else rate,
            seed=of_motion)
        log = simulate.simulate(model, motion, truth, seed=of_noise)
        estimate = identify(identification_problem(model, [log]), self.method, seed=of_sampling)
        result: dict[str, Value] = {}
        for k, name in enumerate(model.parameters.names):
            low, high = estimate.ci95[k]
            result |= {f"{name}.truth": float(truth[k]), f"{name}.value": float(estimate.value[k]),
                       f"{name}.std": float(estimate.std[k]),
                       f"{name}.inside": int(low <= truth[k] <= high) if np.isfinite(low) else None}
        for total in estimate.total_masses:
            mass = float(np.sum(truth[model.parameters.select(f"{owner}.m" for owner in total.bodies)]))
            result |= {f"{total.link} in all.truth": mass, f"{total.link} in all.value": total.value,
                       f"{total.link} in all.std": total.std, f"{total.link} in all.inside":
                       int(total.low <= mass <= total.high) if np.isfinite(total.low) else None}
        rms = unseen_error(self, truth, estimate.psi)
        return result | {f"{each.name}.rms": float(x) for each, x in zip(self.machine.balances, rms, strict=True)}


# once in each process, because the model depends on no cell's seed
@cache
def _model(trial: Trial, accuracy: float) -> Model:
    sensors = [sensor.model_copy(update={"accuracy": sensor.accuracy * accuracy}) for sensor in trial.machine.sensors]
    return Model(trial.machine.model_copy(update={"sensors": tuple(sensors)}))


def unseen_error(trial: Trial, truth: Array, psi: Array) -> Array:
    """RMS error (n,) of the forces that ψ predicts on the validation motion, in σ of the sensors as stated."""
    model, motion = _model(trial, 1.0), trial.unseen
    state = [motion.q, motion.qd, motion.qdd]
    if model.needs_pressure:
        pressed = pressures(model, simulate.simulate(model, motion, truth, noise=False))
        assert pressed is not None
        state.append(pressed)
    true, predicted = (model.over(model.inverse_dynamics, *state, one)[0][:, :, 0] for one in (truth, psi))
    return np.asarray(np.sqrt(np.mean((predicted - true) ** 2, axis=0)) / force_noise(model))


def montecarlo(machine: Machine, *, cells: int, seed: int = 0, method: Method = "sdp",
               motion: simulate.Trajectory | None = None, motion_sha256: str = "",
               vary: Mapping[str, Sequence[float]] | None = None, duration: float = DURATION,
               rate: float | None = None) -> Study:
    """A Monte Carlo study of identification, or a sweep if something is varied.

    Args:
        machine: its priors are the distribution of the truths.
        cells: number of cells at each point of the grid.
        seed: of the study.
        method: of identification.
        motion: of all cells; otherwise each has a random one of `duration` [s] at `rate` [Hz], by default as stated.
        motion_sha256: digest that identifies the motion.
        vary: values of ``accuracy`` (a factor), ``duration`` [s] or ``rate`` [Hz]; several names make a product.

    Raises:
        ProblemError: a name cannot be varied, or its values are not different positive numbers.
    """
    grid = dict(vary or {})
    for name, values in grid.items():
        if name not in VARIED:
            raise ProblemError(f"'{name}' cannot be varied", where="--vary", remedy=f"use {', '.join(VARIED)}")
        if motion is not None and name != "accuracy":
            raise ProblemError(f"a given motion has its own {name}", where="--vary",
                               remedy="leave it out, or --motion")
        if not values or len(set(values)) < len(values) or not all(0 < value < np.inf for value in values):
            raise ProblemError(f"{', '.join(f'{value:g}' for value in values) or 'nothing'} cannot be the values of "
                               f"{name}", where="--vary", remedy="give different positive numbers")
    given = {} if motion is not None else {"duration": duration, "rate": rate or simulate.sampling_rate(machine)}
    points = [given | dict(zip(grid, point, strict=True)) for point in product(*grid.values())]
    for point in points:
        if motion is None:  # refuse now what cannot be sampled
            simulate.random_trajectory(Model(machine), duration=point["duration"], rate=point["rate"], seed=0)
    own = seeds(seed, cells * len(points))
    table = tuple({**point, "seed": own[k * cells + i]} for k, point in enumerate(points) for i in range(cells))
    unseen = simulate.random_trajectory(Model(machine), duration=UNSEEN[0], rate=UNSEEN[1], seed=seed)
    settings = {"machine": machine.name, "machine_sha256": machine.sha256, "method": method, "seed": seed,
                "motion_sha256": motion_sha256, "vary": {name: list(values) for name, values in grid.items()}}
    return Study("sweep" if grid else "montecarlo", Trial(machine, method, motion, unseen), table, settings | given)


def summary(study: Study, table: Table) -> dict[str, Any]:
    """Bias, scatter, coverage and prediction at each point of the grid, as JSON."""
    points = list({tuple((key, cell[key]) for key in cell if key != "seed"): None for cell in study.cells})
    return {"points": [{"values": dict(point), **_point(study.function, table.where(dict(point)))}
                       for point in points]}


def _point(trial: Any, table: Table) -> dict[str, Any]:
    model = _model(trial, 1.0)
    links = [f"{link} in all" for link in carried(model.machine)]
    rows, covered, fewest = [], [], len(table)
    for name, unit in (*zip(model.parameters.names, model.parameters.units, strict=True), *((n, "kg") for n in links)):
        truth, value, std, inside = (table.column(f"{name}.{key}") for key in ("truth", "value", "std", "inside"))
        valued = np.isfinite(value)
        if not np.any(valued):
            continue
        if name not in links:
            covered.append(inside)
        if np.any(np.isfinite(inside)):
            fewest = min(fewest, int(valued.sum()))
        rows.append({"name": name, "unit": unit, "cells": int(valued.sum()), **spread(value[valued] - truth[valued],
                     std[valued]), "coverage": _mean(inside)})
    by_cell = np.array([_mean(cell) for cell in np.array(covered).T], dtype=float)
    by_cell = by_cell[np.isfinite(by_cell)]
    return {"cells": len(table), **table.failed,
            "coverage": _mean(np.array(covered)),
            "coverage_std_error": float(np.std(by_cell, ddof=1) / np.sqrt(len(by_cell))) if len(by_cell) > 1 else None,
            "coverage_half_width": 1.96 * float(np.sqrt(0.95 * 0.05 / max(fewest, 1))),
            "prediction": {balance.name: quantiles(table.column(f"{balance.name}.rms"))
                           for balance in trial.machine.balances},
            "parameters": rows}


def _mean(values: Array) -> float | None:
    values = values[np.isfinite(values)]
    return float(np.mean(values)) if values.size else None
