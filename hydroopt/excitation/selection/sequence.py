"""Which measurement to take next, and after it: the most gain per minute, one or two measurements ahead.

The gain of a measurement is by how much it lowers the sum of ln(σ / target) of all goals that are not met. Of a kind's
parts, such as postures, so many are taken that the gain per minute is about the largest.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from hydroopt.excitation.criteria import gains
from hydroopt.excitation.selection.goals import Goal
from hydroopt.excitation.selection.knowledge import Knowledge
from hydroopt.excitation.selection.measurements import Measurement
from hydroopt.spatial.inertia import Array

PARTS = 12
"""Parts of a measurement that one step takes at most."""
PAST = 0.9
"""Parts are taken as long as they keep so much of the best gain per minute: fewer steps, hardly worse ones."""
AHEAD = 3
"""Measurements after which a second one is tried."""
BETTER = 1.0001
"""How much more gain per minute two measurements must have than the best one alone."""


def lack(goals: Sequence[Goal], covariance: Array) -> float:
    """Sum of ln(σ / target) over the goals that are not met."""
    return float(sum(max(np.log(goal.std(covariance) / goal.target), 0.0) for goal in goals))


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
            if together > BETTER * rate:
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
