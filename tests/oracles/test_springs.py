"""Springs between pins and at joints against MuJoCo's tendons and joint stiffness."""

import numpy as np
import pytest

from fixtures.springs import crane, z_bar
from hydroopt.model.model import Model
from oracles.mujoco_loops import MujocoLoops
from oracles.subjects import balances, forces, random_bodies, relative_error, states


@pytest.mark.parametrize("made", [crane, z_bar])
def test_forces_are_mujocos(made):
    subject, rng = Model(made()), np.random.default_rng(61)
    psi, clouds = random_bodies(subject, rng)
    places, springs = subject.parameters.positions, {}
    for owner in [name.partition(".")[0] for name in places if name.endswith(".stiffness")]:
        springs[owner] = (rng.uniform(1e4, 2e4), rng.uniform(-1e3, 1e3) if f"{owner}.preload" in places else 0.0)
        psi[places[f"{owner}.stiffness"]] = springs[owner][0]
        if f"{owner}.preload" in places:
            psi[places[f"{owner}.preload"]] = springs[owner][1]
    assert len(springs) == len(subject.machine.springs) + sum(
        link.joint.spring is not None for link in subject.machine.links)
    state = states(subject.machine, rng, 12)
    tree = MujocoLoops(subject.machine, clouds, springs)
    torque, arms = zip(*(tree.virtual_work(*row) for row in zip(*state, strict=True)), strict=True)
    expected = np.array([balances(subject.machine, *each) for each in zip(arms, torque, strict=True)])
    found = forces(subject, state, psi)
    assert relative_error(found, expected) < 1e-9
    (K,) = subject.over(subject.regressor, *state)
    assert relative_error(K @ psi, found) < 1e-12
    without = psi.copy()
    without[[places[name] for name in places if name.endswith((".stiffness", ".preload"))]] = 0.0
    assert relative_error(forces(subject, state, without), expected) > 1e-2
