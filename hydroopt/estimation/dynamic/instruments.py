"""Instrumental variables: a second reading of a motion, with independent errors."""

from __future__ import annotations

import numpy as np
from scipy.interpolate import CubicSpline

from hydroopt.errors import LogError, ProblemError
from hydroopt.estimation.dynamic.experiment import Experiment
from hydroopt.logs.joint_angles import angle_from_length
from hydroopt.logs.log import Log
from hydroopt.logs.readings import reading
from hydroopt.logs.smoothing import Motion, SmoothingSpline, condition
from hydroopt.model.model import Model
from hydroopt.spatial.inertia import Array


def instrument(model: Model, data: Experiment, reference: Log | None) -> Motion:
    """The motion of an experiment, at its samples, from a reference or from the lengths of cylinders.

    Raises:
        ProblemError: without a reference, a joint whose angle is read has no cylinder whose length is read, too.
        LogError: the reference does not cover the log, or lacks a joint.
    """
    machine, log = model.machine, data.log
    smoothing = SmoothingSpline(bandwidth=machine.bandwidth)
    if reference is None:
        angles = np.column_stack([_second_angle(model, data, joint) for joint in machine.joints])
        return condition(log.t, angles, log.segment, smoothing, names=machine.joints, where=log.path or log.name)
    where = reference.path or reference.name
    if reference.t[0] > log.t[0] + 1e-9 or reference.t[-1] < log.t[-1] - 1e-9:
        raise LogError(f"it covers {reference.t[0]:g} to {reference.t[-1]:g} s, the log that it belongs to "
                       f"{log.t[0]:g} to {log.t[-1]:g} s", where=where,
                       remedy="shift its time to that of the log, or give the whole motion")
    channels = [[f"{joint}.{rate}" for joint in machine.joints] for rate in ("q", "qd", "qdd")]
    if all(channel in reference.channels for some in channels for channel in some):
        states = [np.column_stack([reading(machine, reference, channel) for channel in some]) for some in channels]
    else:
        angles = np.column_stack([reading(machine, reference, channel) for channel in channels[0]])
        motion = condition(reference.t, angles, reference.segment, smoothing, names=machine.joints, where=where)
        states = [motion.q, motion.qd, motion.qdd]
    q, qd, qdd = (CubicSpline(reference.t, values)(log.t) for values in states)
    every = np.ones(log.t.size, dtype=bool)
    return Motion(log.t, q, qd, qdd, log.segment, every, data.motion.bandwidth, data.motion.passes,
                  (f"instruments from {where}",))


def _second_angle(model: Model, data: Experiment, joint: str) -> Array:
    log = data.log
    lengths = [f"{each.name}.length" for each in model.machine.drivers[joint] if each.name in model.triangles]
    channel = next((one for one in lengths if one in log.channels), None)
    if f"{joint}.q" not in log.channels or channel is None:
        record = f"record '{lengths[0]}' beside '{joint}.q', or " if lengths else ""
        raise ProblemError(f"the joint '{joint}' has no second reading", where=log.path or log.name,
                           remedy=f"{record}give a log of the motion that was driven")
    return angle_from_length(model, log, channel)
