"""Which measurement to take next, and after it: the most gain per minute, one or two measurements ahead.

The gain of a measurement is by how much it lowers the sum of ln(σ / target) of all goals that are not met. Of a kind's
parts, such as postures, so many are taken that the gain per minute is about the largest.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from hashlib import sha256
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from hydroopt.errors import ProblemError
from hydroopt.excitation.criteria import gains
from hydroopt.excitation.selection.exchange import HELPS
from hydroopt.excitation.selection.goals import Goal
from hydroopt.excitation.selection.knowledge import Knowledge
from hydroopt.excitation.selection.measurements import Measurement
from hydroopt.excitation.selection.pose_problem import Postures, csv_in_print
from hydroopt.excitation.selection.what_next_problem import WhatNextProblem
from hydroopt.machine.machine import Machine
from hydroopt.results.answer import Answer
from hydroopt.results.diagnostic import Diagnostic
from hydroopt.results.json_file import FILES, Job
from hydroopt.results.parameter_table import ParameterTable, row
from hydroopt.results.tables import number
from hydroopt.results.verdict import NORMAL, Action, Claim, NextStep, Usable
from hydroopt.spatial.inertia import Array
from hydroopt.support.files import encoded
from hydroopt.support.input_file import read_text
from hydroopt.support.progress import Progress, silent

ADDITION = "addition.toml"
"""File with what the next measurement needs beside the machine file."""
LEAST = 0.001
"""Least gain per minute that a further measurement must bring, if nothing else is stated."""
PARTS = 12
"""Parts of a measurement that one step takes at most."""
PAST = 0.9
"""Parts are taken as long as they keep so much of the best gain per minute: fewer steps, hardly worse ones."""
AHEAD = 3
"""Measurements after which a second one is tried."""


@dataclass(frozen=True, eq=False)
class Step:
    """Parts of a measurement that are taken together.

    Attributes:
        measurement: of which kind.
        parts: which of its parts.
        minutes: with setting up, where that is still to be done.
        gain: by how much it lowers the `lack`.
        after: what is known then.
    """

    measurement: Measurement
    parts: tuple[int, ...]
    minutes: float
    gain: float
    after: Knowledge

    @property
    def rate(self) -> float:
        """Gain per minute."""
        return self.gain / max(self.minutes, 1e-3)

    def joined(self, later: Step) -> Step:
        """This step together with one of the same kind that follows."""
        return Step(self.measurement, (*self.parts, *later.parts), self.minutes + later.minutes,
                    self.gain + later.gain, later.after)


@dataclass(frozen=True, eq=False, repr=False)
class WhatNext(Answer):
    """Measurements to take, the next one first.

    >>> import hydroopt
    >>> plan = hydroopt.solve(hydroopt.what_next_problem("patu655_lift", targets={"force": 0.01}))
    >>> plan.described(plan.steps[0])
    'Drive motions that excite designs, and log angles and forces, 1 motion (about 12 min)'
    >>> plan.sheet().splitlines()[0], plan.stds.shape
    ('What to measure next of patu655_lift: 12 min, until all targets are met.', (2, 1))

    Attributes:
        problem: what was asked.
        steps: to take one after another; none where nothing is to be measured.
        alternatives: what each kind of measurement would gain next, the most per minute first.
        stopped: why no more steps follow, in words.
        minutes, least: that may be spent, and the gain per minute, ln(σ) a minute, below which to stop.
    """

    problem: WhatNextProblem
    steps: tuple[Step, ...]
    alternatives: tuple[Step, ...]
    stopped: str
    minutes: float
    least: float

    job = Job.NEXT

    @property
    def machine(self) -> Machine:
        """The machine that it is about."""
        return self.problem.machine

    @property
    def method(self) -> str:
        """How it was chosen."""
        return "gain per minute"

    @property
    def diagnostics(self) -> tuple[Diagnostic, ...]:
        """None."""
        return ()

    @cached_property
    def inputs(self) -> tuple[Mapping[str, Any], ...]:
        """The answers so far."""
        found = []
        for folder in self.problem.answers:
            file = folder / FILES[Job.IDENTIFICATION]
            found.append({"path": str(folder), "samples": 0, "role": "answer so far",
                          "sha256": sha256(encoded(read_text(file, ProblemError, noun="answer"))).hexdigest()})
        return tuple(found)

    @cached_property
    def known(self) -> tuple[Knowledge, ...]:
        """What is known before the steps and after each of them."""
        return (self.problem.knowledge, *(step.after for step in self.steps))

    @cached_property
    def stds(self) -> Array:
        """(1 + steps, goals) standard deviations to expect, before the steps and after each of them."""
        return np.array([[goal.std(known.covariance) for goal in self.problem.goals] for known in self.known])

    @property
    def spent(self) -> float:
        """Minutes of all steps."""
        return float(sum(step.minutes for step in self.steps))

    @cached_property
    def parameters(self) -> ParameterTable:
        """All numbers: `prior_std` by what is known so far, `std` to expect after all steps; no values."""
        problem = self.problem
        before, after = (np.sqrt(np.diag(known.covariance)) for known in (self.known[0], self.known[-1]))
        stated = {name: (each.kinds[k], each.units[k], float(each.nominal[k]))
                for each in (problem.of_poses, problem.model.parameters) for k, name in enumerate(each.names)}
        return ParameterTable([row(name, *stated[name][:2], nominal=stated[name][2], prior_std=float(before[k]),
                                   std=float(after[k])) for k, name in enumerate(self.known[0].names)])

    @property
    def claims(self) -> tuple[Claim, ...]:
        """How far each goal will be reached."""
        found = []
        for goal, std in zip(self.problem.goals, self.stds[-1].tolist(), strict=True):
            met = std <= goal.target * (1 + 1e-9)
            figure, unit, part = (None, "", NORMAL * std) if goal.unit == "1" else (NORMAL * std, goal.unit, None)
            found.append(Claim(
                goal.purpose, "" if goal.name == goal.purpose else goal.subject, Usable.YES if met else Usable.NO,
                figure, unit, part,
                f"expected 95 % interval after {self.spent:.0f} min of measurements",
                "" if met else f"σ is to be {goal.readable(goal.target)}"))
        return tuple(found)

    @property
    def headline(self) -> str:
        """The next measurement in a sentence."""
        if not self.steps:
            return f"Measure nothing more: {self.stopped}."
        gain = self._gain(1)
        return f"Next: {self.described(self.steps[0])}. {gain[:1].upper()}{gain[1:]}."

    @property
    def next_steps(self) -> tuple[NextStep, ...]:
        """The next measurement, then what to do with it."""
        if not self.steps:
            return (NextStep(Action.USE, f"Use what is known: {self.stopped}."),)
        step = self.steps[0]
        first = (NextStep(Action.USE, f"Add {ADDITION} to the machine file."),) if step.measurement.file else ()
        machine, use, then = self.problem.machine.source, step.measurement.use, step.measurement.command
        what = (NextStep(Action.DRIVE, f"{self.described(step)}.", f"hydroopt excite {machine} -o motion")
                if step.measurement.motions else NextStep(Action.MEASURE, f"{self.described(step)}."))
        if not then or not self.command_line.words:
            return (*first, what, NextStep(Action.USE, f"Then {use}, and ask what-next again with its folder."))
        again = self.command_line.again(then.rpartition(" ")[2])
        return (*first, what, NextStep(Action.USE, f"Then, {use}, and ask again:",
                                       f"{then.format(machine=machine)} && {again}"))

    def described(self, step: Step) -> str:
        """What to do in a step, and how long it takes."""
        count = len(step.parts)
        noun = "motion" if step.measurement.motions else "posture" if step.measurement.postures else ""
        times = f", {count} {noun}{'s' * (count > 1)}" if noun else ""
        return f"{step.measurement.text}{times} (about {step.minutes:.0f} min)"

    def _gain(self, k: int) -> str:
        """What the goals are before and after step k, counted from 1."""
        return ", ".join(f"{goal.name}: σ {goal.readable(before)} → {goal.readable(after)}" for goal, before, after in
                         zip(self.problem.goals, self.stds[k - 1].tolist(), self.stds[k].tolist(), strict=True))

    def details(self) -> Mapping[str, Any]:
        """Goals, steps, alternatives and the stopping rule."""
        def entry(step: Step) -> dict[str, Any]:
            return {"measurement": step.measurement.name, "parts": list(step.parts), "minutes": number(step.minutes),
                    "gain": number(step.gain), "gain_per_minute": number(step.rate),
                    "std": [number(goal.std(step.after.covariance)) for goal in self.problem.goals]}
        return {"goals": [{"name": goal.name, "unit": goal.unit, "target": number(goal.target), "std": number(before),
                           "std_after": number(after)} for goal, before, after in zip(
                               self.problem.goals, self.stds[0], self.stds[-1], strict=True)],
                "steps": [entry(step) for step in self.steps],
                "alternatives": [entry(step) for step in self.alternatives],
                "stopped": self.stopped, "most_minutes": number(self.minutes), "least_gain_per_minute": self.least,
                "seed": self.problem.seed, "reserves": self.problem.reserves._asdict(),
                "left_out": self.problem.left_out._asdict()}

    @property
    def _driven(self) -> Postures | None:
        """Those of the next measurement; None where it has none."""
        found = self.steps[0].measurement.postures if self.steps else None
        return None if found is None else found.at(self.steps[0].parts)

    def files(self) -> Mapping[str, str]:
        """The sheet, the postures of the next measurement, and the table of numbers."""
        files = {"sheet.txt": self.sheet(), "parameters.csv": self.parameters.to_csv()}
        if self._driven is not None:
            files["postures.csv"] = csv_in_print(self._driven.table)
        if self.steps and self.steps[0].measurement.file:
            files[ADDITION] = self.steps[0].measurement.file + "\n"
        return files

    def sheet(self) -> str:
        """What to do, step by step, as plain text; where postures are driven to also what people keep, and when to
        stop."""
        about = f"What to measure next of {self.machine_name}: {self.spent:.0f} min, until {self.stopped}."
        text, driven = [self.problem.left_out.sentence] if self.problem.left_out.drawn else [], self._driven
        for k, step in enumerate(self.steps, start=1):
            text += ["", f"{k}. {self.described(step)}", f"   {self._gain(k)}"]
            text += [f"   posture {at}: {place}" for at, place in enumerate(
                driven.places if driven and k == 1 else (), start=1)]
        if self.alternatives:
            text += ["", "What each kind of measurement would gain now, per minute:"]
            text += [f"  {100 * step.rate:6.2f} %  {step.measurement.name}, {len(step.parts)} in {step.minutes:.0f} min"
                     for step in self.alternatives]
        return "\n".join([about, *text]) + "\n" if driven is None else driven.watch.sheet(about, *text)


def plan_next(problem: WhatNextProblem, *, minutes: float = np.inf, least: float = LEAST, lookahead: bool = True,
              progress: Progress = silent) -> WhatNext:
    """Choose measurements one after another, each by its gain per minute together with the best one after it.

    Args:
        problem: what is known, and what for.
        minutes: that may be spent.
        least: gain per minute, as a part of σ, below which to stop.
        lookahead: whether two measurements are looked at together.
        progress: receives the steps, see `hydroopt.support.progress`.

    Raises:
        ProblemError: minutes or the least gain are no such numbers, or the problem's are wrong.
    """
    if not minutes > 0:
        raise ProblemError(f"nothing can be measured in {minutes:g} min", where="minutes",
                           remedy="give a positive number")
    if not (np.isfinite(least) and least >= 0):
        raise ProblemError(f"{least:g} is not a gain per minute", where="least gain", remedy="give a number from 0 on")
    with threadpool_limits(limits=1, user_api="blas"):
        progress("computing what each measurement tells", 0.1)
        goals, measurements, start = problem.goals, problem.measurements, problem.knowledge
        alternatives = choices(measurements, goals, start, minutes)
        steps, before = list[Step](), lack(goals, start.covariance)
        left = minutes
        for step in sequence(measurements, goals, start, minutes=minutes, least=least, lookahead=lookahead):
            joins = steps and steps[-1].measurement is step.measurement
            steps[-1:] = [steps[-1].joined(step)] if joins else [*steps[-1:], step]
            left -= step.minutes
            now = lack(goals, step.after.covariance)
            progress(f"{step.measurement.name}: {minutes - left:.0f} min" if np.isfinite(left) else
                     step.measurement.name, 0.3 + 0.7 * (1 - now / before))
        last = steps[-1].after if steps else start
        return WhatNext(problem, tuple(steps), tuple(alternatives), _stopped(goals, measurements, last, left, least),
                        minutes, least)


def _stopped(goals: Sequence[Goal], measurements: Sequence[Measurement], known: Knowledge, left: float,
             least: float) -> str:
    if lack(goals, known.covariance) == 0:
        return "all targets are met"
    if not choices(measurements, goals, known, left):
        return "no measurement is left" if not choices(measurements, goals, known) else "the minutes are spent"
    return f"no measurement lowers σ by more than {100 * least:g} % a minute"


def lack(goals: Sequence[Goal], covariance: Array) -> float:
    """Sum of ln(σ / target) over the goals that are not met."""
    return float(sum(max(np.log(goal.std(covariance) / goal.target), 0.0) for goal in goals))


def best_parts(measurement: Measurement, goals: Sequence[Goal], known: Knowledge, left: float = np.inf) -> Step | None:
    """The parts of a measurement with the most gain per minute, one by one; None where none is left or affordable.

    Args:
        measurement: of which to take some.
        goals: to reach.
        known: before it.
        left: minutes that may be spent.
    """
    spent = 0.0 if measurement.name in known.taken else measurement.set_up
    before = lack(goals, known.covariance)
    free = np.ones(len(measurement.rows), dtype=bool)
    free[list(known.taken.get(measurement.name, ()))] = False
    chosen, best, most = list[int](), None, 0.0
    for _ in range(PARTS):
        spent += measurement.minutes
        if spent > left or not free.any():
            break
        k = int(np.argmax(np.where(free, _slope(goals, known, measurement), -1.0)))
        free[k] = False
        chosen.append(k)
        known = known.after(measurement, k)
        now = lack(goals, known.covariance)
        step = Step(measurement, tuple(chosen), spent, before - now, known)
        most = max(most, step.rate)
        if best is not None and step.rate < PAST * most:
            break
        best = step
        if now == 0:
            break
    return best


def _slope(goals: Sequence[Goal], known: Knowledge, measurement: Measurement) -> Array:
    """(K,) decrease of the goals' relative variances by each part, to first order in what it changes."""
    covariance, total, own = known.covariance, np.zeros(len(measurement.rows)), measurement.own
    for goal in goals:
        if (std := goal.std(covariance)) > goal.target:
            task = goal.rows(covariance) @ known.passed_on
            total += gains(measurement.rows, known.first[np.ix_(own, own)], known.first[own] @ task.T) / std**2
    return total


def choices(measurements: Sequence[Measurement], goals: Sequence[Goal], known: Knowledge,
            left: float = np.inf) -> list[Step]:
    """What each kind of measurement would gain next, the most per minute first."""
    found = (best_parts(each, goals, known, left) for each in measurements)
    return sorted((step for step in found if step is not None), key=lambda step: -step.rate)


def next_step(measurements: Sequence[Measurement], goals: Sequence[Goal], known: Knowledge, left: float = np.inf, *,
              lookahead: bool = True) -> Step | None:
    """The step with the most gain per minute, alone or together with the best one after it; None if there is none."""
    found = choices(measurements, goals, known, left)
    if not found:
        return None
    best, rate = found[0], found[0].rate
    for step in found[:AHEAD] if lookahead and len(found) > 1 else ():
        for second in choices(measurements, goals, step.after, left - step.minutes)[:1]:
            together = (step.gain + second.gain) / (step.minutes + second.minutes)
            if together > (1 + HELPS) * rate:
                best, rate = step, together
    return best


def sequence(measurements: Sequence[Measurement], goals: Sequence[Goal], known: Knowledge, *, minutes: float = np.inf,
             least: float = 0.0, lookahead: bool = True) -> Iterator[Step]:
    """Steps until all goals are met, the minutes are spent, or none gains more than `least` per minute."""
    while lack(goals, known.covariance) > 0:
        step = next_step(measurements, goals, known, minutes, lookahead=lookahead)
        if step is None or step.rate <= least:
            return
        yield step
        known, minutes = step.after, minutes - step.minutes
