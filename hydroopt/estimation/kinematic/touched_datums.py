"""Planes and lines that are touched too seldom to tell anything of the geometry, if nothing is known of them."""

from __future__ import annotations

import numpy as np

from hydroopt.errors import ProblemError
from hydroopt.estimation.kinematic.problem import CalibrationProblem

FEWEST = {"plane": 4, "line": 3}
"""Touches of which a datum that is not known tells something: one more than those that determine it."""


def refuse_untouched(problem: CalibrationProblem) -> None:
    """Refuse a datum of unknown place that too few poses touch, unless confidences say where it may be.

    Raises:
        ProblemError: which datum, and how many poses it takes.
    """
    if problem.priors:
        return
    model, names = problem.model, problem.parameters.names
    unknown = {name.partition(".")[0] for name, free in zip(names, problem.free, strict=True) if free}
    for datum in model.machine.datums:
        columns = [model.channels.index(each.channels[0]) for each in model.measurements
                   if each.name.startswith(f"{datum.name}.")]
        touches = int(np.sum(problem.layout.present[:, columns]))
        if datum.name in unknown and 0 < touches < FEWEST[datum.kind]:
            raise ProblemError(
                f"the {datum.kind} '{datum.name}', whose place is not known, is touched {touches} "
                f"time{'s' * (touches != 1)} only", where=f"poses of {problem.poses.name}",
                remedy=f"touch it in {FEWEST[datum.kind]} poses or more, use its confidence, or state its place "
                       "without a 'sigma'")
