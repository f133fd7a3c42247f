"""Perfect sensors and exact derivatives: every estimator must give back the truth."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import pytest

from fixtures.closures import crank as slider_crank
from fixtures.closures import spherical, telescope
from fixtures.tiers import tiered
from hydroopt.estimation.dynamic.estimate import Estimate
from hydroopt.estimation.dynamic.identify import identify
from hydroopt.estimation.dynamic.problem import IdentificationProblem, identification_problem
from hydroopt.estimation.inference.identifiability import structural
from hydroopt.logs.smoothing import Fourier
from hydroopt.machine.machine import Machine
from hydroopt.machine.machine_file import load_machine
from hydroopt.model.model import Model
from hydroopt.simulation.simulate import random_truth

BODY = {"m": 40.0, "mc": (14.0, 1.0, 0.5), "inertia": (2.0, 0.1, 0.1, 9.0, 0.1, 9.0)}
EXACT = {"tolerance": 1e-9, "intervals": False}


def check(estimate: Estimate, truth: np.ndarray) -> None:
    """Unseen forces to 1e-9, base parameters of the ideal motion to 1e-6, or 1e-12 of the largest of them."""
    assert max(fit.relative for fit in estimate.fit["validation"].values()) < 1e-9
    grouping = structural(estimate.problem.model).grouping
    base = grouping @ truth
    np.testing.assert_allclose(grouping @ estimate.psi, base, rtol=1e-6, atol=1e-12 * np.max(np.abs(base)))


@pytest.mark.parametrize("method", tiered(["wls", "tsvd", "qp", "sdp", "nlp"], lambda method: method in ("wls", "sdp")))
def test_excavator_comes_back(method: Any, exact: IdentificationProblem, cat_truth: np.ndarray) -> None:
    check(identify(exact, method, **EXACT), cat_truth)


@cache
def crane() -> Machine:
    """The log crane whose lift cylinder has a barrel and a rod."""
    data = load_machine("patu655_lift").model_dump()
    for end in ("barrel", "rod"):
        data["cylinders"][0][end]["body"] = BODY
    return Machine.model_validate(data)


@pytest.mark.parametrize("machine", [
    pytest.param(load_machine("kr300"), marks=pytest.mark.slow),
    pytest.param(load_machine("excavator_bucket"), marks=pytest.mark.slow), load_machine("patu655_lift"), crane(),
    *(pytest.param(made(), marks=pytest.mark.slow) for made in (telescope, slider_crank, spherical))],
                         ids=lambda machine: machine.name)
def test_other_machines_come_back(machine: Machine, record: Any) -> None:
    model = Model(machine)
    truth = random_truth(model, 3)
    logs = record(model, truth, (1, 2, 99))
    problem = identification_problem(machine, logs[:2], logs[2:], smoothing=Fourier(33.28, 20))
    for method in ("wls", "sdp"):
        check(identify(problem, method, **EXACT), truth)


@pytest.mark.parametrize("method", ["wls", "sdp"])
def test_reduced_model_suffices_where_cylinders_weigh_nothing(method: Any, record: Any) -> None:
    data = load_machine("cat215b").model_dump()
    for cylinder in data["cylinders"]:
        cylinder["barrel"]["body"] = cylinder["rod"]["body"] = None
    machine = Machine.model_validate(data)
    truth = random_truth(Model(machine), 3)
    logs = record(Model(machine), truth, (1, 2, 3, 4, 99))
    # the machine that has barrels and rods, reduced, is the machine that has none
    problem = identification_problem(load_machine("cat215b"), logs[:4], logs[4:], smoothing=Fourier(33.28, 20),
                                     actuator_inertia=False)
    assert problem.parameters.names == Model(machine).parameters.names
    check(identify(problem, method, **EXACT), truth)


def test_reduced_model_cannot_explain_barrels_and_rods(exact: IdentificationProblem, exact_logs: Any) -> None:
    reduced = identification_problem(exact.model.machine, exact_logs[:4], exact_logs[4:], smoothing=Fourier(33.28, 20),
                                     actuator_inertia=False)
    assert identify(reduced, "wls").fit["validation"]["boom_cylinder"].relative > 1e-5
