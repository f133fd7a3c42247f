"""What has changed since the last calibration: friction that rose, an offset that drifted, a body that grew."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from difflib import get_close_matches
from pathlib import Path

import numpy as np
from scipy import stats
from threadpoolctl import threadpool_limits

from hydroopt.errors import ProblemError
from hydroopt.estimation.dynamic.comparison import Comparison, Wald, comparison, settle, wald
from hydroopt.estimation.dynamic.stored_information import Session, refuse_repetition, session
from hydroopt.logs.log import Log
from hydroopt.logs.smoothing import Smoothing
from hydroopt.machine.machine import Machine
from hydroopt.model.model import Model
from hydroopt.parameters.parameter_set import GROUPS, ParameterSet
from hydroopt.spatial.inertia import Array

POWER = 0.95
"""Probability with which the smallest detectable change is seen."""


@dataclass(frozen=True)
class Difference:
    """How much one parameter changed from the first session to the second, in SI.

    Attributes:
        name, unit: of the parameter.
        value, std, ci95: the change; NaN where the logs do not tell it.
        p_value: of the hypothesis that it has not changed; `p_holm` is the same, corrected for the number of
            parameters asked for (Holm 1979).
        detectable: the change that would have been seen with a probability of 95 %.
        changed: whether `p_holm` is below the level.
        verdict: all that in one sentence.
    """

    name: str
    unit: str
    value: float
    std: float
    ci95: tuple[float, float]
    p_value: float
    p_holm: float
    detectable: float
    changed: bool
    verdict: str = ""


@dataclass(frozen=True, eq=False)
class Change:
    """What changed between two sessions.

    Attributes:
        machine: of both.
        differences: one for each parameter asked for.
        statistic, rank, freedom, p_value: of the joint test that none has changed: F with `rank` (directions in which
            the logs tell a change) and `freedom` degrees of freedom.
        level: below which a p-value counts as evidence.
        explanation: which parameter alone could explain what the joint test sees, in a sentence; else "".
        before, after: the sessions.
        notes: what was done, in plain words.
    """

    machine: Machine
    differences: tuple[Difference, ...]
    statistic: float
    rank: int
    freedom: float
    p_value: float
    level: float
    explanation: str
    before: Session
    after: Session
    notes: tuple[str, ...]

    def __getitem__(self, name: str) -> Difference:
        """The difference of one parameter."""
        return next(one for one in self.differences if one.name == name)

    @property
    def verdict(self) -> str:
        """The joint test in one sentence."""
        what = "Something has changed" if self.p_value < self.level else "No change is seen"
        return (f"{what}: all {len(self.differences)} parameters together, F({self.rank}, {self.freedom:.0f}) = "
                f"{self.statistic:.3g}, {probability(self.p_value)}.")

    def __str__(self) -> str:
        said = [self.verdict, *[self.explanation] * bool(self.explanation)]
        return "\n".join([*said, *(f"  {one.verdict}" for one in self.differences)])


def detect_change(machine: Machine, before: Sequence[Log] | str | Path, after: Sequence[Log] | str | Path, *,
                  parts: Iterable[str] | None = None, level: float = 0.05, smoothing: Smoothing | None = None,
                  intervals: bool = True, seed: int = 0) -> Change:
    """Which parameters changed between two sessions, by one least squares over both.

    All other parameters are the same in both and held by the first session and the machine file's priors; bodies are
    possible, and friction is not negative, in both sessions. Values and intervals heed that; the tests are those of
    least squares without such limits, whose distribution is known, and suppose that residuals which repeat
    themselves carry as much less information as their correlation time says.

    Args:
        machine: nominal description, the same for both sessions.
        before: logs, or the folder that `hydroopt identify` made of them.
        after: logs, or such a folder.
        parts: what may have changed: ``friction``, ``offset``, parameters, or parts whose parameters all may. By
            default friction and offsets.
        level: probability of a false alarm, of the joint test and of all verdicts together.
        smoothing: how angles are differentiated.
        intervals: whether to sample the posterior. Values are then its means, else its most probable point with the
            intervals of plain least squares.
        seed: of that sampling.

    Raises:
        LogError: a log cannot be used.
        ProblemError: nothing in the machine is called so, the same samples stand on both sides, or a folder is of no
            use here.
        IdentifiabilityError: the logs tell nothing of what was asked for.
    """
    if not 0 < level < 1:
        raise ProblemError(f"{level:g} is no level of significance", where="level", remedy="use one such as 0.05")
    model = Model(machine)
    names = named_parts(model.parameters, _usual(model.parameters) if parts is None else parts)
    with threadpool_limits(limits=1, user_api="blas"):
        first, second = session(model, before, smoothing), session(model, after, smoothing)
        refuse_repetition(first, second)
        problem = comparison(model, names)
        A, b = problem.rows(first, second)
        test = wald(problem, A, b, first.freedom + second.freedom)
        found = settle(problem, A, b, intervals=intervals, seed=seed)
    rows = (problem.second - np.eye(*problem.second.shape))[model.parameters.select(names)]
    value, std = rows @ found.centre, test.std
    ci = value[:, None] + stats.t.ppf(0.975, test.freedom) * std[:, None] * np.array([-1.0, 1.0])
    if found.posterior is not None:
        std, ci = found.posterior.interval(rows)
    return Change(machine, tuple(_differences(problem, test, value, std, ci, level)), test.statistic, test.rank,
                  test.freedom, test.p_value, level, _explanation(problem, test, level), first, second, found.notes)


def _usual(parameters: ParameterSet) -> list[str]:
    """The groups of kinds that a machine has parameters of."""
    found = [group for group in GROUPS if parameters.matching(group)]
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
            close = get_close_matches(part, [*owners, *parameters.names], n=3) or parameters.names[:2]
            raise ProblemError(f"no parameter is called '{part}' or belongs to it", where="parts",
                               remedy=f"did you mean {' or '.join(close)}")
        chosen.update(own)
    return tuple(parameters.names[k] for k in sorted(chosen))


def holm(p_values: Array) -> Array:
    """p-values (c,) corrected for their number so that any false one is as rare as stated (Holm 1979); NaN stay."""
    corrected = np.full(len(p_values), np.nan)
    order = [k for k in np.argsort(p_values) if np.isfinite(p_values[k])]
    least = 0.0
    for place, k in enumerate(order):
        least = max(least, min(1.0, float(p_values[k]) * (len(order) - place)))
        corrected[k] = least
    return corrected


def detectable(test: Wald, level: float) -> Array:
    """The change (c,) of each parameter that is seen with a probability of 95 %, at worst; NaN where it is not told."""
    tests = max(1, int(np.sum(np.isfinite(test.std))))
    return np.asarray((stats.t.ppf(1 - level / 2 / tests, test.freedom) + stats.t.ppf(POWER, test.freedom)) * test.std)


def _differences(problem: Comparison, test: Wald, value: Array, std: Array, ci: Array,
                 level: float) -> Iterator[Difference]:
    told, single = np.isfinite(test.std), test.single()
    corrected, none = holm(single), float("nan")
    least = detectable(test, level)
    for k, name in enumerate(problem.labels):
        unit = problem.unknowns.units[problem.unknowns.index(name)]
        if told[k]:
            one = Difference(name, unit, float(value[k]), float(std[k]), (float(ci[k, 0]), float(ci[k, 1])),
                             float(single[k]), float(corrected[k]), float(least[k]),
                             changed=bool(corrected[k] < level))
            yield replace(one, verdict=_judged(one))
        else:
            others = [problem.labels[j] for j in test.partners[k]]
            yield Difference(name, unit, none, none, (none, none), none, none, none, changed=False,
                             verdict=_untold(name, others))


def _explanation(problem: Comparison, test: Wald, level: float) -> str:
    """What the joint test sees, put down to one parameter: friction terms that look alike cannot be told one by one."""
    if test.p_value >= level or len(problem.labels) < 2:
        return ""
    value, std, left = test.alone
    able = [k for k in np.argsort(-np.nan_to_num(left, nan=-1.0)) if left[k] >= level]
    if not able:
        return "No single parameter explains it: at least two have changed, or something else has."
    said = [f"{problem.labels[k]} alone, if it {'rose' if value[k] > 0 else 'fell'} by "
            f"{rounded(abs(float(value[k])), float(std[k]))} "
            f"{problem.unknowns.units[problem.unknowns.index(problem.labels[k])].replace('*', '·')}" for k in able[:3]]
    return f"It could be {', or '.join(said)}."


def _judged(one: Difference) -> str:
    unit = one.unit.replace("*", "·")
    if one.changed:
        return (f"{one.name} {'rose' if one.value > 0 else 'fell'} by {rounded(abs(one.value), one.std)} {unit} "
                f"({probability(one.p_holm)}).")
    return (f"{one.name}: no change seen ({probability(one.p_holm)}); a change above "
            f"{float(f'{one.detectable:.2g}'):g} {unit} would have been.")


def _untold(name: str, others: Sequence[str]) -> str:
    if not others:
        return f"{name}: these logs tell nothing of it."
    return f"{name}: these logs cannot tell a change of it from one of {', '.join(others)}."


def rounded(value: float, std: float) -> str:
    """Value ± std to two digits of the latter."""
    place = 1 - int(np.floor(np.log10(std))) if std > 0 else 6
    return f"{round(value, place) + 0.0:.{max(0, place)}f} ± {round(std, place):.{max(0, place)}f}"


def probability(p: float) -> str:
    """A p-value in words."""
    return "p < 1e-6" if p < 1e-6 else f"p = {p:.2g}"
