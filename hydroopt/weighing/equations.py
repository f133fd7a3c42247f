"""The equations of smoothed samples: how measured forces depend on the load and on the scale's own unknowns."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from hydroopt.spatial.inertia import Array
from hydroopt.weighing.scale import Scale
from hydroopt.weighing.smoothed_log import SmoothedLog

LEAST = 1e-6
"""Square of gravity's part along that of the machine file that is left at least [m²/s⁴]."""
SMALLEST_SHARE = 0.1
"""Part of a force's reading that is the force's at least."""


@dataclass(frozen=True, eq=False)
class Equations:
    """M samples of r forces as they depend on a scale's own unknowns and on the ten numbers φ of a load.

    With x = (1, z, μ, ε, φ), the model's numbers z, friction μ and parts ε of the readings that are too much, and a
    change δg of gravity the force is ``predicted + (K + G·δg)·x``, and its reading ``1/(1 − ε)`` times the force.

    Attributes:
        t: (M,) [s].
        sign: (M, r) see `SmoothedLog`; where it is 0 the equation is not used.
        predicted: (M, r) forces [N or N·m] of the calibrated machine without load.
        K: (M, r, c − 1 + 10) of c own unknowns, 0 in its first column; G: (M, r, c − 1 + 10, 3).
        by_motion: (M, r, 4, n, 11) derivatives of the force by q and its first three derivatives, without load and per
            number of it, times the standard deviation of a position's reading.
    """

    scale: Scale
    smoothed: SmoothedLog
    predicted: Array
    K: Array
    G: Array
    by_motion: Array

    @property
    def t(self) -> Array:
        """(M,) times [s]."""
        return self.smoothed.t

    @property
    def sign(self) -> Array:
        """(M, r) directions of the actuators."""
        return self.smoothed.sign

    @cached_property
    def force(self) -> Array:
        """(M, r) measured forces [N or N·m], as known loads have corrected them."""
        return np.asarray(self.smoothed.force * (1 - self.scale.read))

    @cached_property
    def rest(self) -> Array:
        """(M, r) measured less predicted forces."""
        return self.force - self.predicted

    @cached_property
    def moving(self) -> NDArray[np.bool_]:
        """(M, r) where a joint moves in one direction and its force is known."""
        return np.asarray((self.sign != 0) & np.isfinite(self.rest))

    def linearised(self, i: int, own: Array, phi: Array) -> tuple[Array, Array]:
        """Residuals (r,) of sample i and its forces' derivatives (r, c + 10) by the own unknowns and the load φ."""
        change, turn = self._gravity(own)
        K, G = self.K[i], self.G[i]
        x = np.concatenate([[1.0], own[:-2], phi])
        by_number, by_tilt = K + G @ change, np.einsum("rxg,x->rg", G, x) @ turn
        rest, J = self.rest[i] - by_number @ x, np.hstack([by_number[:, 1:-10], by_tilt, by_number[:, -10:]])
        if self.scale.gains:
            at = slice(-2 - self.scale.gains, -2)
            force, read = self.force[i] - rest, 1 / np.maximum(1 - own[at], SMALLEST_SHARE)
            rest, J = self.force[i] - read * force, read[:, None] * J
            J[:, : len(own)][:, at] += np.diag(read**2 * force)
        return rest, J

    def noise_by_motion(self, i: int, phi: Array) -> Array:
        """(r, 4, n) derivatives of sample i's forces by the motion with a load φ, per noise of a position."""
        return np.asarray(self.by_motion[i] @ np.concatenate([[1.0], phi]))

    def _gravity(self, own: Array) -> tuple[Array, Array]:
        """Gravity (3,) less that of the machine file, for the scale's own unknowns (c,), and its derivatives (3, 2)."""
        nominal, axes, across = self.scale.gravity, self.scale.axes, own[-2:]
        along = np.sqrt(max(float(nominal @ nominal - across @ across), LEAST))
        return (np.array([*across, along]) @ axes - nominal,
                axes[:2].T - np.outer(axes[2], across / along))


def equations(scale: Scale, smoothed: SmoothedLog) -> Equations:
    """The equations of smoothed samples for a scale."""
    model, psi, M = scale.model, scale.psi, len(smoothed)
    r = smoothed.force.shape[1]
    parts = [(share, smoothed.motion(tau)) for tau, share in smoothed.kernel.nodes]
    K, predicted = (sum(share * each for (share, _), each in zip(parts, some, strict=True)) for some in zip(*(
        model.over(model.linearised, *at, psi) for _, at in parts), strict=True))
    size = np.abs(smoothed.force * (1 - scale.read))
    numbers = np.column_stack([psi, scale.directions, -scale.taken, scale.carried])
    k = scale.directions.shape[1]
    seen = K @ numbers
    seen[:, :, 0] = 0.0
    rubbing = size * smoothed.sign
    seen[:, :, 1 + k : 1 + k + r] += np.eye(r) * rubbing[:, :, None]
    heavy = sum(share * model.over(model.gravity_regressor, at[0])[0] for share, at in parts)
    G = (heavy @ numbers).reshape(M, 3, r, -1).transpose(0, 2, 3, 1)
    by_motion = np.zeros((M, r, 4, smoothed.q.shape[1], 11))
    for tau, share in smoothed.kernel.nodes:
        for k, column in enumerate((psi, *scale.carried.T)):
            by = np.stack(model.over(model.force_by_motion, *smoothed.motion(tau), column), axis=2)
            by_motion[..., k] += share * np.einsum("mrxn,xd->mrdn", by, smoothed.kernel.at_node(tau))
    return Equations(scale, smoothed, predicted[:, :, 0], seen, np.ascontiguousarray(G),
                     by_motion * scale.angle_std[:, None])
