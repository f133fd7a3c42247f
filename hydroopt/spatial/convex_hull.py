"""The convex hull of points in a plane."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull, QhullError

from hydroopt.spatial.inertia import Array

ROUNDED = 9
"""Decimals of coordinates; points that agree in all of them are one."""


def corners(points: Array) -> NDArray[np.intp]:
    """Which of the points (k, 2) are the corners of their convex hull (c,), counter-clockwise; two of points in a line.

    >>> corners(np.array([[0.0, 0.0], [1.0, 0.0], [0.5, 0.2], [1.0, 1.0], [0.0, 1.0]])).tolist()
    [0, 1, 3, 4]
    """
    order = np.unique(np.round(points, ROUNDED), axis=0, return_index=True)[1]
    try:
        hull = ConvexHull(points[order]).vertices
    except QhullError:  # fewer than three, or in a line
        return order[[0, -1][:len(order)]]
    return np.asarray(order[np.roll(hull, -int(np.argmin(hull)))])
