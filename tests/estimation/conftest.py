"""Machines and simulated logs that the estimation's tests share, made once."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from fixtures.periodic import PERIOD, PERIODIC
from hydroopt.estimation.dynamic.estimate import Estimate
from hydroopt.estimation.dynamic.identify import identify
from hydroopt.estimation.dynamic.problem import IdentificationProblem, identification_problem
from hydroopt.logs.log import Log
from hydroopt.machine.links import Note
from hydroopt.machine.machine import Machine
from hydroopt.machine.machine_file import load_machine
from hydroopt.model.model import Model
from hydroopt.simulation.simulate import random_trajectory, random_truth, simulate

Logs = Callable[..., list[Log]]


@pytest.fixture(scope="session")
def cat215b() -> Model:
    return Model(load_machine("cat215b"))


@pytest.fixture(scope="session")
def cat_truth(cat215b: Model) -> np.ndarray:
    return random_truth(cat215b, 4)


@pytest.fixture(scope="session")
def record() -> Logs:
    """Logs of random motions of a model with the parameters ψ, one a seed."""

    def logs(
        model: Model, psi: np.ndarray, seeds: tuple[int, ...], *, rate: float = 12.5, noise: bool = False
    ) -> list[Log]:
        return [simulate(model, random_trajectory(model, duration=PERIOD, rate=rate, seed=seed), psi, noise=noise,
                         seed=seed, name=f"motion {seed}") for seed in seeds]
    return logs


@pytest.fixture(scope="session")
def exact_logs(cat215b: Model, cat_truth: np.ndarray, record: Logs) -> list[Log]:
    """Five motions of the excavator as perfect sensors see them."""
    return record(cat215b, cat_truth, (1, 2, 3, 4, 99))


@pytest.fixture(scope="session")
def exact(cat215b: Model, exact_logs: list[Log]) -> IdentificationProblem:
    return identification_problem(cat215b.machine, exact_logs[:-1], exact_logs[-1:], smoothing=PERIODIC)


@pytest.fixture(scope="session")
def noisy(cat215b: Model, cat_truth: np.ndarray, record: Logs) -> IdentificationProblem:
    """Two motions of the excavator as its own sensors see them, and a third to judge by."""
    logs = record(cat215b, cat_truth, (1, 2, 99), noise=True)
    return identification_problem(cat215b.machine, logs[:-1], logs[-1:], smoothing=PERIODIC)


@pytest.fixture(scope="session")
def noisy_estimate(noisy: IdentificationProblem) -> Estimate:
    """The physically consistent estimate of these motions, with intervals."""
    return identify(noisy, "sdp")


WHEEL = {
    "name": "wheel", "links": [{"name": "wheel", "parent": "base",
                                "joint": {"type": "revolute", "lower": -3.0, "upper": 3.0, "max_speed": 2.0}}],
    "drives": [{"name": "drive", "joint": "wheel", "rotor_inertia": 2.0,
                "friction": {"offset": 0.0, "coulomb": 5.0, "viscous": 3.0}}]}
"""The smallest machine: torque = offset + coulomb·sign(ω) + viscous·ω + inertia·ω̇."""


@pytest.fixture(scope="session")
def wheel() -> Model:
    return Model(Machine.model_validate(WHEEL))


@pytest.fixture(scope="session")
def one_body() -> Callable[..., IdentificationProblem]:
    """A problem whose only unknown is one body about which the machine file says `phi` ± `sigma`."""
    def problem(phi: np.ndarray, sigma: tuple[float, float, float] = (1.0, 1.0, 1.0)) -> IdentificationProblem:
        link = {"name": "arm", "parent": "base", "joint": {"type": "revolute", "lower": -1.0, "upper": 1.0},
                "body": {"m": phi[0], "mc": tuple(phi[1:4]), "inertia": tuple(phi[4:])}}
        notes = {f"arm.body.{key}": Note(sigma=s) for key, s in zip(("m", "mc", "inertia"), sigma, strict=True)}
        return IdentificationProblem(Model(Machine.model_validate(
            {"name": "arm", "links": [link], "drives": [{"name": "drive", "joint": "arm"}], "notes": notes})), ())
    return problem
