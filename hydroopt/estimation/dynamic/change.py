"""Change detection between two sessions: friction, offsets and bodies that differ."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from scipy import stats
from threadpoolctl import threadpool_limits

from hydroopt.errors import ProblemError
from hydroopt.estimation.dynamic.comparison import TwoSessionProblem, Wald, solve_both, two_session_problem, wald
from hydroopt.estimation.dynamic.session_answer import Quantity, decidable, rounded, session_steps
from hydroopt.estimation.dynamic.stored_information import PREPARED, all_prepared
from hydroopt.estimation.dynamic.two_session_answer import TwoSessionAnswer
from hydroopt.input_file import similar
from hydroopt.logs.log import Log
from hydroopt.logs.smoothing import Smoothing
from hydroopt.machine.given_machine import GivenMachine, machine_of
from hydroopt.model.model import Model
from hydroopt.parameters.parameter_set import GROUPS, ParameterSet
from hydroopt.progress import Progress, silent
from hydroopt.results.diagnostic import Diagnostic, probability
from hydroopt.results.json_file import Job
from hydroopt.results.parameter_table import ParameterTable
from hydroopt.results.tables import csv_text, number, with_limits
from hydroopt.results.verdict import NextStep, Use
from hydroopt.results.wording import Kind
from hydroopt.spatial.inertia import Array

POWER = 0.95
"""Probability of detecting the smallest detectable change."""


@dataclass(frozen=True)
class Difference(Quantity):
    """How much one parameter changed from the first session to the second, in SI.

    Attributes:
        p_value: of the hypothesis that it has not changed; `p_holm` is the same, corrected for the number of
            parameters tested (Holm 1979).
        detectable: the change that would have been detected with a probability of 95 %.
        changed: whether `p_holm` is below the level.
        partners: parameters whose changes cannot be separated from this one.
    """

    p_value: float
    p_holm: float
    detectable: float
    changed: bool
    partners: tuple[str, ...] = ()

    @property
    def finding(self) -> Diagnostic:
        """The result in a sentence."""
        if not self.identifiable:
            kind = Kind.CHANGE_CONFOUNDED if self.partners else Kind.CHANGE_NOT_IDENTIFIABLE
            return Diagnostic(kind, (self.name,), {"partners": ", ".join(self.partners)} if self.partners else {})
        evidence = {"p_holm": self.p_holm, "probability": probability(self.p_holm), "unit": printed(self.unit)}
        if self.changed:
            return Diagnostic(Kind.PARAMETER_CHANGED, (self.name,), evidence | amount(self.value, self.std))
        return Diagnostic(Kind.PARAMETER_UNCHANGED, (self.name,),
                          evidence | {"detectable": float(f"{self.detectable:.2g}")})

    def as_dict(self) -> dict[str, Any]:
        """The entry of comparison.json."""
        return super().as_dict() | {
            "p_value": number(self.p_value), "p_holm": number(self.p_holm), "detectable": number(self.detectable),
            "changed": self.changed, "finding": self.finding.text}


@dataclass(frozen=True, eq=False, repr=False)
class Change(TwoSessionAnswer):
    """What changed between two sessions; `detect_change` returns it.

    Attributes:
        differences: one for each parameter that may have changed.
        level: below which a p-value is significant.
        single_changes: which parameter alone could explain the joint test.
        sampled: whether intervals were requested.

    Example:
        See `detect_change`.
    """

    differences: tuple[Difference, ...]
    level: float
    single_changes: tuple[Diagnostic, ...]
    sampled: bool
    job = Job.CHANGE
    roles = ("before", "after")

    def difference(self, name: str) -> Difference:
        """The difference of one parameter."""
        return next(one for one in self.differences if one.name == name)

    @cached_property
    def findings(self) -> tuple[Diagnostic, ...]:
        """The joint test, what explains it, and each parameter."""
        decisive = self.p_value if self.steady else self.p_value_repeat
        kind = Kind.CHANGE_DETECTED if decisive < self.level else Kind.NO_CHANGE_DETECTED
        joint = Diagnostic(kind, (), {
            "count": len(self.differences), "rank": self.rank, "degrees_of_freedom": self.degrees_of_freedom,
            "statistic": self.statistic, "p_value": self.p_value, "probability": probability(self.p_value),
            "phi": self.split_half, "p_value_over_phi": self.p_value_repeat,
            "repeat": probability(self.p_value_repeat),
            "decides": "" if self.steady else " They do, so that the latter decides."})
        return (joint, *self.single_changes, *(one.finding for one in self.differences if one.identifiable))

    @cached_property
    def diagnostics(self) -> tuple[Diagnostic, ...]:
        """What contradicts the logs, what the intervals assume, and which changes the logs do not identify."""
        return (*self.of_logs, *self.of_sampling(requested=self.sampled),
                *(one.finding for one in self.differences if not one.identifiable))

    @cached_property
    def uses(self) -> tuple[Use, ...]:
        """On which changes the sessions decide."""
        return tuple(decidable(one, one.detectable) for one in self.differences)

    @property
    def next_steps(self) -> tuple[NextStep, ...]:
        """What to check, or what to drive to see more."""
        return session_steps([one.name for one in self.differences if one.changed], self.uses)

    @cached_property
    def parameters(self) -> ParameterTable:
        """The changes by name of the parameter."""
        return ParameterTable([one.row() for one in self.differences])

    def details(self) -> Mapping[str, Any]:
        """Level, joint test, weights of both sessions, each difference, and notes."""
        return {"level": self.level, "differences": [one.as_dict() for one in self.differences], **super().details()}

    def files(self) -> Mapping[str, str]:
        """The differences as CSV."""
        return {"comparison.csv": csv_text([with_limits(one.as_dict()) for one in self.differences])}


def detect_change(machine: GivenMachine, before: Log | Sequence[Log] | str | Path,
                  after: Log | Sequence[Log] | str | Path, *, parts: Iterable[str] | None = None,
                  level: float = 0.05, smoothing: Smoothing | None = None,
                  intervals: bool = True, seed: int = 0, progress: Progress = silent) -> Change:
    """Which parameters changed between two sessions, by one least squares over both.

    All other parameters are equal in both and determined by the first session and the machine file's priors; bodies are
    physically consistent, and friction is not negative, in both sessions. Values and intervals satisfy that; the tests
    are those of least squares without such limits, whose distribution is known. Variances of
    residuals by frequency and their degrees of freedom determine the tests. Where friction already differs between the
    halves of a log by more than these explain (p < 1 %), by φ times, the tests are those of F/φ: whether the sessions
    differ by more than parts of one session do.

    Args:
        machine: nominal description, the same for both sessions.
        before: logs, or the folder that `hydroopt identify` wrote from them.
        after: logs, or such a folder.
        parts: what may have changed: ``friction``, ``offset``, parameters, or parts whose parameters all may. By
            default friction and offsets.
        level: probability of a false alarm, of the joint test and of all parameters together.
        smoothing: how angles are differentiated.
        intervals: whether to sample the posterior. Values are then its means, else its most probable point with the
            intervals of plain least squares.
        seed: of that sampling.
        progress: receives the steps, see `hydroopt.progress`.

    Raises:
        LogError: a log cannot be used.
        ProblemError: no parameter has this name, the same samples are in both sessions, or a folder cannot be used.
        IdentifiabilityError: the logs identify no change of these parameters.

    Example:
        >>> import hydroopt as ho
        >>> model = ho.Model(ho.load_machine("patu655_lift"))
        >>> motions = [ho.random_trajectory(model, duration=20, rate=50, seed=k) for k in (1, 2)]
        >>> before, after = (ho.simulate(model, motion, seed=k) for k, motion in enumerate(motions))
        >>> change = ho.detect_change(model.machine, [before], [after], intervals=False)
        >>> change.findings[0].kind
        <Kind.NO_CHANGE_DETECTED: 'no change detected'>
        >>> friction = change.difference("lift_cylinder.f_coulomb")
    """
    machine = machine_of(machine, "detect_change")
    refuse_level(level)
    model = Model(machine)
    names = usual_names(model.parameters) if parts is None else named_parts(model.parameters, parts)
    with threadpool_limits(limits=1, user_api="blas"):
        first, second = all_prepared(model, (before, after), smoothing, progress, PREPARED)
        problem = two_session_problem(model, names)
        both = problem.rows(first, second)
        progress("testing which parameters changed", PREPARED)
        test = wald(problem, *both)
        found = solve_both(problem, *both, intervals=intervals, seed=seed)
    judged = test if first.steady and second.steady else test.over((first.split_half + second.split_half) / 2)
    rows = (problem.second - np.eye(*problem.second.shape))[model.parameters.select(names)]
    value, std = rows @ found.centre, test.std
    ci = value[:, None] + np.asarray(stats.t.ppf(0.975, test.freedoms) * std)[:, None] * np.array([-1.0, 1.0])
    if found.posterior is not None:
        std, ci = found.posterior.interval(rows)
    return Change(machine, test.statistic, test.rank, test.freedom, test.p_value, first, second, found.posterior,
                  found.notes, tuple(_differences(problem, judged, value, std, ci, level)), level,
                  _single_changes(problem, judged, level), intervals)


def refuse_level(level: float) -> None:
    """Refuse a level of significance that is none.

    Raises:
        ProblemError: it is not between 0 and 1.
    """
    if not 0 < level < 1:
        raise ProblemError(f"the level of significance must be between 0 and 1, not {level:g}", where="level",
                           remedy="use one such as 0.05")


def usual_names(parameters: ParameterSet) -> tuple[str, ...]:
    """Names of what may change between sessions: friction and offsets, as far as a machine has such parameters.

    Raises:
        ProblemError: it has neither.
    """
    found = parameters.grouped(*GROUPS)
    if not found:
        raise ProblemError("the machine file states neither friction nor offsets, which could have changed",
                           where="parts", remedy="state them in the machine file, or name other parameters")
    return found


def named_parts(parameters: ParameterSet, parts: Iterable[str]) -> tuple[str, ...]:
    """Names of the parameters meant by kinds, parts and names, in the order of ψ.

    Raises:
        ProblemError: nothing is called so.
    """
    chosen: set[int] = set()
    for part in parts:
        own = parameters.matching(part)
        if not own:
            owners = dict.fromkeys(map(parameters.owner, parameters.names))
            close = similar(part, [*owners, *parameters.names])
            raise ProblemError(f"no parameter is called '{part}' or belongs to it", where="parts",
                               remedy=f"did you mean {' or '.join(close)}")
        chosen.update(own)
    return tuple(parameters.names[k] for k in sorted(chosen))


def holm(p_values: Array) -> Array:
    """p-values (c,) with Holm's correction for multiple tests (Holm 1979); NaN stay."""
    corrected = np.full(len(p_values), np.nan)
    order = [k for k in np.argsort(p_values) if np.isfinite(p_values[k])]
    least = 0.0
    for place, k in enumerate(order):
        least = max(least, min(1.0, float(p_values[k]) * (len(order) - place)))
        corrected[k] = least
    return corrected


def detectable(test: Wald, level: float) -> Array:
    """The change (c,) of each parameter that is detected with a probability of 95 %; NaN if it is not identifiable."""
    tests = max(1, int(np.sum(np.isfinite(test.std))))
    quantiles = stats.t.ppf(1 - level / 2 / tests, test.freedoms) + stats.t.ppf(POWER, test.freedoms)
    return np.asarray(quantiles * test.std)


def _differences(problem: TwoSessionProblem, test: Wald, value: Array, std: Array, ci: Array,
                 level: float) -> Iterator[Difference]:
    single, nan = test.single(), float("nan")
    corrected, least = holm(single), detectable(test, level)
    for k, name in enumerate(problem.labels):
        kind, unit = str(problem.unknowns.kind(name)), problem.unknowns.units[problem.unknowns.index(name)]
        if np.isfinite(test.std[k]):
            yield Difference(name, kind, unit, float(value[k]), float(std[k]), (float(ci[k, 0]), float(ci[k, 1])),
                             float(single[k]), float(corrected[k]), float(least[k]),
                             changed=bool(corrected[k] < level))
        else:
            yield Difference(name, kind, unit, nan, nan, (nan, nan), nan, nan, nan, changed=False,
                             partners=tuple(problem.labels[j] for j in test.partners[k]))


def _single_changes(problem: TwoSessionProblem, test: Wald, level: float) -> tuple[Diagnostic, ...]:
    """Which parameter alone explains the joint test: similar friction terms are not separable one by one."""
    if test.p_value >= level or len(problem.labels) < 2:
        return ()
    value, std, left = test.alone
    able = [k for k in np.argsort(-np.nan_to_num(left, nan=-1.0)) if left[k] >= level]
    if not able:
        return (Diagnostic(Kind.NO_SINGLE_CHANGE),)
    return tuple(Diagnostic(Kind.SINGLE_CHANGE, (problem.labels[k],), amount(float(value[k]), float(std[k])) | {
        "unit": printed(problem.unknowns.units[problem.unknowns.index(problem.labels[k])])}) for k in able[:3])


def amount(value: float, std: float) -> dict[str, Any]:
    """A change as evidence of a diagnostic."""
    return {"change": value, "std": std, "direction": "rose" if value > 0 else "fell",
            "amount": rounded(abs(value), std)}


def printed(unit: str) -> str:
    """A unit in a sentence."""
    return unit.replace("*", "·")
