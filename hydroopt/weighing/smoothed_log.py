"""What a scale makes of a log: smoothed samples, and how their forces depend on a load and on what is uncertain."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hydroopt.errors import LogError
from hydroopt.logs.forces_from_pressures import forces
from hydroopt.logs.joint_angles import measured_angles
from hydroopt.logs.log import Log
from hydroopt.machine.balances import undriven
from hydroopt.model.model import Model
from hydroopt.spatial.inertia import Array
from hydroopt.weighing.smoothing_kernel import SmoothingKernel

MOVING = 0.03
"""Speed [rad/s or m/s], as a joint's, above which an actuator moves: dry friction then has a sign."""
SHORTEST = 1e-9
"""Arm of an actuator about its joint [m or 1] below which it has none."""
UNEVEN = 0.1
"""Part of the sampling step by which steps may differ."""


@dataclass(frozen=True, eq=False)
class SmoothedLog:
    """Smoothed samples of a log, M of them, of n joints and r balances.

    Attributes:
        t: (M,) times [s]; each is known `kernel.half` samples later.
        stretch: (M,) index of the uninterrupted stretch.
        q, qd, qdd, jerk: (M, n) motion.
        force: (M, r) measured forces.
        sign: (M, r) 1 or −1 where the actuator of a balance moves in one direction throughout, 0 elsewhere, where
            nothing is known of dry friction, and of passive joints; see `actuator_speeds`.
        kernel: of the smoothing.
    """

    t: Array
    stretch: NDArray[np.int64]
    q: Array
    qd: Array
    qdd: Array
    jerk: Array
    force: Array
    sign: Array
    kernel: SmoothingKernel

    def __len__(self) -> int:
        return len(self.t)

    def motion(self, tau: float) -> tuple[Array, Array, Array]:
        """The cubic motion (M, n) at a time from each middle [s], whose mean under the kernel is q, qd, qdd."""
        q, qd, qdd = np.tensordot(self.kernel.at_node(tau), np.stack([self.q, self.qd, self.qdd, self.jerk]), axes=1)
        return q, qd, qdd


def smoothed_log(model: Model, log: Log) -> SmoothedLog:
    """Smooth the motion and the forces of a log alike.

    Raises:
        LogError: sampling is irregular, or the log is too short.
    """
    where, steps = log.path or log.name, np.diff(log.t)[np.diff(log.segment) == 0]
    step = float(np.median(steps)) if steps.size else 0.0
    if not step > 0 or np.any(np.abs(steps - step) > UNEVEN * step):
        raise LogError("a scale needs regular sampling", where=where,
                       remedy="resample the log, or cut it at the gaps with --treat gap=split")
    kernel, q = SmoothingKernel.of_step(step), measured_angles(model, log)
    force = forces(model, log, q)
    found: list[tuple[Any, ...]] = []
    for number in np.unique(log.segment):
        rows = np.flatnonzero(log.segment == number)
        at = kernel.middles(len(rows))
        if not at.size:
            continue
        motion = kernel.smoothed(q[rows], at)
        found.append((log.t[rows][at], np.full(at.size, number), *motion, kernel.smoothed(force[rows], at)[0],
                      _signs(model, kernel, q[rows], at, motion)))
    if not found:
        raise LogError(f"a scale needs stretches of {(2 * kernel.margin + 1) * step:.2g} s", where=where,
                       remedy="give a longer log")
    t, stretch, *rest = (np.concatenate(each) for each in zip(*found, strict=True))
    q, qd, qdd, jerk, force, sign = rest
    return SmoothedLog(t, stretch, q, qd, qdd, jerk, force, sign, kernel)


def actuator_speeds(model: Model, q: Array, qd: Array) -> Array:
    """(N, r): speed of each balance's actuator, as that of its joint which alone would move it as fast.

    A cylinder may shorten as its joint's angle grows, and one that spans several joints follows all of them: the dry
    friction in it has the direction of its own motion. Several actuators at a joint move as the joint does.
    """
    machine, arms = model.machine, model.over(model.transmission, q)[0]
    made = np.array(qd[:, model.dynamics.kept])
    for k, (balance, joint) in enumerate(zip(machine.balances, model.dynamics.kept, strict=True)):
        if balance.alone is not None:
            arm = arms[:, machine.actuators.index(balance.alone)]
            made[:, k] = np.sum(arm * qd, axis=1) / np.maximum(np.abs(arm[:, joint]), SHORTEST)
    return made


def _signs(model: Model, kernel: SmoothingKernel, q: Array, at: NDArray[np.intp], motion: Array) -> Array:
    """Direction (M, r) of each balance's actuator as far as the kernel has weight; its arms are those in the middle."""
    reach, middle = kernel.outlook, kernel.nodes[1][0]
    posture = np.tensordot(kernel.at_node(middle)[0], motion, axes=1)
    speeds = np.stack([actuator_speeds(model, posture, kernel.smoothed(q, places)[1])
                       for places in (at - reach, at, at + reach)])
    slowest, fastest = (end(speeds, axis=0) for end in (np.min, np.max))
    sign = np.where(slowest > MOVING, 1.0, np.where(fastest < -MOVING, -1.0, 0.0))
    sign[:, list(undriven(model.machine.balances))] = 0.0
    return sign
