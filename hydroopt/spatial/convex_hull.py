"""The convex hull of points in a plane (Andrew's monotone chain)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hydroopt.spatial.inertia import Array

ROUNDED = 9
"""Decimals of coordinates; points that agree in all of them are one."""


def corners(points: Array) -> NDArray[np.intp]:
    """Which of the points (k, 2) are the corners of their convex hull (c,), counter-clockwise; all of one or two.

    >>> corners(np.array([[0.0, 0.0], [1.0, 0.0], [0.5, 0.2], [1.0, 1.0], [0.0, 1.0]])).tolist()
    [0, 1, 3, 4]
    """
    at = np.round(points, ROUNDED)
    order = np.unique(at, axis=0, return_index=True)[1]
    if len(order) < 3:
        return order
    chains: list[int] = []
    for sequence in (order, order[::-1]):
        chain: list[int] = []
        for k in sequence.tolist():
            while len(chain) > 1 and _turn(at[chain[-2]], at[chain[-1]], at[k]) <= 0:
                chain.pop()
            chain.append(k)
        chains += chain[:-1]
    return np.array(chains)


def _turn(a: Array, b: Array, c: Array) -> float:
    return float((b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]))
