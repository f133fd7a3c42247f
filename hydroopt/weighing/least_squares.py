"""Gauss-Newton for a load and the scale's own unknowns, from the equations of some samples."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from hydroopt.spatial.inertia import Array
from hydroopt.weighing.equations import Equations
from hydroopt.weighing.gaussian import Gaussian

STEPS = 6
"""Largest number of Gauss-Newton steps."""
CONVERGED = 1e-5
"""Change of the mass, as a part of the full scale, below which they end."""
WIDEST = 2.0
"""Standard deviation of the mass before weighing, as a part of the full scale."""
LEAST = 1e-6
"""Square of gravity's part along the base's z axis that is left at least [m²/s⁴]."""
SMALLEST = 0.02
"""Mass, as a part of the full scale, for which the priors of a small load are made."""


@dataclass(frozen=True, eq=False)
class Weighed:
    """A load and the scale's own unknowns, as far as some samples tell them.

    Attributes:
        both: the ten numbers of the load about its expected centre, unless it is known to be empty, and the c own
            unknowns after them, linearised at the answer.
        count: c.
        misfit: root mean square of the weighted residuals, about 1 where all is as expected.
        rows: number of equations used; moving: how many of them are of joints that move.
    """

    both: Gaussian
    count: int
    misfit: float
    rows: int
    moving: int

    @cached_property
    def own(self) -> Gaussian:
        """The scale's own unknowns, whatever the load is."""
        at = slice(len(self.both.right) - self.count, None)
        return Gaussian(self.both.root[at, at], self.both.right[at])

    @cached_property
    def phi(self) -> Array:
        """(10,) mass [kg], first moments [kg·m] and inertia [kg·m²]; zero where it is known to be empty."""
        size = len(self.both.right) - self.count
        return np.asarray(self.both.mean[:size]) if size else np.zeros(10)

    @cached_property
    def covariance(self) -> Array:
        """(10, 10) of φ, with the misfit."""
        size = len(self.both.right) - self.count
        found = np.asarray(self.both.covariance[:size, :size] * max(1.0, self.misfit) ** 2)
        return found if size else np.zeros((10, 10))

    @property
    def mass(self) -> float:
        """[kg]."""
        return float(self.phi[0])

    @property
    def mass_std(self) -> float:
        """[kg]."""
        return float(np.sqrt(self.covariance[0, 0]))


def load_prior(equations: Equations, mass: float, known: tuple[float, float] | None = None) -> Array:
    """Rows (11, 10) of what is expected of a load of about this mass [kg], the last one of what is known of it."""
    load = equations.scale.load
    size, second = max(abs(mass), SMALLEST * load.full_scale), load.radius**2
    rows = np.eye(11, 10)
    rows[[4, 7, 9], 0] = -second
    rows[10, 0] = 0.0 if known is None else 1 / known[1]
    std = [WIDEST * load.full_scale, *(size * np.array(load.centre_std)), *np.full(6, size * second), 1.0]
    return np.asarray(rows / np.array(std)[:, None])


def gravity(equations: Equations, own: Array) -> tuple[Array, Array]:
    """Gravity (3,) less that of the machine file, for the scale's own unknowns (c,), and its derivatives (3, 2)."""
    nominal = equations.scale.gravity
    x, y = own[-2:]
    z = (np.sign(nominal[2]) or -1.0) * np.sqrt(max(float(nominal @ nominal) - x**2 - y**2, LEAST))
    return np.array([x, y, z]) - nominal, np.array([[1.0, 0.0], [0.0, 1.0], [-x / z, -y / z]])


def linearised(equations: Equations, at: tuple[NDArray[np.intp], NDArray[np.intp]], own: Array,
               phi: Array) -> tuple[Array, Array]:
    """Residuals (N,) of rows and the forces' derivatives (N, 10 + c) by φ and the scale's own unknowns."""
    change, turn = gravity(equations, own)
    K, G = equations.K[at], equations.G[at]
    x = np.concatenate([[1.0], own[:-2], phi])
    by_number = K + G @ change
    by_tilt = np.einsum("xjg,j->xg", G, x) @ turn
    return equations.rest[at] - by_number @ x, np.hstack([by_number[:, -10:], by_number[:, 1:-10], by_tilt])


def weighed(equations: Equations, samples: NDArray[np.intp], *, start: float = 0.0, empty: bool = False,
            known: tuple[float, float] | None = None) -> Weighed:
    """The load that explains samples (m,) of a log best.

    Args:
        equations: of the log, for a scale with what is known of its own unknowns.
        samples: which of them.
        start: mass to begin with [kg].
        empty: whether there is no load, so that only the scale's own unknowns are sought.
        known: mass of the load with its standard deviation [kg], if it is known.
    """
    scale, at = equations.scale, equations.rows(samples)
    c, count = scale.count, len(at[0])
    own, phi = scale.own.mean, np.zeros(10)
    phi[0] = known[0] if known is not None else 0.0 if empty else start
    moving = int(np.sum(equations.sign[at] != 0))
    front = 0 if empty else 10
    for step in range(STEPS):
        rest, J = linearised(equations, at, own, phi)
        J = J[:, 10 - front :]
        unknown = np.concatenate([phi[:front], own])
        rows: list[Array] = [np.column_stack([J, rest + J @ unknown]), np.zeros((1, front + c + 1))]
        if count:
            rows[0] = np.linalg.solve(np.linalg.cholesky(equations.covariance(at, phi)), rows[0])
        rows.append(np.column_stack([np.zeros((c, front)), scale.own.root, scale.own.right]))
        if not empty:
            rows.append(np.column_stack([load_prior(equations, phi[0], known), np.zeros((11, c)), np.zeros(11)]))
            rows[-1][-1, -1] = 0.0 if known is None else known[0] / known[1]
        triangle: Array = np.asarray(np.linalg.qr(np.vstack(rows), mode="r"))
        both = Gaussian(triangle[:-1, :-1], triangle[:-1, -1])
        last, unknown = phi[0], both.mean
        own, phi = unknown[front:], np.concatenate([unknown[:front], np.zeros(10 - front)])
        if abs(phi[0] - last) < CONVERGED * scale.load.full_scale and (step or not empty):
            break
    return Weighed(both, c, float(np.abs(triangle[-1, -1]) / np.sqrt(max(count, 1))), count, moving)
