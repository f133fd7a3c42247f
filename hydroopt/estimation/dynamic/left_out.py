"""Blocks of logs, each predicted without it: how far off forces are along motions that an estimate has not seen."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from hydroopt.errors import HydrooptError
from hydroopt.estimation.dynamic.experiment import Experiment
from hydroopt.estimation.dynamic.folding import split, triangle
from hydroopt.estimation.dynamic.problem import IdentificationProblem
from hydroopt.estimation.dynamic.reduced_model import WITH_PRIORS, most_probable
from hydroopt.estimation.dynamic.regressor_qr import compress
from hydroopt.estimation.dynamic.weighted_residuals import WeightedResiduals
from hydroopt.estimation.inference.left_out import BLOCKS, LeftOut
from hydroopt.spatial.inertia import Array

LONGEST = 20_000
"""Samples of a block that are looked at, from its first one on: more of them do not change what is left out."""


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
