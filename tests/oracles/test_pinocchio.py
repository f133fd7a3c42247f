"""Newton-Euler of the library against Pinocchio's recursion on a tree built here from the same numbers."""

import numpy as np
import pytest

from oracles.pinocchio_tree import PinocchioTree
from oracles.subjects import forces, model, random_bodies, relative_error, states


@pytest.mark.parametrize("name", ["cat215b", "kr300", "patu655_lift", "made_up"])
def test_links_alone(name):
    agrees(model(name, actuator_inertia=False), samples=40)


@pytest.mark.parametrize("name", [
    "cat215b", "lift_with_bodies", pytest.param("made_up", marks=pytest.mark.slow)])
def test_barrels_and_rods_on_their_pins(name):
    agrees(model(name), samples=40)


def agrees(subject, samples):
    rng = np.random.default_rng(21)
    psi, clouds = random_bodies(subject, rng)
    state = states(subject.machine, rng, samples)
    tree = PinocchioTree(subject.machine, clouds)
    expected = np.array([tree.actuator_forces(*row) for row in zip(*state, strict=True)])
    assert relative_error(forces(subject, state, psi), expected) < 1e-9
