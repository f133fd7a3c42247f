"""Checks of poses against the machine before they are calibrated."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from itertools import combinations, permutations
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from hydroopt.errors import ProblemError
from hydroopt.estimation.inference.identifiability import RANK_TOLERANCE
from hydroopt.estimation.kinematic.initial_guesses import Sighting, follow_unsensed, guess_unsensed, placed, sightings
from hydroopt.estimation.kinematic.observability import Linearised
from hydroopt.estimation.kinematic.pose_layout import PoseLayout
from hydroopt.estimation.kinematic.problem import UNFILLED, CalibrationProblem, calibration_problem
from hydroopt.estimation.kinematic.residuals import gaps
from hydroopt.machine.sensors import ACCELEROMETER, Imu
from hydroopt.spatial.inertia import Array

FEWEST = {"plane": 4, "line": 3}
"""Touches of which a datum that is not known tells something: one more than those that determine it."""
EXACT = 1e-4
"""Largest part of its standard deviation, or of `PLAY`, that a residual of planned positions is: measured ones differ
from the nominal machine by the errors of sensors and geometry."""
PLAY = 1e-3
"""Scale [m or rad] of a gap whose fixture has no play, and of rows that no sensed joint weighs."""
BETTER = 0.2
"""Part of the misfit that must be left if readings are taken otherwise to say that they should be."""
STRAY = 0.1
"""Part by which the magnitude of specific forces at rest may differ from gravity."""
OFF = 0.3
"""Angle [rad] between felt and expected gravity from which on a mistake is looked for."""
UPRIGHT = np.radians(85.0)
"""Pitch beyond which roll is not defined."""
BEYOND = np.radians(20.0)
"""How far outside of a joint's limits a reading must lie to count as impossible [rad, m]."""
STILL = 0.03
"""Part of a joint's range within which all poses must lie to suspect radians that are given as degrees."""
LARGE, TURNED = 0.1, 0.5
"""Misfit, as a part of the chain's length or of the size of what was seen, and that of orientations [rad], from which
on a mistake is looked for."""
OTHER_ANGLES = {"have the other sign": -1.0, "be degrees given as radians": np.radians(1),
                "be radians given as degrees": np.degrees(1)}
"""Factors that mistaken angles make."""
OTHER_LENGTHS = {"mm given as m": 1e-3, "cm given as m": 1e-2, "m given as mm": 1e3, "ft given as m": 0.3048}
"""Factors that correct mistaken units of lengths and places."""
FLIP = np.diag([1.0, -1.0, -1.0])
"""Half a turn about x: from a camera's axes with y down and z ahead to those with y up and z behind."""
POSES = 60
"""Poses that are examined for mistaken columns."""


class Otherwise(NamedTuple):
    """The misfit of readings that are taken otherwise, what that means, and its remedy."""

    misfit: float = np.inf
    words: str = ""
    remedy: str = ""


def _refuse_better(others: Iterable[Otherwise], below: float, where: str, said: str,
                   left: Callable[[float], str] = lambda _: "") -> None:
    """Refuse readings that the nominal machine agrees with far better if they are taken otherwise."""
    best = min(others, key=lambda other: other.misfit, default=Otherwise())
    if best.misfit < below:
        raise ProblemError(f"{best.words}: as they stand, {said}{left(best.misfit)}", where=where,
                           remedy=best.remedy)


def refuse_unusable(problem: CalibrationProblem) -> None:
    """Refuse poses that cannot determine the parameters, or that the machine file shows to be misread.

    Raises:
        ProblemError: what is wrong, where, and what to do.
    """
    rows = int(problem.layout.present.sum() - problem.layout.moving.sum()) + len(problem.distances.length)
    unknown = int(np.sum(problem.free & (problem.known == 0)))
    if rows < unknown:
        raise ProblemError(f"{rows} equations of all poses are too few for {unknown} unknown parameters",
                           where=f"poses of {problem.poses.name}", remedy="measure more poses or fix parameters")
    if not has_length_scale(problem):
        raise no_length_scale(f"poses of {problem.poses.name}", "fix a length, state a distance between fixtures, or "
                              "read a tape, a tracker or a cylinder's length")
    for refuse in (_refuse_unseen, _refuse_untouched, _refuse_missed_ground, _refuse_misread_inclination,
                   _refuse_misread_columns):
        refuse(problem)


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


def _refuse_untouched(problem: CalibrationProblem) -> None:
    """Refuse a datum of unknown place that too few poses touch, unless confidences say where it may be."""
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


def _refuse_missed_ground(problem: CalibrationProblem) -> None:
    """Refuse a distance to the ground in a pose in which the beam points away from it."""
    model, layout, poses = problem.model, problem.layout, problem.poses
    for laser in model.machine.rangefinders:
        i = model.channels.index(laser.channel)
        for row in np.flatnonzero(layout.present[:, i] & ~layout.moving.any(axis=1) & ~(_expected(problem)[:, i] > 0)):
            raise ProblemError(f"'{laser.channel}' is {layout.target[row, i]:.4g} m, but by the machine file its beam "
                               "cannot hit the ground in this pose",
                               where=f"{poses.file[row] or poses.name}, data row {poses.row[row]}",
                               remedy=f"check the joints' readings, and 'position' and 'direction' of '{laser.name}'")


def _expected(problem: CalibrationProblem) -> Array:
    """What the nominal machine reads (N, m), its joints as read or locked."""
    model, theta = problem.model, problem.start
    place, q = problem.places(theta), problem.angles(theta, problem.layout.reading)
    place[:, list(model.readings.values())] = 0.0
    return model.over(model.observed, theta[: len(model.parameters)], q, place)[0][:, :, 0]


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


def _refuse_misread_inclination(problem: CalibrationProblem) -> None:
    """Refuse accelerations of another magnitude than gravity, inclinations of upright units, and mistaken axes.

    A mistake of axes is named only if the nominal machine agrees far better with the axes read otherwise.
    """
    where = f"poses of {problem.poses.name}"
    for imu in problem.model.machine.imus:
        pitch = problem.poses.channels.get(f"{imu.name}.pitch", np.empty(0))
        if np.any(np.abs(pitch) > UPRIGHT):
            row = int(np.argmax(np.abs(pitch) > UPRIGHT))
            raise ProblemError(
                f"'{imu.name}.pitch' is {np.degrees(pitch[row]):.0f} deg, where roll is not defined",
                where=f"{problem.poses.file[row] or problem.poses.name}, data row {problem.poses.row[row]}",
                remedy=f"check its unit, record '{imu.name}.accel_x' to '.accel_z', or turn the unit on its link")
        _refuse_magnitude(problem, imu, where)
        expected, felt, names = _up(problem, imu)
        if len(felt) and (usual := _angle(expected, felt)) > OFF:
            remedy = f"correct the columns, or the orientation of '{imu.name}' in the machine file"
            _refuse_better((Otherwise(_angle(expected, other), words, remedy)
                            for other, words in _other_axes(felt, names)), BETTER * usual, where,
                           f"gravity is {np.degrees(usual):.0f} deg off what the nominal machine expects",
                           lambda angle: f", otherwise {np.degrees(angle):.1f} deg")


def _refuse_magnitude(problem: CalibrationProblem, imu: Imu, where: str) -> None:
    felt, gravity = _accelerations(problem, imu), problem.model.machine.gravity
    size = float(np.median(np.linalg.norm(felt, axis=1))) if len(felt) else gravity
    if abs(size - gravity) > STRAY * gravity:
        seem = next((f"; they seem to be {words}" for words, factor in (
            ("g given as m/s^2", gravity), ("mg given as m/s^2", gravity / 1e3), ("m/s^2 given as g", 1 / gravity))
            if abs(size * factor - gravity) < STRAY * gravity), "")
        raise ProblemError(
            f"at rest the accelerations of '{imu.name}' have the magnitude {size:.3g} m/s^2, not that of gravity, "
            f"{gravity:.3g} m/s^2{seem}", where=where,
            remedy="correct the unit in the header or the map, or leave out poses that moved")


def _accelerations(problem: CalibrationProblem, imu: Imu) -> Array:
    """Complete specific forces (K, 3) [m/s²]."""
    channels = problem.poses.channels
    nothing = np.full(len(problem.poses), np.nan)
    felt = np.stack([channels.get(f"{imu.name}.{axis}", nothing) for axis in ACCELEROMETER], axis=1)
    return np.asarray(felt[np.isfinite(felt).all(axis=1)])


def _up(problem: CalibrationProblem, imu: Imu) -> tuple[Array, Array, tuple[str, ...]]:
    """Directions of up (K, 3) in a unit's axes, expected and felt, where all joints are read; and the channels."""
    model, layout = problem.model, problem.layout
    predicted = _expected(problem)
    for names in (tuple(f"{imu.name}.{axis}" for axis in ACCELEROMETER), (f"{imu.name}.roll", f"{imu.name}.pitch")):
        if not set(names) <= set(model.channels):
            continue
        columns = [model.channels.index(name) for name in names]
        there = layout.present[:, columns].all(axis=1) & ~layout.moving.any(axis=1)
        if np.any(there):
            read = np.stack([problem.poses.channels[name][there] for name in names], axis=1)
            return _direction(predicted[there][:, columns]), _direction(read), names
    return np.zeros((0, 3)), np.zeros((0, 3)), ()


def _direction(values: Array) -> Array:
    """Unit vectors (K, 3) upwards, of specific forces (K, 3) or of roll and pitch (K, 2)."""
    if values.shape[1] == 3:
        return np.asarray(values / np.linalg.norm(values, axis=1, keepdims=True))
    roll, pitch = values.T
    return np.stack([-np.sin(pitch), np.sin(roll) * np.cos(pitch), np.cos(roll) * np.cos(pitch)], axis=1)


def _angle(one: Array, other: Array) -> float:
    """RMS angle [rad] between directions (K, 3)."""
    return float(np.sqrt(np.mean(np.arccos(np.clip(np.sum(one * other, axis=1), -1, 1)) ** 2)))


def _other_axes(felt: Array, names: tuple[str, ...]) -> Iterator[tuple[Array, str]]:
    """Directions with signs and axes read otherwise, with what that means."""
    listed = f"'{names[0]}' to '{names[-1].rpartition('.')[2]}'"
    yield -felt, f"the signs of {listed} seem to be reversed: at rest they point up, as the force that holds the unit"
    for order in permutations(range(3)):
        for signs in np.array(np.meshgrid(*3 * [[1.0, -1.0]])).reshape(3, -1).T:
            if np.linalg.det(np.eye(3)[list(order)] * signs[:, None]) > 0 and (order != (0, 1, 2) or np.any(signs < 0)):
                axes = ", ".join(f"{'-' if sign < 0 else ''}{'xyz'[k]}" for k, sign in zip(order, signs, strict=True))
                yield felt[:, order] * signs, f"the axes of {listed} seem to be exchanged for {axes}"


def _refuse_misread_columns(problem: CalibrationProblem) -> None:
    """Refuse readings outside of all limits, exchanged columns, reversed signs, and other units.

    A mistake is named only if the nominal machine agrees far better with the columns read otherwise.
    """
    there = np.flatnonzero(problem.layout.present.any(axis=1))
    chosen = np.zeros(len(problem.poses), dtype=bool)
    chosen[there[np.unique(np.linspace(0, len(there) - 1, POSES).astype(int))]] = True
    few = problem.without(~chosen)
    large = LARGE * sum(abs(link.joint.a) + abs(link.joint.d) for link in problem.model.machine.chain)
    usual, outside, still = _gap(few), _outside(problem), _still(few) == 1
    if not outside and not still and usual < large:
        return
    where = f"poses of {problem.poses.name}"
    others = ((replace(few, layout=layout), words, remedy) for layout, words, remedy in _other_columns(few))
    _refuse_better((Otherwise(_gap(other), words, remedy) for other, words, remedy in others
                    if not _outside(other) and (_still(other) == 0 if still else _still(other) < 1)),
                   large if still else BETTER * usual, where,
                   f"the nominal machine misses the poses by {usual:.2g} m", lambda gap: f", otherwise by {gap:.2g} m")
    if outside:
        raise ProblemError(outside, where=where, remedy="check units and signs, that columns are not exchanged, the "
                                                        "sensor's zero and the limits in the machine file")


def _outside(problem: CalibrationProblem) -> str:
    """Which joint's readings lie outside of its limits in most poses, in words; none: ''."""
    low, high = problem.model.ranges.T
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
    low, high = problem.model.ranges.T
    sensed = problem.layout.sensed.all(axis=0)
    still = (np.ptp(problem.layout.reading, axis=0) < STILL * (high - low))[sensed]
    return float(still.mean()) if still.size else 0.0


def _other_columns(problem: CalibrationProblem) -> Iterator[tuple[PoseLayout, str, str]]:
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


def _refuse_unseen(problem: CalibrationProblem) -> None:
    """Refuse set-ups that see too little, and readings of instruments that the nominal machine contradicts.

    A mistake is named only if the nominal machine agrees far better with readings in another unit or convention.
    """
    for owner, sighting in sightings(problem):
        name, _, setup = owner.partition(".")
        called = f"'{name}' in set-up '{setup}'" if setup else f"'{name}'"
        where = f"poses of {problem.poses.name}"
        if problem.free[problem.parameters.index(f"{owner}.x")] and not sighting.complete:
            count = len(np.unique(np.round(sighting.read, 3), axis=0))
            raise ProblemError(
                f"{called} sees targets at {count} place{'s' * (count != 1)} only, all on a line: where it stands is "
                "not determined", where=where, remedy="measure targets at three places or more that are not on a line, "
                "those of the ground too, or leave the set-up out")
        if (usual := _misfit(sighting)) >= 1:
            _refuse_better((Otherwise(_misfit(other), words, remedy)
                            for other, words, remedy in _other_sightings(sighting)), BETTER * usual, where,
                           f"the nominal machine contradicts what {called} reads")


def _misfit(sighting: Sighting) -> float:
    """That of positions and orientations, in units of those from which on a mistake is looked for."""
    length, turn = sighting.misfit()
    return max(length / LARGE, turn / TURNED)


def _other_sightings(sighting: Sighting) -> Iterator[tuple[Sighting, str, str]]:
    """The readings taken otherwise, with what that means and its remedy."""
    if len(sighting.read) > 3:
        for mirror in 1 - 2 * np.eye(3):
            yield (sighting._replace(read=mirror * sighting.read), "the positions seem to be mirrored, as in "
                   "left-handed axes", "reverse one axis, or exchange two columns back")
        for words, factor in OTHER_LENGTHS.items():
            yield (sighting._replace(read=factor * sighting.read), f"the positions seem to be {words}",
                   "correct the map or the header")
    if not len(sighting.read_turns):
        return
    read = sighting.read_turns
    order = "state the marker in the camera's frame, with the camera's axes for position and orientation alike"
    back = read.transpose(0, 2, 1)
    other = sighting._replace(read_turns=back)
    if len(sighting.read) and np.all(sighting.turned >= 0):
        own = back[sighting.turned]
        other = other._replace(read=-np.einsum("kij,kj->ki", own, sighting.read))
    yield (other, "the poses seem to be those of the instrument in the target's frame", "invert them")
    yield (sighting._replace(read_turns=FLIP @ read), "the orientations seem to be in other axes of the "
           "instrument than the positions, with y and z reversed", order)
    yield (sighting._replace(read_turns=read @ FLIP), "the target's axes seem to be flipped, with y and z "
           "reversed", "turn the orientations, or state the target's 'orientation' in the machine file")
    scalar_last = Rotation.from_quat(np.roll(Rotation.from_matrix(read).as_quat(), 1, axis=1)).as_matrix()
    yield (sighting._replace(read_turns=scalar_last), "the quaternions seem to have their scalar last, not "
           "first", "give the columns the headers qx, qy, qz, qw in that order")
