"""Whether what makes identification faster leaves its intervals as they are, beside the noise of the draws."""

from collections.abc import Sequence
from typing import Any
from unittest.mock import patch

import numpy as np

from hydroopt import identification_problem, load_machine, random_trajectory, random_truth, simulate
from hydroopt.estimation.dynamic.identify import identify
from hydroopt.estimation.dynamic.problem import IdentificationProblem
from hydroopt.estimation.inference import posterior
from hydroopt.model.model import model_of
from studies.bench.goals import Row

MACHINES = ("cat215b", "wheel_loader")
SWEEPS = 500
"""Of a long run: a hundred times as many as identification makes."""
RUNS = 8
"""Long runs, each with random numbers of its own, that are averaged."""
ROUNDING = 1e-12
"""Relative change of all residuals' rows that stands for other rounding."""


def intervals() -> list[Row]:
    """Intervals of one log with the same random numbers after other rounding, by many draws, and their scatter."""
    print(f"{'machine':>14} {'':>38} {'std, worst':>12} {'95 % width, worst':>18} {'mean':>8}")
    changes, scatters = [], []
    for name in MACHINES:
        model = model_of(name, "intervals")
        motion = random_trajectory(model, duration=33.28, rate=50.0, seed=1)
        log = simulate(model, motion, random_truth(model, seed=1), seed=1)
        problem = identification_problem(load_machine(name), [log])
        usual = _mean(problem, [1])
        with patch.object(posterior, "sample", _rounded(posterior.sample)):
            _show(name, "other rounding, same numbers", _mean(problem, [1]), usual)
        widths = np.array([_mean(problem, [seed])[1] for seed in range(1, 1 + RUNS)])
        scatter = widths.std(axis=0, ddof=1) / widths.mean(axis=0)
        scatters.append(100 * np.max(np.abs(widths / widths.mean(axis=0) - 1)))
        print(f"{name:>14} scatter of widths over {RUNS} usual runs: median {100 * np.median(scatter):.1f} %, "
              f"most {100 * np.max(scatter):.1f} %, worst single one {scatters[-1]:.1f} %")
        with patch.object(posterior, "SWEEPS", SWEEPS):
            long = _mean(problem, range(2, 2 + RUNS))
            with patch.object(posterior, "sample", _rounded(posterior.sample)):
                other = _mean(problem, range(102, 102 + RUNS))
        _show(name, "as usual against many", usual, long)
        changes.append(_show(name, "many draws, other rounding and numbers", other, long))
    return [Row("intervals", max(changes)), Row("scatter", max(scatters))]


def _mean(problem: IdentificationProblem, seeds: Sequence[int]) -> np.ndarray:
    """Standard deviations and widths (2, k) of identifications with these random numbers."""
    sums = np.zeros((2, len(problem.parameters)))
    for seed in seeds:  # each holds its samples
        found = identify(problem, "sdp", seed=seed)
        sums += found.std**2, np.ptp(found.ci95, axis=1)
    std, width = np.sqrt(sums[0] / len(seeds)), sums[1] / len(seeds)
    return np.array([std, width])[:, np.isfinite(std) & (std > 0)]


def _show(machine: str, label: str, one: np.ndarray, other: np.ndarray) -> float:
    """The worst change of a width [%]."""
    std, width = one / other - 1
    print(f"{machine:>14} {label:>38} {100 * np.max(np.abs(std)):10.4f} % {100 * np.max(np.abs(width)):16.4f} % "
          f"{100 * np.mean(width):6.2f} %", flush=True)
    return float(100 * np.max(np.abs(width)))


def _rounded(sample: Any) -> Any:
    def made(problem: Any, R: np.ndarray, r: np.ndarray, *more: Any, **options: Any) -> Any:
        noise = np.random.default_rng(0).uniform(-ROUNDING, ROUNDING, R.shape)
        return sample(problem, R * (1 + noise), r, *more, **options)

    return made
