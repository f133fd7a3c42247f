"""The equations of smoothed samples: how measured forces depend on the load and on the scale's own unknowns."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hydroopt.spatial.inertia import Array
from hydroopt.weighing.scale import Scale, acting
from hydroopt.weighing.smoothed_log import MOVING, SmoothedLog

SHOWN = 3.0
"""Standard deviations by which a change of mass shows."""
STILL_PART = 1 / 3
"""Variance of what dry friction holds of a standing joint, per square of the friction: anything between its ends."""


@dataclass(frozen=True, eq=False)
class Equations:
    """M samples of r forces as they depend on a scale's own unknowns and on the ten numbers φ of a load.

    With x = (1, z, μ, φ), the model's numbers z and friction μ, and a change δg of gravity the force is ``predicted +
    (K + G·δg)·x``.

    Attributes:
        t: (M,) [s].
        sign: (M, r) see `SmoothedLog`; what is NaN there is not used.
        rest: (M, r) measured less predicted force.
        K: (M, r, 1 + k + r + 10), 0 in its first column; G: (M, r, 1 + k + r + 10, 3).
        by_motion: (M, r, 3·n, 11) derivatives of the force by q, q̇, q̈, without load and per number of it, times the
            standard deviation of a position's reading.
        stiction: (M, r) standard deviation of what dry friction holds of standing joints.
    """

    scale: Scale
    smoothed: SmoothedLog
    rest: Array
    K: Array
    G: Array
    by_motion: Array
    stiction: Array

    @property
    def t(self) -> Array:
        """(M,) times [s]."""
        return self.smoothed.t

    @property
    def sign(self) -> Array:
        """(M, r) directions of the joints."""
        return self.smoothed.sign

    def moving(self) -> NDArray[np.bool_]:
        """(M, r) where a joint moves in one direction and its force is known."""
        return np.asarray((np.abs(np.nan_to_num(self.sign)) > 0) & np.isfinite(self.rest))

    def telling(self, mass: float) -> NDArray[np.bool_]:
        """(M,) where a change of mass [kg] shows in the force of a moving joint, by `SHOWN` standard deviations."""
        own = self.smoothed.kernel.covariance[0]
        by = self.by_motion[:, :, :, 0].reshape(*self.rest.shape, 3, -1)
        noise = np.sqrt(np.einsum("mran,ab,mrbn->mr", by, own, by) + own[0, 0] * self.scale.force_std**2)
        return np.asarray(np.any(self.moving() & (np.abs(self.K[:, :, -10]) * mass > SHOWN * noise), axis=1))

    def rows(self, samples: NDArray[np.intp], *, moving: bool = False) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
        """The equations of some samples (m,) that count: sample and balance of each (N,), sample by sample.

        A joint that stands counts once for each time, by its last sample: what friction holds stays the same.
        """
        taken = self.moving()[samples]
        if not moving:
            still = (self.sign[samples] == 0) & np.isfinite(self.rest[samples])
            goes_on = np.zeros_like(still)
            goes_on[:-1] = still[:-1] & still[1:] & (np.diff(samples) == 1)[:, None]
            taken = taken | (still & ~goes_on)
        place, balance = np.nonzero(taken)
        return samples[place], balance

    def covariance(self, at: tuple[NDArray[np.intp], NDArray[np.intp]], phi: Array) -> Array:
        """(N, N) covariance of the forces' errors in these rows, with a load φ (10,)."""
        sample, balance = at
        n3 = self.by_motion.shape[2]
        by = (self.by_motion[sample, balance] @ np.concatenate([[1.0], phi])).reshape(len(sample), 3, n3 // 3)
        known = self.smoothed.kernel.covariance
        made = np.zeros((len(sample), len(sample)))
        lag = sample[None, :] - sample[:, None]
        same = self.smoothed.stretch[sample][None, :] == self.smoothed.stretch[sample][:, None]
        for shift in range(len(known)):
            i, j = np.nonzero((lag == shift) & same)
            value = np.einsum("xan,ab,xbn->x", by[i], known[shift], by[j])
            value += np.where(balance[i] == balance[j], known[shift, 0, 0] * self.scale.force_std[balance[i]] ** 2, 0.0)
            made[i, j] = made[j, i] = value
        made[np.diag_indices(len(sample))] += self.stiction[sample, balance] ** 2
        return made


def equations(scale: Scale, smoothed: SmoothedLog) -> Equations:
    """The equations of smoothed samples for a scale."""
    model, psi, M = scale.model, scale.psi, len(smoothed)
    n, r = smoothed.q.shape[1], smoothed.force.shape[1]
    kept = model.dynamics.kept

    def motion(tau: float) -> tuple[Array, Array, Array]:
        q, qd, qdd = smoothed.motion(tau)
        qd[:, kept] = np.where(smoothed.sign == 0, 0.0, qd[:, kept])  # dry friction of what stands is unknown
        return q, qd, qdd

    parts = [(share, motion(tau)) for tau, share in smoothed.kernel.nodes]
    K, predicted = (sum(share * each for (share, _), each in zip(parts, some, strict=True)) for some in zip(*(
        model.over(model.linearised, *at, psi) for _, at in parts), strict=True))
    size, numbers = np.abs(smoothed.force), np.column_stack([psi, scale.directions, -scale.taken, scale.carried])
    k = scale.directions.shape[1]
    seen = K @ numbers
    seen[:, :, 0] = 0.0
    rubbing = size * acting(model, smoothed.q, np.nan_to_num(smoothed.sign))
    seen[:, :, 1 + k : 1 + k + r] += np.eye(r) * rubbing[:, :, None]
    heavy = sum(share * model.over(model.gravity_regressor, at[0])[0] for share, at in parts)
    G = (heavy @ numbers).reshape(M, 3, r, -1).transpose(0, 2, 3, 1)
    speeds = np.zeros((2, M, n))
    speeds[0, :, kept], speeds[1, :, kept] = MOVING, -MOVING
    ends = [model.over(model.inverse_dynamics, smoothed.q, each, 0 * each, psi)[0][:, :, 0] for each in speeds]
    held = np.abs(ends[0] - ends[1]) / 2
    by_motion = np.stack([np.concatenate(model.over(model.force_by_motion, *motion(0.0), column), axis=2)
                          for column in (psi, *scale.carried.T)], axis=3)
    still = STILL_PART * (held**2 + (scale.uncertain.load_friction * size) ** 2)
    return Equations(
        scale, smoothed, smoothed.force - predicted[:, :, 0], seen, np.ascontiguousarray(G),
        by_motion * np.tile(scale.angle_std, 3)[:, None], np.where(smoothed.sign == 0, np.sqrt(still), 0.0))
