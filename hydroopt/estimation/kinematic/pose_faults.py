"""Faults of poses as extensions of the model, and suspects: those that contradict the rest of the poses.

Each fault adds a few columns to the whitened rows of the linearised problem; their coefficients are its amount.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from enum import StrEnum
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hydroopt.estimation.kinematic.observability import Linearised
from hydroopt.estimation.kinematic.problem import CalibrationProblem
from hydroopt.results.diagnostic import Diagnostic, Meaning, filled
from hydroopt.results.tables import number
from hydroopt.spatial.inertia import Array


class SuspectKind(StrEnum):
    """What a suspect is; the value stands in JSON files."""

    PLANE = "plane"
    STAGE = "stage"
    STRETCH = "stretch"
    POSE = "pose"
    FIXTURE = "fixture"
    BASE = "base"
    TOOL = "tool"
    INSTRUMENT = "instrument"
    OFFSET = "offset"
    SCALE = "scale"
    BACKLASH = "backlash"
    GEAR = "gear"
    SAG = "sag"
    NONLINEAR = "nonlinear"
    DISTANCE = "distance"
    LACK = "lack"

    @property
    def is_poses(self) -> bool:
        """Whether the suspect is poses, which can be left out."""
        return self in (SuspectKind.STAGE, SuspectKind.STRETCH, SuspectKind.POSE)


class _Words(NamedTuple):
    """What is said of a kind of suspect: kind of its diagnostic, it in a few words as one of several, the sentence."""

    kind: str
    phrase: str
    text: str
    remedy: str = ""
    meaning: Meaning = Meaning.CONTRADICTION


_POSES, _BEFORE = "wrong poses at {place}", "by about {size:.1f} {unit} before {place}."
_WORDS = {
    SuspectKind.PLANE: _Words("poses in one plane", _POSES, (
        "All joints that turned between the poses have parallel axes, so that the poses lie in one plane and geometry "
        "across it is not identifiable."), "Measure poses that leave the plane.", Meaning.NOTE),
    SuspectKind.STAGE: _Words("stage contradicts the others", _POSES, (
        "The poses of '{subject}' ({place}) contradict the others: their errors are {strength:.1f} times the usual "
        "ones.")),
    SuspectKind.STRETCH: _Words("stretch of poses contradicts the others", _POSES, (
        "In '{subject}', {place} contradict the others: their errors are {strength:.1f} times the usual ones."),
        meaning=Meaning.NOTE),
    SuspectKind.POSE: _Words("pose contradicts the others", _POSES, (
        "Pose {subject} ({place}) contradicts the others: its error is {strength:.1f} times the usual one."),
        meaning=Meaning.NOTE),
    SuspectKind.FIXTURE: _Words("fixture moved", "fixture '{subject}' moved{by} before {place}", (
        "The fixture '{subject}' moved " + _BEFORE)),
    SuspectKind.BASE: _Words("base moved", "the base moved{by} before {place}", "The base moved " + _BEFORE),
    SuspectKind.TOOL: _Words("tool moved", "the tool moved{by} before {place}", (
        "The tool moved on its link " + _BEFORE)),
    SuspectKind.INSTRUMENT: _Words("instrument moved", "instrument '{subject}' moved{by} before {place}", (
        "The instrument '{subject}' moved " + _BEFORE), "Name another set-up from there on, in the column 'setup'."),
    SuspectKind.OFFSET: _Words("sensor reads another zero", "another zero of '{subject}' {where}{by}", (
        "The sensor of '{subject}' reads another zero {where}, by {size:.3g} {unit}.")),
    SuspectKind.SCALE: _Words("sensor reads a wrong scale", "a wrong scale of '{subject}' by {size:.2f %}", (
        "The sensor of '{subject}' reads a wrong scale, by {size:.2f %}.")),
    SuspectKind.BACKLASH: _Words("backlash", "backlash of '{subject}'{by}", (
        "'{subject}' has backlash: its reading depends on where it comes from, by {size:.3g} {unit}.")),
    SuspectKind.GEAR: _Words("sensor or gear eccentric", "an eccentric sensor or gear of '{subject}'{by}", (
        "The sensor or the gear of '{subject}' is eccentric: its error repeats once a turn, with an amplitude of "
        "{size:.3g} {unit}.")),
    SuspectKind.NONLINEAR: _Words("sensor not linear", "a nonlinear sensor of '{subject}'{by}", (
        "The sensor of '{subject}' is not linear: its error at both ends differs from that in the middle by "
        "{size:.3g} {unit}.")),
    SuspectKind.SAG: _Words("joint gives way under gravity", "'{subject}' giving way under gravity{by}", (
        "'{subject}' gives way under gravity, by up to {size:.3g} {unit}."),
        "Take it in by --compliance auto, or state its compliance with a sigma."),
    SuspectKind.DISTANCE: _Words("distance between fixtures wrong", "a wrong distance '{subject}'{by}", (
        "The stated distance '{subject}' is wrong by {size:.2f} {unit}."), "Measure it again."),
    SuspectKind.LACK: _Words("effect lacking", "an effect that the model lacks", (
        "The model lacks an effect that the poses show."))}
"""By kind of suspect; those that are poses alone do not contradict a calibration, from which they can be left out."""
NAMED = 4
"""Most alternatives that a sentence names."""


@dataclass(frozen=True, eq=False)
class Suspect:
    """Something that contradicts the rest.

    Attributes:
        kind: what it is.
        name: of the stage, pose, fixture, distance, joint or cylinder.
        poses: (N,) poses it concerns; `place` says where they stand in their files.
        strength: root of the likelihood gain: of the drop of squared errors that it explains, in units of the errors'
            variance; of poses, their errors relative to the usual ones.
        size: of the defect [rad, m, or 1 for a scale]; NaN where it has none.
        where: in which poses a sensor reads another zero.
        unit: ``deg`` or ``mm``, in which the size is said.
        rivals: what else explains the same errors about as well. The data decide where there are none.
    """

    kind: SuspectKind
    name: str
    poses: NDArray[np.bool_]
    place: str
    strength: float
    size: float = float("nan")
    where: str = ""
    unit: str = "deg"
    rivals: tuple[Suspect, ...] = ()

    @property
    def decided(self) -> bool:
        """Whether the data decide for it."""
        return not self.rivals

    @property
    def phrase(self) -> str:
        """It in a few words, as one of several."""
        evidence = self._evidence
        by = " by {size:.3g} {unit}".format(**evidence) if "unit" in evidence else ""
        return filled(_WORDS[self.kind].phrase, self._subject, evidence | {"by": by})

    @property
    def diagnostic(self) -> Diagnostic:
        """The finding with its words."""
        if self.rivals:
            candidates = (self, *self.rivals)
            named = dict.fromkeys(each.name for each in candidates if each.name)
            return Diagnostic.of("cause of the contradiction undecided", tuple(named), {
                "place": self.place, "strength": self.strength,
                "alternatives": "; ".join(s.phrase for s in candidates[:NAMED])
                + (f"; and {len(candidates) - NAMED} more" if len(candidates) > NAMED else ""),
                "strengths": [number(s.strength) for s in candidates]},
                "Something contradicts the poses, and the data do not decide between: {alternatives}.",
                meaning=Meaning.CONTRADICTION)
        words = _WORDS[self.kind]
        return Diagnostic.of(words.kind, self._subject, self._evidence, words.text, words.remedy, words.meaning)

    @property
    def _subject(self) -> tuple[str, ...]:
        return (self.name,) if self.name else ()

    @property
    def _evidence(self) -> dict[str, Any]:
        """Where it is and how large, as sentences write it."""
        evidence: dict[str, Any] = {"place": self.place, "strength": self.strength}
        if np.isnan(self.size):
            return evidence
        if self.kind is SuspectKind.SCALE:
            return evidence | {"size": self.size}
        size = float(np.degrees(self.size)) if self.unit == "deg" else 1e3 * self.size
        return evidence | {"size": size, "unit": self.unit, "where": self.where}


BEYOND = 3.0
"""How many times its stated standard deviation a sensor must be off: less is what was stated."""
CLEAR = 8.0
"""Standard deviations by which a reading must change to say from where it comes: of less, its own error does."""
SPLITS = 24
"""Places in the poses at which a move is tested, beside the ends of stages."""
SHORTEST = 5
"""Fewest poses before and after a move."""
NEAR = 10
"""Poses before and after a move that was found, at which its beginning is sought further."""
TURN = 0.05
"""Usual turn [rad] of a base that moves."""
ECCENTRIC = 0.02
"""Usual eccentricity of a sensor [rad]."""
TURNS = 1.0
"""Range of an angle [rad] from which on an eccentricity differs from an offset and a scale."""

STANDS = ("x", "y", "z", "rx", "ry", "rz", "roll", "pitch", "yaw")
"""Ends of the names of numbers that say where an instrument stands."""


class Fault(NamedTuple):
    """A fault and what it adds to the whitened rows: `columns` (N, u, d), times the poses' `weight` (N,).

    Attributes:
        kind, name: as of a `Suspect`.
        poses: (N,) those concerned.
        columns: change of the rows by a unit of the amount (d,), shared by faults that differ in `weight`.
        least: size of the change below which it is within what the machine file states.
        change: the largest change of a reading, or of a place, by a unit of the amount.
        where: in which poses, in words.
        unit: ``deg`` or ``mm``.
        lengths: how many of the first amounts are lengths [m], where the rest are turns.
        usual: standard deviation of the amounts of such faults; of turns `TURN`.
        there: (N,) the poses that it may concern, from some pose on; None if it does not begin.
        shared: (K, d) change of the rows that no pose owns; None for zero.
    """

    kind: SuspectKind
    name: str
    poses: NDArray[np.bool_]
    columns: Array
    weight: Array
    least: float
    change: float = 1.0
    where: str = ""
    unit: str = "deg"
    lengths: int | None = None
    usual: float = 0.05
    there: NDArray[np.bool_] | None = None
    shared: Array | None = None

    @property
    def information(self) -> Array:
        """(d,) inverse variance of the amounts before anything is known."""
        d = self.columns.shape[2]
        return np.asarray([1 / (self.usual if k < (self.lengths or d) else TURN) ** 2 for k in range(d)])

    def neighbours(self) -> Iterator[Fault]:
        """The same beginning up to `NEAR` of the poses that it may concern earlier or later."""
        if self.there is not None:
            rows = np.flatnonzero(self.there)
            at = int(np.searchsorted(rows, self.first))
            for k in range(max(SHORTEST, at - NEAR), min(len(rows) - SHORTEST, at + NEAR) + 1):
                late = self.there & (np.arange(len(self.there)) >= rows[k])
                yield self._replace(poses=late, weight=late.astype(float))

    def size(self, amount: Array) -> float:
        """Size of an amount (d,), in rad, m or as a part."""
        return float(np.linalg.norm(amount[: self.lengths]))

    def rows(self, kept: NDArray[np.bool_], count: int) -> Array:
        """(count, d) change of the rows of some poses (N,), then of the shared ones, then nothing."""
        column = np.zeros((count, self.columns.shape[2]))
        own = (self.columns * (self.weight * kept)[:, None, None]).reshape(-1, column.shape[1])
        column[: len(own)] = own
        if self.shared is not None:
            column[len(own) : len(own) + len(self.shared)] = self.shared
        return column

    @property
    def first(self) -> int:
        """The first pose concerned."""
        return int(np.argmax(self.poses))


def faults(problem: CalibrationProblem, q: Array, linearised: Linearised) -> Iterator[Fault]:
    """All faults that are tested.

    Args:
        problem: the calibration.
        q: (N, n) joint vectors of the solution [rad, m].
        linearised: rows about it.
    """
    starts = _starts(problem)
    for k, joint in enumerate(problem.model.joints):
        sigma, sensed = float(problem.angle_sigma[k]), problem.layout.sensed[:, k]
        if sigma > 0 and np.any(sensed):
            column = linearised.by_angles[:, :, [k]]
            prismatic = problem.model.machine.channel_units[f"{joint}.q"] == "m"
            unit = "mm" if prismatic else "deg"
            yield from _of_sensor(problem, joint, column, q[:, k], sensed, sigma, unit, starts)
            if not prismatic and np.ptp(q[sensed, k]) > TURNS:
                turn = np.stack([np.cos(q[:, k]), np.sin(q[:, k])], axis=1) * sensed[:, None]
                yield Fault(SuspectKind.GEAR, joint, sensed, column * turn[:, None, :], np.ones(len(q)),
                            BEYOND * sigma, usual=ECCENTRIC)
    yield from _of_cylinders(problem, q, linearised, starts)
    yield from _distances(problem, linearised)
    yield from _sagging(problem, q, linearised)
    yield from _moves(problem, q, linearised, starts)


def _of_sensor(problem: CalibrationProblem, name: str, column: Array, reading: Array, sensed: NDArray[np.bool_],
               sigma: float, unit: str, starts: NDArray[np.intp]) -> Iterator[Fault]:
    """Another zero in a stage or from a pose on, a wrong scale, and backlash; of usual size 0.05 rad, m or 5 %."""
    labels, least = problem.poses.stage, BEYOND * sigma
    stages = list(dict.fromkeys(str(label) for label in labels[sensed]))
    for label in stages if len(stages) > 1 else ():
        there = sensed & (labels == label)
        yield Fault(SuspectKind.OFFSET, name, there, column, there.astype(float), least, where=f"in '{label}'",
                    unit=unit)
    for start in starts:
        late = sensed & (np.arange(len(sensed)) >= start)
        if min(late.sum(), (sensed & ~late).sum()) >= SHORTEST:
            yield Fault(SuspectKind.OFFSET, name, late, column, late.astype(float), least, unit=unit, there=sensed)
    centred = np.where(sensed, reading - reading[sensed].mean(), 0.0)
    yield Fault(SuspectKind.SCALE, name, sensed, column, centred, least, float(np.max(np.abs(centred))), unit=unit)
    going = _direction(reading, sensed, labels, CLEAR * sigma)
    yield Fault(SuspectKind.BACKLASH, name, sensed, column, going / 2, least, 0.5, unit=unit)


def _of_cylinders(problem: CalibrationProblem, q: Array, linearised: Linearised,
                  starts: NDArray[np.intp]) -> Iterator[Fault]:
    """Faults of length transducers; one that is not linear has a parabola, its size at the ends of its range.

    They are functions of the lengths of the solution: of the readings, whose own errors the residuals contain, in many
    samples they would explain these.
    """
    lengths = problem.layout.target + problem.rows(problem.start, q)[0]
    for i, channel in enumerate(problem.model.channels):
        sensed = problem.layout.present[:, i]
        if not channel.endswith(".length") or not np.any(sensed):
            continue
        raw = np.zeros((len(sensed), len(problem.model.channels), 1))
        raw[sensed, i] = 1.0
        column, reading = linearised.whitened(raw), lengths[:, i]
        sigma, name = float(np.median(problem.row_sigma[sensed, i])), channel.removesuffix(".length")
        yield from _of_sensor(problem, name, column, reading, sensed, sigma, "mm", starts)
        middle, half = (np.max(reading[sensed]) + np.min(reading[sensed])) / 2, np.ptp(reading[sensed]) / 2
        if half > 0:
            bow = np.where(sensed, ((reading - middle) / half) ** 2, 0.0)
            yield Fault(SuspectKind.NONLINEAR, name, sensed, column, bow, BEYOND * sigma, unit="mm")


def _sagging(problem: CalibrationProblem, q: Array, linearised: Linearised) -> Iterator[Fault]:
    """Joints that give way under gravity, where the file states masses and no compliance is estimated."""
    model = problem.model
    theta = problem.start[: len(model.parameters)]
    torque = model.over(model.gravity_torque, theta, q)[0][:, :, 0]
    for k, joint in enumerate(model.joints):
        largest = float(np.max(np.abs(torque[:, k]), initial=0.0))
        if largest > 0 and f"{joint}.compliance" not in model.parameters.positions:
            sigma = float(problem.angle_sigma[k]) or float(np.max(problem.angle_sigma))
            yield Fault(SuspectKind.SAG, joint, np.ones(len(q), bool), linearised.by_angles[:, :, [k]],
                        torque[:, k] / largest, BEYOND * sigma)


def _distances(problem: CalibrationProblem, linearised: Linearised) -> Iterator[Fault]:
    """Distances between fixtures that are not what the machine file states."""
    known, nothing = problem.distances, np.zeros((*linearised.residual.shape, 1))
    for name in dict.fromkeys(known.names):
        own = np.flatnonzero(np.array(known.names) == name)
        rows = np.zeros((len(linearised.shared), 1))
        rows[own, 0] = 1 / known.sigma[own]
        everywhere = np.ones(len(nothing), dtype=bool)
        yield Fault(SuspectKind.DISTANCE, name, everywhere, nothing, everywhere.astype(float),
                    BEYOND * float(known.sigma[own[0]]), unit="mm", shared=rows)


def _moves(problem: CalibrationProblem, q: Array, linearised: Linearised, starts: NDArray[np.intp]) -> Iterator[Fault]:
    """A fixture, the tool or the base that stands elsewhere from some pose on."""
    layout, model, order = problem.layout, problem.model, np.arange(len(q))
    least, everywhere = stated_gap(problem), np.ones(len(q), dtype=bool)
    fixtures = np.unique(layout.fixture[layout.held], axis=0)
    for columns in fixtures:
        there = np.all(layout.fixture == columns, axis=1)
        rows = np.flatnonzero(there)
        name = problem.parameters.names[columns[0]].removesuffix(".x")
        for start in np.union1d(starts, _splits(rows)):
            late = there & (order >= start)
            if min(late.sum(), (there & ~late).sum()) >= SHORTEST:
                yield Fault(SuspectKind.FIXTURE, name, late, linearised.jacobian[:, :, columns], late.astype(float),
                            least, unit="mm", there=there)
    yield from _moved_instruments(problem, linearised, starts)
    by_tip, turn = model.over(model.moved_tip, problem.start[: len(model.parameters)], q,
                              problem.places(problem.start))
    by_tip = by_tip * layout.present[:, :, None]
    tip = model.over(model.tip, problem.start[: len(model.parameters)], q)[0][:, :, 0]
    skew = np.cross(np.eye(3)[None], tip[:, None, :])  # rows e_k × tip: the tip's way by a turn about each axis
    tool = linearised.whitened(by_tip @ turn)
    base = linearised.whitened(np.concatenate([by_tip, by_tip @ skew.transpose(0, 2, 1)], axis=2))
    tracked = bool(np.any(layout.present[:, [model.channels.index(f"tip.{axis}") for axis in "xyz"]]))
    if not np.any(by_tip):
        return
    for start in starts:
        late = order >= start
        if min(late.sum(), (~late).sum()) < SHORTEST:
            continue
        yield Fault(SuspectKind.TOOL, "tip", late, tool, late.astype(float), least, unit="mm", there=everywhere)
        seen = np.unique(layout.fixture[late & layout.held], axis=0)
        # a single fixture moves against the base as the base against it
        if (tracked or len(seen) > 1) and not model.oriented:
            yield Fault(SuspectKind.BASE, "base", late, base, late.astype(float), least, unit="mm", lengths=3,
                        there=everywhere)


def _moved_instruments(problem: CalibrationProblem, linearised: Linearised,
                       starts: NDArray[np.intp]) -> Iterator[Fault]:
    """An instrument that stands elsewhere from some pose of a set-up on."""
    layout, order, places = problem.layout, np.arange(len(linearised.rank)), problem.parameters.positions
    setups = np.array([str(label) for label in problem.poses.setup])
    for instrument in problem.model.machine.instruments:
        read = [i for i, channel in enumerate(problem.model.channels) if channel.startswith(f"{instrument.name}.")]
        seen = np.any(layout.present[:, read], axis=1)
        for setup in dict.fromkeys(setups[seen].tolist()):
            there = seen & (setups == setup)
            owner = ".".join(filter(None, (instrument.name, "" if instrument.stands else setup)))
            columns = [places[name] for name in (f"{owner}.{axis}" for axis in STANDS) if name in places]
            if len(columns) < 6:
                continue  # what is stated exactly has no columns
            least = BEYOND * float(np.max(problem.row_sigma[there][:, read]))
            for start in np.union1d(starts, _splits(np.flatnonzero(there))):
                late = there & (order >= start)
                if min(late.sum(), (there & ~late).sum()) >= SHORTEST:
                    yield Fault(SuspectKind.INSTRUMENT, owner, late, linearised.jacobian[:, :, columns],
                                late.astype(float), least, unit="mm", lengths=3, there=there)


def stated_gap(problem: CalibrationProblem) -> float:
    """How far [m] stated errors let the tip miss its fixture or its tracked place."""
    reach = sum(abs(link.joint.a) + abs(link.joint.d) for link in problem.model.machine.chain)
    tip = [i for i, name in enumerate(problem.model.channels) if name.startswith(("gap.", "tip."))]
    play = float(np.max(problem.row_sigma[:, tip], initial=0.0))
    return float(np.hypot(np.max(problem.angle_sigma, initial=0.0) * reach, play))


def _starts(problem: CalibrationProblem) -> NDArray[np.intp]:
    """Poses at which something may have moved: those where a stage begins, and some between."""
    labels = problem.poses.stage
    begins = np.flatnonzero(labels[1:] != labels[:-1]) + 1
    return np.union1d(begins, _splits(np.arange(len(labels))))


def _splits(rows: NDArray[np.intp]) -> NDArray[np.intp]:
    if len(rows) < 2 * SHORTEST:
        return np.zeros(0, dtype=np.intp)
    return np.asarray(rows[np.unique(np.linspace(SHORTEST, len(rows) - SHORTEST, SPLITS).astype(int))])


def _direction(reading: Array, sensed: NDArray[np.bool_], labels: NDArray[np.str_], clear: float) -> Array:
    """Direction (N,) of the move within a stage, of more than `clear`, on which each pose was read; 0 where none is.

    >>> label, sensed = np.full(6, "log"), np.ones(6, bool)
    >>> _direction(np.array([0.0, 1.0, 0.9, 2.0, 1.9, 0.5]), sensed, label, 0.5).tolist()
    [0.0, 1.0, 1.0, 1.0, -1.0, -1.0]
    """
    found, label, last, going = np.zeros(len(reading)), "", np.intp(0), 0.0
    for k in np.flatnonzero(sensed):
        step = reading[k] - reading[last]
        if labels[k] != label:
            label, last, going = labels[k], k, 0.0
        elif step * going > 0:  # farther
            last = k
        elif abs(step) > clear:  # back from the farthest
            found[last + 1 : k] = going = np.sign(step)
            last = k
        found[k] = going
    return np.where(sensed, found, 0.0)
