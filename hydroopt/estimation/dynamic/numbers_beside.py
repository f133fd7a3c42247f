"""Numbers beside ψ, such as those of the geometry, that forces and further readings of a motion depend on.

What is fitted together with the motion then has the unknowns [g, ψ]. Rows of independent errors of size one, from which
the motion is eliminated, leave a triangle for both. Its first rows give g where ψ is known, with the covariance that is
left then; the others are the information about ψ alone, in which g may be whatever is most probable.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple, Protocol, Self

import numpy as np
from numpy.typing import NDArray

from hydroopt.errors import IdentifiabilityError
from hydroopt.estimation.dynamic.experiment import Experiment
from hydroopt.spatial.inertia import Array

SINGULAR = 1e-12
"""Size of a diagonal entry, relative to its column, below which rows do not determine a number."""


class Readings(NamedTuple):
    """Readings of N samples, linearised: ``by_q·δq + by_numbers·g = right``, (N, m, n), (N, m, k) and (N, m), with
    independent errors of size one."""

    by_q: Array
    by_numbers: Array
    right: Array


class Forces(NamedTuple):
    """Forces of N samples, linearised: ``by_motion·δ + by_psi·ψ + by_numbers·g = right``; (3, N, r, n) by q, qd and
    qdd, (N, r, p), (N, r, k) and (N, r)."""

    by_motion: Array
    by_psi: Array
    by_numbers: Array
    right: Array


class NumbersBeside(Protocol):
    """Numbers g (k,) beside ψ, at some values, and the readings of one experiment that depend on them."""

    @property
    def names(self) -> tuple[str, ...]:
        """Of the numbers."""

    @property
    def value(self) -> Array:
        """(k,) the numbers [SI]."""

    @property
    def known(self) -> Array:
        """Rows (·, k+1) of [g, right side] with what is known beside the experiments, errors of size one."""

    @property
    def unread(self) -> NDArray[np.bool_]:
        """(n,) True for joints of the machine whose position no channel reads itself."""

    def readings(self, q: Array) -> Readings:
        """The readings about a motion (N, n) and the present numbers."""

    def forces(self, data: Experiment, psi: Array) -> Forces:
        """The forces of an experiment about its motion, ψ (p,) and the present numbers."""

    def moved(self, before: Array, after: Array, value: Array) -> Self:
        """With other numbers (k,), when the motion (N, n) has moved along."""


@dataclass(frozen=True, eq=False)
class NumbersGiven:
    """Numbers g (k,) for given ψ: ``root·g + by_psi·ψ = right`` with independent errors of size one."""

    names: tuple[str, ...]
    root: Array
    by_psi: Array
    right: Array

    @classmethod
    def of(cls, names: tuple[str, ...], rows: Array, where: str) -> NumbersGiven:
        """From the first rows (k, k+p+1) of a triangle.

        Raises:
            IdentifiabilityError: they do not determine all numbers.
        """
        k = len(names)
        weak = np.abs(np.diag(rows)) <= SINGULAR * np.max(np.abs(rows[:, :k]), axis=0, initial=0.0)
        if np.any(weak):
            raise IdentifiabilityError(f"nothing determines {', '.join(np.array(names)[weak])}", where=where,
                                       remedy="state how far it may be off, or fix it")
        return cls(names, rows[:, :k], rows[:, k:-1], rows[:, -1])

    def at(self, psi: Array) -> Array:
        """The most probable numbers (k,) or (N, k) for parameters ψ (p,) or (N, p)."""
        left = self.right - psi @ self.by_psi.T
        return np.asarray(np.linalg.solve(self.root, left.T).T)

    @property
    def slope(self) -> Array:
        """(k, p) how the most probable numbers change with ψ."""
        return np.asarray(-np.linalg.solve(self.root, self.by_psi))

    @property
    def covariance(self) -> Array:
        """(k, k) of the numbers where ψ is known."""
        inverse = np.linalg.inv(self.root)
        return np.asarray(inverse @ inverse.T)
