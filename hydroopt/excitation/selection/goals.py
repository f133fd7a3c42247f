"""What measurements are for: the tip, forces, a load or single numbers, each to a standard deviation."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from hydroopt.estimation.dynamic.claims import POSTURES, RANGE, WEIGHED, load_effect
from hydroopt.estimation.inference.identifiability import random_states
from hydroopt.excitation.criteria import presumed_noise
from hydroopt.model.model import Model
from hydroopt.results.readable import percentage, readable
from hydroopt.results.verdict import Purpose
from hydroopt.simulation.simulate import Trajectory, sampling_rate
from hydroopt.spatial.inertia import Array

ByGeometry = Callable[[Array, Array, Array], Array]
"""Derivatives (N, r, f) of the forces in states q, qd, qdd (N, n) by the f numbers of the geometry."""


@dataclass(frozen=True, eq=False)
class Goal:
    """A standard deviation [`unit`] to reach: the root mean square of some combinations of all P numbers.

    Attributes:
        purpose: what for.
        subject: which part of the machine; "" for the whole of it.
        unit: SI; ``1`` for a part of the force's range.
        target: to reach.
        task: (s, P) combinations.
    """

    purpose: Purpose
    subject: str
    unit: str
    target: float
    task: Array

    def rows(self, covariance: Array) -> Array:
        """(s, P) rows T with which the variance is tr(T·C·Tᵀ) + `floor`, at a covariance C (P, P) and near it."""
        return self.task

    def floor(self, covariance: Array) -> float:
        """The part of the variance that stays however well the machine is known."""
        return 0.0

    def std(self, covariance: Array) -> float:
        """At a covariance (P, P) of what is known."""
        rows = self.rows(covariance)
        return float(np.sqrt(max(np.sum((rows @ covariance) * rows), 0.0) + self.floor(covariance)))

    @property
    def name(self) -> str:
        """In words."""
        return str(self.purpose) if self.subject in str(self.purpose) else self.subject

    def readable(self, value: float) -> str:
        """A standard deviation as people write it."""
        return percentage(value) if self.unit == "1" else readable(value, self.unit)


@dataclass(frozen=True, eq=False)
class LoadGoal(Goal):
    """A load at the tip, weighed by the forces of a slow lift in one of S postures, as `hydroopt weigh` does.

    Attributes:
        task: (S, r, P) derivatives of the forces by all numbers.
        effect: (S, r) forces per mass of the load.
        noise: (r,) variance of the averaged forces.
    """

    effect: Array
    noise: Array

    def weights(self, covariance: Array) -> Array:
        """(S, r) of the forces in the load: generalised least squares."""
        noisy = self.task @ covariance @ self.task.transpose(0, 2, 1) + np.diag(self.noise)
        weighed = np.linalg.solve(noisy, self.effect[:, :, None])[:, :, 0]
        return np.asarray(weighed / np.sum(weighed * self.effect, axis=1)[:, None])

    def rows(self, covariance: Array) -> Array:
        """Of the errors of the load in all postures."""
        weights = self.weights(covariance)
        return np.asarray(np.einsum("sr,srp->sp", weights, self.task) / np.sqrt(len(weights)))

    def floor(self, covariance: Array) -> float:
        """What noise of the forces leaves."""
        return float(np.mean(np.sum(self.weights(covariance) ** 2 * self.noise, axis=1)))


def force_goal(model: Model, by_geometry: ByGeometry, states: Sequence[Array], target: float) -> Goal:
    """The forces in a motion, each as a part of its range, root mean square over actuators and time.

    Args:
        model: the machine.
        by_geometry: derivatives of its forces.
        states: q, qd, qdd of the motion (N, n) each.
        target: part of the range, which is four standard deviations of the force.
    """
    K = model.over(model.regressor, *states)[0]
    size = RANGE * np.std(K @ model.parameters.nominal, axis=0)
    driven = size > 1e-6 * np.max(size)
    rows = np.concatenate([by_geometry(*states), K], axis=2)[:, driven] / size[driven, None]
    rows = rows.reshape(-1, rows.shape[2]) / np.sqrt(rows.shape[0] * rows.shape[1])
    return Goal(Purpose.FORCE, "", "1", target, np.asarray(np.linalg.qr(rows, mode="r")))


def load_goal(model: Model, by_geometry: ByGeometry, motion: Trajectory, target: float) -> LoadGoal:
    """A load at the tip, weighed in random postures at a tenth of a motion's speed.

    Args:
        model: the machine.
        by_geometry: derivatives of its forces.
        motion: whose speeds count.
        target: standard deviation of the load [kg].
    """
    rng = np.random.default_rng(1)
    q = random_states(model, POSTURES, rng)[0]
    qd = 0.1 * np.sqrt(np.mean(motion.qd**2, axis=0)) * rng.choice([-1.0, 1.0], q.shape)
    by_psi, by_g = model.over(model.regressor, q, qd, 0 * q)[0], by_geometry(q, qd, 0 * q)
    effect = load_effect(model, q)
    noise = presumed_noise(model) ** 2 / (sampling_rate(model.machine) * WEIGHED)
    return LoadGoal(Purpose.WEIGHING, "", "kg", target, np.concatenate([by_g, by_psi], axis=2), effect, noise)
