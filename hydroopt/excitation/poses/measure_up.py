"""The fewest readings by hand that determine where the tip is: which one to take in which posture.

A measure-up needs no rig: prisms, tapes, a level, and datums to touch, as the machine file states them. Each reading by
hand takes minutes; joint sensors, and what is said to take none, read by themselves in every posture. A greedy search
adds the reading that lowers the tip's mean variance over the workspace most per minute; then whatever the others make
superfluous is taken away again.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Never

import numpy as np
from numpy.typing import NDArray

from hydroopt.errors import ProblemError
from hydroopt.estimation.kinematic.observability import linearise, observability
from hydroopt.excitation.poses.exchange import candidate_postures
from hydroopt.excitation.poses.measure_up_plan import MeasureUpPlan
from hydroopt.excitation.poses.posture_readings import PostureReadings, gains, tip_rows
from hydroopt.excitation.poses.problem import PoseLabels, PoseProblem, pose_problem
from hydroopt.excitation.poses.readings import DRIVE, Reading, readings
from hydroopt.limits.postures import LeftOut
from hydroopt.limits.reserves import DEFAULT, Reserves
from hydroopt.machine.machine import Machine
from hydroopt.machine.machine_file import GivenMachine, machine_of
from hydroopt.notebook_card import Shown
from hydroopt.progress import Progress, silent
from hydroopt.spatial.inertia import Array

HELPS = 1e-4
"""Relative gain of the tip's variance from which on a reading helps."""
MOST = 400
"""Readings after which the search gives up."""
POLISH = 60
"""Exchanges of readings at most."""


@dataclass(frozen=True, eq=False)
class MeasureUpProblem(Shown):
    """Which readings to take by hand so that the tip is known well enough; solving never changes it.

    Attributes:
        poses: the machine, its stages and set-ups, and the parameters that are held.
        tip: standard deviation of the tip [m] to reach, root mean square over the workspace.
        minutes: what a reading takes, by its name; the others take what `readings` states.

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
    >>> hydroopt.measure_up_problem(machine, tip=0.01)
    <MeasureUpProblem of excavator_bucket: tip to 10 mm by tip>
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

    def nlp(self) -> Never:
        """Refused.

        Raises:
            ProblemError: always: a combinatorial choice has no nonlinear program.
        """
        self.poses.nlp()

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
    >>> [each.name for each in hydroopt.measure_up_problem(machine, tip=0.01).readings if each.by_hand]
    ['tip']
    """
    machine = machine_of(machine, "measure_up_problem")
    if not (np.isfinite(tip) and tip > 0):
        raise ProblemError(f"the accuracy {tip:g} m of the tip is not positive", where="tip",
                           remedy="give a positive length")
    poses = pose_problem(machine, 1, priors=True, fixed=fixed, setups=setups, reserves=reserves)
    problem = MeasureUpProblem(poses, tip, dict(minutes or {}))
    known = {each.name: each for each in problem.readings}
    for name, spent in problem.minutes.items():
        if name not in known:
            raise ProblemError("the machine states no such reading", where=f"minutes of '{name}'",
                               remedy=f"use {', '.join(known)}")
        if not (np.isfinite(spent) and spent >= 0):
            raise ProblemError(f"{spent:g} min is not a duration", where=f"minutes of '{name}'",
                               remedy="give a number from 0 on")
    if any(group.fixture for group in poses.groups):
        raise ProblemError("a fixture holds its tip", where=f"machine '{machine.name}'",
                           remedy="plan the poses with plan-poses, or leave out the fixtures")
    if not any(each.by_hand for each in problem.readings):
        raise ProblemError("nothing is read by hand", where=f"machine '{machine.name}'",
                           remedy="state targets with an instrument, distances, datums, or cylinders' lengths, with "
                                  "their sensors")
    return problem


def fewest_readings(problem: MeasureUpProblem, *, candidates: int = 60, seed: int = 0,
                    progress: Progress = silent) -> MeasureUpPlan:
    """Choose readings: the best one per minute after another, then none that the others make superfluous.

    Args:
        problem: what may be read, and how well the tip is to be known.
        candidates: random postures of each group to choose from.
        seed: of the random postures.
        progress: receives the steps, see `hydroopt.progress`.

    Raises:
        ProblemError: no posture lies within the limits, or no choice reaches the accuracy.
    """
    groups, rng = problem.poses.groups, np.random.default_rng(seed)
    drawn, left_out = [], LeftOut()
    for k, group in enumerate(groups):
        progress(f"drawing postures for {group}", 0.2 * k / len(groups))
        found_here, out = candidate_postures(problem.poses, group, candidates, rng)
        drawn.append(found_here)
        left_out = left_out.with_more(out)
    q, labels = np.concatenate(drawn), problem.poses.labels(candidates)
    choice = _Choice(problem, q, labels)
    if choice.before <= problem.tip:
        raise ProblemError(f"the machine file states the tip to {1e3 * choice.before:.3g} mm already",
                           where=f"tip to {1e3 * problem.tip:.3g} mm", remedy="state a 'sigma' for every length, angle "
                           "and pin that may be off, or ask for more")
    found = []
    for search in (choice.forward, choice.backward):
        if search(progress):
            found.append((choice.total, choice.chosen.copy(), choice.information))
    if not found:
        raise ProblemError(
            f"all readings in {len(q)} postures leave the tip to {1e3 * np.sqrt(choice.variance()):.3g} mm",
            where=f"tip to {1e3 * problem.tip:.3g} mm", remedy="ask for less, state more accurate sensors or other "
            "readings, or fewer uncertain numbers")
    _, choice.chosen, choice.information = min(found, key=lambda each: each[0])
    choice.polish(progress)
    return choice.plan(candidates, seed, left_out)


class _Choice:
    """Readings (N, R) chosen among those of N candidate postures, and what they tell."""

    def __init__(self, problem: MeasureUpProblem, q: Array, labels: PoseLabels) -> None:
        self.problem, self.q, self.labels = problem, q, labels
        self.postures = PostureReadings(problem.poses, problem.readings, q, labels)
        self.calibration, self.there = self.postures.calibration, self.postures.there
        self.by_hand = np.array([each.by_hand for each in problem.readings])
        self.minutes = np.array([each.minutes for each in problem.readings])
        self.touching = labels.touch[:, None] == np.array([each.name for each in problem.readings])
        self.chosen = np.zeros(self.there.shape, dtype=bool)
        self.free, self.scale = self.postures.free, self.postures.scale
        self.known = self.information = self.postures.prior
        self.task = tip_rows(self.calibration)[:, self.free]
        self.before = float(np.sqrt(self.variance()))

    def variance(self, information: Array | None = None) -> float:
        """Mean variance of the tip [m²] over the workspace, by the readings chosen or by another information."""
        given = self.information if information is None else information
        return float(np.sum(self.task * np.linalg.solve(given, self.task.T).T))

    @property
    def count(self) -> int:
        """Readings by hand."""
        return int((self.chosen & self.by_hand).sum())

    @property
    def total(self) -> float:
        """Minutes of the readings chosen."""
        return float(DRIVE * self.chosen.any(axis=1).sum() + (self.chosen * self.minutes).sum())

    def forward(self, progress: Progress) -> bool:
        """From nothing, add the most useful readings per minute until the tip is known well enough; False if none does
        it."""
        self.chosen[:] = False
        self.information = self.known
        start, target = self.before**2, self.problem.tip**2
        while (now := self.variance()) > target:
            done = np.log(start / now) / max(np.log(start / target), 1e-9)
            progress(f"{self.count} readings: tip to {1e3 * np.sqrt(now):.3g} mm",
                     0.2 + 0.3 * float(np.clip(done, 0, 1)))
            if self.count >= MOST or not self.add_best(now):
                return False
        self.drop_superfluous()
        return True

    def backward(self, progress: Progress) -> bool:
        """From all readings in all postures, leave out the least useful per minute; False if all are too few."""
        self.chosen[:] = self.there
        rows = self.postures.rows_of(np.arange(len(self.q)), self.chosen).reshape(-1, len(self.free))
        self.information = self.known + rows.T @ rows
        progress("leaving out readings", 0.5)
        if self.variance() > self.problem.tip**2:
            return False
        self.drop_superfluous()
        return True

    def add_best(self, now: float) -> bool:
        """Add the reading, or the readings of a new posture, that lower the variance most per minute; False if none
        helps."""
        covariance, fresh = np.asarray(np.linalg.inv(self.information)), ~self.chosen.any(axis=1)
        best: tuple[float, int, NDArray[np.bool_], Array] | None = None
        for read, rows, spent in self._firsts:
            gain = np.where(fresh, gains(rows, covariance, self.task), 0.0) / spent
            k = int(np.argmax(gain))
            if best is None or gain[k] > best[0]:
                best = float(gain[k]), k, read[k], rows[k].T @ rows[k]
        for k, r, added, spent in self._changes(~self.chosen):
            gain_there = (now - self.variance(self.information + added)) / spent
            if best is None or gain_there > best[0]:
                best = gain_there, k, self.chosen[k] | (np.arange(len(self.by_hand)) == r), added
        if best is None or best[0] < HELPS * now:
            return False
        _, k, read_there, added = best
        self.chosen[k] |= read_there
        self.information = self.information + added
        return True

    @cached_property
    def _firsts(self) -> list[tuple[NDArray[np.bool_], Array, float]]:
        """What may be read first in each posture (N, R), one reading by hand or all, with what reads by itself; its
        whitened rows (N, u, f), and the minutes."""
        hands = np.flatnonzero(self.by_hand)
        single = [~self.by_hand | (np.arange(len(self.by_hand)) == r) for r in hands]
        made = []
        for kind in [*single, np.ones(len(self.by_hand), dtype=bool)] if len(hands) > 1 else single:
            read = self._sensible(self.there & kind, self.touching)
            made.append((read, self.postures.rows_of(np.arange(len(self.q)), read),
                         DRIVE + float((read * self.minutes).sum(axis=1).max())))
        return made

    def _changes(self, possible: NDArray[np.bool_]) -> Iterator[tuple[int, int, Array, float]]:
        """Readings by hand, among the `possible` (N, R), by which postures that are measured would differ: posture,
        reading, information that it adds to the others there, and the minutes that it takes."""
        places = np.flatnonzero(self.chosen.any(axis=1))
        if not len(places):
            return
        now = self.postures.rows_of(places, self.chosen[places])
        now = now.transpose(0, 2, 1) @ now
        for r in np.flatnonzero(self.by_hand):
            changing = self.there[places, r] & possible[places, r]
            if not changing.any():
                continue
            some, read = places[changing], self.chosen[places[changing]].copy()
            read[:, r] ^= True
            read = self._sensible(read, self.touching[some])
            other = self.postures.rows_of(some, read)
            other = other.transpose(0, 2, 1) @ other
            left = read.any(axis=1)
            spent = np.abs(read.astype(float) - self.chosen[some]) @ self.minutes + np.where(left, 0.0, DRIVE)
            for k, more, minutes in zip(some, np.where(read[:, r, None, None], 1, -1) * (other - now[changing]), spent,
                                        strict=True):
                yield int(k), int(r), more, float(minutes)

    def _sensible(self, read: NDArray[np.bool_], touching: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """Readings (K, R) without those of postures to which no one drives: where nothing is read by hand, or the
        machine would touch a datum (K, R) that is not read."""
        there = (read & self.by_hand).any(axis=1) & ~(touching & ~read).any(axis=1)
        return np.asarray(read & there[:, None])

    def drop_superfluous(self) -> None:
        """Leave out, the least useful per minute first, readings without which the tip is known well enough."""
        target = self.problem.tip**2
        while True:
            now, worth = self.variance(), []
            for k, r, less, spent in self._changes(self.chosen):
                left = self.variance(self.information - less)
                if 0 < left <= target:
                    worth.append(((left - now) / spent, k, r, less))
            if not worth:
                return
            # several at once, as long as the tip stays known well enough
            worth.sort(key=lambda each: each[0])
            some: dict[int, tuple[int, Array]] = {}
            for _, k, r, less in worth:
                some.setdefault(k, (r, less))
            several = list(some.items())[: max(1, self.count // 10)]
            while len(several) > 1 and not 0 < self.variance(
                    self.information - sum(less for _, (_, less) in several)) <= target:
                several = several[: len(several) // 2]
            for k, (r, less) in several:
                self.chosen[k, r] = False
                self.chosen[[k]] = self._sensible(self.chosen[[k]], self.touching[[k]])
                self.information = self.information - less

    def polish(self, progress: Progress) -> None:
        """Add the best reading and leave out what it makes superfluous, as long as minutes are saved."""
        for k in range(POLISH):
            progress("exchanging readings", 0.7 + 0.3 * k / POLISH)
            kept, information, before = self.chosen.copy(), self.information, self.total
            for _ in range(1 + k % 3):
                self.add_best(self.variance())
            self.drop_superfluous()
            if self.total >= before:
                self.chosen, self.information = kept, information
                if k % 3 == 2:
                    return

    def plan(self, candidates: int, seed: int, left_out: LeftOut) -> MeasureUpPlan:
        """The plan of what is chosen."""
        places = np.flatnonzero(self.chosen.any(axis=1))
        read = self.chosen[places]
        labels = PoseLabels(*(np.asarray(each)[places] for each in self.labels))
        kept = self.calibration.without(~np.isin(np.arange(len(self.q)), places))
        kept = self.postures.reading(kept, read)
        q, model = self.q[places], self.problem.poses.model
        identified = observability(kept, linearise(kept, kept.parameters.nominal, q))
        lengths = model.over(model.lengths, model.parameters.nominal, q)[0][:, :, 0]
        log_det = float(np.linalg.slogdet(self.information * np.outer(self.scale, self.scale))[1])
        return MeasureUpPlan(self.problem.poses, candidates, seed, labels, q, lengths, identified, log_det,
                             left_out, self.problem.readings, read, kept.poses, self.problem.tip,
                             float(np.sqrt(self.variance())), self.before)
