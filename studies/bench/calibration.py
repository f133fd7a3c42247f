"""Kinematic calibration of a surveyed arm beside SciPy on the same problem, and of closed chains."""

import math
import tempfile
import time
import tomllib
from pathlib import Path

import numpy as np
import tomli_w
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from hydroopt import KinematicModel, Poses, calibration_problem, dump_machine, load_machine, read_machine, solve
from hydroopt.machine.machine import Machine
from hydroopt.simulation import postures
from hydroopt.simulation.pose_table import simulate_poses
from studies import closed_postures
from studies.bench.goals import Row
from studies.bench.process import HYDROOPT, Cost, measured

POSES = (100, 1000, 10_000)
CHAINS = (360, 3000, 10_000)
ANGLES, READINGS = np.radians(0.02), 2e-4
"""Standard deviations of the arm's joint angles [rad] and of the tracker [m]."""


def calibration() -> list[Row]:
    """CPU time with covariance and diagnosis, kernels cached; SciPy only estimates, its rows whitened once."""
    machine, taken = surveyed_arm(), []
    print(f"{'poses':>8} {'UR10 s':>8} {'SciPy s':>8} {'ratio':>6} {'apart in sigma':>15}")
    for count in POSES:
        poses = surveyed_poses(machine, count)
        solve(calibration_problem(machine, poses))  # compiles the kernels
        began = time.process_time()
        ours = solve(calibration_problem(machine, poses))
        own = time.process_time() - began
        began = time.process_time()
        theta = by_scipy(machine, poses)
        other = time.process_time() - began
        apart = np.max(np.abs(theta - ours.theta) / ours.std)
        taken.append(own)
        print(f"{count:8d} {own:8.2f} {other:8.2f} {own / other:6.2f} {apart:15.1e}")
    whole = as_command(machine, poses)
    rows = [Row("arm", own, "SciPy's least_squares", other), Row("arm memory", whole.peak),
            Row("arm growth", math.log(taken[-1] / taken[-2]) / math.log(POSES[-1] / POSES[-2]))]
    machine = load_machine("cat215b")
    model = KinematicModel(machine)
    geometry, fixture = model.parameters.nominal, machine.fixtures[0].position
    print(f"{'poses':>8} {'CAT s':>8} {'ms/pose':>8}")
    for count in CHAINS:
        q = np.concatenate([
            closed_postures.random_postures(model, stage, count // 3, geometry=geometry, fixture=fixture, seed=k)
            for k, stage in enumerate(machine.stages)])
        labels = [stage.name for stage in machine.stages for _ in range(count // 3)]
        table = postures.record(model, q, labels, ["ball"] * len(q), geometry=geometry)
        solve(calibration_problem(machine, table, fixed={"ball.y": 0.0}))
        own = min(seconds(machine, table) for _ in range(3))
        print(f"{count:8d} {own:8.2f} {1e3 * own / count:8.2f}")
        if count == CHAINS[0]:
            whole = as_command(machine, table, "--fix", "ball.y=0 m")
            rows.append(Row("chain", own, "`calibrate` with its page", whole.cpu))
    return rows


def seconds(machine: Machine, table: Poses) -> float:
    """CPU time [s] of one calibration of the closed chain."""
    began = time.process_time()
    solve(calibration_problem(machine, table, fixed={"ball.y": 0.0}))
    return time.process_time() - began


def as_command(machine: Machine, table: Poses, *options: str) -> Cost:
    """`hydroopt calibrate` with these poses, the shortest of three runs."""
    with tempfile.TemporaryDirectory() as folder:
        table.write(f"{folder}/poses.csv")
        Path(folder, "machine.toml").write_text(dump_machine(machine))
        command = [HYDROOPT, "calibrate", f"{folder}/machine.toml", f"{folder}/poses.csv", *options, "-o",
                   f"{folder}/out", "--quiet"]
        return min((measured(command) for _ in range(3)), key=lambda cost: cost.cpu)


def surveyed_arm() -> Machine:
    """The bundled UR10 with uncertain Denavit-Hartenberg numbers, seen by a tracker that stands anywhere."""
    machine = tomllib.loads(dump_machine(load_machine("ur10")))
    for link in machine["links"]:
        for key, sigma in (("theta", "1 deg"), ("d", "5 mm"), ("a", "5 mm"), ("alpha", "1 deg")):
            stated = link["joint"].get(key, "0 deg" if key in ("theta", "alpha") else "0 m")
            link["joint"][key] = {"value": stated["value"] if isinstance(stated, dict) else stated, "sigma": sigma}
    last = machine["links"][-1]["name"]
    machine["targets"] = [{"name": "prism", "link": last,
                           "position": {"value": ["0.05 m", "0.02 m", "0.03 m"], "sigma": "10 mm"}}]
    machine["instruments"] = [{"name": "tracker"}]
    machine["sensors"] = [
        {"channels": [f"{link['name']}.q" for link in machine["links"]], "accuracy": f"{ANGLES} rad",
         "distribution": "gaussian"},
        {"channels": [f"tracker.prism.{axis}" for axis in "xyz"], "accuracy": f"{READINGS} m",
         "distribution": "gaussian"}]
    return read_machine(tomli_w.dumps(machine))


def surveyed_poses(machine: Machine, count: int) -> Poses:
    """Random poses as an arm that is off by its confidences reads them."""
    model = KinematicModel(machine)
    q = np.random.default_rng(1).uniform(-1.5, 1.5, (count, len(model.joints)))
    stated = Poses("random", channels={f"{name}.q": q[:, k] for k, name in enumerate(model.joints)})
    return simulate_poses(model, stated, random=True, seed=2).poses


def by_scipy(machine: Machine, poses: Poses) -> np.ndarray:
    """Parameters (33,) by SciPy's least_squares with numeric Jacobians: residuals of the tracker, whitened once with
    the errors of the angles by differences, and priors."""
    links = [link.joint for link in machine.links]
    numbers = np.array([[getattr(joint, key) for key in ("d", "a", "theta", "alpha")] for joint in links])
    target = np.array(machine.targets[0].position)
    q = np.array([poses.channels[f"{link.name}.q"] for link in machine.links]).T
    read = np.array([poses.channels[f"tracker.prism.{axis}"] for axis in "xyz"]).T

    def point(dh: np.ndarray, at: np.ndarray, angles: np.ndarray) -> np.ndarray:
        """The target (N, 3) in the base frame."""
        turn, origin = np.broadcast_to(np.eye(3), (len(angles), 3, 3)), np.zeros((len(angles), 3))
        for (d, a, theta, alpha), angle in zip(dh, angles.T, strict=True):
            c, s = np.cos(theta + angle), np.sin(theta + angle)
            zero, one = np.zeros_like(c), np.ones_like(c)
            turn = turn @ np.array([[c, -s, zero], [s, c, zero], [zero, zero, one]]).transpose(2, 0, 1)
            origin = origin + turn @ np.array([0.0, 0.0, d])
            held = origin + turn @ at  # pins and targets stand before a and alpha of their link
            origin = origin + turn @ np.array([a, 0.0, 0.0])
            turn = turn @ Rotation.from_euler("x", alpha).as_matrix()
        return np.asarray(held)

    names = [f"{link.name}.{key}" for link in machine.links for key in ("d", "a", "theta", "alpha")]
    names += [f"prism.{axis}" for axis in "xyz"]
    sigma = np.array([*[5e-3, 5e-3, np.radians(1), np.radians(1)] * len(links), 1e-2, 1e-2, 1e-2])
    nominal = np.concatenate([numbers.ravel(), target])
    by_q = np.stack([(point(numbers, target, q + step) - point(numbers, target, q - step)) / 2e-6
                     for step in 1e-6 * np.eye(len(links))], axis=2)

    def predicted(x: np.ndarray) -> np.ndarray:
        seen = point(x[: numbers.size].reshape(numbers.shape), x[numbers.size : numbers.size + 3], q)
        return np.asarray((seen - x[-6:-3]) @ Rotation.from_rotvec(x[-3:]).as_matrix())

    own = point(numbers, target, q)
    turn, _ = Rotation.align_vectors(own - own.mean(0), read - read.mean(0))  # where the tracker stands
    start = np.concatenate([nominal, own.mean(0) - turn.apply(read.mean(0)), turn.as_rotvec()])
    seen_by_q = turn.as_matrix().T @ by_q
    spread = ANGLES**2 * seen_by_q @ seen_by_q.transpose(0, 2, 1) + READINGS**2 * np.eye(3)
    white = np.linalg.inv(np.linalg.cholesky(spread))

    def residuals(x: np.ndarray) -> np.ndarray:
        rows = np.einsum("nij,nj->ni", white, predicted(x) - read)
        return np.concatenate([rows.ravel(), (x[:-6] - nominal) / sigma])

    found = least_squares(residuals, start, x_scale=np.concatenate([sigma, [1.0] * 6])).x
    ours = calibration_problem(machine, poses).parameters.names
    place = {**{name: k for k, name in enumerate(names)},
             **{f"tracker.{axis}": len(nominal) + k for k, axis in enumerate(("x", "y", "z", "rx", "ry", "rz"))}}
    return np.asarray(found[[place[name] for name in ours]])
