"""Bias by noisy angles: smoothing and least squares, instrumental variables, motion and parameters fitted together."""

import numpy as np

from hydroopt import (
    Butterworth,
    Log,
    Machine,
    Model,
    SmoothingSpline,
    identification_problem,
    load_machine,
    random_trajectory,
    random_truth,
    simulate,
    solve,
)

DRAWS = {0.03: 4, 0.1: 16, 0.3: 4}
"""Draws of the errors by the accuracy of the resolvers [deg], of which the thesis's is 0.1."""
SIGNS = ((1, 1), (1, -1), (-1, 1), (-1, -1))
"""Of the errors of angles and of pressures: in the mean over these all cancels that either has to an odd power."""


def run() -> dict:
    """Bias of predicted forces of the driven motion, RMS over samples and actuators, in the force sensors' σ."""
    results: dict = {}
    for level, draws in DRAWS.items():
        machine = with_resolvers(load_machine("cat215b"), np.deg2rad(level))
        found = biases(machine, draws)
        for name, (bias, uncertainty) in found.items():
            results[f"{name}_bias_at_{level}_deg"] = round(bias, 5)
            results[f"{name}_uncertainty_at_{level}_deg"] = round(uncertainty, 5)
        for better, worse in (("fitted", "spline"), ("fitted", "filter"), ("instruments", "filter")):
            results[f"{better}_cuts_{worse}_at_{level}_deg"] = round(found[worse][0] / found[better][0], 1)
    return results


def with_resolvers(machine: Machine, accuracy: float) -> Machine:
    sensors = [s.model_copy(update={"accuracy": accuracy, "resolution": 0.0}) if s.channels[0].endswith(".q") else s
               for s in machine.sensors]
    return machine.model_copy(update={"sensors": tuple(sensors)})


def biases(machine: Machine, draws: int) -> dict[str, tuple[float, float]]:
    """Bias of each way and its uncertainty."""
    model = Model(machine)
    truth = random_truth(model, 1)
    motion = random_trajectory(model, duration=33.28, rate=50, seed=2)
    clean = simulate(model, motion, truth, noise=False)
    K = model.over(model.regressor, motion.q, motion.qd, motion.qdd)[0]
    errors: dict[str, list] = {}
    for seed in range(draws):
        rng = np.random.default_rng(seed)
        off = {name: rng.uniform(-1, 1, len(clean.t)) * sensor.accuracy for name in clean.channels
               if (sensor := machine.sensor(name))}
        for of_angles, of_pressures in SIGNS:
            channels = {name: values + (of_angles if name.endswith(".q") else of_pressures) * off[name]
                        for name, values in clean.channels.items()}
            log = Log("noisy", clean.t, channels, units=clean.units)
            for name, problem in ways(machine, log, clean).items():
                psi = solve(problem, "wls").psi
                errors.setdefault(name, []).append(K @ (psi - truth) / problem.force_std)
    return {name: _bias(np.array(some)) for name, some in errors.items()}


def ways(machine: Machine, log: Log, reference: Log) -> dict:
    smooth = identification_problem(machine, [log], smoothing=SmoothingSpline(bandwidth=machine.bandwidth))
    filtered = identification_problem(machine, [log], smoothing=Butterworth(machine.bandwidth))
    return {"filter": filtered, "spline": smooth, "instruments": filtered.with_instruments([reference]),
            "fitted": smooth.with_fitted_motion()}


def _bias(errors: np.ndarray) -> tuple[float, float]:
    means = errors.reshape(-1, len(SIGNS), *errors.shape[1:]).mean(axis=1)
    bias = means.mean(axis=0)
    return float(np.sqrt(np.mean(bias**2))), float(np.sqrt(np.mean((means - bias) ** 2) / (len(means) - 1)))
