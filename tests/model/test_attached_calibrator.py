"""What an attached calibrator adds to actuator forces: against MuJoCo, and by energy, in fixtures of every kind."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from fixtures.calibrator_with_bodies import FREEDOMS, MIDDLE, attached, motion_about_middle, with_calibrator
from hydroopt.errors import ProblemError
from hydroopt.machine.geometry import Geometry
from hydroopt.machine.links import Link
from hydroopt.machine.machine import Machine
from hydroopt.model.attached_calibrator import AttachedCalibrator
from hydroopt.model.model import Model
from hydroopt.simulation.calibrator_motion import CalibratorMotion, follow
from oracles.mujoco_tree import MujocoTree


def zero_start(subject: AttachedCalibrator, count: int) -> tuple[np.ndarray, ...]:
    """Readings of the calibrator near its zero position, without rates."""
    return tuple(np.zeros((count, len(subject.joints))) for _ in range(3))


def followed(subject: AttachedCalibrator, *motion: np.ndarray) -> CalibratorMotion:
    start = zero_start(subject, len(motion[0]))
    return follow(subject, *motion, start, np.zeros(len(subject.joints), dtype=bool))


def open_tree(machine: Machine) -> Machine:
    """The machine and its calibrator as one tree without loop, a drive at every joint of the calibrator."""
    data = machine.model_dump()
    own = data["calibrator"]["links"]
    data |= {"links": [*data["links"], *own], "calibrator": None, "fixtures": [], "drives": [
        {"name": f"{link['name']}_drive", "joint": link["name"]} for link in own if link["joint"]["type"] != "locked"]}
    data["sensors"] = []
    for cylinder in data["cylinders"]:
        cylinder["barrel"]["body"] = cylinder["rod"]["body"] = None
    return Machine.model_validate(data)


def test_forces_are_those_of_mujoco_with_the_loop_closed() -> None:
    machine = with_calibrator("ball")
    subject = attached(machine)
    tree_machine = open_tree(machine)
    tree = MujocoTree(tree_machine, {link.name: link.body.phi for link in tree_machine.links if link.body})
    model, data = tree.model, tree.data
    _, q, qd, qdd = motion_about_middle(8.0, 40)
    moved = followed(subject, q, qd, qdd)
    reduced = Model(machine, actuator_inertia=False)
    force = reduced.over(reduced.inverse_dynamics, q, qd, qdd, bodies_alone(reduced))[0][:, :, 0]
    force = force + moved.regressor(q, qd, qdd) @ bodies_alone(subject.model)
    arms = reduced.over(reduced.cylinder_kinematics, q, qd, qdd)[3]
    joints = tree_machine.joints
    tip_body = model.body("rig_5").id
    last = machine.calibrator.links[-1].joint
    worst = 0.0
    for k in range(len(q)):
        for name, *state in zip(joints, np.append(q[k], moved.q[k]), np.append(qd[k], moved.qd[k]),
                                np.append(qdd[k], moved.qdd[k]), strict=True):
            tree._set(name, *state)
        mujoco.mj_inverse(model, data)
        turn = data.xmat[tip_body].reshape(3, 3)
        end = np.array([last.a, 0, 0]) + rotation_x(last.alpha) @ machine.calibrator.tip
        point = data.xpos[tip_body] + turn @ end
        np.testing.assert_allclose(point, machine.fixtures[0].position, atol=1e-9)
        J, dot = np.zeros((2, 3, model.nv))
        mujoco.mj_jac(model, data, J, None, point, tip_body)
        mujoco.mj_jacDot(model, data, dot, None, point, tip_body)
        np.testing.assert_allclose(J @ data.qvel, 0, atol=1e-9)
        np.testing.assert_allclose(J @ data.qacc + dot @ data.qvel, 0, atol=1e-9)
        multiplier = np.linalg.solve(J[:, 3:].T, data.qfrc_inverse[3:])  # no torque at the calibrator's joints
        torque = data.qfrc_inverse[:3] - J[:, :3].T @ multiplier
        ours = np.array([force[k, 0], *(arms[k][:, 1:].T @ force[k, 1:])])
        worst = max(worst, float(np.max(np.abs(ours - torque)) / np.max(np.abs(torque))))
    assert worst < 1e-9


def rotation_x(angle: float) -> np.ndarray:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[1, 0, 0], [0, c, -s], [0, s, c]])


def bodies_alone(model: Model) -> np.ndarray:
    """The nominal parameters without friction and offsets."""
    return np.where([kind.is_inertial for kind in model.parameters.kinds], model.parameters.nominal, 0.0)


@pytest.mark.parametrize("kind", sorted(FREEDOMS))
def test_power_is_the_rate_of_energy(kind: str) -> None:
    subject = attached(with_calibrator(kind))
    model, psi = subject.model, bodies_alone(subject.model)
    t, q, qd, qdd = motion_about_middle(8.0, 16000)
    moved = followed(subject, q[:9], qd[:9], qdd[:9])
    K = moved.regressor(q[:9], qd[:9], qdd[:9])
    speeds = np.column_stack([qd[:9, 0], model.over(model.cylinder_kinematics, q[:9], qd[:9], qdd[:9])[1][:, :, 0]])
    power = np.sum((K @ psi) * speeds, axis=1)
    energy = np.array([calibrator_energy(subject, q[k], qd[k], moved.q[k], moved.qd[k]) for k in range(9)])
    step = t[1]
    stencil = np.array([1 / 280, -4 / 105, 1 / 5, -4 / 5, 0, 4 / 5, -1 / 5, 4 / 105, -1 / 280])
    assert abs(power[4] - stencil @ energy / step) < 1e-7 * np.max(np.abs(power))
    # rates are derivatives of positions, too
    np.testing.assert_allclose(moved.qd[4], stencil @ moved.q / step, atol=1e-8)
    np.testing.assert_allclose(moved.qdd[4], stencil @ moved.qd / step, atol=1e-7)


def calibrator_energy(subject: AttachedCalibrator, q: np.ndarray, qd: np.ndarray, own: np.ndarray,
                      own_rate: np.ndarray) -> float:
    """Energy of the calibrator's bodies: kinetic by differences of poses along the motion, and potential."""
    machine, h = subject.model.machine, 1e-30

    def poses(angles: np.ndarray) -> dict[str, np.ndarray]:
        geometry, at, known = Geometry(machine), {}, dict(zip(subject.kinematics.joints, angles, strict=True))
        for link in geometry.links:
            j, variable = link.joint, known.get(link.name, 0.0)
            local = dh(j.theta + variable, j.d)
            before = next((each for each in geometry.links if each.name == link.parent), None)
            at[link.name] = local if before is None else at[before.name] @ far(before) @ local
        return at

    moved = poses(np.append(q, own) + 1j * h * np.append(qd, own_rate))
    total = 0.0
    for link in machine.calibrator.links:
        T, rate = moved[link.name].real, moved[link.name].imag / h
        m, c = link.body.phi[0], link.body.phi[1:4]
        xx, xy, xz, yy, yz, zz = link.body.phi[4:]
        about = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        second = np.trace(about) / 2 * np.eye(3) - about  # ∫ x·xᵀ dm
        pseudo = np.block([[second, c[:, None]], [c[None], np.array([[m]])]])
        total += 0.5 * np.trace(rate @ pseudo @ rate.T) + machine.gravity * (T @ np.append(c, m))[2]
    return float(total)


def dh(theta: complex, d: float) -> np.ndarray:
    c, s = np.cos(theta), np.sin(theta)
    return np.array([[c, -s, 0, 0], [s, c, 0, 0], [0, 0, 1, d], [0, 0, 0, 1]])


def far(link: Link) -> np.ndarray:
    j = link.joint
    pose = np.eye(4)
    cb, sb = np.cos(j.beta), np.sin(j.beta)
    pose[:3, :3] = rotation_x(j.alpha) @ np.array([[cb, 0, sb], [0, 1, 0], [-sb, 0, cb]])
    pose[0, 3] = j.a
    return pose


def test_freedoms_beyond_the_loop_come_from_readings() -> None:
    """A ball leaves five joints two freedoms: readings on the loop come back, with noise they close it."""
    subject = attached(with_calibrator("ball", joints=5))
    _, q, qd, qdd = motion_about_middle(8.0, 20)
    rng = np.random.default_rng(3)
    read = [0.1 * rng.standard_normal((20, 5)) for _ in range(3)]
    sensed = np.ones(5, dtype=bool)
    first = follow(subject, q, qd, qdd, tuple(read), sensed)
    again = follow(subject, q, qd, qdd, (first.q, first.qd, first.qdd), sensed)
    for name in ("q", "qd", "qdd"):
        np.testing.assert_allclose(getattr(again, name), getattr(first, name), atol=1e-9)
    # one joint without reading is determined, three are not
    partly = follow(subject, q, qd, qdd, (first.q, first.qd, first.qdd), np.array([0, 1, 1, 1, 1], dtype=bool))
    np.testing.assert_allclose(partly.q, first.q, atol=1e-6)
    with pytest.raises(ProblemError, match=r"does not determine rig_0, rig_1, rig_2, rig_3 of the calibrator"):
        follow(subject, q, qd, qdd, (first.q, first.qd, first.qdd), np.array([0, 0, 0, 0, 1], dtype=bool))


def test_a_calibrator_that_holds_the_machine_is_refused() -> None:
    machine = with_calibrator("ball", joints=2)
    subject = attached(machine)
    state = MIDDLE[None], np.zeros((1, 3)), np.zeros((1, 3))
    whole = (np.hstack([part, np.zeros((1, 2))]) for part in state)
    with pytest.raises(ProblemError, match="cannot follow every motion of swing, boom, stick"):
        subject.regressor(*whole)


def test_a_fixture_out_of_reach_is_named() -> None:
    machine = with_calibrator("ball")
    data = machine.model_dump()
    data["fixtures"][0]["position"] = (-20.0, 0.0, 0.0)
    subject = attached(Machine.model_validate(data))
    _, q, qd, qdd = motion_about_middle(8.0, 5)
    with pytest.raises(ProblemError, match="does not reach the fixture 'post' at sample 1"):
        followed(subject, q, qd, qdd)


def test_friction_of_the_calibrators_joints_is_refused() -> None:
    data = with_calibrator("ball").model_dump()
    data["calibrator"]["links"][0]["joint"]["friction"] = {"coulomb": 10.0}
    with pytest.raises(ValueError, match="the joint of 'rig_0' states friction"):
        Machine.model_validate(data)
