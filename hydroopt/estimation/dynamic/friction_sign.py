"""Where the sign of a velocity, and so of dry friction, is known (Eq. 4.51), and where joints stand still.

In a sample a joint is in motion, calm, or in a reversal. Forces of an actuator without dry friction follow from the
motion in all of them, and with dry friction in motion. While the joint is calm its friction is anything between −f and
f (`holds`), and reversals are left out. A cylinder that spans several joints moves otherwise than each of them: its
length counts like the position of a joint.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import reduce

import numpy as np
from numpy.typing import NDArray

from hydroopt.logs.smoothing import STANDSTILL, Motion
from hydroopt.machine.actuators import Cylinder
from hydroopt.machine.parameter_kind import ParameterKind
from hydroopt.model.model import Model
from hydroopt.spatial.inertia import Array

NOISE_FACTOR, OVERSHOOT = 4.0, 0.15
"""The sign of a joint's velocity is unknown below this many standard deviations of its noise, below this part of its
RMS speed (after an abrupt stop smoothing oscillates, so that slower readings may have the wrong sign), and below
`STANDSTILL`."""

FEW_MOVING = 0.01
"""A joint that moves in less than this part of the samples counts as standing still, since noise has the same
effect."""

WINDOW, PARTS, SAME = 1.0, 4, 5.0
"""A joint is calm where it is slow throughout this time [s]. It is at rest where the mean measured positions of so many
parts of it differ by less than so many standard deviations."""

ROUNDING = 1e-9
"""Error of times [s]."""

DRY = (ParameterKind.COULOMB_FRICTION, ParameterKind.STRIBECK_FRICTION, ParameterKind.SEAL_FRICTION,
       ParameterKind.PIN_FRICTION)
"""Kinds of parameters whose force at standstill is not known."""


@dataclass(frozen=True, eq=False)
class Courses:
    """What dry friction may follow: the joints, then the lengths of cylinders that span several of them.

    Attributes:
        model: of the machine.
        spanning: places of these cylinders in the machine's parts with two pins.
        of_balances: columns whose dry friction is in the equation of each balance, its joint's where there is none.
    """

    model: Model
    spanning: tuple[int, ...]
    of_balances: tuple[tuple[int, ...], ...]

    @classmethod
    def of(cls, model: Model) -> Courses:
        """Those of a machine.

        >>> import hydroopt as ho
        >>> Courses.of(ho.Model(ho.load_machine("wheel_loader"))).of_balances
        ((0,), (2,))
        """
        machine, kept = model.machine, model.dynamics.kept
        spanning = [each for each in machine.cylinders if len(machine.moved_by(each)) > 1]
        own: tuple[tuple[int, ...], ...] = tuple((joint,) for joint in kept)
        if spanning:
            column = {joint: k for k, joint in enumerate(machine.joints)}
            column |= {each.name: column[machine.main_joint(each)] for each in machine.actuators}
            column |= {each.name: len(machine.joints) + k for k, each in enumerate(spanning)}
            dry = has_dry(model)
            owners = [[name.partition(".")[0] for name in np.array(model.parameters.names)[row & dry].tolist()]
                      for row in model.regressor_pattern]
            own = tuple(tuple(sorted({column.get(owner, joint) for owner in some} or {joint}))
                        for some, joint in zip(owners, kept, strict=True))
        return cls(model, tuple(machine.pinned.index(each) for each in spanning), own)

    def measured(self, angles: Array) -> Array:
        """Measured positions (N, c) [rad or m] from those of the joints (N, n)."""
        return angles if not self.spanning else np.hstack([angles, self._lengths(angles, 0 * angles)[0]])

    def smoothed(self, motion: Motion) -> Motion:
        """Their smoothed motion, without accelerations: a bandwidth is the largest of the joints that are spanned."""
        if not self.spanning:
            return motion
        machine = self.model.machine
        widest = [max(motion.bandwidth[machine.joints.index(joint)] for joint in machine.moved_by(machine.pinned[k]))
                  for k in self.spanning]
        return replace(motion, q=self.measured(motion.q), qd=self.speeds(motion.q, motion.qd),
                       bandwidth=np.append(motion.bandwidth, widest))

    def speeds(self, q: Array, qd: Array) -> Array:
        """Their speeds (N, c) [rad/s or m/s] in a motion of the joints (N, n)."""
        return qd if not self.spanning else np.hstack([qd, self._lengths(q, qd)[1]])

    def in_any(self, columns: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """What is so of any column (N, c) whose dry friction a balance has, by balance (N, r)."""
        return np.array([reduce(np.logical_or, (columns[:, k] for k in own)) for own in self.of_balances]).T

    def _lengths(self, q: Array, qd: Array) -> tuple[Array, Array]:
        found = self.model.over(self.model.cylinder_kinematics, q, qd, 0 * q)
        return found[0][:, list(self.spanning), 0], found[1][:, list(self.spanning), 0]


@dataclass(frozen=True, eq=False)
class SpeedLimits:
    """How slow counts as what, for each joint or column of `Courses` (c,).

    Attributes:
        slow: speed [rad/s or m/s] below which its sign may be wrong.
        noise: that below which noise alone may turn it.
        sigma: standard deviation of the measured positions [rad or m].
    """

    slow: Array
    noise: Array
    sigma: Array

    @classmethod
    def of(cls, angles: Array, motion: Motion) -> SpeedLimits:
        """Those of measured positions (N, n) and the motion that they were smoothed to."""
        sigma = np.std(angles - motion.q, axis=0)
        step = float(np.median(np.diff(motion.t)))
        bandwidth = np.clip(motion.bandwidth, 1 / float(motion.t[-1] - motion.t[0]), 0.5 / step)
        # white noise, low-passed and differentiated: σ_v² = ∫₀^f (2πν)²·2σ²Δt dν
        noise = NOISE_FACTOR * sigma * np.sqrt(8 / 3 * np.pi**2 * step * bandwidth**3)
        rms_speed = np.sqrt(np.mean(motion.qd**2, axis=0))
        return cls(np.maximum(np.maximum(noise, OVERSHOOT * rms_speed), STANDSTILL), noise, sigma)


@dataclass(frozen=True, eq=False)
class Phases:
    """What each joint, or each column of `Courses`, does in each sample (N, c): `moving` faster than its sign needs, or
    `calm`, and `rest` if it does not move at all then.
    """

    moving: NDArray[np.bool_]
    calm: NDArray[np.bool_]
    rest: NDArray[np.bool_]

    @classmethod
    def of(cls, angles: Array, motion: Motion, limits: SpeedLimits) -> Phases:
        """Those of measured positions (N, n) and the motion that they were smoothed to.

        >>> t = np.arange(400) / 100
        >>> q = np.maximum(t - 2, 0)[:, None]
        >>> one = np.zeros(400, int)
        >>> motion = Motion(t, q, 1.0 * (q > 0), 0 * q, one, t >= 0, np.array([5.0]), np.ones(1, int), ())
        >>> found = Phases.of(q, motion, SpeedLimits.of(q, motion))
        >>> int(np.flatnonzero(found.rest)[-1]), int(np.flatnonzero(found.moving)[0])
        (150, 201)
        """
        made = np.empty((3, motion.qd.shape[1], len(motion.t)), dtype=bool)
        moving, calm, rest = (each.T for each in made)
        shifts = np.array([WINDOW * (k / PARTS - 0.5) + sign * ROUNDING
                           for k, sign in zip(range(PARTS + 1), (-1, *[0] * (PARTS - 1), 1), strict=True)])
        edges = np.flatnonzero(np.diff(motion.segment, prepend=motion.segment[0] - 1, append=motion.segment[-1] + 1))
        for start, stop in zip(edges[:-1].tolist(), edges[1:].tolist(), strict=True):
            span = slice(start, stop)
            moving[span], calm[span], rest[span] = _phases(motion.t[span], angles[span], motion.qd[span], shifts,
                                                           limits.slow, SAME * limits.sigma)
        return cls(moving, calm, rest & calm)

    def at_rest(self, motion: Motion) -> Motion:
        """The motion without the noise of speeds and accelerations where a joint is at rest.

        Where all are, the ends of stretches are as good as their middle.
        """
        rest = self.rest[:, : motion.q.shape[1]]
        if not np.any(rest):
            return motion
        everywhere, rest = reduce(np.logical_and, rest.T), np.ascontiguousarray(rest)  # in the order of the motion
        return replace(motion, qd=np.where(rest, 0.0, motion.qd), qdd=np.where(rest, 0.0, motion.qdd),
                       interior=motion.interior | everywhere)

    def of_balances(self, courses: Courses) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
        """Where all that has dry friction in each balance moves (N, r), and where all of it is calm (N, r)."""
        return ~courses.in_any(~self.moving), ~courses.in_any(~self.calm)


def _phases(t: Array, angles: Array, speeds: Array, shifts: Array, slow: Array, apart: Array
            ) -> tuple[NDArray[np.bool_], NDArray[np.bool_], NDArray[np.bool_]]:
    """Where joints move, are calm, and have one mean in all parts of the window, (N, c) each, in one stretch.

    Args:
        t: times (N,) [s], not decreasing.
        angles: measured positions (N, c).
        speeds: (N, c).
        shifts: (PARTS + 1,) from a sample's time to the first of each part of its window, and to the end [s].
        slow: (c,) speeds up to which joints do not move.
        apart: (c,) difference of two means of one sample each, over the square root of 2, up to which they are one.
    """
    places = np.array([np.searchsorted(t, t + shift) for shift in shifts.tolist()])
    same = _same_mean(angles, places, apart)
    moving, calm = (np.abs(speeds) > slow) & ~same, np.empty_like(same)
    for j, one in enumerate(moving.T):
        fast = np.concatenate([[0], np.cumsum(one)])
        calm[:, j] = fast.take(places[-1]) == fast.take(places[0])
    return moving, calm, same


def _same_mean(angles: Array, places: NDArray[np.intp], apart: Array) -> NDArray[np.bool_]:
    """Whether positions (N, n) have one mean in all parts of a window about each sample; `apart` (n,) as of `_phases`.

    `places` (parts + 1, N) are the first samples of the parts, and one after the last.
    """
    total = np.zeros((angles.shape[1], len(angles) + 1))
    np.cumsum((angles - angles.mean(axis=0)).T, axis=1, out=total[:, 1:])
    counts = np.diff(places, axis=0)
    empty = counts == 0
    share = 1.0 / np.where(empty, np.nan, counts)  # a part without samples has no mean
    fewest = np.min(np.where(empty, np.inf, counts), axis=0)
    same = np.empty(angles.shape, dtype=bool)
    for j, sums in enumerate(total):
        means = np.diff(sums.take(places), axis=0) * share
        most = np.maximum(apart[j] * np.sqrt(2 / fewest), STANDSTILL * WINDOW)
        same[:, j] = np.fmax.reduce(means) - np.fmin.reduce(means) <= most
    return same


def has_dry(model: Model) -> NDArray[np.bool_]:
    """Which parameters (p,) are of dry friction."""
    return np.array([kind in DRY for kind in model.parameters.kinds], dtype=bool)


def has_dry_friction(model: Model) -> NDArray[np.bool_]:
    """Which measured forces (r,) depend on dry friction."""
    return np.asarray(np.any(model.regressor_pattern & has_dry(model), axis=1))


def dry_friction_known(model: Model, motion: Motion, moving: NDArray[np.bool_], noise: Array) -> NDArray[np.bool_]:
    """Where the dry friction in each balance is known (N, r): where what has it is `moving` (N, r), and inside dead
    zones, where it is zero.

    Near the ends of a dead zone it is not known. `noise` (n,) bounds the errors of the joints' speeds. That of a
    balance without dry friction is known everywhere.
    """
    machine, known = model.machine, moving.copy()
    for k, balance in enumerate(machine.balances):
        j = machine.joints.index(balance.joint)
        for actuator in balance.actuators:
            width = actuator.friction.dead_zone
            if width is None:
                continue
            speed, uncertainty = motion.qd[:, j], np.full(len(motion.t), noise[j])
            other_dry = machine.link(balance.joint).joint.friction.coulomb is not None or not balance.alone
            if isinstance(actuator, Cylinder):
                c = machine.pinned.index(actuator)
                _, speeds, _, arms, _ = model.over(model.cylinder_kinematics, motion.q, motion.qd, motion.qdd)
                speed, uncertainty = speeds[:, c, 0], np.linalg.norm(arms[:, c] * noise, axis=1)
                other_dry |= actuator.friction.barrel_pin is not None or actuator.friction.rod_pin is not None
            size = np.abs(speed)
            known[:, k] &= size > width + uncertainty
            if not other_dry:
                known[:, k] |= size < width - uncertainty
    return np.asarray(known | ~has_dry_friction(model))
