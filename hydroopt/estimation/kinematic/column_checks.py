"""Checks of columns against the machine: degrees given as radians, exchanged columns."""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations

import numpy as np

from hydroopt.errors import ProblemError
from hydroopt.estimation.kinematic.problem import CalibrationProblem
from hydroopt.estimation.kinematic.unsensed_angles import guess_unsensed
from hydroopt.simulation.postures import limits
from hydroopt.spatial.inertia import Array

BEYOND = np.radians(20.0)
"""How far outside of a joint's limits a reading must lie to count as impossible [rad, m]."""
BETTER = 0.2
"""Part of the gap that must be left after exchanging two columns to say that they were exchanged."""
LARGE = 0.1
"""Part of the chain's length that the nominal gap must reach before a mistake in the columns is looked for."""
POSES = 60
"""Poses that are examined."""


def refuse_misread(problem: CalibrationProblem) -> None:
    """Refuse readings outside of all limits, and exchanged columns.

    Args:
        problem: with all its poses.

    Raises:
        ProblemError: which column, why, and what to do.
    """
    low, high = limits(problem.model)
    layout = problem.layout
    for k, joint in enumerate(problem.model.joints):
        reading = layout.reading[layout.sensed[:, k], k]
        outside = _outside(reading, low[k], high[k])
        if outside.sum() <= reading.size / 2:
            continue
        row = np.flatnonzero(layout.sensed[:, k])[int(np.argmax(outside))]
        turned = _outside(np.radians(reading), low[k], high[k]).mean() < 0.1
        raise ProblemError(
            f"'{joint}.q' lies outside of the joint's limits in {int(outside.sum())} of {reading.size} poses, from "
            f"data row {problem.poses.row[row]} on", where=f"poses of {problem.poses.name}",
            remedy="these look like degrees given as radians: correct the unit" if turned else
            "check that columns are not exchanged, the sensor's zero and the limits in the machine file")
    _refuse_exchanged(problem)


def _outside(reading: Array, low: float, high: float) -> Array:
    return np.asarray((reading < low - BEYOND) | (reading > high + BEYOND), dtype=float)


def _refuse_exchanged(problem: CalibrationProblem) -> None:
    closed = np.flatnonzero(problem.layout.present[:, :3].all(axis=1))
    if not closed.size:
        return
    chosen = np.zeros(len(problem.poses), dtype=bool)
    chosen[closed[np.unique(np.linspace(0, len(closed) - 1, POSES).astype(int))]] = True
    few = problem.without(~chosen)
    usual = _gap(few)
    reach = sum(abs(link.joint.a) + abs(link.joint.d) for link in problem.model.machine.chain)
    if usual < LARGE * reach:
        return
    sensed = [k for k in range(len(problem.model.joints)) if few.layout.sensed[:, k].all()]
    trials = []
    for one, other in combinations(sensed, 2):
        reading = few.layout.reading.copy()
        reading[:, [one, other]] = reading[:, [other, one]]
        trials.append((_gap(few, reading), problem.model.joints[one], problem.model.joints[other]))
    if trials and (best := min(trials))[0] < BETTER * usual:
        raise ProblemError(
            f"the columns '{best[1]}.q' and '{best[2]}.q' seem to be exchanged: as they stand the nominal chain stays "
            f"open by {usual:.2g} m, the other way round by {best[0]:.2g} m", where=f"poses of {problem.poses.name}",
            remedy="exchange their headers or correct the map")


def _gap(problem: CalibrationProblem, reading: Array | None = None) -> float:
    """RMS [m] of the nominal gap; fixtures that may stand anywhere take the mean of their poses."""
    if reading is not None:
        problem = replace(problem, layout=replace(problem.layout, reading=reading))
    q = guess_unsensed(problem, problem.start)
    model = problem.model
    tip = model.over(model.tip, problem.start[: len(model.parameters)], q)[0][:, :, 0]
    gap = tip - problem.fixtures(problem.start)
    anywhere = {f.name for f in model.machine.fixtures if f.moves}
    for columns in np.unique(problem.layout.fixture, axis=0):
        if problem.parameters.names[columns[0]].split(".")[0] in anywhere:
            rows = np.all(problem.layout.fixture == columns, axis=1)
            gap[rows] = tip[rows] - tip[rows].mean(axis=0)
    return float(np.sqrt(np.mean(np.sum(gap**2, axis=1))))
