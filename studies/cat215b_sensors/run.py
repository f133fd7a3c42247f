"""CAT 215B with the thesis's sensors: least squares against the physically possible estimate, on unseen motion."""

import numpy as np

from hydroopt import Model, identification_problem, load_machine, random_trajectory, random_truth, simulate, solve
from hydroopt.logs.forces_from_pressures import force_noise

SEEDS = 20


def run() -> dict:
    """Prediction of noise-free forces of a motion nobody fitted, in standard deviations of each force sensor."""
    machine = load_machine("cat215b")
    model = Model(machine)
    noise = force_noise(model)
    unseen = random_trajectory(model, duration=30, rate=50, seed=10_000)
    K = model.over(model.regressor, unseen.q, unseen.qd, unseen.qdd)[0]
    errors: dict[str, list] = {"nominal": [], "wls": [], "sdp": []}
    inconsistent = 0
    for seed in range(SEEDS):
        truth = random_truth(model, seed)
        motion = random_trajectory(model, duration=33.28, rate=50, seed=100 + seed)
        problem = identification_problem(machine, [simulate(model, motion, truth, seed=seed)])
        forces = K @ truth
        found = {"nominal": model.parameters.nominal}
        for method in ("wls", "sdp"):
            estimate = solve(problem, method)
            found[method] = estimate.psi
        inconsistent += sum(smallest <= 0 for smallest in estimate.consistency.values())
        for method, psi in found.items():
            errors[method].append(np.sqrt(np.mean((K @ psi - forces) ** 2, axis=0)) / noise)
    results: dict = {"inconsistent_bodies": int(inconsistent)}
    for method, table in errors.items():
        for actuator, median, worst in zip(machine.actuators, np.median(table, axis=0), np.max(table, axis=0),
                                           strict=True):
            results[f"{method}_{actuator.name}_median"] = round(float(median), 4)
            results[f"{method}_{actuator.name}_worst"] = round(float(worst), 4)
    return results
