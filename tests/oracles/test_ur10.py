"""The bundled UR10 against Pinocchio on a tree of the maker's numbers, bodies in the frames they are stated in."""

import numpy as np
import pinocchio as pin
from subjects import forces, model, relative_error, states

JOINTS = [(0.1273, 0.0, 90), (0.0, -0.612, 0), (0.0, -0.5723, 0), (0.163941, 0.0, 90), (0.1157, 0.0, -90),
          (0.0922, 0.0, 0)]
"""d, a [m] and α [deg] of the Denavit-Hartenberg table."""
BODIES = [
    (7.1, (0.021, 0, 0.027), (0.03408, 0.00002, -0.00425, 0.03529, 0.00008, 0.02156)),
    (12.7, (0.38, 0, 0.158), (0.02814, 0.00005, -0.01561, 0.77068, 0.00002, 0.76943)),
    (4.27, (0.24, 0, 0.068), (0.01014, 0.00008, 0.00916, 0.30928, 0, 0.30646)),
    (2.0, (0, 0.007, 0.018), (0.00296, -0.00001, 0, 0.00222, -0.00024, 0.00258)),
    (2.0, (0, 0.007, 0.018), (0.00296, -0.00001, 0, 0.00222, -0.00024, 0.00258)),
    (0.365, (0, 0, -0.026), (0.0004, 0, 0, 0.00041, 0, 0.00034))]
"""Mass, centre of mass and xx, xy, xz, yy, yz, zz about it, in the frame at the link's far end."""


def test_forces_are_those_of_the_makers_numbers():
    subject = model("ur10")
    q, qd, qdd = states(subject.machine, np.random.default_rng(29), 100)
    arm = published_arm()
    data = arm.createData()
    for still in (True, False):
        state = [q, 0 * qd, 0 * qdd] if still else [q, qd, qdd]
        expected = np.array([pin.rnea(arm, data, *row) for row in zip(*state, strict=True)])
        # gravity cannot turn an upright axis: the columns' sizes are compared together
        found = forces(subject, state, subject.parameters.nominal)
        assert relative_error(found.reshape(-1, 1), expected.reshape(-1, 1)) < 1e-12


def published_arm():
    arm = pin.Model()
    arm.gravity.linear = np.array([0, 0, -9.81])
    far_end, joint = pin.SE3.Identity(), 0
    for k, ((d, a, alpha), (mass, centre, (xx, xy, xz, yy, yz, zz))) in enumerate(zip(JOINTS, BODIES, strict=True)):
        place = far_end * pin.SE3(np.eye(3), np.array([0, 0, d]))
        joint = arm.addJoint(joint, pin.JointModelRZ(), place, f"joint{k + 1}")
        far_end = pin.SE3(pin.rpy.rpyToMatrix(np.radians(alpha), 0, 0), np.array([a, 0, 0]))
        tensor = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        arm.appendBodyToJoint(joint, pin.Inertia(mass, np.array(centre), tensor), far_end)
    return arm
