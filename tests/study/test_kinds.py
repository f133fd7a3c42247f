"""What the kinds of studies compute, against theory and by other ways."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.signal import lfilter

from hydroopt import Model, identification_problem, load_machine, random_truth, simulate, solve
from hydroopt.errors import HydrooptError, ProblemError
from hydroopt.logs.forces_from_pressures import force_noise
from hydroopt.logs.log import Log
from hydroopt.machine.machine import Machine
from hydroopt.parameters.dynamic import carried
from hydroopt.simulation.simulate import forces, random_trajectory
from hydroopt.study.bootstrap import block_length, bootstrap, redrawn
from hydroopt.study.bootstrap import summary as bootstrap_summary
from hydroopt.study.montecarlo import montecarlo, unseen_error
from hydroopt.study.montecarlo import summary as montecarlo_summary
from hydroopt.study.study import Study
from hydroopt.study.table import Table


def table(study: Study) -> Table:
    return Table(study.cells, tuple({"result": study.function(**cell)} for cell in study.cells))


@pytest.fixture(scope="module")
def crane() -> Model:
    return Model(load_machine("patu655_lift"))


@pytest.mark.slow
def test_a_cell_is_what_a_user_would_do_by_hand(crane: Model) -> None:
    from hydroopt.study.study import seeds

    study = montecarlo(crane.machine, cells=2, seed=4, duration=6.0, rate=50.0)
    result = study.function(**study.cells[1])
    of_truth, of_motion, of_noise, of_sampling = seeds(study.cells[1]["seed"], 4)
    truth = random_truth(crane, of_truth)
    motion = random_trajectory(crane, duration=6.0, rate=50.0, seed=of_motion)
    estimate = solve(identification_problem(crane.machine, [simulate(crane, motion, truth, seed=of_noise)]),
                     seed=of_sampling)
    for k, name in enumerate(crane.parameters.names):
        assert result[f"{name}.truth"] == truth[k]
        np.testing.assert_equal(result[f"{name}.value"], estimate.value[k])
        low, high = estimate.ci95[k]
        assert result[f"{name}.inside"] == (None if np.isnan(low) else low <= truth[k] <= high)
    unseen = random_trajectory(crane, duration=30.0, rate=50.0, seed=4)
    error = forces(crane, unseen, estimate.psi) - forces(crane, unseen, truth)
    expected = float(np.sqrt(np.mean(error**2)) / force_noise(crane)[0])
    assert result["lift_cylinder.rms"] == pytest.approx(expected, rel=1e-9)


def test_seals_and_stribeck_speeds_are_predicted_as_they_are(crane: Model) -> None:
    data = crane.machine.model_dump()
    data["cylinders"][0]["friction"] |= {"offset": 0.0, "seal": 3e-4, "stribeck": 900.0, "stribeck_speed": 0.03}
    study = montecarlo(Machine.model_validate(data), cells=1, duration=6.0)
    trial: Any = study.function
    model = Model(trial.machine)
    psi = model.parameters.nominal.copy()
    np.testing.assert_allclose(unseen_error(trial, psi, psi), 0.0, atol=1e-12)
    psi[model.parameters.index("lift_cylinder.f_offset")] += 1000.0
    np.testing.assert_allclose(unseen_error(trial, model.parameters.nominal, psi), 1000.0 / force_noise(model))


def test_the_summary_counts_what_the_cells_say(crane: Model) -> None:
    study = montecarlo(crane.machine, cells=4, duration=6.0)
    rng = np.random.default_rng(0)
    value = rng.standard_normal(4)
    links = [f"{link} in all" for link in carried(crane.machine)]
    blank = {f"{name}.{key}": float("nan") for name in (*crane.parameters.names, *links)
             for key in ("truth", "value", "std", "inside")}
    results = [{"result": {**blank, "lift.m.truth": 10.0, "lift.m.value": 10.0 + v, "lift.m.std": 2.0,
                           "lift.m.inside": int(k != 2), "lift_cylinder.rms": float(k)}} for k, v in enumerate(value)]
    cells = (*study.cells, {**study.cells[0], "seed": 1})
    failed = {"error": "cell: nothing; measure more."}
    (point,) = montecarlo_summary(study, Table(cells, (*results, failed)))["points"]
    (row,) = point["parameters"]
    assert (point["cells"], point["failed"], point["failures"]) == (5, 1, [{"error": failed["error"], "cells": [4]}])
    assert row["bias"] == pytest.approx(sum(value) / 4)
    scatter = (sum((v - sum(value) / 4) ** 2 for v in value) / 3) ** 0.5
    assert row["scatter"] == pytest.approx(scatter)
    assert row["scatter_over_stated"] == pytest.approx(scatter / 2)
    assert row["coverage"] == point["coverage"] == 0.75
    assert point["coverage_std_error"] == pytest.approx(0.25)  # of 1, 1, 0, 1: σ 0.5 over √4
    assert point["prediction"]["lift_cylinder"]["median"] == 1.5


@pytest.mark.slow
def test_a_sweep_is_a_product_in_which_better_sensors_predict_better(crane: Model) -> None:
    study = montecarlo(crane.machine, cells=4, method="wls", vary={"accuracy": [0.1, 4.0], "duration": [15.0, 25.0]})
    assert len({cell["seed"] for cell in study.cells}) == len(study.cells) == 16
    points = montecarlo_summary(study, table(study))["points"]
    assert [tuple(point["values"].values()) for point in points] == [
        (15.0, 100.0, 0.1), (25.0, 100.0, 0.1), (15.0, 100.0, 4.0), (25.0, 100.0, 4.0)]
    medians = [point["prediction"]["lift_cylinder"]["median"] for point in points]
    assert medians[0] < medians[2]
    assert medians[1] < medians[3]


def test_a_given_motion_is_the_same_in_all_cells(crane: Model) -> None:
    motion = random_trajectory(crane, duration=6.0, rate=100.0, seed=9)
    study = montecarlo(crane.machine, cells=3, method="wls", motion=motion, motion_sha256="of the file")
    assert study.identity["motion_sha256"] == "of the file"
    assert {frozenset(cell) for cell in study.cells} == {frozenset({"seed"})}
    first, second, third = (study.function(**cell) for cell in (*study.cells[:2], study.cells[0]))
    np.testing.assert_equal(first, third)
    assert first["lift.m.truth"] != second["lift.m.truth"]
    with pytest.raises(ProblemError, match="a given motion has its own rate"):
        montecarlo(crane.machine, cells=3, motion=motion, vary={"rate": [50.0]})


@pytest.mark.slow
@pytest.mark.parametrize("rho", [0.0, 0.5, 0.9])
def test_blocks_keep_the_variance_of_a_mean(rho: float) -> None:
    """Of a first-order process: Σ(1 − |k|/b)·ρ^|k| over |k| < b of N⁻¹ by theory, less b/N as its mean is taken off."""
    count, rng, time = 4000, np.random.default_rng(1), (1 + rho) / (1 - rho)
    block, ratios = block_length(time, count), []
    for _ in range(40):
        x = lfilter([np.sqrt(1 - rho**2)], [1, -rho], rng.standard_normal(count + 200))[200:]
        ratios.append(np.var([redrawn(x, block, rng).mean() for _ in range(200)]) * count / time)
    lags = np.arange(1, block)
    theory = (1 + 2 * np.sum((1 - lags / block) * rho**lags)) / time - block / count
    assert np.mean(ratios) == pytest.approx(theory, abs=0.06)
    assert theory > 0.85


def test_block_length_is_that_of_politis_and_white() -> None:
    """For ρ = 0.5 and N = 1000, from their formula by hand: (√6·0.5/0.75)^⅔·10 = 13.87."""
    assert block_length(3.0, 1000) == 14
    assert block_length(1.0, 1000) == 1
    assert block_length(1e6, 100) == 25


@pytest.mark.slow
def test_scatter_of_the_bootstrap_is_that_of_new_measurements(crane: Model) -> None:
    """Of the forces alone, whose noise is white here: what a new log's noise does, the bootstrap foretells from one.

    The angle is stated as exact as it is: smoothing it for 0.3 degrees leaves a slow error of the forces, which the
    bootstrap takes for noise with a memory.
    """
    data = crane.machine.model_dump()
    (angle,) = (sensor for sensor in data["sensors"] if "lift.q" in sensor["channels"])
    data["bandwidth"], angle["accuracy"] = None, 1e-7
    crane = Model(Machine.model_validate(data))
    motion = random_trajectory(crane, duration=60.0, rate=50.0, seed=2)
    clean = simulate(crane, motion, random_truth(crane, 3), noise=False)
    rng = np.random.default_rng(5)

    def measured() -> Log:
        noisy = {name: values + 2e4 * rng.standard_normal(len(values)) if ".p_" in name else values
                 for name, values in clean.channels.items()}
        return replace(clean, channels=noisy)

    study = bootstrap(crane.machine, [measured()], cells=80, method="wls")
    summary = bootstrap_summary(study, table(study))
    assert summary["block_samples"]["lift_cylinder"] <= 6
    again = [solve(identification_problem(crane, [measured()]), "wls") for _ in range(80)]
    scatter = np.std([estimate.base_value for estimate in again], axis=0, ddof=1)
    foretold = np.array([row["scatter"] for row in summary["base_parameters"]])
    np.testing.assert_allclose(foretold / scatter, 1.0, atol=0.25)
    # what one log states varies by a sixth, since few frequencies tell the noise where the parameters act
    stated = np.sqrt(np.mean([estimate.base_std**2 for estimate in again], axis=0))
    np.testing.assert_allclose(stated / scatter, 1.0, atol=0.25)


@pytest.mark.parametrize("vary", [{"mass": [1.0]}, {"rate": []}, {"rate": [50.0, 50.0]}, {"accuracy": [float("nan")]}])
def test_what_cannot_be_varied_is_refused(vary: dict[str, list[float]], crane: Model) -> None:
    with pytest.raises(HydrooptError, match="--vary"):
        montecarlo(crane.machine, cells=1, vary=vary)
