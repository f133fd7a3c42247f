"""What is known of the scale's own unknowns: a Gaussian in the form of least squares."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hydroopt.spatial.inertia import Array


@dataclass(frozen=True, eq=False)
class Gaussian:
    """x with ``root·x − right`` independent and standard normal; `root` (k, k) is upper triangular."""

    root: Array
    right: Array

    @classmethod
    def independent(cls, mean: Array, std: Array) -> Gaussian:
        """Independent numbers of these means and standard deviations (k,)."""
        return cls(np.diag(1 / std), mean / std)

    @property
    def mean(self) -> Array:
        """(k,)."""
        return np.asarray(np.linalg.solve(self.root, self.right))

    @property
    def covariance(self) -> Array:
        """(k, k)."""
        inverse = np.linalg.inv(self.root)
        return np.asarray(inverse @ inverse.T)

    def without(self, places: slice) -> Gaussian:
        """The others alone, whatever those at `places` (the last ones) are."""
        kept = slice(0, places.start)
        # the last unknowns first, so that the triangle's lower part is free of them
        order = np.r_[places.start:len(self.right), kept]
        rows: Array = np.asarray(np.linalg.qr(np.column_stack([self.root[:, order], self.right]), mode="r"))
        count = len(self.right) - places.start
        return Gaussian(rows[count:len(order), count:-1], rows[count:len(order), -1])

    def changed(self, by: Array, covariance: Array) -> Gaussian:
        """Of ``by·x`` and a change of this covariance (k, k), which is independent of x."""
        root = np.linalg.cholesky(np.linalg.inv(by @ self.covariance @ by.T + covariance)).T
        return Gaussian(root, root @ (by @ self.mean))

    def and_other(self, other: Gaussian) -> Gaussian:
        """These unknowns, and after them others that are independent of them."""
        k, more = len(self.right), len(other.right)
        root = np.zeros((k + more, k + more))
        root[:k, :k], root[k:, k:] = self.root, other.root
        return Gaussian(root, np.concatenate([self.right, other.right]))

    def and_independent(self, mean: Array, std: Array) -> Gaussian:
        """These unknowns, and after them some that are independent of them and of each other."""
        return self.and_other(Gaussian.independent(mean, std))
