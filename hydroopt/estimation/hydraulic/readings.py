"""Readings of one actuator between two gaps of a log: motion, pressures, supply, and how far each may err."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from hydroopt.spatial.inertia import Array

QUANTITIES = ("length", "p_a", "p_b", "p_supply", "p_tank")
"""What is read at each sample: a cylinder's length or the angle of a motor's joint, pressures of both chambers, supply
and tank."""
PIECE = 0.005
"""Duration [s] of the pieces of an interval over which flows are integrated, at most."""


@dataclass(frozen=True, eq=False)
class Readings:
    """One actuator over N samples without a gap.

    Attributes:
        t: (N,) times [s].
        times: (N - 1, parts) when each piece of an interval begins [s].
        command: (N,) given at the samples, before it arrives.
        values: (N, 5) the `QUANTITIES`.
        variance: (N, 5) of their errors, which differ at every sample.
        chambers: whose pressures are read, 0 or 1 or both.
        begin: first interval that counts: before, the spool's place may still be another than its first command's.
        lever: (N, g) change of the length per standard deviation of each uncertain number of the geometry; none where
            the length itself is read.
    """

    t: Array
    times: Array
    command: Array
    values: Array
    variance: Array
    chambers: tuple[int, ...]
    begin: int
    lever: Array

    @cached_property
    def dt(self) -> Array:
        """(N - 1,) durations of the intervals [s]."""
        return np.diff(self.t)

    @property
    def used(self) -> int:
        """Number of intervals that count."""
        return len(self.dt) - self.begin

    @property
    def balances(self) -> int:
        """Number of balances: one for each chamber that is read in each interval that counts."""
        return self.used * len(self.chambers)


def pieces(t: Array) -> Array:
    """(N - 1, parts) beginnings of an even number of pieces, the same in all intervals of the times (N,)."""
    dt = np.diff(t)
    parts = 2 * max(1, int(np.ceil(float(np.median(dt)) / PIECE / 2 - 1e-6)))
    return np.asarray(t[:-1, None] + dt[:, None] * np.arange(parts) / parts)
