"""A crane's lift with valve and oil in doubt, driven up and down: intervals that hold the true numbers."""

from pathlib import Path

import numpy as np
from scipy.stats import truncnorm

from hydroopt import load_machine
from hydroopt.errors import SolverError
from hydroopt.estimation.hydraulic.estimate import identify_hydraulics
from hydroopt.estimation.hydraulic.problem import hydraulic_problem
from hydroopt.model.model import Model
from hydroopt.model.plant import Plant
from hydroopt.simulation.drive_valves import commands_for, drive
from hydroopt.simulation.simulate import Trajectory

HERE = Path(__file__).parent
LOGS, SECONDS, RATE = 60, 4.0, 50


def swing() -> Trajectory:
    """Up and down about 30 deg, slowly and fast, beginning and ending at rest."""
    t = np.arange(round(SECONDS * RATE)) / RATE
    turn, fade = 2 * np.pi / SECONDS, np.sin(np.pi * t / SECONDS) ** 2
    q = np.radians(30) + fade * (np.radians(5) * np.sin(1.5 * turn * t) + np.radians(2) * np.sin(5 * turn * t))
    qd = np.gradient(q, t)
    return Trajectory(t, q[:, None], qd[:, None], np.gradient(qd, t)[:, None])


def run() -> dict:
    """Share of true numbers inside their 95 % intervals, truths drawn from the machine file's confidences."""
    plant = Plant(Model(load_machine(str(HERE / "crane.toml"))))
    motion = swing()
    commands = commands_for(plant, motion)
    rng = np.random.default_rng(1)
    inside, score, narrower, failed = [], [], [], 0
    for k in range(LOGS):
        blank = hydraulic_problem(plant.machine, [drive(plant, motion.t, commands, motion.q[0], noise=False)])
        known = blank.parameters
        truth = truncnorm.rvs((known.lower - known.nominal) / known.scale, (known.upper - known.nominal) / known.scale,
                              known.nominal, known.scale, random_state=rng)
        psi, theta = (np.asarray(part).ravel() for part in blank.split(truth))
        log = drive(plant, motion.t, commands, motion.q[0], psi=psi, theta=theta, seed=k)
        try:
            found = identify_hydraulics(hydraulic_problem(plant.machine, [log])).shooting
        except SolverError:
            failed += 1
            continue
        inside.append((found.ci95[:, 0] <= truth) & (truth <= found.ci95[:, 1]))
        score.append((found.theta - truth) / np.sqrt(np.diag(found.covariance)))
        narrower.append(np.sqrt(np.diag(found.covariance)) / known.scale)
    held, deviation = np.mean(inside, axis=0), np.median(narrower, axis=0)
    results = {"logs": len(inside), "failed": failed, "numbers_per_log": len(known),
               "pooled_coverage": round(float(np.mean(held)), 4), "lowest_coverage": round(float(np.min(held)), 3),
               "lowest_coverage_of": known.names[int(np.argmin(held))],
               "standardised_error": round(float(np.std(score)), 3)}
    for name, part in zip(known.names, deviation, strict=True):
        results[f"σ of {name}, part of its prior's"] = round(float(part), 4)
    return results
