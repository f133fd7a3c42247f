"""The library's forces against MuJoCo's inverse dynamics of the same machine."""

import numpy as np
import pytest

from oracles.mujoco_tree import MujocoTree
from oracles.subjects import forces, model, random_bodies, relative_error, states


@pytest.mark.parametrize(("name", "complete"), [("kr300", True), ("cat215b", False), ("cat215b", True)])
def test_bodies(name, complete):
    subject = model(name, actuator_inertia=complete)
    rng = np.random.default_rng(22)
    psi, clouds = random_bodies(subject, rng)
    agrees(subject, psi, clouds, rng)


def test_friction_at_the_pins():
    subject = model("cat215b")
    rng = np.random.default_rng(23)
    psi, clouds = random_bodies(subject, rng)
    friction = {f"{cylinder}.{end}": rng.uniform(1000, 5000)
                for cylinder in ("boom_cylinder", "stick_cylinder") for end in ("barrel", "rod")}
    for pin, torque in friction.items():
        psi[subject.parameters.index(pin.replace(".", ".n_"))] = torque
    agrees(subject, psi, clouds, rng, friction)


def agrees(subject, psi, clouds, rng, friction=None):
    state = states(subject.machine, rng, 100)
    tree = MujocoTree(subject.machine, clouds)
    expected = np.array([tree.actuator_forces(*row, friction) for row in zip(*state, strict=True)])
    assert relative_error(forces(subject, state, psi), expected) < 1e-9
