"""Tip, mass matrix and gravity against derivations of their own: Lagrange's energies, virtual work, Pinocchio."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pinocchio as pin
import pytest

from fixtures.drives import crane
from fixtures.tiers import tiered
from hydroopt.model import lagrange
from hydroopt.model.model import Model
from hydroopt.parameters.dynamic import bodies
from oracles.complex_machine import ComplexMachine, complex_step
from oracles.pinocchio_tree import PinocchioTree
from oracles.subjects import SUBJECTS, model, random_bodies, states

Array = np.ndarray


def deviation(found: Array, expected: Array) -> float:
    return float(np.max(np.abs(found - expected)) / np.max(np.abs(expected)))


def energies(subject: Model, psi: Array) -> ca.Function:
    """(q, q̇) → kinetic and potential energy of all bodies, from positions alone."""
    kinetic, potential = ca.SX(0), ca.SX(0)
    for owner in bodies(subject.machine):
        first = subject.parameters.index(f"{owner}.m")
        T, V = lagrange.energies(subject.dynamics, owner, ca.SX(ca.DM(psi[first:first + 10])))
        kinetic, potential = kinetic + T, potential + V
    q, qd = subject.dynamics.coordinates[:2]
    hessian = ca.jacobian(ca.gradient(kinetic, qd), qd)
    return ca.Function("energies", [q], [hessian, ca.gradient(potential, q)])


@pytest.mark.parametrize("name", tiered(SUBJECTS, lambda name: name not in ("made_up", "kr300")))
def test_mass_matrix_and_gravity_are_those_of_the_energies(name: str) -> None:
    subject, rng = model(name), np.random.default_rng(5)
    psi, _ = random_bodies(subject, rng)
    derived = energies(subject, psi)
    for q in states(subject.machine, rng, 5)[0]:
        M, torque = (np.array(out) for out in derived(q))
        assert deviation(np.array(subject.mass_matrix(q, psi)), M) < 1e-12
        assert deviation(np.array(subject.gravity_torques(q, psi)), torque) < 1e-12


@pytest.mark.parametrize("name", ["cat215b", "kr300", "made_up"])
def test_mass_matrix_and_tip_are_those_of_pinocchio(name: str) -> None:
    subject, rng = model(name, actuator_inertia=False), np.random.default_rng(6)
    psi, clouds = random_bodies(subject, rng)
    tree = PinocchioTree(subject.machine, clouds)
    link = subject.machine.link(subject.machine.tip)
    for q in states(subject.machine, rng, 5)[0]:
        upper = np.triu(pin.crba(tree.model, tree.data, q))
        assert deviation(np.array(subject.mass_matrix(q, psi)), upper + np.triu(upper, 1).T) < 1e-12
        pin.computeJointJacobians(tree.model, tree.data, q)
        pin.updateFramePlacements(tree.model, tree.data)
        frame = tree.model.getFrameId(f"at {link.name}")
        J = pin.getFrameJacobian(tree.model, tree.data, frame, pin.ReferenceFrame.LOCAL_WORLD_ALIGNED)
        arm = tree.data.oMf[frame].rotation @ np.array([link.joint.a, 0.0, 0.0])
        J = np.vstack([J[:3] + np.cross(J[3:].T, arm).T, J[3:]])
        turn = np.kron(np.eye(2), pin.rpy.rpyToMatrix(*subject.machine.orientation))  # the world's axes to the base's
        assert deviation(np.array(subject.tip_jacobian(q)), turn.T @ J) < 1e-12


def test_rotors_count_in_the_mass_matrix() -> None:
    subject = model("made_up")
    psi = np.zeros(len(subject.parameters))
    psi[subject.parameters.index("mast_drive.rotor_inertia")] = 2.0
    M = np.array(subject.mass_matrix(np.full(5, 0.4), psi))
    assert M[4, 4] == pytest.approx(2.0 * 40**2)
    assert np.count_nonzero(M) == 1


@pytest.mark.parametrize("name", ["cat215b", "kr300", "patu655_lift", "made_up"])
def test_wrench_does_the_work_that_the_actuators_do(name: str) -> None:
    """Along every motion: actuator forces times actuator speeds plus wrench times tip speeds are zero."""
    subject, rng = model(name), np.random.default_rng(7)
    second = ComplexMachine(subject.machine)
    for q in states(subject.machine, rng, 10)[0]:
        wrench = rng.standard_normal(6) * np.repeat([1e4, 1e3], 3)
        force = np.array(subject.wrench_forces(q, wrench)).ravel()
        place = complex_step(lambda x: second.frames(x, 0 * x, 0 * x)[1][subject.machine.tip].value[:3, 3], q)
        assert deviation(np.array(subject.tip_jacobian(q))[:3], place) < 1e-12
        J = np.array(subject.tip_jacobian(q))
        for _ in range(3):
            qd = rng.standard_normal(len(q))
            speeds = (second.transmission(q) @ qd).real
            done, given = force * speeds, wrench * (J @ qd)
            assert abs(done.sum() + given.sum()) < 1e-11 * (np.abs(done).sum() + np.abs(given).sum())


def test_tip_wrench_is_read_back_from_forces() -> None:
    """Whole where six joints move the tip, else the force, or its part along the motions of the tip."""
    rng = np.random.default_rng(8)
    for name, rows in (("kr300", 6), ("cat215b", 3), ("patu655_lift", 1)):
        subject = model(name)
        psi, _ = random_bodies(subject, rng)
        for q, qd, qdd in zip(*states(subject.machine, rng, 5), strict=True):
            wrench = rng.standard_normal(6) * 1e3
            wrench[min(rows, 3) if rows < 6 else 6:] = 0.0
            J = np.array(subject.tip_jacobian(q))
            if rows == 1:
                wrench = np.append(J[:3, 0] / np.linalg.norm(J[:3, 0]) * 700.0, np.zeros(3))
            force = subject.inverse_dynamics(q, qd, qdd, psi) + subject.wrench_forces(q, wrench)
            found, determined = subject.tip_wrench(q, qd, qdd, force, psi)
            assert np.allclose(np.array(found).ravel(), wrench, rtol=0, atol=1e-6)
            assert 0 < float(determined) <= 1


@pytest.mark.parametrize("subject", [model("tampere_manipulator"), Model(crane("swing_right"))],
                         ids=["joints of a plane", "a plane that an unmeasured joint turns"])
def test_tip_wrench_of_a_plane_is_the_force_in_it(subject: Model) -> None:
    """Where three measured joints move the tip in a plane: with least squares, and nothing across the plane."""
    rng = np.random.default_rng(81)
    psi, _ = random_bodies(subject, rng)
    for q, qd, qdd in zip(*states(subject.machine, rng, 5), strict=True):
        free = np.array(subject.inverse_dynamics(q, qd, qdd, psi)).ravel()
        columns = np.column_stack([np.array(subject.wrench_forces(q, unit)).ravel() for unit in np.eye(6)[:3]])
        arms = np.array(subject.transmission(q))
        # forces of actuators that are alone at a joint count there by their lever arms
        at_joints = np.diag([1.0 if each.alone is None else arms[subject.machine.actuators.index(each.alone),
                                                                  subject.machine.joints.index(each.joint)]
                             for each in subject.machine.balances])
        assert np.linalg.matrix_rank(columns, 1e-9 * np.linalg.norm(columns)) == 2
        measured = rng.standard_normal(3) * 1e3
        found, determined = subject.tip_wrench(q, qd, qdd, free + measured, psi)
        expected = np.linalg.pinv(at_joints @ columns, rcond=1e-9) @ at_joints @ measured
        assert np.allclose(np.array(found).ravel(), [*expected, 0, 0, 0], rtol=0, atol=1e-8 * np.abs(expected).max())
        assert 0 < float(determined) <= 1


def test_stretched_arm_determines_no_wrench() -> None:
    subject = model("cat215b")
    zero, psi = np.zeros(3), subject.parameters.nominal
    for stick in (0.0, np.pi):
        assert float(subject.tip_wrench([0.3, 0.0, stick], zero, zero, zero, psi)[1]) < 1e-12
        q = np.tile([0.3, 0.0, stick], (3, 1))
        assert np.all(subject.over(subject.tip_wrench, q, 0 * q, 0 * q, 0 * q, psi)[1] < 1e-12)
    assert float(subject.tip_wrench([0.3, 0.0, 1.5], zero, zero, zero, psi)[1]) > 0.1


@pytest.mark.slow
def test_complex_machine_computes_the_forces_of_the_model() -> None:
    rng = np.random.default_rng(9)
    for name in ("cat215b", "kr300", "patu655_lift", "made_up"):
        subject = model(name)
        psi, _ = random_bodies(subject, rng)
        psi = np.where(psi == 0, rng.uniform(10, 100, len(psi)), psi)
        second, named = ComplexMachine(subject.machine), dict(zip(subject.parameters.names, psi, strict=True))
        for q, qd, qdd in zip(*states(subject.machine, rng, 5), strict=True):
            expected = second.forces(q, qd, qdd, named)
            assert deviation(np.array(subject.inverse_dynamics(q, qd, qdd, psi)).ravel(), expected.real) < 1e-11
