"""Checks of columns against the machine: units, signs, exchanged columns."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from itertools import combinations

import numpy as np

from hydroopt.errors import ProblemError
from hydroopt.estimation.kinematic.instrument_poses import placed
from hydroopt.estimation.kinematic.pose_layout import PoseLayout
from hydroopt.estimation.kinematic.problem import CalibrationProblem
from hydroopt.estimation.kinematic.residuals import gaps
from hydroopt.estimation.kinematic.unsensed_angles import guess_unsensed
from hydroopt.simulation.postures import limits

BEYOND = np.radians(20.0)
"""How far outside of a joint's limits a reading must lie to count as impossible [rad, m]."""
BETTER = 0.2
"""Part of the gap that must be left if columns are read otherwise to say that they should be."""
STILL = 0.03
"""Part of a joint's range within which all poses must lie to suspect radians that are given as degrees."""
LARGE = 0.1
"""Part of the chain's length that the nominal gap must reach before a mistake in the columns is looked for."""
OTHER_ANGLES = {"have the other sign": -1.0, "be degrees given as radians": np.radians(1),
                "be radians given as degrees": np.degrees(1)}
"""Factors that mistaken angles make."""
OTHER_LENGTHS = {"mm given as m": 1e-3, "cm given as m": 1e-2, "m given as mm": 1e3}
"""Factors that mistaken lengths make."""
POSES = 60
"""Poses that are examined."""


def refuse_misread(problem: CalibrationProblem) -> None:
    """Refuse readings outside of all limits, exchanged columns, reversed signs, and other units.

    A mistake is named only if the nominal machine agrees far better with the columns read otherwise.

    Args:
        problem: with all its poses.

    Raises:
        ProblemError: which column, why, and what to do.
    """
    there = np.flatnonzero(problem.layout.present.any(axis=1))
    chosen = np.zeros(len(problem.poses), dtype=bool)
    chosen[there[np.unique(np.linspace(0, len(there) - 1, POSES).astype(int))]] = True
    few = problem.without(~chosen)
    large = LARGE * sum(abs(link.joint.a) + abs(link.joint.d) for link in problem.model.machine.chain)
    usual, outside, still = _gap(few), _outside(problem), _still(few) == 1
    if not outside and not still and usual < large:
        return
    others = ((replace(few, layout=layout), words, remedy) for layout, words, remedy in _other_readings(few))
    gap, words, remedy = min(((_gap(other), words, remedy) for other, words, remedy in others
                              if not _outside(other) and (_still(other) == 0 if still else _still(other) < 1)),
                             default=(np.inf, "", ""))
    where = f"poses of {problem.poses.name}"
    if gap < (large if still else BETTER * usual):
        raise ProblemError(
            f"{words}: as they stand, the nominal machine misses the poses by {usual:.2g} m, otherwise by {gap:.2g} m",
            where=where, remedy=remedy)
    if outside:
        raise ProblemError(outside, where=where, remedy="check units and signs, that columns are not exchanged, the "
                                                        "sensor's zero and the limits in the machine file")


def _outside(problem: CalibrationProblem) -> str:
    """Which joint's readings lie outside of its limits in most poses, in words; none: ''."""
    low, high = limits(problem.model)
    layout = problem.layout
    for k, joint in enumerate(problem.model.joints):
        reading = layout.reading[layout.sensed[:, k], k]
        outside = (reading < low[k] - BEYOND) | (reading > high[k] + BEYOND)
        if outside.sum() > reading.size / 2:
            row = np.flatnonzero(layout.sensed[:, k])[int(np.argmax(outside))]
            return (f"'{joint}.q' lies outside of the joint's limits in {int(outside.sum())} of {reading.size} poses, "
                    f"from data row {problem.poses.row[row]} on")
    return ""


def _still(problem: CalibrationProblem) -> float:
    """Share of the sensed joints that stay within a small part of their ranges: such poses contradict no geometry."""
    low, high = limits(problem.model)
    sensed = problem.layout.sensed.all(axis=0)
    still = (np.ptp(problem.layout.reading, axis=0) < STILL * (high - low))[sensed]
    return float(still.mean()) if still.size else 0.0


def _other_readings(problem: CalibrationProblem) -> Iterator[tuple[PoseLayout, str, str]]:
    """Layouts in which columns are exchanged or have another sign or unit, with what that means and its remedy."""
    layout, joints = problem.layout, problem.model.joints
    sensed = [k for k in range(len(joints)) if layout.sensed[:, k].all()]
    for one, other in combinations(sensed, 2):
        reading = layout.reading.copy()
        reading[:, [one, other]] = reading[:, [other, one]]
        yield (replace(layout, reading=reading), f"the columns '{joints[one]}.q' and '{joints[other]}.q' seem to be "
               "exchanged", "exchange their headers or correct the map")
    for columns in [*([k] for k in sensed), sensed]:
        named = ", ".join(f"'{joints[k]}.q'" for k in columns)
        for what, factor in OTHER_ANGLES.items():
            reading = layout.reading.copy()
            reading[:, columns] *= factor
            yield replace(layout, reading=reading), f"values of {named} seem to {what}", "correct the map or the header"
    for name, rows in _measured(problem).items():
        for unit, factor in OTHER_LENGTHS.items():
            target = layout.target.copy()
            target[:, rows] *= factor
            yield (replace(layout, target=target), f"values of '{name}' seem to be {unit}",
                   "correct the map or the header")


def _measured(problem: CalibrationProblem) -> dict[str, list[int]]:
    """Rows that compare a measured place or length with the geometry, by what is measured."""
    found: dict[str, list[int]] = {}
    for k, name in enumerate(problem.model.channels):
        if not name.startswith(("gap.", "turn.")) and problem.layout.present[:, k].any():
            found.setdefault("tip" if name in ("tip.x", "tip.y", "tip.z") else name, []).append(k)
    return found


def _gap(problem: CalibrationProblem) -> float:
    """RMS [m] by which nominal geometry misses the poses; fixtures that may stand anywhere take the mean of theirs.

    What several instruments, tapes and datums measure of a pose counts by its mean.
    """
    problem = placed(problem)
    layout = problem.layout
    left = np.where(layout.present, gaps(problem, problem.start, guess_unsensed(problem, problem.start)), np.nan)
    anywhere = {f.name for f in problem.model.machine.fixtures if f.moves}
    for columns in np.unique(layout.fixture, axis=0):
        if problem.parameters.names[columns[0]].split(".")[0] in anywhere:
            here = np.all(layout.fixture == columns, axis=1) & layout.held
            left[here, :3] -= left[here, :3].sum(axis=0) / max(1, here.sum())
    turns = np.array(problem.model.units) != "m"
    turns[: problem.model.loop_rows] = False
    left[:, turns] = np.nan
    more = [[problem.model.channels.index(channel) for channel in each.channels] for each in problem.model.measurements]
    count = sum((np.isfinite(left[:, columns]).any(axis=1).astype(int) for columns in more), np.zeros(len(left)))
    left[:, len(problem.model.channels) - sum(map(len, more)) :] /= np.sqrt(np.maximum(count, 1.0))[:, None]
    return float(np.sqrt(np.nanmean(np.nansum(left**2, axis=1))))
