"""Forces of machines with several, unmeasured or no actuators on a joint against MuJoCo and virtual work."""

import numpy as np
import pytest

from fixtures.drives import crane, crossing
from fixtures.tiers import tiered
from hydroopt.model.model import Model
from oracles.mujoco_loops import MujocoLoops
from oracles.subjects import balances, forces, random_bodies, relative_error, states

MACHINES = {
    "all measured": crane,
    "one of two not measured": lambda: crane("swing_right"),
    "alone and not measured": lambda: crane("reach"),
    "two joints not measured": lambda: crane("swing_left", "swing_right", "boom_left"),
    "one across two joints": crossing,
    "one across two joints not measured": lambda: crossing("grab"),
    "measured across one that is not": lambda: crossing("reach"),
}


@pytest.fixture(scope="module", params=tiered(MACHINES, lambda name: name in (
    "one of two not measured", "one across two joints", "measured across one that is not")))
def subject(request):
    return Model(MACHINES[request.param]())


@pytest.fixture(scope="module")
def moved(subject):
    """States, ψ, and MuJoCo's generalised forces (N, n) and lever arms (N, a, n)."""
    rng = np.random.default_rng(51)
    psi, clouds = random_bodies(subject, rng)
    state = states(subject.machine, rng, 12)
    tree = MujocoLoops(subject.machine, clouds)
    torque, arms = zip(*(tree.virtual_work(*row) for row in zip(*state, strict=True)), strict=True)
    return state, psi, np.array(torque), np.array(arms)


@pytest.mark.slow
def test_balances(subject, moved):
    state, psi, torque, arms = moved
    machine = subject.machine
    found = forces(subject, state, psi)
    expected = np.array([balances(machine, *each) for each in zip(arms, torque, strict=True)])
    assert relative_error(found, expected) < 1e-9
    (K,) = subject.over(subject.regressor, *state)
    assert K.shape[1] == len(machine.balances)
    assert relative_error(K @ psi, found) < 1e-12
    (by_energy,) = subject.over(subject.lagrange_forces, *state, np.tile(psi, (len(found), 1)))
    assert relative_error(found, by_energy[:, :, 0]) < 1e-9


def test_any_actuator_forces_do_in_the_balances_the_work_they_do_at_the_joints(subject, moved):
    state, psi, torque, arms = moved
    machine, rng = subject.machine, np.random.default_rng(52)
    assert np.max(np.abs(subject.over(subject.transmission, state[0])[0] - arms)) < 1e-9
    force = rng.normal(size=arms.shape[:2]) * 1e4
    unmeasured = [each not in machine.measured_actuators for each in machine.actuators]
    shared = np.einsum("nra,na->nr", subject.over(subject.shares, state[0])[0], force)
    missing = torque - np.einsum("naj,na->nj", arms, force)
    expected = np.array([balances(machine, *each) for each in zip(arms, missing, strict=True)])
    found = forces(subject, state, psi) - shared
    assert np.max(np.abs(found - expected)) < 1e-9 * np.max(np.abs(torque))
    assert not np.any(subject.over(subject.shares, state[0])[0][:, :, unmeasured])


def test_all_actuators_share_the_load_of_driven_joints(subject, moved):
    state, psi, torque, arms = moved
    machine = subject.machine
    force = subject.over(subject.actuator_forces, *state, np.zeros_like(torque), psi)[0][:, :, 0]
    driven = [k for k, joint in enumerate(machine.joints) if machine.drivers[joint]]
    work = np.einsum("naj,na->nj", arms, force)
    assert np.max(np.abs((work - torque)[:, driven])) < 1e-9 * np.max(np.abs(torque))
    if len(driven) == len(machine.joints):
        (rows,) = subject.over(subject.shares, state[0])
        assert relative_error(np.einsum("nra,na->nr", rows, force), forces(subject, state, psi)) < 1e-9


def test_what_no_measured_force_sees_has_no_column(subject):
    machine, pattern = subject.machine, subject.regressor_pattern
    names = subject.parameters.names
    for each in machine.actuators:
        own = [k for k, name in enumerate(names) if name.startswith((f"{each.name}.f_", f"{each.name}.v_"))]
        assert np.all(np.any(pattern[:, own], axis=0) == (each in machine.measured_actuators))
