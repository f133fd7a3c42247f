"""What cylinders and loops do over the range of one joint, the others in the middle of theirs."""

from __future__ import annotations

from typing import NamedTuple

import casadi as ca
import numpy as np

from hydroopt.machine.machine import Machine
from hydroopt.machine.mechanism import Mechanism
from hydroopt.model.model import Model
from hydroopt.spatial.inertia import Array

POINTS = 181


class Curve(NamedTuple):
    """One quantity over the range of one joint.

    Attributes:
        subject: the cylinder, or the loop's dependent joint.
        joint: the joint that moves.
        position: of this joint (N,) [rad or m].
        value: of the quantity (N,): a lever arm [m, or 1 where the joint slides], a ratio of speeds.
    """

    subject: str
    joint: str
    position: Array
    value: Array


def lever_arms(model: Model) -> tuple[Curve, ...]:
    """Lever arm ∂length/∂q of every cylinder on the last joint that it moves.

    >>> from hydroopt.machine.machine_file import load_machine
    >>> boom, stick = lever_arms(Model(load_machine("cat215b")))
    >>> stick.subject, stick.joint, round(float(stick.value.max()), 2)
    ('stick_cylinder', 'stick', 0.72)
    """
    machine, found = model.machine, []
    for k, cylinder in enumerate(machine.cylinders):
        joint = machine.moved_by(cylinder)[-1]
        q, column = _sweep(machine, joint)
        arm = model.over(model.cylinder_kinematics, q, 0 * q, 0 * q)[3][:, k, column]
        found.append(Curve(cylinder.name, joint, q[:, column], arm))
    return tuple(found)


def transmission_ratios(model: Model) -> tuple[Curve, ...]:
    """Speed of every loop's first dependent joint per speed of the last joint that it follows.

    >>> from hydroopt.machine.machine_file import load_machine
    >>> rocker, = transmission_ratios(Model(load_machine("excavator_bucket")))
    >>> rocker.subject, rocker.joint, round(float(rocker.value.max()), 2)
    ('rocker', 'bucket', 0.76)
    """
    machine, mechanism, found = model.machine, Mechanism(model.machine), []
    symbols = ca.SX.sym("q", len(machine.joints))
    at = mechanism.positions(model.geometry, {joint: symbols[k] for k, joint in enumerate(machine.joints)})
    for assembly in mechanism.assemblies:
        first, joint = assembly.closure.joints[0], assembly.closure.follows[-1]
        q, column = _sweep(machine, joint)
        ratio = ca.Function("ratio", [symbols], [ca.jacobian(at[first], symbols[column])])
        found.append(Curve(first, joint, q[:, column], np.asarray(ratio(q.T)).ravel()))
    return tuple(found)


def _sweep(machine: Machine, joint: str) -> tuple[Array, int]:
    """Joint positions (N, n) along the range of one joint, and its place in them."""
    column = machine.joints.index(joint)
    q = np.tile(machine.ranges.mean(axis=1), (POINTS, 1))
    q[:, column] = np.linspace(*machine.link(joint).joint.range, POINTS)
    return q, column
