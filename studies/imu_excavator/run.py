"""An excavator with an IMU on each link and no joint sensor: mounting, angles, tip, and forces identified from it."""

import numpy as np

from hydroopt import (
    KinematicModel,
    Log,
    Machine,
    Model,
    Poses,
    identification_problem,
    load_machine,
    random_trajectory,
    sensor_problem,
    simulate,
    solve,
)
from hydroopt.estimation.motion.paths import motion
from hydroopt.machine.links import Note
from hydroopt.simulation.simulate import Trajectory, random_truth

SEEDS, FORCES = 100, 20
DURATION, RATE = 120.0, 100.0
STILLS, STILL_TIME, SURVEYED = 12, 2.0, (0, 5, 9)
SURVEY = 0.002
"""Standard deviation [m] of a surveyed coordinate."""
LENGTHS = 0.005
"""σ [m] of the lengths of links, in the second half of the study."""


def machine_of(lengths: float | None = None) -> Machine:
    """The excavator with IMUs, and a survey of the bucket's edge from the frame of the base."""
    machine = load_machine("excavator_imu")
    data = machine.model_dump(exclude={"notes"})
    survey = {"channels": ("tip.x", "tip.y", "tip.z"), "accuracy": SURVEY, "distribution": "gaussian"}
    notes = dict(machine.notes)
    for path in ("boom.joint.a", "stick.joint.a", "bucket.joint.a"):
        notes[path] = Note(sigma=lengths) if lengths else Note()
    return Machine.model_validate(data | {"calibrator": {"parent": "bucket"}, "tracker": {},
                                          "sensors": (*data["sensors"], survey), "notes": notes})


def true_of(machine: Machine, seed: int, lengths: float | None) -> Machine:
    """The machine with IMUs (and lengths of links) off by what the file says of them."""
    rng = np.random.default_rng([1, seed])
    off = {number.name: machine.notes[number.path].sigma for number in machine.geometry_numbers
           if number.name in machine.imu_numbers}
    off |= dict.fromkeys(("boom.a", "stick.a", "bucket.a"), lengths) if lengths else {}
    return machine.with_values({name: machine.numbers[name].value + sigma * rng.normal()
                                for name, sigma in off.items()})


def stills(true: Machine, seed: int) -> Poses:
    """Twelve postures, two seconds of readings each; the edge is surveyed in three of them."""
    rng, model = np.random.default_rng([2, seed]), Model(true)
    lower, upper = true.ranges.T
    q = rng.uniform(0.9 * lower + 0.1 * upper, 0.1 * lower + 0.9 * upper, (STILLS, len(lower)))
    count = round(STILL_TIME * RATE)
    each = np.repeat(q, count, axis=0)
    log = simulate(model, Trajectory(np.arange(len(each)) / RATE, each, 0 * each, 0 * each), seed=3 * seed + 1)
    channels = {name: values for name, values in log.channels.items() if "_imu." in name}
    kinematic = KinematicModel(true)
    for axis, name in enumerate(("tip.x", "tip.y", "tip.z")):
        channels[name] = np.full(len(each), np.nan)
        for k in SURVEYED:
            tip = np.array(kinematic.tip(kinematic.parameters.nominal, q[k])).ravel()
            channels[name][k * count] = tip[axis] + SURVEY * rng.normal()
    return Poses("stills", channels=channels, pose=np.repeat([str(k) for k in range(STILLS)], count))


def one(seed: int, lengths: float | None) -> dict:
    """Calibration of one excavator: errors of angles [deg] and tip [mm], and how many intervals hold the truth."""
    machine = machine_of(lengths)
    true = true_of(machine, seed, lengths)
    model = Model(true)
    course = random_trajectory(model, duration=DURATION, rate=RATE, seed=10000 + seed)
    log = simulate(model, course, seed=3 * seed)
    found = solve(sensor_problem(machine, [log], [stills(true, seed)]))
    path = found.found.fit.stretches[0].path
    support = path.support(log.t)
    q, std = motion(path, support)[0], found.found.std(0, support)
    q[:, 0] += np.mean(course.q[:, 0] - q[:, 0])  # nobody measures the heading of free motion
    error = np.degrees(q - course.q)
    kinematic, after = KinematicModel(true), KinematicModel(found.machine)
    tips = [kind.over(kind.tip, kind.parameters.nominal, angles)[0][:, :, 0]
            for kind, angles in ((kinematic, course.q), (after, q))]
    apart = np.linalg.norm(tips[1] - tips[0], axis=1)
    held = np.abs(error[:, 1:]) < 1.96 * np.degrees(std[:, 1:])
    numbers = [(row.value - true.numbers[name].value) / row.std for name, row in found.parameters.items()
               if name in true.numbers]
    return {"angles": np.sqrt(np.mean(error**2, axis=0)), "tip": 1e3 * float(np.sqrt(np.mean(apart**2))),
            "tip_95": 1e3 * float(np.percentile(apart, 95)), "held": held.mean(axis=0),
            "numbers": np.abs(numbers) < 1.96, "status": str(found.status), "steps": found.found.steps,
            "machine": found.machine, "log": log, "true": true}


def forces(seed: int, calibrated: Machine, true: Machine) -> float:
    """Error of unseen forces identified from IMUs, over that of the same motion with resolvers of ±0.1 degrees."""
    resolvers = load_machine("excavator_bucket")
    models = Model(true), Model(resolvers)
    psi = random_truth(models[1], 7 + seed)
    driven, unseen = (random_trajectory(models[1], duration=60.0, rate=RATE, seed=20000 + 2 * seed + k)
                      for k in range(2))
    exact = models[1].over(models[1].inverse_dynamics, unseen.q, unseen.qd, unseen.qdd, psi)[0][:, :, 0]
    errors = []
    for model, machine in zip(models, (calibrated, resolvers), strict=True):
        log = simulate(model, driven, psi, seed=30000 + seed)
        kept = {name: x for name, x in log.channels.items() if not name.endswith(".length")}
        estimate = solve(identification_problem(machine, [Log("driven", log.t, kept)]))
        made = models[1].over(models[1].inverse_dynamics, unseen.q, unseen.qd, unseen.qdd, estimate.psi)[0][:, :, 0]
        errors.append(np.sqrt(np.mean(((made - exact) / exact.std(axis=0)) ** 2)))
    return float(errors[0] / errors[1])


def run() -> dict:
    results: dict = {}
    for case, lengths, seeds in (("", None, SEEDS), ("_lengths_uncertain", LENGTHS, SEEDS // 4)):
        found, ratios = [], []
        for seed in range(seeds):
            found.append(one(seed, lengths))
            machine, true = found[-1].pop("machine"), found[-1].pop("true")
            found[-1].pop("log")
            if seed < FORCES and not lengths:
                ratios.append(forces(seed, machine, true))
        angles = np.sqrt(np.mean([each["angles"] ** 2 for each in found], axis=0))
        results |= {
            f"runs{case}": len(found),
            f"angle_deg{case}": dict(zip(("swing", "boom", "stick", "bucket"), angles.tolist(), strict=True)),
            f"worst_angle_deg{case}": float(angles[1:].max()),
            f"tip_rms_mm{case}": float(np.sqrt(np.mean([each["tip"] ** 2 for each in found]))),
            f"tip_worst_run_mm{case}": max(each["tip"] for each in found),
            f"angles_coverage{case}": float(np.mean([each["held"] for each in found])),
            f"numbers_coverage{case}": float(np.mean(np.concatenate([each["numbers"] for each in found]))),
            f"suspect{case}": sum(each["status"] != "ok" for each in found),
            f"most_steps{case}": max(each["steps"] for each in found)}
        if ratios:
            results["forces_over_resolvers"] = float(np.median(ratios))
            results["forces_over_resolvers_all"] = ratios
    return results
