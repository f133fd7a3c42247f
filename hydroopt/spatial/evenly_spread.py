"""Points spread evenly over a box, the same at each call."""

from __future__ import annotations

from hydroopt.spatial.inertia import Array


def halton(dimensions: int, count: int) -> Array:
    """Points (count, dimensions) of Halton's sequence between 0 and 1, without its first one, the corner 0.

    >>> halton(2, 2).round(3).tolist()
    [[0.5, 0.333], [0.25, 0.667]]
    """
    from scipy.stats import qmc  # noqa: PLC0415 — loading scipy.stats takes longer than many a job

    points: Array = qmc.Halton(dimensions, scramble=False).random(count + 1)[1:]
    return points


def sobol(dimensions: int, power: int) -> Array:
    """Points (2**power − 1, dimensions) of Sobol's sequence between 0 and 1, without its first one, the corner 0.

    >>> sobol(2, 1)
    array([[0.5, 0.5]])
    """
    from scipy.stats import qmc  # noqa: PLC0415 (as above)

    points: Array = qmc.Sobol(dimensions, scramble=False).random_base2(power)[1:]
    return points
