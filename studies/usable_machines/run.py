"""100 simulated excavators whose joint limits are assumed: does every calibration give a machine that can be used?"""

from collections import Counter
from tempfile import TemporaryDirectory

import numpy as np

from hydroopt import (
    KinematicModel,
    Model,
    calibration_problem,
    identification_problem,
    load_machine,
    random_trajectory,
    simulate,
    solve,
)
from hydroopt.cli.machine_facts import machine_facts
from hydroopt.machine.joint_limits import within_strokes
from hydroopt.simulation import postures

MACHINES, POSES = 100, 120
ROUND = np.radians(5.0)
"""Joint limits are assumed in steps of 5 degrees."""
READING = 3.0
"""Standard deviations of its readings by which a pose may lie beyond the end of a stroke."""


def assumed(machine, rng: np.random.Generator):
    """The machine with limits that somebody assumed: the nominal ones ± 3° (one σ), rounded, within nominal strokes."""
    limits = {}
    for name in ("boom", "stick"):
        lower, upper = np.round((np.array(machine.link(name).joint.range) + rng.normal(0, np.radians(3), 2)) / ROUND)
        limits[name] = (float(lower * ROUND), float(upper * ROUND))
    return within_strokes(machine.with_joint_limits(limits))[0]


def table(model: KinematicModel, geometry: np.ndarray, rng: np.random.Generator):
    """Poses as far as the true strokes go, wherever the assumed limits lie."""
    machine = model.machine
    q = np.zeros((20 * POSES, len(model.joints)))
    for name in ("boom", "stick"):
        lower, upper = machine.link(name).joint.range
        q[:, model.joints.index(name)] = rng.uniform(lower - np.radians(15), upper + np.radians(15), len(q))
    stroke = model.over(model.strokes, geometry, q)[0][:, :, 0]
    full = np.array([each.stroke for each in machine.cylinders])
    q = q[np.all((stroke >= 0) & (stroke <= full), axis=1)][:POSES]
    channels = ["boom.q", "stick.q", *(f"{each.name}.length" for each in machine.cylinders)]
    return postures.record(model, q, ["angles"] * len(q), [""] * len(q), geometry=geometry, channels=channels,
                           seed=int(rng.integers(1 << 30)))


def faults(seed: int) -> list[str]:
    """What keeps one calibrated machine from being used; empty if nothing does."""
    rng = np.random.default_rng(seed)
    machine = assumed(load_machine("cat215b"), rng)
    model = KinematicModel(machine)
    known = np.diag(model.parameters.information) > 0
    geometry = model.parameters.nominal + rng.normal(size=len(known)) * model.parameters.scale * known
    calibration = solve(calibration_problem(machine, table(model, geometry, rng)))
    with TemporaryDirectory() as folder:
        calibration.save(folder)
        file = f"{folder}/cat215b.toml"
        if "cat215b.toml" not in calibration.files():
            return ["no machine is written"]
        written = load_machine(file)  # which refuses limits beyond strokes
        found = [] if calibration.status == "ok" else [f"status {calibration.status}"]
        machine_facts(written)  # what `hydroopt show` shows
    for name in ("boom", "stick"):
        lower, upper = written.link(name).joint.range
        angle = calibration.q[:, calibration.problem.model.joints.index(name)]
        beyond = max(lower - angle.min(), angle.max() - upper)
        if beyond > READING * written.sensor(f"{name}.q").std:
            found.append(f"poses of {name} beyond its limits")
    forward = Model(written)
    motion = random_trajectory(forward, duration=6.0, rate=15.0, seed=seed)  # short: nothing is compiled for it
    log = simulate(forward, motion, seed=seed)
    if not np.all(np.isfinite(np.column_stack(list(log.channels.values())))):
        found.append("simulation not finite")
    estimate = solve(identification_problem(forward, [log]), intervals=False)
    if estimate.status != "ok":
        found.append(f"identification {estimate.status}")
    return found


def run() -> dict:
    """How many of the machines can be used, and what is wrong with the others."""
    results = [faults(seed) for seed in range(MACHINES)]
    reasons = Counter(reason for each in results for reason in each)
    return {"machines": MACHINES, "usable": sum(not each for each in results), "faults": dict(reasons)}
