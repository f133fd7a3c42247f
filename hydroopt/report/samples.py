"""What a page shows over time or over poses: named columns on one clock, shared by all figures."""

from __future__ import annotations

import base64
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hydroopt.spatial.inertia import Array

MOST = 3000
"""Samples that a page carries; of longer recordings `kept` chooses."""


class Span(NamedTuple):
    """A stretch of samples, first and last, with its role and its name: ``training``, ``log1/log.csv``."""

    first: int
    last: int
    role: str
    name: str


@dataclass(frozen=True)
class Samples:
    """Columns over one clock.

    Attributes:
        clock: what the clock counts: ``time [s]``, or ``pose``.
        at: (N,) of the clock, ascending.
        columns: (N,) each, by name, in the units that the page prints; not a number where there is none.
        spans: the recordings that follow one another.
    """

    clock: str
    at: Array
    columns: Mapping[str, Array]
    spans: tuple[Span, ...] = ()

    def payload(self) -> dict[str, Any]:
        """What the page's scripts read: numbers as 32-bit floats in base64."""
        return {"clock": self.clock, "at": packed(self.at),
                "columns": {name: packed(values) for name, values in self.columns.items()},
                "spans": [span._asdict() for span in self.spans]}


def packed(values: Iterable[float] | Array) -> str:
    """Numbers as little-endian 32-bit floats in base64.

    >>> unpacked(packed([0.5, -2.0])).tolist()
    [0.5, -2.0]
    """
    return base64.b64encode(np.ascontiguousarray(values, dtype="<f4").tobytes()).decode()


def unpacked(text: str) -> NDArray[np.float32]:
    """The numbers of `packed`."""
    return np.frombuffer(base64.b64decode(text), dtype="<f4")


class Recording(NamedTuple):
    """One recording: times (N,), uninterrupted stretches (N,) by number, columns (N,) by name."""

    role: str
    name: str
    t: Array
    segment: NDArray[np.int64]
    columns: Mapping[str, Array]


def joined(recordings: Sequence[Recording], weight: Sequence[str] = (), most: int = MOST) -> Samples:
    """Recordings one after the other, each stretch followed by one sample without numbers.

    Args:
        recordings: all with the same columns.
        weight: columns whose largest magnitudes are kept where samples are left out.
        most: about how many samples are kept.
    """
    count = sum(len(each.t) for each in recordings)
    length = sum(float(each.t[-1] - each.t[0]) for each in recordings)
    at: list[Array] = []
    columns: dict[str, list[Array]] = {name: [] for name in (recordings[0].columns if recordings else ())}
    spans, filled, clock = [], 0, 0.0
    for each in recordings:
        first = filled
        cuts = [0, *(np.flatnonzero(np.diff(each.segment)) + 1).tolist(), len(each.t)]
        for begin, end in pairwise(cuts):
            worst = np.max([np.abs(each.columns[name][begin:end]) for name in weight], axis=0) if weight else None
            rows = begin + kept(end - begin, -(-count // most), worst)
            t = each.t[rows] - each.t[0] + clock
            at += [t, t[-1:] + 1e-6 * length]
            for name, values in each.columns.items():
                columns[name] += [values[rows], np.full(1, np.nan)]
            filled += len(rows) + 1
        spans.append(Span(first, filled - 2, each.role, each.name))
        clock += float(each.t[-1] - each.t[0]) + 0.012 * length
    return Samples("time [s]" if len(recordings) < 2 else "time, logs one after the other [s]",
                   np.concatenate(at) if at else np.zeros(0),
                   {name: np.concatenate(parts) for name, parts in columns.items()}, tuple(spans))


def kept(count: int, stride: int, worst: Array | None = None) -> NDArray[np.int64]:
    """Which of `count` samples are kept: the first of every `2·stride`, the one of these where `worst` (N,) is
    largest, and the last.

    >>> kept(8, 2, np.array([0, 0, 0, 9, 0, 0, 8, 0])).tolist()
    [0, 3, 4, 6, 7]
    """
    if stride <= 1 or count < 4:
        return np.arange(count)
    if worst is None:
        return np.arange(0, count, stride)
    size = 2 * stride
    short = np.nan_to_num(np.concatenate([worst, np.full(-count % size, -1.0)]), nan=-1.0).reshape(-1, size)
    first = np.arange(len(short)) * size
    return np.unique(np.concatenate([first, first + np.argmax(short, axis=1), [count - 1]]))
