"""Points spread evenly over a box, the same at each call."""

from __future__ import annotations

import numpy as np

from hydroopt.spatial.inertia import Array


def halton(dimensions: int, count: int) -> Array:
    """Points (count, dimensions) of Halton's sequence between 0 and 1, without its first one, the corner 0.

    >>> halton(2, 2)
    array([[0.5       , 0.33333333],
           [0.25      , 0.66666667]])
    """
    bases: list[int] = []
    number = 2
    while len(bases) < dimensions:
        if all(number % base for base in bases):
            bases.append(number)
        number += 1
    points = np.zeros((count, dimensions))
    for k, base in enumerate(bases):
        rest, place = np.arange(1, count + 1), 1.0
        while np.any(rest):  # its digits in this base, mirrored at the point
            place /= base
            rest, digit = np.divmod(rest, base)
            points[:, k] += digit * place
    return points


def sobol(dimensions: int, power: int) -> Array:
    """Points (2**power − 1, dimensions) of Sobol's sequence between 0 and 1, without its first one, the corner 0.

    >>> sobol(2, 1)
    array([[0.5, 0.5]])
    """
    from scipy.stats import qmc  # noqa: PLC0415 — loading scipy.stats takes longer than many a job

    points: Array = qmc.Sobol(dimensions, scramble=False).random_base2(power)[1:]
    return points
