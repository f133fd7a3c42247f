"""The excavator with its bucket linkage: what comes back without noise, and whether intervals hold with it."""

import tempfile

import numpy as np
from numpy.linalg import norm

from hydroopt import Model, identification_problem, load_machine, random_truth, simulate, solve
from hydroopt.estimation.inference.identifiability import structural
from hydroopt.logs.smoothing import Fourier
from hydroopt.machine.machine import Machine
from hydroopt.simulation.simulate import random_trajectory
from hydroopt.study.montecarlo import montecarlo
from hydroopt.study.run import run as computed

CELLS = 60
"""Machines drawn from the file's confidences, each on a random motion of its own of 33 s."""
PERIOD = 33.28
LINKAGE = ("rocker", "coupler")
FRICTION = "swing_motor.tau_coulomb"
"""Covered in only two of the first five draws that were looked at."""


def run() -> dict:
    machine = load_machine("excavator_bucket")
    return without_noise(machine) | coverage(machine)


def without_noise(machine: Machine) -> dict:
    """Perfect sensors on two motions: base parameters, and forces of a third, with and without the linkage's bodies."""
    model = Model(machine)
    truth = random_truth(model, 3)
    logs = [simulate(model, random_trajectory(model, duration=PERIOD, rate=12.5, seed=seed), truth, noise=False,
                     name=f"motion {seed}") for seed in (1, 2, 99)]

    def unseen(known: Machine, method: str) -> tuple[np.ndarray, dict[str, float]]:
        problem = identification_problem(known, logs[:2], logs[2:], smoothing=Fourier(PERIOD, 20))
        estimate = solve(problem, method, tolerance=1e-9, intervals=False)
        return estimate.psi, {name: fit.relative for name, fit in estimate.fit["validation"].items() if name != "all"}

    found, errors = unseen(machine, "wls")
    grouping = structural(model).grouping
    base = grouping @ truth
    links = tuple(link.model_copy(update={"body": None}) if link.name in LINKAGE else link for link in machine.links)
    _, light = unseen(machine.model_copy(update={"links": links}), "sdp")
    _, whole = unseen(machine, "sdp")
    return {"parameters": len(model.parameters), "rank": len(base),
            "noise_free_unseen_force_error": max(errors.values()),
            "noise_free_base_parameter_error": float(norm(grouping @ found - base) / norm(base)),
            "noise_free_unseen_force_error_physically_possible": max(whole.values()),
            "without_linkage_bodies_bucket_error": round(light["bucket_cylinder"], 4)}


def coverage(machine: Machine) -> dict:
    """Share of true parameters inside their 95 % intervals."""
    with tempfile.TemporaryDirectory() as folder:
        table = computed(montecarlo(machine, cells=CELLS), folder, workers=2)
    names = [key.removesuffix(".inside") for key in table.results[0] if key.endswith(".inside")]
    held = {name: float(np.mean(values)) for name in names if not name.endswith(" in all")
            and np.all(np.isfinite(values := table.column(f"{name}.inside")))}
    error = (table.column(f"{FRICTION}.value") - table.column(f"{FRICTION}.truth")) / table.column(f"{FRICTION}.std")
    return {"machines": len(table.results), "intervals_per_machine": len(held),
            "pooled_coverage": round(float(np.mean(list(held.values()))), 4),
            "lowest_coverage": round(min(held.values()), 3), "lowest_coverage_of": min(held, key=held.__getitem__),
            "swing_friction_coverage": round(held[FRICTION], 3),
            "swing_friction_error_in_sigma_RMS": round(float(np.sqrt(np.mean(error**2))), 2)} | {
                f"unseen_{actuator.name}_median": round(float(np.median(table.column(f"{actuator.name}.rms"))), 3)
                for actuator in machine.actuators}
