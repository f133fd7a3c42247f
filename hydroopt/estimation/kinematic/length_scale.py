"""Whether poses have a length scale: angles alone fit a chain of any size (Section 3.6.4)."""

from __future__ import annotations

import numpy as np

from hydroopt.errors import ProblemError
from hydroopt.estimation.inference.identifiability import RANK_TOLERANCE
from hydroopt.estimation.kinematic.observability import Linearised
from hydroopt.estimation.kinematic.problem import CalibrationProblem


def has_length_scale(problem: CalibrationProblem, linearised: Linearised | None = None) -> bool:
    """Whether the size of the chain is determined: by an exact length, a reading of a length, a distance or a prior.

    Args:
        problem: a calibration.
        linearised: its rows about exactly closed postures. Then a common factor on all lengths must change the rows in
            a way that pins and fixtures cannot follow; without it, any reading other than an angle counts.
    """
    if _exact_length(problem):
        return True
    if linearised is None:
        return bool(_reads_length(problem) or len(problem.distances.length) or problem.priors
                    or all(link.joint.type == "locked" for link in problem.model.machine.chain))
    if any(problem.fixed.values()):  # an exact fixture
        return True
    parameters, pins = problem.parameters, problem.cylinder_parameters
    grown = np.where((np.array(parameters.units) == "m") & ~pins, problem.start, 0.0)
    follow = pins & problem.free
    follow[problem.layout.place[problem.layout.place >= 0]] = True
    rows = np.vstack([linearised.jacobian.reshape(-1, len(parameters)), linearised.shared])
    trace = rows @ grown
    trace = trace - rows[:, follow] @ np.linalg.lstsq(rows[:, follow], trace, rcond=None)[0]
    return bool(np.linalg.norm(trace) > RANK_TOLERANCE * np.linalg.norm(np.abs(rows) @ np.abs(grown)))


def no_length_scale(where: str, remedy: str) -> ProblemError:
    """The error of poses without a length scale."""
    return ProblemError("there is no length scale: the same angles fit a chain with all its lengths doubled",
                        where=where, remedy=remedy)


def _reads_length(problem: CalibrationProblem) -> bool:
    """Whether poses read a length or a place; turns have no length, nor have touches of datums."""
    rows = np.flatnonzero(np.array(problem.model.units) == "m")
    rows = rows[rows >= problem.model.loop_rows]
    return bool(np.any(problem.layout.present[:, rows] & (problem.layout.target[:, rows] != 0)))


def _exact_length(problem: CalibrationProblem) -> bool:
    """Whether a length of the chain is held at a value other than zero.

    Lengths before the first axis do not count: like fixtures they only place the base frame.
    """
    machine, parameters = problem.model.machine, problem.parameters
    if machine.calibrator is None:
        return False
    first = next((k for k, link in enumerate(machine.chain) if link.joint.independent), 0)
    lengths = {f"{link.name}.{key}": getattr(link.joint, key) for k, link in enumerate(machine.chain)
               for key in ("a", "d") if k > first or (k, key) == (first, "a")}
    lengths |= zip(("tip.x", "tip.y", "tip.z"), machine.calibrator.tip, strict=True)
    free = {name for name, estimated in zip(parameters.names, problem.free, strict=True) if estimated}
    return any(problem.fixed.get(name, value) for name, value in lengths.items() if name not in free)
