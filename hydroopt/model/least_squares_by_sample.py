"""Least squares of many samples at once, each by itself: damped Gauss-Newton steps in all of them together.

The rows of a sample are few, such as the gap of a loop or readings of lengths; where they can vanish, they do.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hydroopt.spatial.inertia import Array

RANK = 1e-7
"""Singular value, relative to the largest, of a direction in which the rows do not change: it stays."""
LEAST, NONE = 1e-3, 1e-9
"""First damping after a refused step, as a part of the largest squared singular value; that which is none."""


class Nearest(NamedTuple):
    """Unknowns (N, k), the norm (N,) of their rows, and the largest change (N,) of an unknown in the last step: zero
    where the rows are as small as they are to be."""

    x: Array
    size: Array
    moved: Array


def nearest(rows: Callable[[Array, NDArray[np.intp]], tuple[Array, Array]], x: Array, *, steps: int,
            longest: float = np.inf, close: float = 0.0, still: float = 0.0, ease: Array | float = 1.0,
            damped: bool = True) -> Nearest:
    """Unknowns at which rows are least, from others nearby.

    Args:
        rows: unknowns (K, k) and which (K,) of the N samples they are of -> rows (K, m), derivatives (K, m, k).
        x: (N, k) initial guess.
        steps: greatest number of them.
        longest: largest change of an unknown in one step.
        close: norm of the rows below which a sample is done; `still` is such a change of its unknowns.
        ease: (N, k), or of fewer dimensions: how easily each unknown changes, so that of all steps the one is taken
            whose changes over it are least; zero holds one.
        damped: whether steps that do not lower the rows are refused; without, these are Newton's.
    """
    x, every = np.array(x, dtype=float), np.arange(len(x))
    value, slope = rows(x, every)
    weight = np.broadcast_to(ease, x.shape)
    size, damping = _norm(value, slope), np.zeros((len(x), 1))
    moved, left = np.where(size > close, np.inf, 0.0), every[np.isfinite(size) & (size > close)]
    for _ in range(steps):
        if not left.size:
            break
        u, s, vt = np.linalg.svd(slope[left] * weight[left][:, None, :], full_matrices=False)
        inverse = np.where(s > RANK * s[:, :1], s / np.maximum(s**2 + damping[left] * s[:, :1] ** 2, 1e-300), 0.0)
        step = -weight[left] * np.einsum("nki,nk,njk,nj->ni", vt, inverse, u, value[left])
        largest = np.max(np.abs(step), axis=1, initial=0.0)
        step *= np.minimum(1, longest / np.maximum(largest, 1e-300))[:, None]
        there, by = rows(x[left] + step, left)
        norm = _norm(there, by)
        good = norm < size[left] if damped else np.isfinite(norm)
        took = left[good]
        x[took], value[took], slope[took], size[took] = x[took] + step[good], there[good], by[good], norm[good]
        lighter = np.where(damping[left] > NONE, damping[left] / 10, 0.0)
        damping[left] = np.where(good[:, None], lighter, np.maximum(10 * damping[left], LEAST))
        moved[left] = np.where(size[left] > close, largest, 0.0)
        left = left[(size[left] > close) & (largest > still)]
    return Nearest(x, size, moved)


def _norm(value: Array, slope: Array) -> Array:
    """Norms (N,) of the rows; infinite where these, or their derivatives, do not exist."""
    known = np.isfinite(value).all(axis=1) & np.isfinite(slope).all(axis=(1, 2))
    return np.where(known, np.linalg.norm(value, axis=1), np.inf)
