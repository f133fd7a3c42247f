"""What cylinders and loops do over the range of one joint, the others in the middle of theirs."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from operator import itemgetter
from typing import NamedTuple

import casadi as ca
import numpy as np

from hydroopt.machine.mechanism import Mechanism
from hydroopt.machine.range_checks import length, sampled
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
    return tuple(_curve(model, each.name, model.machine.moved_by(each)[-1],
                        partial(length, model.geometry, each)) for each in model.machine.cylinders)


def transmission_ratios(model: Model) -> tuple[Curve, ...]:
    """Speed of every loop's first dependent joint per speed of the last joint that it follows.

    >>> from hydroopt.machine.machine_file import load_machine
    >>> rocker, = transmission_ratios(Model(load_machine("excavator_bucket")))
    >>> rocker.subject, rocker.joint, round(float(rocker.value.max()), 2)
    ('rocker', 'bucket', 0.76)
    """
    found = []
    for assembly in Mechanism(model.machine).assemblies:
        first, joint = assembly.closure.joints[0], assembly.closure.follows[-1]
        found.append(_curve(model, first, joint, itemgetter(first)))
    return tuple(found)


def _curve(model: Model, subject: str, joint: str, quantity: Callable[[dict[str, ca.SX]], ca.SX]) -> Curve:
    """The slope of a quantity, a function of all joints by name, along the range of one joint."""
    machine = model.machine
    column = machine.joints.index(joint)
    q = np.tile(machine.ranges.mean(axis=1), (POINTS, 1))
    q[:, column] = np.linspace(*machine.link(joint).joint.range, POINTS)
    slope = sampled(model.geometry, machine.joints, q.T, lambda x, at: [ca.jacobian(quantity(at), x[column])])
    return Curve(subject, joint, q[:, column], slope.values[0].ravel())
