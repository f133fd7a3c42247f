"""Blocks of logs, each predicted without it: how far off forces are along motions that an estimate has not seen."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.special import stdtrit

from hydroopt.errors import HydrooptError
from hydroopt.estimation.dynamic.experiment import Experiment
from hydroopt.estimation.dynamic.folding import split, triangle
from hydroopt.estimation.dynamic.problem import IdentificationProblem
from hydroopt.estimation.dynamic.reduced_model import WITH_PRIORS, most_probable
from hydroopt.estimation.dynamic.regressor_qr import compress
from hydroopt.estimation.dynamic.weighted_residuals import WeightedResiduals
from hydroopt.spatial.inertia import Array

BLOCKS = 5
"""Contiguous blocks of all logs together, each of which is predicted without it."""
LONGEST = 20_000
"""Samples of a block that are looked at, from its first one on: more of them do not change what is left out."""
ENOUGH = 3.0
"""Effective number of blocks in which a force must be read, for a bound that holds for another one."""
LEVEL = 0.95
"""Probability with which the bound holds for one further block."""


@dataclass(frozen=True, eq=False)
class LeftOut:
    """Errors of forces that were predicted without the samples where they occurred.

    Attributes:
        squares, counts: (b, r) sum of squared errors of each balance's force in each block or held-out log, and the
            number of readings that it sums.
    """

    squares: Array
    counts: Array

    @property
    def tested(self) -> Array:
        """Which balances (r,) are read in `ENOUGH` blocks."""
        return np.asarray(self._effective >= ENOUGH)

    @property
    def _share(self) -> Array:
        return np.asarray(self.counts / np.maximum(self.counts.sum(axis=0), 1.0))

    @property
    def _effective(self) -> Array:
        return np.asarray(1 / np.maximum(np.sum(self._share**2, axis=0), 1 / BLOCKS**2))

    @property
    def pooled(self) -> Array:
        """Mean squared error (r,) over all blocks."""
        return np.asarray(self.squares.sum(axis=0) / np.maximum(self.counts.sum(axis=0), 1.0))

    @property
    def bound(self) -> Array:
        """RMS (r,) below which the error of a further block stays with the probability `LEVEL`: Student's t limit of
        one more block, whose mean squares are about log-normal; never below the RMS of all blocks together."""
        share, number = self._share, self._effective
        logs = np.log(np.maximum(self.squares, 1e-300) / np.maximum(self.counts, 1.0))
        mean = np.sum(share * logs, axis=0)
        scatter = np.sum(share * (logs - mean) ** 2, axis=0) / np.maximum(1 - 1 / number, 1e-9)
        limit = stdtrit(np.maximum(number - 1, 1.0), LEVEL) * np.sqrt(scatter * (1 + 1 / number))
        return np.asarray(np.sqrt(np.maximum(self.pooled, np.exp(mean + limit))))


def left_out(problem: IdentificationProblem, weighted: WeightedResiduals[IdentificationProblem], method: str,
             psi: Array, tolerance: float) -> LeftOut | None:
    """Predict blocks of the training logs without them, and held-out logs; None where neither can be tested.

    Each block leaves the rows of the others, folded into triangles and weighted as in the estimate; the same method
    solves what they leave. A motion that was fitted along with the forces, or read by instruments, contains what would
    be left out, as does a shrunk estimate: only held-out logs test these.

    Args:
        problem: with its logs.
        weighted: its residuals.
        method: of `hydroopt.estimation.dynamic.identify.METHODS`.
        psi: (p,) parameters that all blocks together give.
        tolerance: as of the method.
    """
    squares, counts = [], []
    if not (problem.fitted_motion or problem.instruments) and method in (*WITH_PRIORS, "wls"):
        std = weighted.sigma * np.sqrt(weighted.correlation_time)
        blocks = [part for data in problem.experiments for part in _blocks(data, len(problem.experiments))]
        rows = [triangle(*compress([part], psi=psi).triangles / std[:, None, None]) for part in blocks]
        for k, part in enumerate(blocks):
            R, r, _ = split(triangle(*rows[:k], *rows[k + 1:], *weighted.holds))
            try:
                without = most_probable(problem, "sdp" if method == "nlp" else method, R, r, tolerance).psi
            except HydrooptError:  # the others alone determine nothing
                return None
            count, _, _, square = part.moments(without)
            squares.append(square)
            counts.append(count)
    for data in problem.validation:
        count, _, _, square = data.moments(psi)
        squares.append(square)
        counts.append(count)
    return LeftOut(np.array(squares), np.array(counts)) if squares else None


def _blocks(data: Experiment, logs: int) -> list[Experiment]:
    """Contiguous blocks of a log, equally long: `BLOCKS` of all `logs` together."""
    first, end = int(np.argmax(data.inside)), len(data.inside) - int(np.argmax(data.inside[::-1]))
    edges = np.linspace(first, end, max(1, round(BLOCKS / logs)) + 1).astype(int).tolist()
    return [data.part(slice(start, min(stop, start + LONGEST))) for start, stop in pairwise(edges) if stop > start]
