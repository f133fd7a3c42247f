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
from hydroopt.results.diagnostic import Diagnostic
from hydroopt.results.tables import number
from hydroopt.results.wording import Kind
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


DIAGNOSTICS = {SuspectKind.PLANE: Kind.POSES_IN_ONE_PLANE, SuspectKind.STAGE: Kind.STAGE_CONTRADICTS,
               SuspectKind.STRETCH: Kind.STRETCH_CONTRADICTS, SuspectKind.POSE: Kind.POSE_CONTRADICTS,
               SuspectKind.FIXTURE: Kind.FIXTURE_MOVED, SuspectKind.BASE: Kind.BASE_MOVED,
               SuspectKind.INSTRUMENT: Kind.INSTRUMENT_MOVED,
               SuspectKind.TOOL: Kind.TOOL_MOVED, SuspectKind.OFFSET: Kind.SENSOR_OFFSET,
               SuspectKind.SCALE: Kind.SENSOR_SCALE, SuspectKind.BACKLASH: Kind.BACKLASH,
               SuspectKind.GEAR: Kind.SENSOR_ECCENTRIC, SuspectKind.SAG: Kind.JOINT_SAGS,
               SuspectKind.NONLINEAR: Kind.SENSOR_NONLINEAR, SuspectKind.DISTANCE: Kind.DISTANCE_OFF}
"""Kind of the diagnostic of each kind of suspect."""

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
        size = "" if np.isnan(self.size) else f" by {self._shown:.3g} {self.unit}"
        match self.kind:
            case SuspectKind.OFFSET:
                return f"another zero of '{self.name}' {self.where}{size}"
            case SuspectKind.SCALE:
                return f"a wrong scale of '{self.name}' by {100 * self.size:.2f} %"
            case SuspectKind.BACKLASH:
                return f"backlash of '{self.name}'{size}"
            case SuspectKind.GEAR:
                return f"an eccentric sensor or gear of '{self.name}'{size}"
            case SuspectKind.NONLINEAR:
                return f"a nonlinear sensor of '{self.name}'{size}"
            case SuspectKind.SAG:
                return f"'{self.name}' giving way under gravity{size}"
            case SuspectKind.FIXTURE:
                return f"fixture '{self.name}' moved{size} before {self.place}"
            case SuspectKind.INSTRUMENT:
                return f"instrument '{self.name}' moved{size} before {self.place}"
            case SuspectKind.BASE:
                return f"the base moved{size} before {self.place}"
            case SuspectKind.TOOL:
                return f"the tool moved{size} before {self.place}"
            case SuspectKind.DISTANCE:
                return f"a wrong distance '{self.name}'{size}"
            case SuspectKind.LACK:
                return "an effect that the model lacks"
        return f"wrong poses at {self.place}"

    @property
    def _shown(self) -> float:
        return float(np.degrees(self.size)) if self.unit == "deg" else 1e3 * self.size

    @property
    def diagnostic(self) -> Diagnostic:
        """The finding with its words."""
        evidence: dict[str, Any] = {"place": self.place, "strength": self.strength}
        if self.rivals:
            candidates = (self, *self.rivals)
            return Diagnostic(Kind.SUSPECTS_UNDECIDED, tuple(dict.fromkeys(s.name for s in candidates if s.name)), {
                **evidence, "alternatives": "; ".join(s.phrase for s in candidates[:NAMED])
                + (f"; and {len(candidates) - NAMED} more" if len(candidates) > NAMED else ""),
                "strengths": [number(s.strength) for s in candidates]})
        match self.kind:
            case SuspectKind.SCALE:
                evidence |= {"size": self.size}
            case SuspectKind.PLANE | SuspectKind.STAGE | SuspectKind.STRETCH | SuspectKind.POSE:
                pass
            case _:
                evidence |= {"size": self._shown, "unit": self.unit, "where": self.where}
        return Diagnostic(DIAGNOSTICS[self.kind], (self.name,) if self.name else (), evidence)


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
