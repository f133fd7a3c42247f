"""Work of the study that runs in processes of its own."""

from __future__ import annotations

import numpy as np

from hydroopt import Model, identification_problem, load_machine, simulate, solve
from hydroopt.excitation.motion.problem import ExcitationProblem
from hydroopt.excitation.motion.random_motion import random_motion, resting_posture
from hydroopt.simulation.simulate import Trajectory


def random_motions(program: ExcitationProblem, seeds: range) -> list[tuple[float, np.ndarray]]:
    """Criterion and variables of a random feasible motion of each seed."""
    still = resting_posture(program, np.random.default_rng(0))
    motions = [random_motion(program, still, np.random.default_rng((7, seed))) for seed in seeds]
    return [(program.value(x), x) for x in motions]


def identified(path: Trajectory, seeds: range) -> list[tuple[tuple[int, ...], np.ndarray, np.ndarray]]:
    """Basis, base parameters and ψ by weighted least squares of a simulated log of each seed."""
    machine = load_machine("cat215b")
    model = Model(machine)
    found = []
    for seed in seeds:
        log = simulate(model, path, seed=seed)
        estimate = solve(identification_problem(machine, [log]), "wls")
        found.append((estimate.identifiability.basis, estimate.base_value, estimate.psi))
    return found
