"""Nominal, reduced and complete models side by side (Figure 37)."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from fixtures.periodic import PERIODIC
from hydroopt.estimation.dynamic.estimate import Estimate
from hydroopt.estimation.dynamic.identify import identify
from hydroopt.estimation.dynamic.problem import IdentificationProblem, identification_problem
from hydroopt.estimation.inference.conditions import consistency
from hydroopt.logs.log import Log
from hydroopt.machine.machine_file import load_machine
from hydroopt.model.model import Model
from hydroopt.parameters.dynamic import bodies
from hydroopt.report.identification import render
from hydroopt.simulation.simulate import random_trajectory, simulate


def ends(problem: IdentificationProblem) -> np.ndarray:
    """Positions of the parameters of barrels and rods."""
    small = bodies(problem.model.machine, actuator_inertia=False)
    return np.concatenate([np.arange(len(problem.parameters))[columns] for owner, columns
                           in problem.parameters.bodies.items() if owner not in small])


@pytest.mark.slow
def test_a_machine_without_barrels_and_rods_is_recovered_exactly_by_the_reduced_model(
        cat215b: Model, exact: IdentificationProblem, record: Callable[..., list[Log]], cat_truth: np.ndarray) -> None:
    truth = cat_truth.copy()
    truth[ends(exact)] = 0.0
    logs = record(cat215b, truth, (1, 2, 99))
    problem = identification_problem(cat215b.machine, logs[:-1], logs[-1:], smoothing=PERIODIC)
    found = identify(problem.by_data_alone(), "wls")
    assert np.all(found.variants["reduced"][ends(problem)] == 0.0)
    for table in found.fit_by_model["reduced"].values():
        assert table["all"].vaf > 1 - 1e-9
    assert found.fit_by_model["nominal"]["validation"]["all"].vaf < 0.9


@pytest.fixture(scope="module")
def estimate(noisy: IdentificationProblem) -> Estimate:
    return identify(noisy, intervals=False)


@pytest.mark.slow
def test_the_reduced_model_predicts_as_one_that_is_identified_by_itself(estimate: Estimate,
                                                                        noisy: IdentificationProblem) -> None:
    machine = noisy.model.machine
    training, unseen = ([data.log for data in some] for some in (noisy.experiments, noisy.validation))
    alone = identify(identification_problem(machine, training, unseen, smoothing=PERIODIC, actuator_inertia=False),
                     intervals=False)
    assert list(alone.variants) == ["nominal", "reduced"]
    for data, table in alone.fit.items():
        for channel, fit in table.items():
            if channel != "all":
                assert estimate.fit_by_model["reduced"][data][channel].rms == pytest.approx(fit.rms, rel=0.02)
    links = [body for body in noisy.bodies if body.owner in bodies(machine, actuator_inertia=False)]
    assert len(links) == 3
    for body in links:
        assert consistency(body, len(noisy.parameters)).margin(estimate.variants["reduced"]) > 0


@pytest.mark.parametrize("method", ["wls", "ridge", "tsvd"])
def test_linear_methods_solve_the_columns_that_are_left(method: str, noisy: IdentificationProblem) -> None:
    found = identify(noisy.by_data_alone(), method)  # type: ignore[arg-type]
    weighted = found.weighted_residuals
    R, r = (weighted.R, weighted.r) if method == "wls" else weighted.plain[:2]
    kept = np.setdiff1d(np.arange(len(noisy.parameters)), ends(noisy))
    size = np.maximum(np.linalg.norm(R[:, kept], axis=0), 1e-12)
    best = np.linalg.lstsq(R[:, kept] / size, r, rcond=1e-9)[0] / size
    least, reached = (float(np.sum((R[:, kept] @ psi - r) ** 2)) for psi in (best, found.variants["reduced"][kept]))
    assert least * (1 - 1e-9) <= reached <= least * (1.0 + (1e-6 if method == "wls" else 0.05))


@pytest.mark.slow
def test_what_stands_side_by_side(estimate: Estimate, tmp_path: Path) -> None:
    assert list(estimate.variants) == ["nominal", "reduced", "complete"]
    assert estimate.variants["complete"] is estimate.psi
    assert estimate.fit_by_model["complete"] == estimate.fit
    data, error = estimate.problem.validation[0], estimate.predict(
        estimate.problem.validation[0].plotted, estimate.problem.parameters.nominal)
    inside = data.plotted.inside
    rms = np.sqrt(np.mean((data.plotted.force - error)[inside] ** 2, axis=0))
    assert estimate.fit_by_model["nominal"]["validation"]["boom_cylinder"].rms == pytest.approx(rms[1])
    estimate.save(tmp_path, pages={"report.html": render(estimate)})
    said = json.loads((tmp_path / "estimate.json").read_text())
    assert said["fit_by_model"]["complete"] == said["fit"]
    table = {(row["model"], row["data"], row["channel"]): float(row["rms"])
             for row in csv.DictReader(io.StringIO((tmp_path / "fit.csv").read_text()))}
    assert table == {(model, data, channel): one["rms"] for model, sets in said["fit_by_model"].items()
                     for data, fits in sets.items() for channel, one in fits.items()}
    page = (tmp_path / "report.html").read_text()
    assert "<h3>Models side by side</h3>" in page
    assert "Reduced: without barrels and rods, identified from the same residuals" in page
    printed = str(estimate).splitlines()
    assert printed[1].split()[-3:] == ["nominal", "reduced", "complete"]
    assert len(printed[2].split()) == 3 + 3 * 3


@pytest.mark.slow
def test_there_is_no_reduced_model_where_a_statement_binds_a_rod(noisy: IdentificationProblem) -> None:
    for bound in (noisy.fix("boom_cylinder.rod.m"), noisy.subject_to("weighed", "boom.m + boom_cylinder.rod.m <= 3 t"),
                  noisy.with_prior("rod", "boom_cylinder.rod.m = 100 +- 20 kg"),
                  noisy.subject_to("mine", lambda p: p["boom_cylinder.rod.m"] <= 3000.0)):
        assert list(identify(bound, intervals=False).variants) == ["nominal", "complete"]
    free = noisy.fix("boom.m").subject_to("weighed", "boom.m + stick.m <= 3 t").with_prior(
        "scales", "stick.m = 300 +- 90 kg")
    found = identify(free, intervals=False)
    nominal = noisy.parameters.nominal[noisy.parameters.index("boom.m")]
    assert found.variants["reduced"][noisy.parameters.index("boom.m")] == pytest.approx(nominal, rel=1e-6)


@pytest.mark.slow
def test_a_machine_without_barrels_has_two_models() -> None:
    model = Model(load_machine("panda_mukca"))
    log = simulate(model, random_trajectory(model, duration=8.0, rate=20.0, seed=1), seed=1)
    assert list(identify(identification_problem(model, [log]), "qp", intervals=False).variants) == [
        "nominal", "complete"]
