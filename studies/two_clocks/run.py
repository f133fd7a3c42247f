"""Two clocks, 20 ms and 0.3 % apart: what is recovered of them, and what forces lose."""

import numpy as np

from hydroopt import (
    Log,
    Machine,
    Model,
    Recording,
    identification_problem,
    load_machine,
    random_trajectory,
    random_truth,
    sensor_problem,
    simulate,
    solve,
)
from hydroopt.logs.clock import Clock
from hydroopt.machine.links import Note

LATE, FAST = 0.02, 0.003
"""Delay [s] and drift of the second clock."""
UNKNOWN = Clock(0.0, 0.05, 0.0, 0.005)
"""What is known of it before."""
DURATION, RATE = {"motion": 30.0, "forces": 60.0}, {"motion": 50.0, "forces": 100.0}
"""Of the logs [s, Hz], by what tells the second clock."""
SEEDS = 20


def run() -> dict:
    """By case: how many 95 % intervals hold the truth, and errors of unseen forces over those with one clock."""
    results: dict = {}
    for case, one in CASES.items():
        found = [one(seed) for seed in range(SEEDS)]
        z = np.array([each["z"] for each in found])
        results |= {
            f"runs_{case}": SEEDS,
            f"held_{case}": float(np.mean(np.abs(z) < 1.96)),
            f"rms_z_{case}": float(np.sqrt(np.mean(z**2))),
            f"delay_std_ms_{case}": 1e3 * float(np.median([each["std"][0] for each in found])),
            f"drift_std_ppm_{case}": 1e6 * float(np.median([each["std"][1] for each in found])),
            f"forces_{case}": _over([each["recovered"] for each in found], [each["one"] for each in found])}
        if "ignored" in found[0]:
            results[f"forces_ignored_{case}"] = _over([each["ignored"] for each in found],
                                                      [each["one"] for each in found])
    return results


def _over(errors: list[float], sound: list[float]) -> float:
    return float(np.sqrt(np.mean(np.square(errors)) / np.mean(np.square(sound))))


def excavator_with_imus() -> Machine:
    """The CAT 215B with an IMU on each link beside its resolvers."""
    machine = load_machine("cat215b")
    data, notes = machine.model_dump(exclude={"notes"}), dict(machine.notes)
    units = [{"name": f"{joint}_imu", "link": joint, "position": (0.5, 0.2, 0.1), "rate": RATE["motion"],
              "gyroscope": {"noise": np.radians(0.01), "bias": np.radians(0.2)},
              "accelerometer": {"noise": 100e-6 * 9.80665, "bias": 5e-3 * 9.80665}} for joint in machine.joints]
    for unit in units:
        notes |= {f"{unit['name']}.position": Note(sigma=0.05),
                  f"{unit['name']}.orientation": Note(sigma=np.radians(3.0))}
    return Machine.model_validate(data | {"imus": units, "notes": notes})


def by_motion(seed: int) -> dict:
    """IMUs on one clock, angles and pressures on the other: both groups tell the motion."""
    machine = excavator_with_imus()
    return _case(machine, seed, "motion", lambda channel: "_imu." not in channel, _clock_of_motion)


def by_forces(name: str):
    """Pressures on the other clock: only forces tell how late they are."""
    machine = load_machine(name)
    return lambda seed: _case(machine, seed, "forces", lambda channel: ".p_" in channel, _clock_of_forces)


def _clock_of_motion(model: Model, recording: Recording):
    found = solve(sensor_problem(model.machine, [recording], geometry=False)).parameters
    clock = [row for name, row in found.items() if name.endswith((": delay", ": drift"))]
    return np.array([row.value for row in clock]), np.array([row.std for row in clock]), solve(
        identification_problem(model, [recording.log()]), intervals=False)


def _clock_of_forces(model: Model, recording: Recording):
    log = recording.log()
    estimate = solve(identification_problem(model, [log]).free("delay", "clock"), intervals=False)
    # sizes are delays at the log's beginning, and from there to its end
    delay, grown = estimate.freed.size
    duration = log.t[-1] - log.t[0]
    part = grown / duration
    by = np.array([[1.0, -log.t[0] / duration], [0.0, 1.0 / duration]]) / (1 - part)
    clock = np.array([delay - part * log.t[0], part]) / (1 - part)
    return clock, np.sqrt(np.diag(by @ estimate.freed.covariance @ by.T)), estimate


def _case(machine: Machine, seed: int, by: str, later, clock_and_estimate) -> dict:
    model = Model(machine)
    truth = random_truth(model, 7 + seed)
    driven, unseen = (random_trajectory(model, duration=DURATION[by], rate=RATE[by], seed=100 + 2 * seed + k)
                      for k in range(2))
    log = simulate(model, driven, truth, seed=seed)
    exact = model.over(model.inverse_dynamics, unseen.q, unseen.qd, unseen.qdd, truth)[0][:, :, 0]

    def error(estimate) -> float:
        made = model.over(model.inverse_dynamics, unseen.q, unseen.qd, unseen.qdd, estimate.psi)[0][:, :, 0]
        return float(np.sqrt(np.mean(((made - exact) / exact.std(axis=0)) ** 2)))

    def plain(late: float, fast: float) -> float:
        recording = grouped(log, later, late, fast, {})
        return error(solve(identification_problem(model, [recording.log()]), intervals=False))

    clock, std, estimate = clock_and_estimate(model, grouped(log, later, LATE, FAST, {"other": UNKNOWN}))
    found = {"z": (clock - [LATE, FAST]) / std, "std": std, "recovered": error(estimate), "one": plain(0.0, 0.0)}
    # where motion tells of two clocks, a log that ignores them is searched for misread units at length
    return found if by == "motion" else found | {"ignored": plain(LATE, FAST)}


def grouped(log: Log, later, late: float, fast: float, clocks: dict) -> Recording:
    """The log as two loggers have it, the second of which has those channels, and a clock that is late and fast."""
    channels = {name: x for name, x in log.channels.items() if not name.endswith(".length")}
    parts = [{name: x for name, x in channels.items() if later(name) is second} for second in (False, True)]
    return Recording("drive", (Log("one", log.t, parts[0]),
                               Log("other", log.t * (1 + fast) + late, parts[1])), clocks=clocks)


CASES = {"by_motion_cat215b": by_motion} | {
    f"by_forces_{name}": by_forces(name) for name in ("cat215b", "excavator_bucket", "excavator_imu")}
