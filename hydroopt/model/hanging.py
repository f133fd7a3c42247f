"""Passive joints: the postures in which they hang, and how far a designed motion may leave them without balance."""

from __future__ import annotations

from functools import cached_property

import casadi as ca
import numpy as np

from hydroopt.model.model import Model
from hydroopt.spatial.inertia import Array

UNBALANCED = 0.2
"""Part of the largest weight at a passive joint that a design may leave without balance, as far as swinging goes."""
STEPS, LONGEST, STILL = 60, 0.3, 1e-6
"""Steps towards the posture in which a joint hangs; the longest of them, and the one at which it is there [rad, m]."""
POSTURES = 500
"""Random postures in which the weight at passive joints is looked up."""


class Hanging:
    """The passive joints of a machine with its nominal parameters, of which dry friction is left out.

    Attributes:
        joints: their places (p,) in q.
        balance: (p,) forces that would have to hold them in a motion, in the model's coordinates.
        tolerance: (p,) by how much a design may miss zero [N·m, N].
    """

    def __init__(self, model: Model) -> None:
        self.model, machine = model, model.machine
        self.balance, rows = ca.SX(0, 1), [k for k, each in enumerate(machine.balances) if not each.actuators]
        self.joints = [model.dynamics.kept[k] for k in rows]
        if not rows:
            return
        psi, places = model.parameters.nominal.copy(), model.parameters.positions
        for joint in machine.joints:
            if machine.link(joint).joint.passive and (name := f"{joint}.tau_coulomb") in places:
                psi[places[name]] = 0.0
        self.balance = model.dynamics.forces(ca.DM(psi))[rows]

    @cached_property
    def _static(self) -> ca.Function:
        q, qd, qdd = self.model.coordinates
        held = ca.substitute(self.balance, ca.vertcat(qd, qdd), ca.DM.zeros(2 * q.size1()))
        return ca.Function("hanging", [q], [ca.densify(held), ca.densify(ca.jacobian(held, q[self.joints]))])

    @cached_property
    def tolerance(self) -> Array:
        """By how much a design may miss balance (p,)."""
        low, high = self.model.machine.ranges.T
        drawn = np.random.default_rng(0).uniform(low, high, (POSTURES, len(low)))
        weight = self.model.over(self._static, drawn)[0][:, :, 0]
        return np.asarray(UNBALANCED * np.max(np.abs(weight), axis=0))

    def postures(self, q: Array) -> Array:
        """Postures (N, n) in which the passive joints hang still, within their ranges; all others as given.

        Steps down the weight's potential by Newton's method with the curvature's absolute value, so that they end where
        the joints hang and not where they stand upright.
        """
        if not self.joints:
            return q
        found = np.array(q, dtype=float)
        low, high = self.model.machine.ranges[self.joints].T
        for _ in range(STEPS):
            force, curvature = self.model.over(self._static, found)
            pull, at = force[:, :, 0], found[:, self.joints]
            free = ((at > low) | (pull < 0)) & ((at < high) | (pull > 0))  # not held at the end of its range
            sizes, axes = np.linalg.eigh(
                (curvature + np.swapaxes(curvature, 1, 2)) / 2 * (free[:, :, None] & free[:, None]))
            along = np.einsum("nij,ni->nj", axes, pull * free) / np.maximum(np.abs(sizes), 1e-9)
            step = np.clip(np.einsum("nij,nj->ni", axes, along), -LONGEST, LONGEST)
            moved = np.clip(found[:, self.joints] - step, low, high)
            still = np.max(np.abs(moved - found[:, self.joints])) < STILL
            found[:, self.joints] = moved
            if still:
                break
        return found
