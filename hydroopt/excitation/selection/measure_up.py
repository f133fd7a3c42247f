"""The fewest readings by hand that determine where the tip is: which one to take in which posture.

A measure-up needs no rig: prisms, tapes, a level, and datums to touch, as the machine file states them. Each reading by
hand takes minutes; joint sensors, and what is said to take none, read by themselves in every posture. A greedy search
adds the reading that lowers the tip's mean variance over the workspace most per minute, until the tip is known well
enough, and leaves out what is then superfluous. Then postures are exchanged: one or two in turn are taken away, and
others are searched in their place, as long as minutes are saved.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hydroopt.errors import ProblemError
from hydroopt.estimation.inference.listing import counted
from hydroopt.estimation.kinematic.problem import CalibrationProblem
from hydroopt.excitation.criteria import gains
from hydroopt.excitation.selection.candidate_postures import random_candidates
from hydroopt.excitation.selection.exchange import HELPS, Chosen, exchanged
from hydroopt.excitation.selection.pose_plan import PosePlan
from hydroopt.excitation.selection.pose_problem import CombinatorialProblem, PoseProblem, Postures, pose_problem
from hydroopt.excitation.selection.readings import DRIVE, PostureReadings, Reading, readings, refuse_minutes, tip_rows
from hydroopt.limits.reserves import DEFAULT, Reserves
from hydroopt.limits.watch import in_print
from hydroopt.machine.machine import Machine
from hydroopt.machine.machine_file import GivenMachine, machine_of
from hydroopt.results.readable import readable
from hydroopt.results.tables import number
from hydroopt.results.verdict import NORMAL, Action, Claim, NextStep, Purpose, Usable
from hydroopt.spatial.inertia import Array
from hydroopt.support.progress import Progress, silent


@dataclass(frozen=True, eq=False)
class MeasureUpProblem(CombinatorialProblem):
    """Which readings to take by hand so that the tip is known well enough; solving never changes it.

    Attributes:
        poses: the machine, its stages and set-ups, and the parameters that are held.
        tip: standard deviation of the tip [m] to reach, root mean square over the workspace.
        minutes: what a reading takes, by its name; the others take what `readings` states.

    See `measure_up_problem`.
    """

    poses: PoseProblem
    tip: float
    minutes: Mapping[str, float] = field(default_factory=dict)

    @property
    def machine(self) -> Machine:
        """What is measured."""
        return self.poses.machine

    @cached_property
    def readings(self) -> tuple[Reading, ...]:
        """What can be read, with the minutes that it takes."""
        return tuple(replace(each, minutes=self.minutes.get(each.name, each.minutes))
                     for each in readings(self.poses.model, self.poses.channels))

    def fixing(self, **values: float) -> MeasureUpProblem:
        """The problem with parameters held, ``fixing(**{"tip.z": 0.0})`` [SI].

        Raises:
            ProblemError: there is no such parameter.
        """
        return replace(self, poses=self.poses.fixing(**values))

    def __repr__(self) -> str:
        by_hand = ", ".join(each.name for each in self.readings if each.by_hand)
        return f"<MeasureUpProblem of {self.machine.name}: tip to {1e3 * self.tip:.3g} mm by {by_hand}>"

    def __str__(self) -> str:
        return "\n".join([
            f"measure-up of {self.machine.name}: tip to {1e3 * self.tip:.3g} mm",
            "minimise the minutes of", *(f"  {each}" for each in self.readings if each.by_hand),
            f"  {DRIVE:g} min for each posture",
            "subject to", "  limits of joints and strokes", "  reserves of the machine's other limits",
            "  the tip's standard deviation, root mean square over the workspace"])


def measure_up_problem(machine: GivenMachine, tip: float, *, minutes: Mapping[str, float] | None = None,
                       fixed: Mapping[str, float] | None = None, setups: Sequence[str] = ("",),
                       reserves: Reserves = DEFAULT) -> MeasureUpProblem:
    """Which readings to take by hand for a machine's calibration.

    Args:
        machine: states what may be read (targets and instruments, distances, datums, inclinometers, cylinders'
            lengths) with sensors' accuracy, and which lengths and angles are uncertain.
        tip: standard deviation of the tip [m] to reach, root mean square over the workspace.
        minutes: what a reading takes, by its name, such as ``{"tape": 3.0}``; 0 for one that needs no hand.
        fixed: values [SI] of parameters that are held.
        setups: names of the set-ups in which instruments of unknown pose stand.
        reserves: that each posture keeps of the machine's limits.

    Raises:
        ProblemError: the machine states no reading by hand, there is no such reading, or the accuracy is no length.

    >>> import hydroopt
    >>> machine = hydroopt.read_machine('''
    ... based_on = "excavator_bucket"
    ... [tracker]
    ... [calibrator]
    ... parent = "bucket"
    ... [[links]]
    ... name = "stick"
    ... joint = { theta = { value = "0 deg", sigma = "1 deg" } }
    ... [[sensors]]
    ... channels = ["swing.q", "boom.q", "stick.q", "bucket.q"]
    ... accuracy = "0.1 deg"
    ... [[sensors]]
    ... channels = ["tip.x", "tip.y", "tip.z"]
    ... accuracy = "5 mm"
    ... ''')
    >>> problem = hydroopt.measure_up_problem(machine, tip=0.01)
    >>> problem
    <MeasureUpProblem of excavator_bucket: tip to 10 mm by tip>
    >>> plan = hydroopt.solve(problem, candidates=20)
    >>> plan.count, plan.tip <= 0.01 < plan.tip_before
    (1, True)
    """
    machine = machine_of(machine, "measure_up_problem")
    if not (np.isfinite(tip) and tip > 0):
        raise ProblemError(f"the accuracy {tip:g} m of the tip is not positive", where="tip",
                           remedy="give a positive length")
    poses = pose_problem(machine, 1, priors=True, fixed=fixed, setups=setups, reserves=reserves)
    problem = MeasureUpProblem(poses, tip, dict(minutes or {}))
    known = {each.name: each for each in problem.readings}
    refuse_minutes(problem.minutes)
    for name in problem.minutes:
        if name not in known:
            raise ProblemError("the machine states no such reading", where=f"minutes of '{name}'",
                               remedy=f"use {', '.join(known)}")
    if any(group.fixture for group in poses.groups):
        raise ProblemError("a fixture holds its tip", where=f"machine '{machine.name}'",
                           remedy="plan the poses with plan-poses, or leave out the fixtures")
    if not any(each.by_hand for each in problem.readings):
        raise ProblemError("nothing is read by hand", where=f"machine '{machine.name}'",
                           remedy="state targets with an instrument, distances, datums, or cylinders' lengths, with "
                                  "their sensors")
    return problem


@dataclass(frozen=True, eq=False, repr=False)
class MeasureUpPlan(PosePlan):
    """Readings to take by hand, posture by posture, in the order of measuring.

    Attributes:
        readings: R that the machine file offers; `taken` (N, R) which of them to take in which posture.
        target: standard deviation of the tip [m] that was asked for, `tip` the one to expect and `tip_before` that of
            the machine file, each a root mean square over the workspace.

    See `measure_up_problem`.
    """

    readings: tuple[Reading, ...]
    taken: Chosen
    target: float
    tip: float
    tip_before: float

    @cached_property
    def calibration(self) -> CalibrationProblem:
        """The calibration problem of the table that is filled in with what the nominal geometry would give."""
        there = PostureReadings(self.driven, self.readings)
        return there.reading(np.arange(len(self.q)), self.taken)

    @property
    def method(self) -> str:
        """How it was chosen."""
        return "fewest readings, per minute"

    @property
    def count(self) -> int:
        """Readings by hand."""
        return int(self.taken[:, [each.by_hand for each in self.readings]].sum())

    @property
    def minutes(self) -> float:
        """Minutes for driving and reading."""
        return float(DRIVE * len(self.q) + (self.taken * [each.minutes for each in self.readings]).sum())

    @property
    def by_themselves(self) -> tuple[str, ...]:
        """Channels that the plan counts on in every posture: joints' sensors, and readings that need no hand."""
        return (*(f"{joint}.q" for joint in self.joints if f"{joint}.q" in self.problem.channels),
                *(channel for each in self.readings if not each.by_hand for channel in each.channels))

    @property
    def claims(self) -> tuple[Claim, ...]:
        """How well the tip will be known."""
        return (Claim(Purpose.POSITION, "tip", Usable.YES, NORMAL * self.tip, "m", condition=(
            f"expected 95 % interval over the workspace after {self._effort}")),)

    @property
    def _effort(self) -> str:
        return f"{counted(self.count, 'reading')} in {counted(len(self.q), 'posture')}"

    @property
    def next_steps(self) -> tuple[NextStep, ...]:
        """Measure, and calibrate."""
        along = " and what reads by itself" if self.by_themselves else ""
        return (NextStep(Action.MEASURE, f"Take the readings of sheet.txt (about {self.minutes:.0f} min), and fill "
                                         f"them{along} into poses.csv; leave all other cells empty."),
                NextStep(Action.USE, "Then:", f"hydroopt calibrate {self.machine.source} "
                                              f"{self.command_line.path('poses.csv')} -o calibration"))

    def details(self) -> Mapping[str, Any]:
        """What was chosen, and how well the tip will be known."""
        return {**super().details(), "readings": self.count, "minutes": number(self.minutes),
                "tip_m": number(self.tip), "tip_before_m": number(self.tip_before), "target_m": number(self.target),
                "taken": [[each.name for each, there in zip(self.readings, row, strict=True) if there]
                          for row in self.taken]}

    def sheet(self) -> str:
        """The measuring sheet as plain text: where to drive, what to read there, and what to expect."""
        text = [self.left_out.sentence, self.ways]
        if self.by_themselves:
            text += [f"In every posture, record along: {', '.join(self.by_themselves)}."]
        read = [joint for joint in self.joints if f"{joint}.q" in self.problem.channels]
        printed = {joint: self._printed(joint) for joint in read}
        before = None
        for k in range(len(self.q)):
            group = self.driven.groups[k]
            if group is not before and group.named:
                text += ["", group.named]
            before = group
            places = ", ".join(f"{joint} {texts[k]} {unit}" for joint, (unit, texts) in printed.items())
            lengths = ", ".join(" ".join((cylinder.name, *in_print(length, "m"))) for cylinder, length in
                                zip(self.machine.cylinders, self.lengths[k].tolist(), strict=True))
            text += ["", f"posture {k + 1}: {places or lengths}"]
            text += [f"  read {each.name}{self._expected(each, k)}"
                     for each, there in zip(self.readings, self.taken[k], strict=True) if there and each.by_hand]
        about = (f"{self._effort} for {self.machine.name}: about {self.minutes:.0f} min. The tip is then known to "
                 f"{readable(self.tip, 'm')}, now to {readable(self.tip_before, 'm')}.")
        return self.watch.sheet(about, *text)

    def _expected(self, reading: Reading, k: int) -> str:
        """The values that the nominal geometry gives; none where the instrument's place is not known."""
        if reading.owner in self.calibration.model.instruments:
            return ""
        expected = self.calibration.poses
        return ": " + ", ".join(" ".join((channel.rpartition(".")[2], *in_print(
            float(expected.channels[channel][k]), expected.units[channel]))) for channel in reading.channels)


def fewest_readings(problem: MeasureUpProblem, *, candidates: int = 60, seed: int = 0,
                    progress: Progress = silent) -> MeasureUpPlan:
    """Choose readings: the best one per minute after another, then postures in exchange for others.

    Args:
        problem: what may be read, and how well the tip is to be known.
        candidates: random postures of each group to choose from.
        seed: of the random postures.
        progress: receives the steps, see `hydroopt.support.progress`.

    Raises:
        ProblemError: no posture lies within the limits, or no choice reaches the accuracy.
    """
    drawn, left_out = random_candidates(problem.poses, candidates, np.random.default_rng(seed), progress)
    choice = _Choice(problem, drawn)
    before, reachable = (np.sqrt(choice.worth(read)[1]) for read in (choice.nothing, choice.postures.there))
    if before <= problem.tip:
        raise ProblemError(f"the machine file states the tip to {1e3 * before:.3g} mm already",
                           where=f"tip to {1e3 * problem.tip:.3g} mm", remedy="state a 'sigma' for every length, angle "
                           "and pin that may be off, or ask for more")
    progress("choosing readings", 0.4)
    chosen = choice.reaching(choice.nothing) if reachable <= problem.tip else None
    if chosen is None:
        raise ProblemError(
            f"all readings in {len(choice.nothing)} postures leave the tip to {1e3 * reachable:.3g} mm",
            where=f"tip to {1e3 * problem.tip:.3g} mm", remedy="ask for less, state more accurate sensors or other "
            "readings, or fewer uncertain numbers")
    progress("exchanging postures until none helps", 0.5)
    chosen = choice.exchanged(chosen)
    places = np.flatnonzero(chosen.any(axis=1))
    return MeasureUpPlan(
        drawn.at(places), candidates, seed, left_out, problem.readings, chosen[places], problem.tip,
        float(np.sqrt(choice.worth(chosen)[1])), float(before))


class _Choice:
    """What may be read in N candidate postures, and what it is worth. A choice (N, R) says what is read where."""

    def __init__(self, problem: MeasureUpProblem, postures: Postures) -> None:
        self.target = problem.tip**2
        self.postures = PostureReadings(postures, problem.readings)
        self.by_hand = np.array([each.by_hand for each in problem.readings])
        self.minutes = np.array([each.minutes for each in problem.readings])
        self.touching = postures.touch[:, None] == np.array([each.name for each in problem.readings])
        self.nothing = np.zeros_like(self.postures.there)
        self.task = tip_rows(self.postures.calibration)[:, self.postures.free]

    def spent(self, read: Chosen) -> Array:
        """(K,) minutes for readings (K, R), with driving there."""
        return np.asarray(DRIVE * read.any(axis=1) + read @ self.minutes)

    def worth(self, chosen: Chosen) -> tuple[float, float]:
        """Minutes, then the variance of the tip [m²], the mean over the workspace: less is better."""
        variance = np.sum(self.task * np.linalg.solve(self.postures.information(chosen), self.task.T).T)
        return float(self.spent(chosen).sum()), float(variance)

    def changes(self, chosen: Chosen) -> tuple[NDArray[np.intp], Chosen, Array, Array]:
        """Every other choice in one posture, by one reading by hand more or less, by all or none: postures (K,),
        readings (K, R) there, minutes (K,) that are spent more, and variance [m²] (K,) of the tip that is left."""
        there, own = self.postures.there, np.diag(self.by_hand)[self.by_hand]
        made = np.array([*(chosen ^ (there & each) for each in own), there, self.nothing])
        made = (made | ~self.by_hand) & there
        # no one drives where nothing is read by hand, or the machine would touch a datum that is not read
        made &= ((made & self.by_hand).any(axis=2) & ~(self.touching & ~made).any(axis=2))[:, :, None]
        option, places = np.nonzero((made != chosen).any(axis=2))
        read, left = made[option, places], np.zeros(len(places))
        rows, information = self.postures.rows_of(places, read), self.postures.information(chosen)
        taken = np.flatnonzero(chosen.any(axis=1))
        away = zip(taken.tolist(), self.postures.rows_of(taken, chosen[taken]), strict=True)
        for some, less in ((~np.isin(places, taken), 0.0), *((places == k, each.T @ each) for k, each in away)):
            covariance = np.linalg.inv(information - less)
            across = covariance @ self.task.T
            left[some] = np.sum(self.task.T * across) - gains(rows[some], covariance, across)
        return places, read, self.spent(read) - self.spent(chosen[places]), left

    def reaching(self, chosen: Chosen, worth: tuple[float, float] = (np.inf, np.inf)) -> Chosen | None:
        """These readings and the most useful ones per minute, until the tip is known well enough, without those that
        are then superfluous; None where that is no better than a stated worth."""
        chosen, missing = chosen.copy(), True
        while True:
            spent, variance = self.worth(chosen)
            missing = missing and variance > self.target
            if missing and spent >= worth[0]:
                return None
            places, read, more, left = self.changes(chosen)
            possible = (more > 0) & (left < variance) if missing else (more < 0) & (left <= self.target)
            if not possible.any():
                return None if missing or (spent, variance) >= worth else chosen
            rate = np.where(possible, (variance - left) / np.where(possible, more, 1.0), np.inf)
            k = int(np.argmax(np.where(possible, rate, 0.0)) if missing else np.argmin(rate))
            chosen[places[k]] = read[k]

    def exchanged(self, chosen: Chosen) -> Chosen:
        """Other readings in place of those of one posture after another, then of two that follow each other, as long
        as minutes are saved, or the tip is known better in as many."""
        def few(chosen: Chosen) -> Iterator[NDArray[np.intp]]:
            places = np.flatnonzero(chosen.any(axis=1))
            yield from (*places[:, None], *np.column_stack([places, np.roll(places, -1)]))

        def refilled(chosen: Chosen, some: NDArray[np.intp]) -> Chosen | None:
            rest, (spent, variance) = chosen.copy(), self.worth(chosen)
            rest[some] = False
            return self.reaching(rest, (spent, variance * (1 - HELPS)))

        return exchanged(chosen, few, refilled)
