"""Platforms: which cylinder is there to move which joint, singular postures, links that joints do not hold."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from fixtures.drives import crossing, eight_legs
from hydroopt.errors import MachineError
from hydroopt.logs.forces_from_pressures import actuator_forces, forces
from hydroopt.machine.balances import matched
from hydroopt.machine.free_links import AXES
from hydroopt.machine.machine import Machine
from hydroopt.machine.machine_file import load_machine, read_machine
from hydroopt.machine.range_checks import spans
from hydroopt.model.joints_from_readings import joints_from_readings, readings
from hydroopt.model.model import Model
from hydroopt.simulation.simulate import random_trajectory, simulate

FILE = (Path(__file__).parents[2] / "models/stewart_platform.toml").read_text("utf-8")


@pytest.fixture(scope="module")
def platform() -> Machine:
    return load_machine("stewart_platform")


@pytest.fixture(scope="module")
def model(platform: Machine) -> Model:
    return Model(platform)


def test_six_cylinders_share_six_joints(platform: Machine) -> None:
    assert platform.one_each
    assert sorted(map(platform.main_joint, platform.cylinders)) == sorted(platform.joints)
    assert platform.entangled == (platform.joints,)


def test_a_cylinder_across_a_driven_joint_moves_the_last_one() -> None:
    machine = crossing()
    grab = next(each for each in machine.cylinders if each.name == "grab")
    assert machine.moved_by(grab) == ("stick", "grapple")
    assert machine.main_joint(grab) == "grapple"
    assert machine.entangled == ()


def test_matching_takes_the_shortest_chain() -> None:
    moved = {"a": ("x", "y"), "b": ("y", "z"), "c": ("z",)}
    assert matched(moved, ("x", "y", "z")) == {"a": "x", "b": "y", "c": "z"}
    assert "x" not in matched({"a": ("x", "y")}, ("x", "y")).values()


def test_lengths_and_forces_are_those_of_vectors(platform: Machine, model: Model) -> None:
    """Pins by a rotation matrix; and a platform without legs' bodies by Newton's and Euler's equations of one body."""
    rng = np.random.default_rng(7)
    ranges = platform.ranges
    q = rng.uniform(*ranges.T)
    turn = Rotation.from_euler("ZYX", q[3:])
    low, up = (np.array([getattr(each, end).pin for each in platform.cylinders]) for end in ("barrel", "rod"))
    carried = turn.apply(up)
    legs = q[:3] + carried - low
    found, _ = readings(model, q[None], [f"{each.name}.length" for each in platform.cylinders])
    assert found[0] == pytest.approx(np.linalg.norm(legs, axis=1), abs=1e-12)

    rates, accelerations = rng.uniform(-0.3, 0.3, (2, 6))
    yaw, pitch = q[3:5]
    first = np.array([np.cos(yaw), np.sin(yaw), 0])  # where roll's axis points before it pitches
    axes = [np.array([0, 0, 1.0]), np.array([-np.sin(yaw), np.cos(yaw), 0]),
            np.cos(pitch) * first - np.sin(pitch) * np.array([0, 0, 1.0])]
    w = sum(rate * axis for rate, axis in zip(rates[3:], axes, strict=True))
    moved = [np.zeros(3), np.cross(rates[3] * axes[0], axes[1]),
             np.cross(rates[3] * axes[0] + rates[4] * axes[1], axes[2])]
    wd = sum(acc * axis + rate * change
             for acc, rate, axis, change in zip(accelerations[3:], rates[3:], axes, moved, strict=True))
    body = platform.link("platform").body
    assert body is not None
    mass, com = body.m, turn.apply(np.array(body.com))
    xx, xy, xz, yy, yz, zz = body.inertia_com
    inertia = turn.as_matrix() @ np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]) @ turn.as_matrix().T
    acceleration = accelerations[:3] + np.cross(wd, com) + np.cross(w, np.cross(w, com))
    force = mass * (acceleration + np.array([0, 0, platform.gravity]))
    moment = np.cross(com, force) + inertia @ wd + np.cross(w, inertia @ w)
    units = legs / np.linalg.norm(legs, axis=1)[:, None]
    expected = np.linalg.solve(np.vstack([units.T, np.cross(carried, units).T]), [*force, *moment])
    psi = np.zeros(len(model.parameters))
    for name, value in zip(model.parameters.names, model.parameters.nominal, strict=True):
        psi[model.parameters.index(name)] = value if name.startswith("platform.") else 0.0
    (forces,) = model.over(model.inverse_dynamics, q[None], rates[None], accelerations[None], psi[None])
    assert forces[0, :, 0] == pytest.approx(expected, rel=1e-9)


def test_six_lengths_give_six_joints(platform: Machine, model: Model) -> None:
    rng = np.random.default_rng(8)
    ranges = platform.ranges
    q = rng.uniform(*ranges.T, (50, 6))
    channels = [f"{each.name}.length" for each in platform.cylinders]
    measured, _ = readings(model, q, channels)
    assert joints_from_readings(model, 0 * q, range(6), channels, measured) == pytest.approx(q, abs=1e-11)


def test_margin_to_a_singular_posture(platform: Machine) -> None:
    (span,) = spans(platform)
    assert np.degrees(span.angle) == pytest.approx(64.5, abs=0.5)
    turned = FILE.replace('yaw = { lower = "-8 deg", upper = "8 deg"', 'yaw = { lower = "82 deg", upper = "98 deg"')
    turned = turned.replace('stroke = { value = "1.25 m"', 'stroke = { value = "4 m"')
    with pytest.raises(MachineError, match=r"'leg1' and 5 more do not hold their joints at platform_x = .*lengths"):
        read_machine(turned)


@pytest.mark.parametrize(("old", "new", "words"), [
    ('[links.free]', '[links.free]\nheave = { lower = "0 m", upper = "1 m" }',
     "free.heave: this key is unknown; use one of x, y, z"),
    ('name = "platform"\n', 'name = "platform"\njoint = { type = "locked" }\n', "free link has a joint, too"),
    ('yaw = { lower = "-8 deg"', 'yaw = { lower = "12 deg"', "free.yaw.*not below the upper"),
    ('pitch = { lower = "-6 deg"', 'pitch = { limit = "-6 deg"',
     "free.pitch.limit: this key is unknown; use one of lower, upper"),
    ('stroke = { value = "1.25 m"', 'stroke = { value = "0.8 m"', "'leg1' would be .* can only be 2.080 to 2.880 m"),
])
def test_bad_platforms(old: str, new: str, words: str) -> None:
    with pytest.raises(MachineError, match=words):
        read_machine(FILE.replace(old, new, 1))


def test_five_cylinders_do_not_hold_six_joints(platform: Machine) -> None:
    data = platform.model_dump() | {"sensors": (), "notes": {}}
    data["cylinders"] = data["cylinders"][:5]
    with pytest.raises(ValueError, match="5 actuators, leg1 to leg5, cannot move the 6 joints platform_x"):
        Machine.model_validate(data)


def test_eight_cylinders_are_weighed_by_what_they_do_at_the_joints() -> None:
    """Of a log with the pressures of all legs, forces at the joints are those that bodies and friction demand."""
    machine = eight_legs()
    model = Model(machine)
    assert [(each.name, each.unit) for each in machine.balances] == [
        *((f"platform_{axis}", "N") for axis in "xyz"), *((f"platform_{turn}", "N*m") for turn in list(AXES)[3:])]
    motion = random_trajectory(model, duration=2.0, rate=50.0, seed=1)
    log = simulate(model, motion, noise=False)
    own = [name for name in model.parameters.names if "coulomb" in name or "viscous" in name or "offset" in name]
    assert len(own) == 24
    legs = actuator_forces(model, log)
    (arms,) = model.over(model.cylinder_kinematics, motion.q, motion.qd, motion.qdd)[3:4]
    work = np.einsum("na,naj->nj", legs, arms)
    np.testing.assert_allclose(forces(model, log, motion.q), work, rtol=1e-9, atol=1e-6)
    demanded = model.over(model.inverse_dynamics, motion.q, motion.qd, motion.qdd, np.tile(
        model.parameters.nominal, (log.size, 1)))[0][:, :, 0]
    np.testing.assert_allclose(work, demanded, atol=1e-6 * np.max(np.abs(demanded)))
    (span,) = spans(machine)
    assert len(span.cylinders) == 8
    assert np.degrees(span.angle) == pytest.approx(53.0, abs=0.5)


def test_eight_cylinders_of_which_one_is_not_measured_are_refused() -> None:
    data = eight_legs().model_dump() | {"notes": {}, "sensors": ()}
    data["cylinders"] = [each | {"measured": each["name"] != "leg3"} for each in data["cylinders"]]
    with pytest.raises(ValueError, match=r"'leg3' is not measured, one of 8 actuators that move 6 joints, .* together.*"
                                         r"cannot distinguish"):
        Machine.model_validate(data)


def test_a_leg_that_is_not_measured_leaves_five_balances() -> None:
    machine = read_machine(FILE.replace('name = "leg3"\n', 'name = "leg3"\nmeasured = false\n', 1))
    assert [each.name for each in machine.balances] == ["leg1", "leg2", "leg4", "leg5", "leg6"]


def test_coordinates_of_a_free_link() -> None:
    assert [joint.removeprefix("platform_") for joint in load_machine("stewart_platform").joints] == list(AXES)
