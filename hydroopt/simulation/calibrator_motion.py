"""How an attached calibrator moves with the machine: closed postures, and their rates by implicit differentiation."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hydroopt.errors import ProblemError
from hydroopt.model.attached_calibrator import AttachedCalibrator
from hydroopt.simulation.postures import close
from hydroopt.spatial.inertia import Array

FREE = 1e3
"""How much more easily joints without readings turn than those with, when the chain is closed."""
PASSES = 2
"""How often a posture with joints without readings is closed, each time from the readings as they were."""
STILL = 1e-6
"""Smallest singular value of a loop's Jacobian, relative to the largest, that counts."""


@dataclass(frozen=True, eq=False)
class CalibratorMotion:
    """Positions, rates and accelerations (N, r) [rad, m, s] of the joints of a calibrator in a fixture."""

    attached: AttachedCalibrator
    q: Array
    qd: Array
    qdd: Array

    def regressor(self, q: Array, qd: Array, qdd: Array) -> Array:
        """What the calibrator adds to the regressor K (N, r, p) for the machine's motion (N, n)."""
        return self.attached.regressor(*self._with((q, qd, qdd)))

    def at_joints(self, q: Array, qd: Array, qdd: Array) -> Array:
        """Generalised forces (N, n, p) per parameter that it loads the machine's joints with."""
        return self.attached.at_joints(*self._with((q, qd, qdd)))

    def _with(self, motion: tuple[Array, Array, Array]) -> tuple[Array, ...]:
        return tuple(np.hstack(pair) for pair in zip(motion, (self.q, self.qd, self.qdd), strict=True))


def follow(attached: AttachedCalibrator, q: Array, qd: Array, qdd: Array,
           read: tuple[Array, Array, Array], sensed: NDArray[np.bool_]) -> CalibratorMotion:
    """The motion of the calibrator that closes the loop at each sample of a machine's motion (N, n).

    Where the loop determines the calibrator's joints, they and their rates follow from the machine's alone. Freedoms
    beyond are taken from readings, which change as little as closing needs.

    Args:
        attached: the calibrator in its fixture.
        q, qd, qdd: the machine's motion.
        read: the calibrator's joints (N, r) with their rates as they were read.
        sensed: (r,) which of them were read; the others only start there.

    Raises:
        ProblemError: the chain cannot be closed at a sample, or joints without readings are not determined.
    """
    kinematics, fixture = attached.kinematics, attached.fixture
    n, r, N = q.shape[1], len(attached.joints), len(q)
    weight = np.where(sensed, 1.0, FREE)
    whole, nominal = np.hstack([q, read[0]]), kinematics.parameters.nominal
    free = list(range(n, n + r))
    if np.all(sensed):
        whole, closed = close(kinematics, nominal, whole, free, fixture)
    else:  # each posture starts from the one before, so that no branch is left
        closed = np.zeros(N, dtype=bool)
        for k in range(N):
            if k:
                whole[k, n:][~sensed] = whole[k - 1, n:][~sensed]
            for _ in range(PASSES):  # far from where it started the chain has bent the readings, too
                whole[k, n:][sensed] = read[0][k, sensed]
                at = slice(k, k + 1)
                whole[at], closed[at] = close(kinematics, nominal, whole[at], free, fixture, weight)
            if not closed[k]:
                break
    if not np.all(closed):
        first = int(np.flatnonzero(~closed)[0]) + 1
        raise ProblemError(f"the calibrator does not reach the fixture '{fixture.name}' at sample {first}",
                           where=attached.model.machine.name,
                           remedy="correct the geometry of calibrator or fixture, or the angles of the log")
    C = kinematics.over(attached.loop_rates, whole, np.zeros_like(whole))[0]
    own = C[:, :, n:]
    _refuse_loose(attached, own, sensed)
    inverse = weight[:, None] * np.linalg.pinv(own * weight, rcond=STILL / FREE)

    def consistent(rate: Array, machine: Array, curvature: Array) -> Array:
        rate = np.where(sensed, rate, 0.0)
        gap = C[:, :, :n] @ machine[:, :, None] + own @ rate[:, :, None] + curvature
        return np.asarray(rate - (inverse @ gap)[:, :, 0])

    speed = consistent(read[1], qd, np.zeros((N, C.shape[1], 1)))
    curvature = kinematics.over(attached.loop_rates, whole, np.hstack([qd, speed]))[1]
    return CalibratorMotion(attached, whole[:, n:], speed, consistent(read[2], qdd, curvature))


def _refuse_loose(attached: AttachedCalibrator, own: Array, sensed: NDArray[np.bool_]) -> None:
    """Refuse joints without readings whose motion the loop does not determine."""
    loose = np.flatnonzero(~sensed)
    if not loose.size:
        return
    sizes = np.linalg.svd(own[:, :, loose], compute_uv=False)
    size = np.linalg.norm(own, axis=(1, 2))
    if own.shape[1] < loose.size or np.any(sizes[:, loose.size - 1] < STILL * size):
        names = [attached.joints[k] for k in loose]
        raise ProblemError(f"the machine's motion does not determine {', '.join(names)} of the calibrator",
                           where=attached.model.machine.name,
                           remedy="record the angles of more of its joints")
