"""Tables of poses whose readings are planned positions, not measurements."""

from __future__ import annotations

import numpy as np

from hydroopt.errors import ProblemError
from hydroopt.estimation.kinematic.problem import UNFILLED, CalibrationProblem, calibration_problem
from hydroopt.estimation.kinematic.residuals import gaps
from hydroopt.estimation.kinematic.unsensed_angles import follow_unsensed, guess_unsensed

EXACT = 1e-4
"""Largest part of its standard deviation, or of `PLAY`, that a residual of planned positions is: measured ones differ
from the nominal machine by the errors of sensors and geometry."""
PLAY = 1e-3
"""Scale [m or rad] of a gap whose fixture has no play."""


def refuse_planned(problem: CalibrationProblem) -> None:
    """Refuse positions of joints beside which nothing was read, and tables that equal the nominal machine as a whole.

    It is asked once, of all poses that were read: what is left after some were left out or held out may well be exact.

    Raises:
        ProblemError: the table is a plan, or as good as one.
    """
    present, where = problem.layout.present, next(iter(problem.poses.sha256), problem.poses.name)
    if not np.any(present):
        raise ProblemError("positions of joints are filled in, but no reading that the geometry can be compared with",
                           where=where, remedy="fill in places, lengths or distances, or name the fixture of each pose")
    held_out = problem.validation
    if _as_planned(problem) and (held_out is None or _as_planned(
            calibration_problem(problem.model.machine, held_out))):
        raise ProblemError("the readings equal those of the nominal machine without any error: they are planned, not "
                           "measured", where=where, remedy=UNFILLED)


def _as_planned(problem: CalibrationProblem) -> bool:
    """Whether readings equal those of the nominal machine."""
    present = problem.layout.present
    if present.sum() <= problem.layout.moving.sum():
        return False
    nominal = follow_unsensed(problem, problem.start, guess_unsensed(problem, problem.start))
    sigma = np.where(problem.row_sigma > 0, problem.row_sigma, PLAY)
    return bool(np.all(np.abs(gaps(problem, problem.start, nominal) / sigma)[present] < EXACT))
