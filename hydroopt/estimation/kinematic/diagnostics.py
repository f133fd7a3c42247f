"""What a solved calibration leaves to say: residuals of every pose, errors over the workspace, and what is in doubt."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from hydroopt.errors import HydrooptError
from hydroopt.estimation.kinematic.calibration import (
    Calibration,
    fit_of,
    follow_unsensed,
    gaps,
    guess_unsensed,
    predicted,
)
from hydroopt.estimation.kinematic.observability import spread
from hydroopt.estimation.kinematic.problem import CalibrationProblem
from hydroopt.estimation.kinematic.suspects import Suspect
from hydroopt.logs.poses import Poses
from hydroopt.machine.geometry import Geometry
from hydroopt.machine.machine import BASE
from hydroopt.machine.machine_file import dump_machine, read_machine
from hydroopt.model.closed_chain import KinematicModel
from hydroopt.results.fit import Fit
from hydroopt.simulation import postures
from hydroopt.spatial.inertia import Array

CORRELATED = 0.95
"""Correlation from which on two parameters count as hardly told apart."""
LITTLE = 0.8
"""Part of the prior's standard deviation above which the data told next to nothing."""
FAR = 3.0
"""Change in standard deviations of the prior that calls for a second look."""
SAMPLES = 8000
"""Postures that stand for the workspace."""


LEAVABLE = ("stage", "stretch", "pose")
"""Kinds of suspects that are poses, which can be left out."""


class Residuals(NamedTuple):
    """What the poses of one role leave open [m] at the nominal and at the calibrated geometry: by channel (N,)."""

    role: str
    poses: Poses
    before: dict[str, Array]
    after: dict[str, Array]


class Workspace(NamedTuple):
    """Where `point` can be (K, 3) [m] and the standard deviation (K,) [m] of it; `measured` (N, 3) where it was."""

    point: str
    at: Array
    std: Array
    measured: Array


class Chain(NamedTuple):
    """The closed chain in N poses [m].

    Points from base to tip (N, k, 3), of which the `own` first links are the machine's, fixtures (N, 3), and the pins
    (N, c, 2, 3) of the cylinders with the number of the link (c, 2) that carries each, −1 for those beside the chain.
    """

    points: Array
    own: int
    fixture: Array
    pins: Array
    carrier: NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class Appraisal:
    """A calibration with all that a reader wants to know of it.

    Attributes:
        calibration: the answer.
        before: the answer with all poses, if those of its suspects were left out afterwards.
        seed: of the workspace's postures, and of the starts.
    """

    calibration: Calibration
    before: Calibration | None = None
    seed: int = 0

    @property
    def left_out(self) -> tuple[Suspect, ...]:
        """Suspects of the answer before whose poses this one does without."""
        return () if self.before is None else tuple(s for s in self.before.suspects if s.kind in LEAVABLE)

    @cached_property
    def machine_text(self) -> tuple[str, str]:
        """Text of the calibrated machine's file, or "" and why no machine can have this geometry."""
        try:
            text = dump_machine(self.calibration.machine)
            read_machine(text, where="the calibrated machine")
        except (HydrooptError, ValueError) as error:
            return "", self._in_words(error)
        return text, ""

    def _in_words(self, error: Exception) -> str:
        lines = [line.split(" [type=")[0].strip() for line in str(error).splitlines()]
        if len(lines) < 3:
            return lines[0]
        kind, number, *rest = lines[1].split(".")
        parts = getattr(self.calibration.problem.model.machine, kind, ())
        named = number.isdigit() and int(number) < len(parts)
        place = ".".join([parts[int(number)].name, *rest]) if named else lines[1]
        return f"{place}: {lines[2][0].lower()}{lines[2][1:]}."

    @cached_property
    def residuals(self) -> tuple[Residuals, ...]:
        """Of the training poses, then of those held out."""
        c, problem = self.calibration, self.calibration.problem
        nominal = follow_unsensed(problem, problem.start, guess_unsensed(problem, problem.start))
        found = [Residuals("train", problem.poses, residuals(problem, problem.start, nominal),
                           residuals(problem, c.theta, c.q))]
        if problem.validation is not None:
            found.append(Residuals("validation", problem.validation,
                                   *(residuals(*predicted(problem, theta, problem.validation))
                                     for theta in (problem.start, c.theta))))
        return tuple(found)

    @cached_property
    def suspicious(self) -> NDArray[np.bool_]:
        """(N,) training poses that do not fit."""
        return leavable(self.calibration)

    @cached_property
    def workspace(self) -> Workspace:
        """The machine's end over its joints' limits: the tip of a rigid tool, or where the calibrator's links begin."""
        c, model = self.calibration, self.calibration.problem.model
        low, high = postures.limits(model)
        q = np.random.default_rng(self.seed).uniform(low, high, (SAMPLES, len(low)))
        name, function = _end(model)
        geometry_now = c.theta[: len(model.parameters)]
        at, by_g = model.over(function, geometry_now, q)
        blur = spread(model, c.seen, by_g) * max(1.0, c.noise_scale)
        return Workspace(name, at[:, :, 0], blur, model.over(function, geometry_now, c.q)[0][:, :, 0])

    def chain(self, rows: Sequence[int]) -> Chain:
        """The chain as calibrated in some of the training poses."""
        c, model = self.calibration, self.calibration.problem.model
        q, geometry_now = c.q[list(rows)], c.theta[: len(model.parameters)]
        ends = model.over(model.far_ends, geometry_now, q)[0].transpose(0, 2, 1)
        tip = model.over(model.tip, geometry_now, q)[0].transpose(0, 2, 1)
        held = c.problem.at.fixture[list(rows), :1] >= 0
        chain = [link.name for link in model.machine.chain]
        own = sum(name in {link.name for link in model.machine.links} for name in chain)
        carrier = [[chain.index(end.link) if end.link in chain else -1 for end in (cylinder.barrel, cylinder.rod)]
                   for cylinder in model.machine.all_cylinders]
        return Chain(np.concatenate([np.zeros_like(tip), ends, tip], axis=1), own,
                     np.where(held, c.problem.fixtures(c.theta)[list(rows)], np.nan), _pins(model, q),
                     np.array(carrier, dtype=int).reshape(-1, 2))

    @cached_property
    def doubts(self) -> tuple[str, ...]:
        """Sentences, the gravest first; none if nothing is in doubt."""
        said = (*self._left_out(), *self._poses(), *self._suspects(), *self._prediction(), *self._noise(),
                *self._unseen(), *self._priors(), *self._uniqueness(), *self._held(), *self._machine())
        return tuple(dict.fromkeys(said))

    def _left_out(self) -> Iterator[str]:
        if self.left_out:
            count = len(self.before.problem.poses) - len(self.calibration.problem.poses) if self.before else 0
            yield (f"{count} poses were left out because they did not fit the others, which makes the fit look better "
                   f"than the measurement was: {_some([s.text for s in self.left_out], 3, '; ')}.")

    def _suspects(self) -> Iterator[str]:
        for kind in dict.fromkeys(s.kind for s in self.calibration.suspects):
            texts = [s.text for s in self.calibration.suspects if s.kind == kind]
            if kind == "pose" and len(texts) > 3:
                yield f"{len(texts)} single poses do not fit, the worst: {texts[0]}."
            else:
                yield from (f"{text[0].upper()}{text[1:]}." for text in texts)

    @cached_property
    def _nominal_prediction(self) -> dict[str, Fit]:
        problem = self.calibration.problem
        return {} if problem.validation is None else fit_of(*predicted(problem, problem.start, problem.validation))

    def _poses(self) -> Iterator[str]:
        problem = self.calibration.problem
        idle = ~problem.at.present.any(axis=1)
        if np.any(idle):
            yield (f"{int(idle.sum())} poses name no fixture and read nothing else, so that they were not used (data "
                   f"rows {_some([str(row) for row in problem.poses.row[idle]], 5, ', ')}).")
        held = np.column_stack([problem.at.reading, problem.at.target, problem.at.fixture])
        labels = np.unique(problem.poses.stage, return_inverse=True)[1]
        twice = len(held) - len(np.unique(np.column_stack([held, labels]), axis=0))
        if twice:
            yield (f"{twice} poses repeat others in every reading: if rows were copied, intervals are too narrow.")
        if self.calibration.method != "joint":
            yield "The link-by-link method gives no intervals: use the method 'joint' for them."

    def _prediction(self) -> Iterator[str]:
        fit = self.calibration.fit
        if "validation" not in fit:
            yield ("No pose was held out, so how well unseen poses are predicted is not known: give --validate or "
                   "--holdout-stage.")
        for channel, held_out in fit.get("validation", {}).items():
            trained = fit["train"].get(channel)
            before = self._nominal_prediction.get(channel)
            if before is not None and held_out.rms > before.rms:
                yield (f"Unseen poses fit worse after calibration than before ({channel}: "
                       f"{1e3 * held_out.rms:.3g} mm against {1e3 * before.rms:.3g} mm).")
            elif trained is not None and held_out.rms > 2 * trained.rms:
                yield (f"Unseen poses leave {held_out.rms / trained.rms:.1f} times the error of the training poses "
                       f"({channel}): the geometry is overfitted, or they lie where it was not measured.")

    def _noise(self) -> Iterator[str]:
        scale = self.calibration.noise_scale
        if not np.isfinite(scale):
            yield "There are as many equations as parameters: nothing tells how large the errors are."
        elif scale > 1.5:
            yield (f"Errors are {scale:.1f} times those stated: sensors or fixtures are worse than stated, or the "
                   "geometry moves in a way that the model lacks; intervals are widened accordingly.")
        elif scale < 0.5:
            yield (f"Errors are only {scale:.2f} times those stated: sensors or fixtures are better than stated; "
                   "intervals follow what is stated.")

    def _unseen(self) -> Iterator[str]:
        c = self.calibration
        std = dict(zip(c.seen.names, np.asarray(c.seen.std), strict=True))
        gone = self._without_poses()
        for group in self.combinations:
            yield f"The poses show only together: {_some(group)}."
        lost = [name for name in c.seen.names if not np.isfinite(std[name]) and name not in gone]
        if lost:
            yield f"Neither poses nor priors tell {_some(lost)}."
        shape = c.problem.model.parameters.positions
        pairs = {frozenset((name, other)): r for k, name in enumerate(c.seen.names)
                 for other, r in [c.seen.strongest(k)] if abs(r) > CORRELATED and (name in shape or other in shape)}
        if pairs:
            words = [f"{' and '.join(sorted(pair))} ({r:.3f})".replace("-", "−")
                     for pair, r in sorted(pairs.items(), key=lambda item: -abs(item[1]))]
            yield f"Hardly told apart by these poses (correlation): {_some(words, 5)}."

    @property
    def combinations(self) -> tuple[tuple[str, ...], ...]:
        """Groups of parameters that the poses show only together, stages aside that were left out."""
        gone = self._without_poses()
        return tuple(group for group in self.calibration.seen.combinations if not gone.issuperset(group))

    def _without_poses(self) -> set[str]:
        """Parameters of stages that were left out."""
        problem = self.calibration.problem
        there = {*range(len(problem.model.parameters)), *problem.at.fixture.ravel().tolist(),
                 *problem.at.locked[1].tolist()}
        return {name for k, name in enumerate(problem.parameters.names) if k not in there}

    def _priors(self) -> Iterator[str]:
        c, parameters = self.calibration, self.calibration.problem.parameters
        known = np.diag(parameters.information) > 0
        std, away = dict[str, float](), dict[str, float]()
        for k in np.flatnonzero(known & c.problem.free):
            name = parameters.names[k]
            std[name] = float(np.asarray(c.seen.std)[c.seen.names.index(name)]) / float(parameters.scale[k])
            away[name] = abs(float(c.theta[k] - parameters.nominal[k])) / float(parameters.scale[k])
        blank = [name for name in std if c.category(name) == "none" and c.problem.priors]
        if blank:
            yield f"Only the machine file's confidences tell {_some(blank)}."
        little = [name for name, part in std.items() if LITTLE < part < np.inf and name not in blank]
        if little:
            yield f"These poses tell hardly more than the machine file did about {_some(little)}."
        far = sorted((name for name in away if away[name] > FAR and np.isfinite(std[name])),
                     key=lambda name: -away[name])
        if far:
            yield ("Further from the machine file than its confidences allow: "
                   f"{_some([f'{name} (by {away[name]:.1f} σ)' for name in far])}.")

    def _uniqueness(self) -> Iterator[str]:
        said = self.calibration.uniqueness
        if said.startswith("not examined"):
            yield "Whether other solutions exist was not examined: give --starts."
        elif said.startswith("not unique"):
            yield f"The solution is {said}."
        elif " to worse ones" in said or " to none" in said:
            yield f"Of the starts, {said}."

    def _held(self) -> Iterator[str]:
        held = [name for name, at in zip(self.calibration.problem.parameters.names, self.calibration.at_bound,
                                         strict=True) if at]
        if held:
            yield f"Held back by a bound: {_some(held)}."

    def _machine(self) -> Iterator[str]:
        if self.machine_text[1]:
            yield f"No calibrated machine is written, since none can have this geometry: {self.machine_text[1]}"


def leavable(calibration: Calibration) -> NDArray[np.bool_]:
    """(N,) poses that do not fit the others: those that suspects of kind stage, stretch and pose name."""
    named = [s.poses for s in calibration.suspects if s.kind in LEAVABLE]
    return np.any(named, axis=0) if named else np.zeros(len(calibration.problem.poses), dtype=bool)


def residuals(problem: CalibrationProblem, theta: Array, q: Array) -> dict[str, Array]:
    """Size (N,) [m] of what every pose leaves open, by channel; NaN where a pose does not have it."""
    left, present, names = gaps(problem, theta, q), problem.at.present, problem.model.channels
    columns: dict[str, list[int]] = {}
    for i, name in enumerate(names):
        kind = name.partition(".")[0]
        columns.setdefault(kind if kind in ("gap", "tip") and not name.endswith(".distance") else name, []).append(i)
    return {name: np.where(present[:, some].all(axis=1), np.linalg.norm(left[:, some], axis=1), np.nan)
            for name, some in columns.items() if np.any(present[:, some].all(axis=1))}


def _end(model: KinematicModel) -> tuple[str, ca.Function]:
    """Name of the machine's end, and (g, q) -> its place (3,) [m] and Jacobian by g (3, p)."""
    g, q = ca.SX.sym("g", len(model.parameters)), ca.SX.sym("q", len(model.joints))
    calibrator = model.machine.calibrator
    if calibrator is None or not calibrator.links:
        name, point = "tip", model.tip(g, q)
    else:
        name = f"end of {calibrator.parent}"
        point = model.far_ends(g, q)[:, [link.name for link in model.machine.chain].index(calibrator.parent)]
    return name, ca.Function("end", [g, q], [point, ca.jacobian(point, g)])


def _pins(model: KinematicModel, q: Array) -> Array:
    """Pins (N, c, 2, 3) [m] of the cylinders in the base frame, at the nominal geometry."""
    machine, geometry = model.machine, Geometry(model.machine)
    symbols = ca.SX.sym("q", len(model.joints))
    at = {joint: symbols[k] for k, joint in enumerate(model.joints)}
    places = [geometry.seen_from(BASE, getattr(cylinder, end).link, at).point(geometry.point(f"{cylinder.name}.{end}"))
              for cylinder in machine.all_cylinders for end in ("barrel", "rod")]
    if not places:
        return np.zeros((len(q), 0, 2, 3))
    function = ca.Function("pins", [symbols], [ca.horzcat(*places)])
    values = np.asarray(function.map(len(q))(q.T))
    return values.T.reshape(len(q), len(machine.all_cylinders), 2, 3)


def _some(names: Sequence[str], most: int = 8, between: str = ", ") -> str:
    return between.join(names[:most]) + (f" and {len(names) - most} more" if len(names) > most else "")
