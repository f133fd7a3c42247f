"""Bias of forces identified from resolvers alone, with gyroscopes and with whole IMUs beside them."""

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
from hydroopt.machine.links import Note
from hydroopt.simulation.simulate import Trajectory

CASES = {"cat215b_slow": ("cat215b", 0.3, 16), "cat215b_fast": ("cat215b", 1.0, 8),
         "excavator_bucket_slow": ("excavator_bucket", 0.3, 8), "excavator_bucket_fast": ("excavator_bucket", 1.0, 4)}
"""Machine, fastest sine of its motion [Hz], and draws of the errors."""
DURATION, RATE = 30.0, 100.0
ANGLE = np.radians(0.1)
"""Half width [rad] of the resolvers' errors."""
GYROSCOPE = {"noise": np.radians(0.01), "bias": np.radians(0.2)}
ACCELEROMETER = {"noise": 100e-6 * 9.80665, "bias": 5e-3 * 9.80665}
PLACE, TURN = 0.05, np.radians(3.0)
"""How well it is known where the units sit [m, rad]."""
SIGNS = ((1, 1), (1, -1), (-1, 1), (-1, -1))
"""Of the errors of the motion's sensors and of the pressures: in the mean over these all cancels that either has to an
odd power."""


def run() -> dict:
    """Bias of predicted forces, RMS over samples and actuators, in the force sensors' σ."""
    results: dict = {}
    for case, (name, fastest, draws) in CASES.items():
        found = biases(name, fastest, draws)
        for way, (bias, uncertainty) in found.items():
            results[f"{way}_bias_{case}"] = round(bias, 5)
            results[f"{way}_uncertainty_{case}"] = round(uncertainty, 5)
        for better in ("gyros", "imus"):
            for worse in ("filter", "spline"):
                results[f"{better}_cut_{worse}_{case}"] = round(found[worse][0] / found[better][0], 1)
    return results


def equipped(name: str) -> Machine:
    """A machine with a resolver at each joint and an IMU on each link, roughly placed."""
    machine = load_machine(name)
    data, notes = machine.model_dump(exclude={"notes"}), dict(machine.notes)
    units = [{"name": f"{joint}_imu", "link": joint, "position": (0.5, 0.2, 0.1), "rate": RATE,
              "gyroscope": GYROSCOPE, "accelerometer": ACCELEROMETER} for joint in machine.joints]
    for unit in units:
        notes |= {f"{unit['name']}.position": Note(sigma=PLACE), f"{unit['name']}.orientation": Note(sigma=TURN)}
    pressures = [sensor for sensor in data["sensors"] if ".p_" in sensor["channels"][0]]
    resolvers = {"channels": tuple(f"{joint}.q" for joint in machine.joints), "accuracy": ANGLE, "rate": RATE}
    return Machine.model_validate(data | {"imus": units, "sensors": [*pressures, resolvers], "notes": notes})


def biases(name: str, fastest: float, draws: int) -> dict[str, tuple[float, float]]:
    """Bias of each way in the driven motion, and its uncertainty."""
    machine = equipped(name)
    model = Model(machine)
    truth = random_truth(model, 1)
    course = random_trajectory(model, duration=DURATION, rate=RATE, seed=2, fastest=fastest)
    K = model.over(model.regressor, course.q, course.qd, course.qdd)[0]
    errors: dict[str, list] = {}
    for seed in range(draws):
        for log in readings(machine, course, truth, seed):
            for way, problem in ways(model, log).items():
                psi = solve(problem, "wls").psi
                errors.setdefault(way, []).append(K @ (psi - truth) / problem.force_std)
    return {way: _bias(np.array(some)) for way, some in errors.items()}


def readings(machine: Machine, course: Trajectory, truth: np.ndarray, seed: int) -> list[Log]:
    """Logs of one draw of all errors: noise, biases and places of the units, by signs."""
    rng = np.random.default_rng(seed)
    off = {name: machine.notes[machine.numbers[name].path].sigma * rng.normal() for name in sorted(machine.imu_numbers)}
    clean = {sign: simulate(Model(machine.with_values(
        {name: machine.numbers[name].value + sign * size for name, size in off.items()})), course, truth, noise=False)
        for sign in (1, -1)}
    errors = {}
    for channel in clean[1].channels:
        sensor = machine.sensor(channel)
        if sensor is not None:
            uniform = sensor.distribution == "uniform"
            errors[channel] = sensor.accuracy * (rng.uniform(-1, 1, len(course.t)) if uniform
                                                 else rng.normal(size=len(course.t)))
    for imu in machine.imus:
        for channel in imu.channels:
            errors[channel] += rng.normal(0.0, imu.part(channel).bias)
    return [Log("noisy", course.t, {
        channel: values + (of_forces if ".p_" in channel else of_motion) * errors.get(channel, 0.0)
        for channel, values in clean[of_motion].channels.items()}) for of_motion, of_forces in SIGNS]


def ways(model: Model, log: Log) -> dict:
    """Problems by what the motion is made of."""
    resolvers = without(log, "_imu.")
    bandwidth = model.machine.bandwidth
    return {"filter": identification_problem(model, [resolvers], smoothing=Butterworth(bandwidth)),
            "spline": identification_problem(model, [resolvers], smoothing=SmoothingSpline(bandwidth=bandwidth)),
            "gyros": identification_problem(model, [without(log, ".accel_")]),
            "imus": identification_problem(model, [log])}


def without(log: Log, part: str) -> Log:
    return Log(log.name, log.t, {channel: values for channel, values in log.channels.items() if part not in channel})


def _bias(errors: np.ndarray) -> tuple[float, float]:
    means = errors.reshape(-1, len(SIGNS), *errors.shape[1:]).mean(axis=1)
    bias = means.mean(axis=0)
    return float(np.sqrt(np.mean(bias**2))), float(np.sqrt(np.mean((means - bias) ** 2) / (len(means) - 1)))
