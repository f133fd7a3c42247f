"""The reference motion that a log describes: what a simulated machine or a controller is to follow."""

from __future__ import annotations

import numpy as np

from hydroopt.errors import LogError
from hydroopt.logs.log import Log
from hydroopt.logs.readings import reading
from hydroopt.logs.smoothing import SmoothingSpline, condition
from hydroopt.logs.tip_wrench import tip_wrench
from hydroopt.machine.machine import Machine
from hydroopt.simulation.simulate import Trajectory
from hydroopt.spatial.inertia import Array

CONSISTENT = 1e-4
"""Part of a joint's range within which the speeds and accelerations of a designed motion lead to its next position."""


def reference_motion(machine: Machine, log: Log, *, bounded: bool = True) -> Trajectory:
    """The motion of a log's joint positions.

    Speeds and accelerations of a designed motion (`.qd` and `.qdd` of all joints, consistent with `.q` at every sample)
    are taken as they stand, so that what was checked at design is what is followed. Any other log is smoothed. A wrench
    at the tip that the log states is part of the motion.

    Args:
        machine: whose joints move.
        log: with `<joint>.q` of all joints.
        bounded: whether positions must be within the joints' ranges.

    Raises:
        LogError: a joint's positions are missing, or leave its range.

    Example:
        >>> import hydroopt as ho
        >>> model = ho.Model(ho.load_machine("patu655_lift"))
        >>> log = ho.simulate(model, ho.random_trajectory(model, duration=5, rate=100, seed=0), seed=0)
        >>> reference_motion(model.machine, log).q.shape
        (500, 1)
    """
    positions, wrench = _channels(machine, log, "q"), tip_wrench(log)
    for k, joint in enumerate(machine.joints if bounded else ()):
        lower, upper = machine.link(joint).joint.range
        beyond = np.flatnonzero((positions[:, k] < lower) | (positions[:, k] > upper))
        if beyond.size:
            raise LogError(f"{joint}.q leaves the joint's range at sample {log.sample[beyond[0]]}",
                           where=log.path or log.name, remedy="correct the motion or the joint's limits")
    if all(f"{joint}.{kind}" in log.channels for joint in machine.joints for kind in ("qd", "qdd")):
        designed = Trajectory(log.t, positions, _channels(machine, log, "qd"), _channels(machine, log, "qdd"), wrench)
        if _consistent(machine, designed):
            return designed
    smooth = condition(log.t, positions, log.segment, SmoothingSpline(bandwidth=machine.bandwidth),
                       where=log.path or log.name)
    return Trajectory(smooth.t, smooth.q, smooth.qd, smooth.qdd, wrench)


def _channels(machine: Machine, log: Log, kind: str) -> Array:
    return np.column_stack([reading(machine, log, f"{joint}.{kind}") for joint in machine.joints])


def _consistent(machine: Machine, motion: Trajectory) -> bool:
    """Whether every position follows from the one before it, by the quintic that joins both states."""
    step = np.diff(motion.t)[:, None]
    predicted = step / 2 * (motion.qd[:-1] + motion.qd[1:]) + step**2 / 12 * (motion.qdd[:-1] - motion.qdd[1:])
    return bool(np.all(np.abs(np.diff(motion.q, axis=0) - predicted) <= CONSISTENT * np.ptp(machine.ranges, axis=1)))
