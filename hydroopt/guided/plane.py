"""Triangles and four-bar linkages in the plane of a machine; points are complex numbers [m]."""

from __future__ import annotations

import cmath
import math


class OpenError(Exception):
    """A triangle or linkage does not close; the text says which distance must lie between which limits."""


ON_LINE = 0.01
"""By how much [m] three distances may miss a triangle so that the point counts as on the line: a tape's errors."""


def by_distances(near: float, far: float, length: float, side: float) -> complex:
    """The point at distances from 0 and from `length` on the x axis, above it for side 1 and below for −1.

    Where the distances miss a triangle by no more than a tape's errors, it is the point on the line that fits best.

    Raises:
        OpenError: there is no such point.

    >>> by_distances(3.0, 4.0, 5.0, 1.0)
    (1.8+2.4j)
    >>> by_distances(3.0, 1.996, 5.0, 1.0)
    (3.002+0j)
    """
    for gap, x in ((length - near - far, (length + near - far) / 2), (near - far - length, (near + far + length) / 2),
                   (far - near - length, (length - near - far) / 2)):
        if 0 <= gap <= ON_LINE:
            return complex(x)
    _close(near, far, length)
    x = (near**2 - far**2 + length**2) / (2 * length)
    return complex(x, side * math.sqrt(max(near**2 - x**2, 0.0)))


def turned(fixed: complex, carried: complex, length: float, sign: float) -> float:
    """Angle by which `carried` turns about 0 until it is `length` from `fixed`; lengthening turns it by `sign`.

    Raises:
        OpenError: at no angle.

    >>> round(math.degrees(turned(1.0, 1.0, math.sqrt(2), 1.0)), 6)
    90.0
    """
    a, b = abs(fixed), abs(carried)
    _close(length, a, b)
    cosine = (a**2 + b**2 - length**2) / (2 * a * b)
    return cmath.phase(fixed) - cmath.phase(carried) + sign * math.acos(max(-1.0, min(1.0, cosine)))


def near_to(angle: float, middle: float) -> float:
    """The angle plus whole turns that lies nearest to another.

    >>> near_to(3 * math.pi, 0.1) == math.pi
    True
    """
    return angle - 2 * math.pi * round((angle - middle) / (2 * math.pi))


def _close(side: float, a: float, b: float) -> None:
    """Refuse three sides that make no triangle."""
    least, most = abs(a - b), a + b
    if not least < side < most:
        raise OpenError(f"{1e3 * side:.0f} mm does not close the triangle whose other sides are {1e3 * a:.0f} mm and "
                        f"{1e3 * b:.0f} mm: it must lie between {1e3 * least:.0f} mm and {1e3 * most:.0f} mm")
