"""The equations of poses: rows that must vanish, their derivatives, and what weights them.

Every pose gives rows that must vanish: the gap between tip and fixture, and the differences of cylinder lengths, of
tracked tips and of taped distances from their readings. Joint angles are sensed (with errors of their own), locked at
a constant of their stage, or moving without a sensor.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Literal

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from hydroopt.estimation.inference import listing
from hydroopt.estimation.kinematic.pose_layout import FixtureDistances, PoseLayout
from hydroopt.logs.poses import Poses
from hydroopt.model.closed_chain import KinematicModel
from hydroopt.parameters.parameter_set import ParameterKind, ParameterSet
from hydroopt.spatial.inertia import Array

ALWAYS_KNOWN = (ParameterKind.DRIFT, ParameterKind.BIAS)
"""Kinds whose confidences count as measurements, with and without priors."""
PoseLoss = Literal["squares", "huber", "student_t"]
HUBER = 3.0
"""Error of a pose, in units of what is expected, beyond which Huber's loss grows linearly."""
FREEDOM = 4.0
"""Degrees of freedom of Student's t."""


def robust_loss(square: ca.SX, loss: str, expected: ca.SX) -> ca.SX:
    """Cost of a squared error in standard deviations, of which `expected` are usual; near zero it is the square.

    >>> robust_loss(ca.SX(4.0), "squares", ca.SX(1.0))
    SX(4)
    >>> robust_loss(ca.SX(36.0), "huber", ca.SX(1.0))
    SX(27)
    """
    if loss == "huber":
        limit = HUBER**2 * expected
        return ca.if_else(square <= limit, square, 2 * ca.sqrt(limit * ca.fmax(square, limit)) - limit)
    if loss == "student_t":
        return (FREEDOM + expected) * ca.log1p(square / (FREEDOM + expected))
    return square


@dataclass(frozen=True, eq=False, repr=False)
class PoseEquations:
    """What is unknown in which poses, and how it is weighted.

    Attributes:
        model: geometry and its derivatives.
        poses: the measured ones (N of them); `validation` those held out.
        parameters: geometry, then fixtures, angles of locked joints and their drifts.
        layout: where the angles of the poses come from.
        angle_sigma: (n,) standard deviation of each joint's readings [rad, m]; 0 counts as exact.
        row_sigma: (N, m) standard deviation of each row [m]; 0 must hold exactly.
        distances: between fixtures.
        fixed: parameters that keep the value given here.
        priors: whether the machine file's confidences count as measurements; those of drifts and biases always do.
        loss: what a pose's squared error, in standard deviations, costs.
    """

    model: KinematicModel
    poses: Poses
    validation: Poses | None
    parameters: ParameterSet
    layout: PoseLayout
    angle_sigma: Array
    row_sigma: Array
    distances: FixtureDistances
    fixed: Mapping[str, float]
    priors: bool = True
    loss: PoseLoss = "squares"

    @property
    def free(self) -> NDArray[np.bool_]:
        """(P,) which parameters are estimated."""
        return np.array([name not in self.fixed for name in self.parameters.names], dtype=bool)

    @property
    def known(self) -> Array:
        """(P,) root of the information that counts beside the data: of drifts and biases always, of the rest as
        `priors` says."""
        counts = [self.priors or kind in ALWAYS_KNOWN for kind in self.parameters.kinds]
        return np.asarray(np.sqrt(np.diag(self.parameters.information)) * counts)

    @property
    def cylinder_parameters(self) -> NDArray[np.bool_]:
        """(P,) which parameters are the cylinders' own: pins and dead lengths."""
        owners = {cylinder.name for cylinder in self.model.machine.cylinders}
        return np.array([name.partition(".")[0] in owners for name in self.parameters.names], dtype=bool)

    @property
    def start(self) -> Array:
        """(P,) nominal values, with the fixed ones in place."""
        start = self.parameters.nominal.copy()
        for name, value in self.fixed.items():
            start[self.parameters.index(name)] = value
        return start

    @property
    def objective(self) -> Iterator[str]:
        """The terms whose sum is minimised, in words."""
        layout, model = self.layout, self.model
        for k, joint in enumerate(model.joints):
            count = int(layout.sensed[:, k].sum())
            if count and self.angle_sigma[k]:
                unit = model.machine.channel_units[f"{joint}.q"]
                yield (f"readings of {joint}.q: ½·((q − reading)/σ)² over {count} poses, "
                       f"σ = {listing.number(self.angle_sigma[k])} {unit}")
        for i, channel in enumerate(model.channels):
            rows = layout.present[:, i] & (self.row_sigma[:, i] > 0)
            if np.any(rows):
                sigma = listing.number(float(np.median(self.row_sigma[rows, i])))
                yield f"rows of {channel}: ½·(row/σ)² over {int(rows.sum())} poses, σ = {sigma} {model.units[i]}"
        if self.loss != "squares":
            yield f"loss '{self.loss}' of the sum of each pose's terms"
        if len(self.distances.length):
            yield f"distances between fixtures: ½·((distance − length)/σ)² over {len(self.distances.length)}"
        known = int(np.sum(self.known > 0))
        if known:
            yield f"priors of the machine file: ½·((θ − nominal)/σ)² over {known} parameters"

    def angles(self, theta: Array, own: Array) -> Array:
        """Joint vectors (N, n): `own` where sensed or moving, the parameters' where locked."""
        q: Array = np.where(self.layout.sensed | self.layout.moving, own, self.layout.reading)
        where, which, factor = self.layout.locked
        np.add.at(q.ravel(), where, factor * theta[which])
        return q

    def places(self, theta: Array) -> Array:
        """Place (N, k) [m, rad] of every pose's fixture, of its tapes' end and of its instruments, and what rows take
        of its readings, see `KinematicModel.loop`; zero where there is none."""
        return np.where(self.layout.place >= 0, theta[np.maximum(self.layout.place, 0)], self.layout.given)

    def rows(self, theta: Array, q: Array, used: NDArray[np.intp] | None = None) -> tuple[Array, Array, Array]:
        """Rows (N, m) that must vanish, and their Jacobians by all parameters (N, m, P) and by angles (N, m, n);
        with `used` (u,) only those of some rows (N, u), (N, u, P), (N, u, n)."""
        count, n = q.shape
        k = len(self.model.parameters)
        value, by_g, by_q, by_place = self.model.over(self.model.observed_jacobians, theta[:k], q, self.places(theta))
        layout = self.layout
        some = slice(None) if used is None else used
        present = layout.present[:, some]
        rows = np.where(present, value[:, some, 0] - layout.target[:, some], 0.0)
        jacobian = np.zeros((count, rows.shape[1], len(self.parameters)))
        there = present[:, :, None]
        np.copyto(jacobian[:, :, :k], by_g[:, some], where=there)
        by_q, by_place = np.where(there, by_q[:, some], 0.0), np.where(there, by_place[:, some], 0.0)
        where, which, factor = layout.locked
        np.add.at(jacobian, (where[:, None] // n, np.arange(rows.shape[1]), which[:, None]),
                  factor[:, None] * by_q[where // n, :, where % n])
        for axis, column in enumerate(layout.place.T):
            placed = np.flatnonzero(column >= 0)
            jacobian[placed, :, column[placed]] += by_place[placed, :, axis]
        return rows, jacobian, by_q
