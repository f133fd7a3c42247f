"""An excavator on a slope, surveyed from two set-ups: recovery, accuracy of the bucket's edge, coverage."""

from pathlib import Path

import numpy as np

from hydroopt import KinematicModel, calibration_problem, load_machine, pose_problem, solve
from hydroopt.estimation.kinematic.calibration import optimum
from hydroopt.estimation.kinematic.observability import linearise, observability
from hydroopt.simulation.pose_table import simulate_poses

MACHINE = Path(__file__).parents[2] / "docs" / "how-to" / "survey.toml"
DRAWS, EACH, CANDIDATES, POINTS = 40, 8, 150, 300
"""Machines drawn from the file's confidences; poses of each of six groups; postures to choose from; postures at which
the edge is judged."""


def run() -> dict:
    """Errors of the edge [mm], relative to the chassis, and the part of the intervals that contain the truth."""
    machine = load_machine(MACHINE)
    model = KinematicModel(machine)
    plan = solve(pose_problem(machine, EACH, setups=("A", "B")), candidates=CANDIDATES)
    q = np.random.default_rng(0).uniform(*model.ranges.T, (POINTS, len(model.joints)))
    q[:, [model.joints.index(joint) for joint in machine.base_joints]] = 0.0

    def edge(geometry) -> np.ndarray:
        return model.over(model.tip, geometry, q)[0][:, :, 0]

    def rms(one, other) -> float:
        return 1e3 * float(np.sqrt(np.mean(np.sum((edge(one) - edge(other)) ** 2, axis=1))))

    count, within, before, after, exact = len(model.parameters), [], [], [], []
    for draw in range(DRAWS):
        for noise in (True, False) if draw < 2 else (True,):
            made = simulate_poses(model, plan.postures, random=True, noise=noise, seed=draw)
            problem = calibration_problem(machine, made.poses)
            found = optimum(problem, "joint", problem.start)
            true = np.array([made.truth[name] for name in problem.parameters.names])
            if not noise:
                exact.append(rms(found.theta[:count], true[:count]))
                continue
            seen = observability(problem, linearise(problem, found.theta, found.q))
            error = (found.theta - true)[problem.free]
            within.append((np.abs(error) < 1.959964 * seen.std)[np.isfinite(seen.std)])
            before.append(rms(problem.start[:count], true[:count]))
            after.append(rms(found.theta[:count], true[:count]))
    return {"poses": len(plan.q), "parameters": len(within[0]), "machines": DRAWS,
            "coverage": round(float(np.mean(within)), 3),
            "edge_nominal_mm": round(float(np.median(before)), 1), "edge_mm": round(float(np.median(after)), 2),
            "edge_worst_mm": round(max(after), 2), "edge_without_noise_mm": round(max(exact), 3)}
