"""Machines drawn from their files, all but the geometry, and driven by their valves: intervals of valves and oil.

Delays are known to 10 ms beside that, and drawn like the rest; once they are stated 10 ms too short by a file that
knows them so, and once by one that takes them as exact.
"""

from contextlib import suppress
from pathlib import Path

import numpy as np

from hydroopt import hydraulic_problem, load_machine, solve
from hydroopt.errors import ProblemError, SolverError
from hydroopt.logs.log import Log
from hydroopt.machine.links import Note
from hydroopt.machine.machine import Machine
from hydroopt.model.model import Model
from hydroopt.model.plant import Plant
from hydroopt.simulation.drive_valves import commands_for, drive, random_numbers
from hydroopt.simulation.simulate import Trajectory, random_trajectory, random_truth

HERE = Path(__file__).parent
MACHINES = ("cat215b", "backhoe", "forestry_crane")
DRAWS, SECONDS, RATE = 20, 10.0, 50.0
KNOWN = 0.01
"""σ of the delays [s]."""
SIZES = 0.5 ** np.arange(7)
"""Parts of a random motion's amplitude, the first that supply and joint ranges allow being driven."""


def with_delays(machine: Machine, sigma: float | None, shift: float = 0.0) -> Machine:
    """The machine with its delays known so well, and moved; exact without a sigma."""
    values = {name: each.value + shift for name, each in machine.numbers.items() if name.endswith(".delay")}
    return machine.with_values(values, dict.fromkeys(values, Note(sigma=sigma)) if sigma else {})


def driven(plant: Plant, seed: int) -> tuple[Log, np.ndarray]:
    """A log of a machine whose every uncertain number of bodies, friction, valves and oil is drawn, and its true θ."""
    psi, theta = random_truth(plant.model, seed), random_numbers(plant, seed)
    motion = random_trajectory(plant.model, duration=SECONDS, rate=RATE, seed=1000 + seed)
    middle = np.mean(motion.q, axis=0)
    for size in SIZES:
        part = Trajectory(motion.t, middle + size * (motion.q - middle), size * motion.qd, size * motion.qdd)
        with suppress(ProblemError):
            commands = commands_for(plant, part, psi, theta)
            return drive(plant, motion.t, commands, part.q[0], psi=psi, theta=theta, seed=seed), theta
    raise ProblemError("no motion is possible", where=f"{plant.machine.name}, seed {seed}", remedy="drive less")


def run() -> dict:
    """Share of true numbers inside their 95 % intervals, by machine."""
    results: dict = {}
    cases = [(name, with_delays(load_machine(name), KNOWN), None) for name in MACHINES]
    cat = load_machine("cat215b")
    for sigma, case in ((KNOWN, "late_known"), (None, "late_exact")):
        cases.append((f"cat215b_{case}", cat, with_delays(cat, sigma, -KNOWN)))
    for name, machine, stated in cases:
        plant = Plant(Model(machine))
        inside, score = [], []
        for seed in range(DRAWS):
            log, theta = driven(plant, seed)
            with suppress(SolverError):
                estimate = solve(hydraulic_problem(stated or machine, [log]))
                true = dict(zip(plant.parameters.names, theta, strict=True))
                found, truth = estimate.posterior, np.array([true[each] for each in estimate.problem.parameters.names])
                inside.append((found.ci95[:, 0] <= truth) & (truth <= found.ci95[:, 1]))
                score.append((found.theta - truth) / np.sqrt(np.diag(found.covariance)))
        results |= {f"{name}_converged": len(inside), f"{name}_coverage": round(float(np.mean(inside)), 4),
                    f"{name}_standardised_error": round(float(np.sqrt(np.mean(np.square(score)))), 3),
                    f"{name}_largest_error": round(float(np.max(np.abs(score))), 1)}
    return results
