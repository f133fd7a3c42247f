"""The recursion of the scale: each smoothed sample is taken once, and a state of fixed size holds what all have shown.

Kept is the triangle of least squares for the scale's own unknowns and the ten numbers of the load (Bierman 1977),
after whitening by the banded Cholesky factor of errors that are correlated over a few samples. Changes of the mass
since each of the last samples are further right-hand sides: what the triangle cannot explain of them and of the
forces gives the likelihood ratio of each change. A change is a jump that has passed the smoothing: whitening amplifies
whatever is sharper than smoothed errors are, so that a jump between two samples would be judged by its edge alone. The
load stands last, so that its own block of the triangle gives its estimate, whatever the others are. The generated C
runs the same steps.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hydroopt.spatial.inertia import Array
from hydroopt.weighing.equations import Equations
from hydroopt.weighing.scale import CarriedLoad, Gaussian

RECENT = 20
"""Number of samples since which a change is sought: a small one shows late where forces are read badly."""
WIDEST = 2.0
"""Standard deviation of the mass before weighing, as a part of the full scale."""
SMALLEST = 0.02
"""Mass, as a part of the full scale, for which the priors of a small load are made."""
AGAIN = 3
"""How often the load is solved for, with priors for the mass that was found before."""
ALIKE = 1e-3
"""Part by which an earlier change must be likelier than a later one: where nothing moved between, they are alike."""
SHOWN = 3.0
"""Standard deviations by which a change of mass shows."""


class Change(NamedTuple):
    """A change of the load: likelihood ratio, how many samples ago it began, and by how much [kg]."""

    ratio: float
    ago: int
    size: float


@dataclass(frozen=True, eq=False)
class Weighed:
    """A load and the scale's own unknowns, as far as the samples tell them.

    Attributes:
        own: the c own unknowns, whatever the load is.
        load: the ten numbers of the load about its expected centre.
        misfit: root mean square of the weighted residuals, about 1 where all is as expected.
        change: the likeliest change of the mass within the last samples.
        gain: standard deviation of the relative error that all masses have in common.
    """

    own: Gaussian
    load: Gaussian
    misfit: float
    change: Change
    gain: float

    @cached_property
    def phi(self) -> Array:
        """(10,) mass [kg], first moments [kg·m] and inertia [kg·m²]."""
        return self.load.mean

    @cached_property
    def covariance(self) -> Array:
        """(10, 10) of φ, with the misfit and the common error of all masses."""
        return self.load.covariance * max(1.0, self.misfit) ** 2 + self.gain**2 * np.outer(self.phi, self.phi)

    @property
    def mass(self) -> float:
        """[kg]."""
        return float(self.phi[0])

    @property
    def mass_std(self) -> float:
        """[kg]."""
        return float(np.sqrt(self.covariance[0, 0]))


def load_prior(load: CarriedLoad, mass: float, known: tuple[float, float] | None = None) -> Array:
    """Rows (11, 11) of what is expected of a load of about this mass [kg], the last one of what is known of it.

    Their last column is the right-hand side.
    """
    size, second = max(abs(mass), SMALLEST * load.full_scale), load.radius**2
    rows = np.eye(11)
    rows[[4, 7, 9], 0] = -second
    rows[10] = 0.0
    if known is not None:
        rows[10, [0, 10]] = 1 / known[1], known[0] / known[1]
    std = [WIDEST * load.full_scale, *(size * np.array(load.centre_std)), *np.full(6, size * second), 1.0]
    return np.asarray(rows / np.array(std)[:, None])


def expected(load: CarriedLoad, mass: float) -> Array:
    """(10,): a load of this mass [kg] as it is expected."""
    phi = np.zeros(10)
    phi[[0, 4, 7, 9]] = mass * np.array([1.0, *[load.radius**2] * 3])
    return phi


class Recursion:
    """What the samples of a log say about one load, sample by sample.

    Attributes:
        rows: number of equations of moving joints that were taken.
        own, phi: where the next ones are linearised, (c,) and (10,).
    """

    def __init__(self, equations: Equations, known: Gaussian, mass: float = 0.0) -> None:
        """Begin.

        Args:
            equations: of the log.
            known: of the scale's own unknowns.
            mass: about what the load weighs [kg].
        """
        self._equations, kernel = equations, equations.smoothed.kernel
        c, r, lags = len(known.mean), equations.rest.shape[1], len(kernel.covariance) - 1
        self.rows, self._since, self._stretch = 0, 0, -1
        self.own, self.phi = known.mean, expected(equations.scale.load, mass)
        # columns: own unknowns, load, forces, changes since each of the last samples, the latest first
        self._table: Array = np.zeros((c + 10, c + 10 + 1 + RECENT))
        self._table[:c, :c], self._table[:c, c + 10] = known.rows
        self._products = np.zeros((1 + RECENT, 2))
        self._jump = kernel.of_a_jump(RECENT)
        # mean squares of the residuals after each of the last samples: those of before a change widen its errors
        self._before = np.zeros(RECENT + 1)
        # of the last samples: whitened rows, their errors' derivatives, and the factor of their covariance
        self._white = np.zeros((lags * r, self._table.shape[1]))
        self._by = np.zeros((lags, r, *equations.by_motion.shape[2:4]))
        self._used, self._factor = np.zeros(lags * r, dtype=bool), np.eye(lags * r)

    def take(self, i: int, *, empty: bool = False) -> float:
        """Take the sample i, of a load unless the machine is known to be empty.

        Returns:
            The change of mass [kg] that the sample shows by `SHOWN` standard deviations.
        """
        lines, c = self._equations, len(self.own)
        if lines.smoothed.stretch[i] != self._stretch:
            self._stretch, self._used[:] = int(lines.smoothed.stretch[i]), False
        used, (rest, J) = lines.moving[i], lines.linearised(i, self.own, self.phi)
        rows = np.zeros((len(rest), self._table.shape[1]))
        rows[:, : c + 10], rows[:, c + 10] = J, rest + J @ np.concatenate([self.own, self.phi])
        for columns in (self._table, self._white):
            columns[:, c + 12 :], columns[:, c + 11] = columns[:, c + 11 : -1].copy(), 0.0
        self._products[2:], self._products[1] = self._products[1:-1].copy(), 0.0
        since = min(self._since, RECENT)
        rows[:, c + 11 : c + 11 + since] = J[:, [c]] * self._jump[:since]
        self._since += int(used.any() or self._since > 0)
        if empty:
            rows[:, c + 10] -= J[:, c:] @ self.phi
            rows[:, c : c + 10], rows[:, c + 11 :] = 0.0, 0.0
        noise, white = self._whitened(i, rows, used)
        triangle = _triangle(self._table, white[used])
        self._table = triangle[: c + 10]
        self._products += _products(triangle[c + 10 :, c + 10 :])
        self.rows += int(used.sum())
        self._before[1:], self._before[0] = self._before[:-1].copy(), self._products[0, 0] / max(self.rows, 1)
        with np.errstate(divide="ignore"):
            return float(np.min(SHOWN * noise[used] / np.abs(J[used, c]), initial=np.inf))

    def _whitened(self, i: int, rows: Array, used: NDArray[np.bool_]) -> tuple[Array, Array]:
        """Standard deviations of a sample's errors (r,), and its rows as independent ones of the variance 1."""
        lines = self._equations
        known, r = lines.smoothed.kernel.covariance, len(rows)
        by = lines.noise_by_motion(i, self.phi)
        self._by = np.concatenate([self._by, by[None]])
        self._used = np.concatenate([self._used, used])
        last = len(self._by) - 1
        V = np.stack([np.einsum("xan,ab,ybn->xy", each, known[last - k], by)
                      + np.diag(known[last - k, 0, 0] * lines.scale.force_std**2)
                      for k, each in enumerate(self._by)]).reshape(-1, r)
        V = np.where(self._used[:, None] & used, V, 0.0)
        across = np.linalg.solve(self._factor, V[:-r])
        own = V[-r:] - across.T @ across
        own[~used, ~used] = 1.0
        root = np.linalg.cholesky(own)
        white = np.linalg.solve(root, np.where(used[:, None], rows - across.T @ self._white, 0.0))
        noise = np.sqrt(np.diag(V[-r:]))
        size = len(self._factor)
        factor = np.zeros((size + r, size + r))
        factor[:size, :size], factor[size:, :size], factor[size:, size:] = self._factor, across.T, root
        self._factor, self._white = factor[r:, r:], np.vstack([self._white, white])[r:]
        self._by, self._used = self._by[1:], self._used[r:]
        return noise, white

    def with_prior(self, mass: float, known: tuple[float, float] | None = None) -> tuple[Array, Array]:
        """What remains of all samples for the load, with the priors of a load of about this mass [kg].

        Returns:
            Triangle (10, 11) of its ten numbers, with the right-hand side; squares (1 + RECENT,) of what it leaves of
            the forces and of each change, and their products with that of the forces, as columns (1 + RECENT, 2).
        """
        c, prior = len(self.own), np.zeros((11, 11 + RECENT))
        prior[:, :11] = load_prior(self._equations.scale.load, mass, known)
        block = _triangle(self._table[c:, c:], prior)
        return block[:10, :11], self._products + _products(block[10:, 10:])

    def solved(self, known: tuple[float, float] | None = None) -> Weighed:
        """The load that explains all samples best, whose mass [kg] may be known with its standard deviation.

        The next samples are linearised there.
        """
        c = len(self.own)
        for _ in range(AGAIN):
            block, products = self.with_prior(self.phi[0], known)
            self.phi = np.asarray(np.linalg.solve(block[:, :10], block[:, 10]))
        root, right = self._table[:, : c + 10].copy(), self._table[:, c + 10].copy()
        root[c:, c:], right[c:] = block[:, :10], block[:, 10]
        both = Gaussian.of_rows(root, right)
        self.own = both.mean[:c]
        (rest, _), *changes = products
        ratios = [along**2 / size if size > 0 else 0.0 for size, along in changes]
        ago = 0
        for k, ratio in enumerate(ratios):
            ago = k if ratio > (1 + ALIKE) * ratios[ago] else ago
        size, along = changes[ago]
        change = Change(float(ratios[ago]) / max(1.0, self._before[-1]), ago,
                        float(along / size) if size > 0 else 0.0)
        return Weighed(both[:c], both[c:], float(np.sqrt(rest / max(self.rows, 1))), change,
                       self._equations.scale.gain)

    def solved_empty(self) -> Weighed:
        """The scale's own unknowns after samples of the empty machine, with a load of zero."""
        c = len(self.own)
        own = Gaussian.of_rows(self._table[:c, :c], self._table[:c, c + 10])
        rest = self._products[0, 0] + np.sum(self._table[c:, c + 10] ** 2)
        self.own, self.phi = own.mean, np.zeros(10)
        misfit = float(np.sqrt(rest / max(self.rows, 1)))
        return Weighed(own, Gaussian(np.zeros(10), np.zeros((10, 10))), misfit, Change(0.0, 0, 0.0),
                       self._equations.scale.gain)


def _triangle(*rows: Array) -> Array:
    return np.asarray(np.linalg.qr(np.vstack(rows), mode="r"))


def _products(rows: Array) -> Array:
    """(1 + RECENT, 2): sums of squares of each column of some rows, and of its products with the first one."""
    return np.stack([np.sum(rows**2, axis=0), rows[:, 0] @ rows], axis=1)
