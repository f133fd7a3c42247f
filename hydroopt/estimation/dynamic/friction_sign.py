"""Where the sign of a joint's velocity, and so of its dry friction, is known (Eq. 4.51)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hydroopt.logs.smoothing import Motion
from hydroopt.machine.actuators import Cylinder
from hydroopt.model.model import Model
from hydroopt.spatial.inertia import Array

NOISE_FACTOR, OVERSHOOT, STANDSTILL = 4.0, 0.15, 1e-6
"""The sign of a joint's velocity is unknown below this many standard deviations of its noise, below this part of its
RMS speed (after an abrupt stop smoothing oscillates, so that slower readings may have the wrong sign), and below this
speed in rad/s or m/s."""

FEW_MOVING = 0.01
"""A joint that moves in less than this part of the samples counts as standing still, since noise has the same
effect."""


def speed_threshold(angles: Array, motion: Motion) -> tuple[Array, Array]:
    """Speed (n,) of each joint below which its sign is not known, and the noise (n,) of its speed."""
    rms_speed, noise = np.sqrt(np.mean(motion.qd**2, axis=0)), NOISE_FACTOR * _velocity_noise(angles, motion)
    return np.maximum(np.maximum(noise, OVERSHOOT * rms_speed), STANDSTILL), noise


def dry_friction_known(model: Model, motion: Motion, moving: NDArray[np.bool_], noise: Array) -> NDArray[np.bool_]:
    """Where dry friction is known (N, n): where joints are `moving`, and inside dead zones, where it is zero.

    Near the ends of a dead zone it is not known. `noise` (n,) bounds the errors of the joints' speeds.
    """
    machine = model.machine
    known = moving.copy()
    for k, (joint, actuator) in enumerate(zip(machine.joints, machine.actuators, strict=True)):
        width = actuator.friction.dead_zone
        if width is None:
            continue
        speed, uncertainty = motion.qd[:, k], np.full(len(motion.t), noise[k])
        other_dry = machine.link(joint).joint.friction.coulomb is not None
        if isinstance(actuator, Cylinder):
            c = machine.all_cylinders.index(actuator)
            _, speeds, _, arms, _ = model.over(model.cylinder_kinematics, motion.q, motion.qd, motion.qdd)
            speed, uncertainty = speeds[:, c, 0], np.linalg.norm(arms[:, c] * noise, axis=1)
            other_dry |= actuator.friction.barrel_pin is not None or actuator.friction.rod_pin is not None
        size = np.abs(speed)
        known[:, k] &= size > width + uncertainty
        if not other_dry:
            known[:, k] |= size < width - uncertainty
    return known


def _velocity_noise(angles: Array, motion: Motion) -> Array:
    """Standard deviation of the smoothed velocities (n,): white noise, low-passed and differentiated.

    σ_v² = ∫₀^f (2πν)²·2σ²Δt dν with the smoother's bandwidth f and the σ of its residuals.
    """
    sigma = np.std(angles - motion.q, axis=0)
    step = float(np.median(np.diff(motion.t)))
    bandwidth = np.clip(motion.bandwidth, 1 / float(motion.t[-1] - motion.t[0]), 0.5 / step)
    return np.asarray(sigma * np.sqrt(8 / 3 * np.pi**2 * step * bandwidth**3))
