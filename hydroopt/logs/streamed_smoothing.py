"""The smoothing spline of a log that is smoothed in pieces: knots and weights are chosen once, for all pieces."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hydroopt.logs import spline
from hydroopt.logs.smoothing import Motion, SmoothingSpline, inside, refuse_too_short, refuse_too_slow, smoothing_note
from hydroopt.logs.spline import Basis, Filter, Grid

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Smoother:
    """Knots, filter and bandwidth [Hz] of every joint's spline, and how they were chosen in words."""

    grids: tuple[Grid, ...]
    filters: tuple[Filter, ...]
    bandwidth: Array
    notes: tuple[str, ...]

    @property
    def margin(self) -> float:
        """How far [s] beyond a piece its smoothing has to reach, for what lies beyond to be felt no more.

        A sample's influence falls by e within 1/(π·bandwidth) of one smoothing: the slowest of the six roots of
        1 + (ω/ω₀)⁶. Each further smoothing of what is left multiplies it by the time, three e-foldings at that length.
        """
        most = max(one.passes for one in self.filters)
        once = float(np.min(self.bandwidth)) / spline.wider(most)
        return (spline.DECAY + 3 * (most - 1)) / (np.pi * once)

    def motion(self, t: Array, q: Array, segment: NDArray[np.int64], needed: NDArray[np.bool_], where: str) -> Motion:
        """Smooth positions (N, n) of a piece at times t (N,); stretches in which no sample is `needed` (N,) stay NaN.

        Raises:
            LogError: a stretch is too short.
        """
        out = np.empty((3, *q.shape))
        interior = np.zeros(t.size, bool)
        edges = np.flatnonzero(np.diff(segment, prepend=segment[0] - 1, append=segment[-1] + 1))
        for start, stop in zip(edges[:-1].tolist(), edges[1:].tolist(), strict=True):
            span = slice(start, stop)
            if not needed[span].any():
                out[:, span] = np.nan
                continue
            refuse_too_short(stop - start, where)
            for grid in dict.fromkeys(self.grids):
                basis = Basis(t[span], grid)
                some = [j for j, own in enumerate(self.grids) if own == grid]
                joints = some if len(some) < len(self.grids) else slice(None)
                right = basis.design.T @ q[span, joints]
                made = basis.courses(np.column_stack([basis.solve(self.filters[j], column)
                                                      for j, column in zip(some, right.T, strict=True)]))
                if made.shape == out.shape:  # of all at once
                    out = made
                else:
                    out[:, span, joints] = made
            interior[span] = inside(t[span], self.bandwidth)
        passes = np.array([one.passes for one in self.filters])
        return Motion(t, out[0], out[1], out[2], segment, interior, self.bandwidth, passes, self.notes)


def choose(pieces: Sequence[tuple[Array, Array]], grid: Grid, smoothing: SmoothingSpline, noise: Array,
           names: Sequence[str], where: str) -> Smoother:
    """The smoother of a motion by a sample of it: pieces (t, q) of N samples (N,), (N, n).

    Args:
        pieces: uninterrupted stretches, none too short for a spline.
        grid: knots of the whole motion.
        smoothing: how weights are chosen.
        noise: (n,) standard deviation of the positions; NaN where unknown.
        names: of the joints.
        where: name of the log, for error messages.

    Raises:
        ProblemError: the bandwidth leaves nothing of the motion.
    """
    refuse_too_slow(smoothing, grid.duration, where)
    grids, filters, corners, notes = [], [], [], []
    shared = spline.Pieces([t for t, _ in pieces], grid)
    for j, name in enumerate(names):
        stated = None if smoothing.cross_validate or np.isnan(noise[j]) else float(noise[j])
        bases, chosen = shared.choose([q[:, j] for _, q in pieces], stated, smoothing.bandwidth)
        fitted = [basis.spline(q[:, j], chosen) for basis, (_, q) in zip(bases, pieces, strict=True)]
        sizes = [t.size for t, _ in pieces]
        residual = float(np.sqrt(np.average([one.residual**2 for one in fitted], weights=sizes)))
        grids.append(bases[0].grid)
        filters.append(chosen)
        corners.append(min(one.bandwidth for one in fitted))
        notes.append(smoothing_note(name, where, corners[-1], residual, stated, smoothing))
    return Smoother(tuple(grids), tuple(filters), np.array(corners), tuple(notes))
