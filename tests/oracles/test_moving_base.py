"""A base on a slope or in motion: against a fixed base in another orientation, other gravity, and MuJoCo."""

import copy
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from fixtures.drives import CRANE
from hydroopt.errors import MachineError
from hydroopt.estimation.dynamic.experiment import experiment
from hydroopt.logs.log_files import read_log
from hydroopt.logs.smoothing import SmoothingSpline
from hydroopt.machine.free_links import AXES
from hydroopt.machine.machine import Machine
from hydroopt.machine.machine_file import dump_machine, read_machine
from hydroopt.model.model import Model
from hydroopt.simulation.simulate import random_trajectory, simulate
from oracles.mujoco_loops import MujocoLoops
from oracles.subjects import forces, random_bodies, relative_error, states

LIMITS = 'lower = {0}, upper = {1}, max_speed = {2}, max_acceleration = {3}'
MOTION = "[base_motion]\n" + "\n".join(
    f"{key} = {{ " + LIMITS.format(*(f'"{number} {unit}"' for number, unit in (
        zip((-0.3, 0.3, 0.5, 1.0), ("m", "m", "m/s", "m/s^2"), strict=True) if key in "xyz" else
        zip((-20, 20, 20, 40), ("deg", "deg", "deg/s", "deg/s^2"), strict=True)))) + " }" for key in AXES)


def fixed() -> Machine:
    """The crane with every joint driven by one cylinder."""
    data = copy.deepcopy(CRANE)
    data["links"][3]["joint"] = {"type": "locked", "a": 0.8}
    data["cylinders"] = [each for each in data["cylinders"] if each["name"] not in ("swing_right", "boom_left")]
    return Machine.model_validate({**data, "sensors": (), "orientation": (0.1, -0.2, 0.3)})


@pytest.fixture(scope="module")
def moving() -> Machine:
    return read_machine(dump_machine(fixed()) + MOTION)


def test_joints_of_the_base(moving):
    assert moving.joints == (*(f"base_{key}" for key in AXES), "swing", "boom", "stick")
    assert [each.name for each in moving.balances] == [each.name for each in fixed().balances]
    model, q = Model(moving), np.array([0.1, -0.2, 0.3, 0.4, -0.2, 0.3, 0, 0, 0])
    poses = dict(zip((link.name for link in moving.links), model.forward_kinematics(q), strict=True))
    chassis = np.asarray(poses["chassis"])
    assert np.allclose(chassis[:3, 3], q[:3], rtol=0, atol=1e-14)
    assert np.allclose(chassis[:3, :3], Rotation.from_euler("ZYX", q[3:6]).as_matrix(), rtol=0, atol=1e-14)


def test_slope_is_another_orientation_and_acceleration_other_gravity(moving):
    model, rng = Model(moving), np.random.default_rng(61)
    psi, _ = random_bodies(model, rng)
    q, qd, qdd = states(moving, rng, 1)
    qd[:, :6] = qdd[:, :6] = 0
    turned = Rotation.from_euler("xyz", fixed().orientation) * Rotation.from_euler("ZYX", q[0, 3:6])
    still = Model(fixed().model_copy(update={"orientation": tuple(turned.as_euler("xyz"))}))
    expected = forces(still, [each[:, 6:] for each in (q, qd, qdd)], psi)
    assert relative_error(forces(model, [q, qd, qdd], psi), expected) < 1e-12
    # free fall
    down = Rotation.from_euler("xyz", fixed().orientation).inv().apply([0, 0, -fixed().gravity])
    qdd[:, :3] = down
    weightless = Model(fixed().model_copy(update={"gravity": 0.0}))
    expected = forces(weightless, [each[:, 6:] for each in (q, qd, qdd)], psi)
    assert relative_error(forces(model, [q, qd, qdd], psi), expected) < 1e-9


def test_six_degrees_of_freedom_against_mujoco(moving):
    model, rng = Model(moving), np.random.default_rng(62)
    psi, clouds = random_bodies(model, rng)
    state = states(moving, rng, 8)
    tree = MujocoLoops(moving, clouds)
    torque, arms = zip(*(tree.virtual_work(*row) for row in zip(*state, strict=True)), strict=True)
    of_cylinders = [moving.actuators.index(each) for each in moving.measured_actuators]
    expected = np.array([np.linalg.solve(arm[of_cylinders, 6:].T, load[6:])
                         for arm, load in zip(arms, torque, strict=True)])
    assert relative_error(forces(model, state, psi), expected) < 1e-9


def test_a_log_states_the_slope_it_was_recorded_on(tmp_path):
    slope = "[base_motion]\nroll = { lower = \"-20 deg\", upper = \"20 deg\" }\n"
    model = Model(read_machine(dump_machine(fixed()) + slope))
    motion = random_trajectory(model, duration=10.0, rate=20.0, seed=1)
    flat = replace(motion, q=motion.q.copy(), qd=motion.qd.copy(), qdd=motion.qdd.copy())
    flat.q[:, 0], flat.qd[:, 0], flat.qdd[:, 0] = np.radians(8.0), 0, 0
    log = simulate(model, flat, noise=False)
    assert not any("ground" in channel for channel in log.channels)
    kept = [channel for channel in log.channels if channel != "base_roll.q"]
    np.savetxt(tmp_path / "log.csv", np.column_stack([log.t, *(log.channels[each] for each in kept)]), delimiter=",",
               fmt="%.17g")
    columns = "".join(f'"{name}" = {{ column = {k + 1}, unit = "{log.units[name]}" }}\n' for k, name in enumerate(kept))
    (tmp_path / "map.toml").write_text(
        f'header = false\n[columns]\nt = {{ column = 0, unit = "s" }}\n{columns}'
        '"base_roll.q" = { unit = "deg", offset = "8 deg" }\n')
    read = read_log(tmp_path / "log.csv", mapping=tmp_path / "map.toml")
    found, expected = (experiment(model, each, SmoothingSpline(bandwidth=2.0)) for each in (read, log))
    assert np.allclose(found.motion.q, expected.motion.q, rtol=0, atol=1e-9)
    assert np.allclose(found.force, expected.force, rtol=1e-9)


@pytest.mark.parametrize(("text", "words"), [
    ("[base_motion]\nheave = { lower = \"-1 m\", upper = \"1 m\" }", "base_motion.heave: this key is unknown"),
    ("[base_motion]\nroll = \"3 deg\"", "base_motion.roll: must be a table of keys"),
    ("[base_motion]\nroll = { lower = \"20 deg\", upper = \"-20 deg\" }", "base_motion.roll.*not below the upper"),
])
def test_contradictions(text, words):
    with pytest.raises(MachineError, match=words):
        read_machine(dump_machine(fixed()) + text)
