"""A log as a scale takes it: positions, their derivatives and forces smoothed by one kernel.

A filter distorts a motion, and the forces that belong to it, alike (Gautier 1997), but only as far as forces are
linear in the motion: the force of the smoothed motion is off by half a per cent where joints turn fast. Within the
kernel the motion is therefore taken for a cubic, and forces are averaged over it at three `nodes`, as the kernel
averages measured ones. The kernel w(τ) = (1 − τ²/h²)³ ends after the reach h, so that a controller has the result
soon, and the errors of smoothed samples are correlated over 2·h only, by known sums of its weights.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
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

REACH = 0.5
"""How far the kernel reaches to either side [s]."""
STRIDE = 0.2
"""Time between smoothed samples [s]."""
MOVING = 0.03
"""Speed [rad/s or m/s], as a joint's, above which an actuator moves: dry friction then has a sign."""
SHORTEST = 1e-9
"""Arm of an actuator about its joint [m or 1] below which it has none."""
UNEVEN = 0.1
"""Part of the sampling step by which steps may differ."""


@dataclass(frozen=True)
class SmoothingKernel:
    """Weights of samples that are taken every `step` [s].

    Attributes:
        step: between samples [s].
        half: number of samples to either side of the middle.
        stride: number of samples from one smoothed sample to the next.

    >>> kernel = SmoothingKernel.of_step(0.02)
    >>> t = np.arange(100) * 0.02
    >>> q, qd, qdd, jerk = kernel.smoothed(t**2, kernel.middles(100))
    >>> bool(np.allclose(qdd, 2.0) and np.allclose(qd, 2 * t[kernel.middles(100)]))
    True
    """

    step: float
    half: int
    stride: int

    @classmethod
    def of_step(cls, step: float) -> SmoothingKernel:
        """The kernel for a sampling step [s]."""
        return cls(step, max(2, round(REACH / step)), max(1, round(STRIDE / step)))

    @property
    def outlook(self) -> int:
        """Number of samples to either side within which nearly all of the weight lies."""
        return round(0.8 * self.half)

    @property
    def margin(self) -> int:
        """Number of samples that a smoothed one needs on either side, together with the speeds at its outlook."""
        return self.half + self.outlook

    @cached_property
    def weights(self) -> Array:
        """(4, 2·half + 1): what positions, and their first three derivatives, are of the samples."""
        k = np.arange(-self.half, self.half + 1)
        x, tau = k / (self.half + 1), k * self.step
        w = (1 - x**2) ** 3
        first, second = 6 * x * (1 - x**2) ** 2, (1 - x**2) * (30 * x**2 - 6)
        second -= w * second.sum() / w.sum()  # no acceleration of what stands still
        w /= w.sum()
        # the cubic that fits best with the weights w
        third = w * (tau**3 - tau * (w @ tau**4) / (w @ tau**2))
        return np.stack([w, first / (first @ tau), 2 * second / (second @ tau**2), 6 * third / (third @ tau**3)])

    @cached_property
    def spread(self) -> float:
        """Variance of the time under the weights [s²]."""
        return float(self.weights[0] @ self._times**2)

    @cached_property
    def nodes(self) -> tuple[tuple[float, float], ...]:
        """Times from the middle [s] and weights that average polynomials up to the fifth degree as the kernel does."""
        fourth = float(self.weights[0] @ self._times**4)
        apart, share = math.sqrt(fourth / self.spread), self.spread**2 / (2 * fourth)
        return (-apart, share), (0.0, 1 - 2 * share), (apart, share)

    def at_node(self, tau: float) -> Array:
        """(3, 4): position, speed and acceleration at a time from the middle [s], by a smoothed sample's value and
        derivatives: of the cubic whose mean under the kernel they are."""
        rest = (tau**2 - self.spread) / 2
        return np.array([[1.0, tau, rest, tau**3 / 6 - self.spread * tau / 2], [0.0, 1.0, tau, rest],
                         [0.0, 0.0, 1.0, tau]])

    @property
    def _times(self) -> Array:
        return np.asarray(np.arange(-self.half, self.half + 1) * self.step)

    def middles(self, size: int) -> NDArray[np.intp]:
        """Places of the smoothed samples in a stretch of `size` samples."""
        return np.arange(self.margin, size - self.margin, self.stride)

    def smoothed(self, values: Array, middles: NDArray[np.intp]) -> Array:
        """(4, M, …): smoothed values (N, …) and their derivatives at the places `middles` (M,)."""
        near = values[middles[:, None] + np.arange(-self.half, self.half + 1)]
        return np.asarray(np.einsum("dk,mk...->dm...", self.weights, near))

    def of_a_jump(self, count: int) -> Array:
        """(count,): which part of a jump the smoothed samples show, from the first one that shows more than a tenth."""
        reached = np.minimum(self.stride * np.arange(2, count + 2), self.weights.shape[1])
        return np.asarray(np.cumsum(self.weights[0])[reached - 1])

    @cached_property
    def covariance(self) -> Array:
        """(L, 4, 4): covariance of a smoothed sample's value and first three derivatives with those of the l-th one
        after it, per variance of a sample; zero from the L-th on."""
        weights, size, made = self.weights, self.weights.shape[1], []
        for shift in range(0, size, self.stride):
            made.append(weights[:, shift:] @ weights[:, : size - shift].T)
        return np.stack(made)


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
