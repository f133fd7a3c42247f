"""What a motion uses of each limit, when it comes nearest to it, and by how much it breaks it."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from hydroopt.limits.limits import Limits
from hydroopt.spatial.inertia import Array


class UseOfLimit(NamedTuple):
    """What a motion uses of a limit, over all of its samples [`unit`]; infinite bounds are none.

    `sample` is where it comes nearest to a bound; `margin` and `seen` are those of its row.
    """

    name: str
    unit: str
    lower: float
    lowest: float
    highest: float
    upper: float
    sample: int = 0
    margin: float = 0.0
    seen: bool = False

    @property
    def stop(self) -> tuple[float, float]:
        """Values below and above which a motion is stopped, infinite where it is not: beyond the plan by the margin."""
        return (self.lowest - self.margin if self.margin and np.isfinite(self.lower) else -np.inf,
                self.highest + self.margin if self.margin and np.isfinite(self.upper) else np.inf)

    @property
    def room(self) -> float:
        """What is left; not negative if the limit is kept."""
        return min(self.lowest - self.lower, self.upper - self.highest)

    @property
    def part(self) -> float:
        """What is left of the range, or of the bound if there is but one; not a number if that is zero."""
        bounds = [bound for bound in (self.lower, self.upper) if np.isfinite(bound)]
        size = float(np.ptp(bounds)) or abs(bounds[0])
        return self.room / size if size else float("nan")


class Course(NamedTuple):
    """A limited quantity over time (N,), and what is used of its limit."""

    values: Array
    use: UseOfLimit


def courses(limits: Limits, q: Array, qd: Array, qdd: Array) -> dict[str, Course]:
    """Each limited quantity over states (N, n); of rows that share a name, at each sample the one with the least room.

    >>> from hydroopt.machine.machine_file import load_machine
    >>> from hydroopt.model.model import Model
    >>> model = Model(load_machine("patu655_lift"))
    >>> use = courses(Limits(model), np.array([[0.2], [0.3]]), np.zeros((2, 1)), np.zeros((2, 1)))["lift position"].use
    >>> round(use.lowest, 9), use.highest, use.room > 0
    (0.2, 0.3, True)
    """
    values = limits.values(q, qd, qdd) * limits.scale
    return {name: _course(limits, values, rows) for name, rows in _by_name(limits)}


def _by_name(limits: Limits) -> Iterator[tuple[str, list[int]]]:
    names = [row.name for row in limits.rows]
    yield from ((name, [k for k, other in enumerate(names) if other == name]) for name in dict.fromkeys(names))


def _course(limits: Limits, values: Array, places: list[int]) -> Course:
    rows = [limits.rows[k] for k in places]
    own = np.maximum(values[:, places], [row.floor for row in rows])
    lower, upper = ([getattr(row, side) for row in rows] for side in ("lower", "upper"))
    room = np.minimum(own - lower, upper - own)
    bounded = [[k for k, bound in enumerate(side) if np.isfinite(bound)] or range(len(rows)) for side in (lower, upper)]
    use = UseOfLimit(rows[0].name, rows[0].unit, max(lower), float(np.min(own[:, bounded[0]])),
                     float(np.max(own[:, bounded[1]])), min(upper), int(np.argmin(np.min(room, axis=1))),
                     rows[0].margin, rows[0].seen)
    return Course(np.take_along_axis(own, np.argmin(room, axis=1)[:, None], axis=1)[:, 0], use)
