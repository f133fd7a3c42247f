"""Columns that hold numbers in some rows only: sampled more slowly than the rows, or not at all."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hydroopt.logs.mapped import release

Array = NDArray[np.float64]

SPARSE = 0.9
"""Share of the rows with a number below which a column may count as sampled more slowly."""
EVEN = 4.0
"""Largest distance between rows with a number, in median distances, of such a column."""


@dataclass(frozen=True)
class Partial:
    """Channels of a table by their rows.

    Attributes:
        full: names of the channels that have numbers in nearly all rows, or in uneven ones, which are defects.
        sparse: (N,) rows and names of the channels that have numbers in exactly these rows, evenly.
        empty: names of the channels without a number.
    """

    full: tuple[str, ...]
    sparse: tuple[tuple[NDArray[np.bool_], tuple[str, ...]], ...]
    empty: tuple[str, ...]


def partial_columns(channels: Mapping[str, Array]) -> Partial:
    """Which of the channels (N,) hold numbers in which rows.

    >>> nan = np.nan
    >>> found = partial_columns({"a.q": np.arange(8.0), "a.p_head": np.array([1, nan] * 4), "b.q": np.full(8, nan)})
    >>> found.full, found.sparse[0][1], found.empty
    (('a.q',), ('a.p_head',), ('b.q',))
    """
    full, empty = [], []
    sparse: dict[bytes, tuple[NDArray[np.bool_], list[str]]] = {}
    for name, x in channels.items():
        rows = np.isfinite(x)
        release()
        if not rows.any():
            empty.append(name)
        elif np.any(np.isinf(x)) or not _even(rows):
            full.append(name)
        else:
            sparse.setdefault(np.packbits(rows).tobytes(), (rows, []))[1].append(name)
    return Partial(tuple(full), tuple((rows, tuple(names)) for rows, names in sparse.values()), tuple(empty))


def _even(rows: NDArray[np.bool_]) -> bool:
    """Whether the rows are few and evenly spread over all."""
    index = np.flatnonzero(rows)
    if index.size < 2 or index.size >= SPARSE * rows.size:
        return False
    steps = np.diff(index)
    widest = EVEN * np.median(steps)
    return bool(max(steps.max(), index[0], rows.size - 1 - index[-1]) <= max(widest, 2))
