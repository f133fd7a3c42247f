"""What tracking gains on machines drawn from the file's confidences, each identified from its own valve test."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from hydroopt.control.cascade import Cascade
from hydroopt.control.setting import TRUE, ModelVariant, Setting
from hydroopt.control.tuning import tuned
from hydroopt.control.valve_test import driven_test, valve_test
from hydroopt.estimation.dynamic.identify import identify
from hydroopt.estimation.dynamic.problem import identification_problem
from hydroopt.estimation.hydraulic.estimate import identify_hydraulics
from hydroopt.estimation.hydraulic.problem import hydraulic_problem
from hydroopt.logs.smoothing import SmoothingSpline
from hydroopt.simulation.drive_valves import random_numbers
from hydroopt.simulation.simulate import random_truth
from hydroopt.spatial.inertia import Array
from hydroopt.support.progress import Progress, silent


class Draw(NamedTuple):
    """One machine: its seed, and the RMS distance of the tip [m] by what the feedforward knows.

    Distances are infinite where the machine hits its stops.
    """

    seed: int
    nominal: float
    identified: float


def draws(setting: Setting, count: int, *, progress: Progress = silent) -> tuple[Draw, ...]:
    """Machines with bodies, friction, valves and oil drawn, on the setting's motion.

    Each is driven through `valve_test`, identified from that log alone, and then follows the motion with the machine
    file's numbers and with the identified ones; gains are tuned by what is known.

    Args:
        setting: machine, motion, rate and sensitivity; seeds begin with its own.
        count: number of machines.
        progress: receives the part that is done.

    Raises:
        ProblemError: a drawn machine leaves its range in the test of its valves.
        SolverError: a plant could not be integrated.
    """
    plant, found = setting.plant, []
    test = valve_test(plant)
    smoothing = SmoothingSpline(bandwidth=test.bandwidth)
    for k in range(count):
        progress(f"machine {k + 1} of {count}", k / count)
        seed = (setting.seed or 0) + k
        psi, theta = random_truth(plant.model, seed), random_numbers(plant, seed)
        log = driven_test(test, psi, theta, rate=setting.rate, seed=seed)
        bodies = identify(identification_problem(plant.model, [log], smoothing=smoothing), intervals=False)
        problem = hydraulic_problem(plant.machine, [log])
        valves = problem.whole(identify_hydraulics(problem).adjustment.theta)
        here = replace(setting, true=ModelVariant(TRUE, "drawn", plant.model, psi), true_theta=theta, seed=seed)
        found.append(Draw(seed, tracked(here, plant.model.parameters.nominal, plant.parameters.nominal),
                          tracked(here, bodies.psi, valves)))
    return tuple(found)


def tracked(setting: Setting, psi: Array, theta: Array) -> float:
    """RMS distance of the tip [m] with the feedforward that knows ψ and θ, its gains tuned by them."""
    setting = replace(setting, theta=theta)
    valves, model = setting.demands.valves, setting.plant.model
    gains = tuned(setting.points(setting.plant, psi, theta), valves, setting.sensitivity)
    done = setting.run(Cascade(valves, setting.demands.by(model, psi), gains, 1 / setting.rate))
    return np.inf if done.stopped else float(np.sqrt(np.mean(setting.tip_error(done) ** 2)))


def spread(values: Sequence[float]) -> str:
    """Median and greatest of some distances [m], in millimetres."""
    return f"{1e3 * np.median(values):.1f} mm (at most {1e3 * np.max(values):.1f})"
