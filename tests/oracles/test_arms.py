"""Bundled arms against Pinocchio on trees of the published numbers, bodies in the frames they are published in."""

from typing import NamedTuple

import numpy as np
import pinocchio as pin
import pytest

from oracles.subjects import forces, model, relative_error, states


class Arm(NamedTuple):
    """d, a [m] and α [deg] of each joint; mass, centre of mass and xx, xy, xz, yy, yz, zz about it of each body.

    The far end of link k is Rot(x, α_k) at (a_k, 0, 0) from its joint's frame; `at_far_end` says whether the bodies
    are stated there or in the joint's frame. `rotors` are inertias [kg·m²] on the joints' side.
    """

    joints: list[tuple[float, float, float]]
    bodies: list[tuple[float, tuple[float, ...], tuple[float, ...]]]
    at_far_end: bool
    rotors: tuple[float, ...] = ()


WRIST = (0.00296, -0.00001, 0, 0.00222, -0.00024, 0.00258)
UR_INERTIAS = [(0.03408, 0.00002, -0.00425, 0.03529, 0.00008, 0.02156),
               (0.02814, 0.00005, -0.01561, 0.77068, 0.00002, 0.76943),
               (0.01014, 0.00008, 0.00916, 0.30928, 0, 0.30646), WRIST, WRIST, (0.0004, 0, 0, 0.00041, 0, 0.00034)]
UR_CENTRES = [(0.021, 0, 0.027), (0.38, 0, 0.158), (0.24, 0, 0.068), (0, 0.007, 0.018), (0, 0.007, 0.018),
              (0, 0, -0.026)]
# Gaz et al. 2019, supplementary tables VIII and IX
PANDA_BODIES = [
    (4.970684, (3.875e-3, 2.081e-3, -0.04762), (0.70337, -1.39e-4, 6.772e-3, 0.70661, 1.9169e-2, 9.117e-3)),
    (0.646926, (-3.141e-3, -2.872e-2, 3.495e-3), (7.962e-3, -3.925e-3, 1.0254e-2, 2.811e-2, 7.04e-4, 2.5995e-2)),
    (3.228604, (2.7518e-2, 3.9252e-2, -6.6502e-2), (3.7242e-2, -4.761e-3, -1.1396e-2, 3.6155e-2, -1.2805e-2, 1.083e-2)),
    (3.587895, (-5.317e-2, 0.104419, 2.7454e-2), (2.5853e-2, 7.796e-3, -1.332e-3, 1.9552e-2, 8.641e-3, 2.8323e-2)),
    (1.225946, (-1.1953e-2, 4.1065e-2, -3.8437e-2), (3.5549e-2, -2.117e-3, -4.037e-3, 2.9474e-2, 2.29e-4, 8.627e-3)),
    (1.666555, (6.0149e-2, -1.4117e-2, -1.0517e-2), (1.964e-3, 1.09e-4, -1.158e-3, 4.354e-3, 3.41e-4, 5.433e-3)),
    (0.735522, (1.0517e-2, -4.252e-3, 6.1597e-2), (1.2516e-2, -4.28e-4, -1.196e-3, 1.0027e-2, -7.41e-4, 4.815e-3))]
ARMS = {
    "ur10": Arm([(0.1273, 0.0, 90), (0.0, -0.612, 0), (0.0, -0.5723, 0), (0.163941, 0.0, 90), (0.1157, 0.0, -90),
                 (0.0922, 0.0, 0)],
                list(zip((7.1, 12.7, 4.27, 2.0, 2.0, 0.365), UR_CENTRES, UR_INERTIAS, strict=True)), at_far_end=True),
    "ur10e": Arm([(0.1807, 0.0, 90), (0.0, -0.6127, 0), (0.0, -0.57155, 0), (0.17415, 0.0, 90), (0.11985, 0.0, -90),
                  (0.11655, 0.0, 0)],
                 list(zip((7.369, 13.051, 3.989, 2.1, 1.98, 0.615), UR_CENTRES, UR_INERTIAS, strict=True)),
                 at_far_end=True, rotors=(2, 2, 1, 0.4, 0.4, 0.4)),
    "panda": Arm([(0.333, 0, -90), (0, 0, 90), (0.316, 0.0825, 90), (0, -0.0825, -90), (0.384, 0, 90), (0, 0.088, 90),
                  (0, 0, 0)], PANDA_BODIES, at_far_end=False)}


@pytest.mark.parametrize("name", ARMS)
def test_forces_are_those_of_the_published_numbers(name):
    subject, arm = model(name), ARMS[name]
    q, qd, qdd = states(subject.machine, np.random.default_rng(29), 100)
    tree = tree_of(arm)
    data = tree.createData()
    for still in (True, False):
        state = [q, 0 * qd, 0 * qdd] if still else [q, qd, qdd]
        expected = np.array([pin.rnea(tree, data, *row) for row in zip(*state, strict=True)])
        if arm.rotors:
            expected += state[2] * np.array(arm.rotors)
        # gravity cannot turn an upright axis: the columns' sizes are compared together
        found = forces(subject, state, subject.parameters.nominal)
        assert relative_error(found.reshape(-1, 1), expected.reshape(-1, 1)) < 1e-12


def tree_of(arm: Arm) -> pin.Model:
    tree = pin.Model()
    tree.gravity.linear = np.array([0, 0, -9.81])
    far_end, joint = pin.SE3.Identity(), 0
    for k, ((d, a, alpha), (mass, centre, (xx, xy, xz, yy, yz, zz))) in enumerate(
            zip(arm.joints, arm.bodies, strict=True)):
        place = far_end * pin.SE3(np.eye(3), np.array([0, 0, d]))
        joint = tree.addJoint(joint, pin.JointModelRZ(), place, f"joint{k + 1}")
        far_end = pin.SE3(pin.rpy.rpyToMatrix(np.radians(alpha), 0, 0), np.array([a, 0, 0]))
        tensor = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        tree.appendBodyToJoint(joint, pin.Inertia(mass, np.array(centre), tensor),
                               far_end if arm.at_far_end else pin.SE3.Identity())
    return tree
