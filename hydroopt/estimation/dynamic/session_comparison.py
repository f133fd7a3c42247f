"""What changed over sessions: one change with its interval, how much sessions differ without any, and what would show.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from scipy import stats
from threadpoolctl import threadpool_limits

from hydroopt.errors import ProblemError
from hydroopt.estimation.dynamic.session_answer import Quantity, SessionAnswer, rounded
from hydroopt.estimation.dynamic.session_model import SIGNIFICANT, Shape, session_model
from hydroopt.estimation.dynamic.stored_information import StoredInformation, all_prepared
from hydroopt.logs.log import Log
from hydroopt.logs.smoothing import Smoothing
from hydroopt.machine.machine import Machine
from hydroopt.machine.machine_file import GivenMachine, machine_of
from hydroopt.model.model import Model
from hydroopt.parameters.parameter_set import GROUPS, ParameterSet
from hydroopt.results.diagnostic import Diagnostic, Meaning, listed, probability
from hydroopt.results.json_file import Job
from hydroopt.results.parameter_table import ParameterTable
from hydroopt.results.tables import csv_text, number, with_limits
from hydroopt.results.verdict import Action, Claim, NextStep, Purpose, Usable
from hydroopt.support.input_file import similar
from hydroopt.support.progress import Progress, silent
from hydroopt.units import in_print

METHOD = "linear mixed model"
"""Fixed effects of a step or drift, random effects of friction and offsets by session."""
DECIDED = 0.95
"""Probability above which one shape is stated as the one."""
EXPLANATIONS = 3
"""Changes of a single parameter that are written out at most, where several look alike."""


@dataclass(frozen=True)
class Difference(Quantity):
    """How one parameter changed by the likeliest step or drift, in SI.

    Its interval holds for all parameters together, and contains zero where no change is stated.

    Attributes:
        p_value: of no change of it, corrected for all parameters, shapes and sessions.
        changed: whether it is stated to have changed.
        differs: p-value that sessions differ in it by what residuals explain and this step or drift, if it is stated:
            small where it differs from session to session without any order. NaN where nothing is left to show it.
        detectable: its change alone that is detected with a probability of 95 % at each later session (N−1,); inf
            where none is.
        sessions: change since the first session (N,), and its standard deviation by residuals alone, where each has
            values of its own.
    """

    p_value: float
    changed: bool
    differs: float
    detectable: tuple[float, ...]
    sessions: tuple[tuple[float, float], ...]

    @property
    def largest_detectable(self) -> float:
        """The change detected with a probability of 95 % at each session where one is; NaN where none is."""
        return max((size for size in self.detectable if np.isfinite(size)), default=float("nan"))

    @property
    def printed(self) -> str:
        """The change with its interval."""
        ends = sorted(self.ci95 if self.value > 0 else (-end for end in self.ci95))
        low, high = (rounded(end, self.std).partition(" ")[0] for end in ends)
        size = rounded(abs(self.value), self.std).partition(" ")[0]
        unit = in_print(self.unit)
        return f"{self.name} {'rose' if self.value > 0 else 'fell'} by {size} {unit} (95 %: {low} to {high} {unit})"

    def as_dict(self) -> dict[str, Any]:
        """The entry of comparison.json."""
        return super().as_dict() | {
            "p_value": number(self.p_value), "changed": self.changed, "differs": number(self.differs),
            "detectable": [number(size) for size in self.detectable],
            "sessions": [{"change": number(change), "std": number(std)} for change, std in self.sessions]}


@dataclass(frozen=True, eq=False, repr=False)
class SessionComparison(SessionAnswer):
    """What changed over sessions of one machine; `compare` returns it.

    Attributes:
        machine: of all sessions.
        in_order: the sessions.
        p_value: of no step or drift of any parameter, corrected for all shapes.
        level: below which a p-value is significant.
        shapes: steps and drift with their probabilities among all, if there was one, the likeliest first.
        differences: one for each parameter that may have changed.
        single: changes of one parameter that alone explain what no parameter is named for, the likeliest first.
        unexplained: p-value of no change of the parameters that are not said to have changed.
        scatter: κ, how much friction and offsets differ from session to session beside the change: their RMS force
            relative to the friction force; NaN for two sessions.
        scatter_ci95: 95 % of the probability of κ.
        scatter_p_value: that sessions differ by what residuals explain and the change that is stated.
        rank: number of identifiable combinations of changes.

    Example:
        See `compare`.
    """

    machine: Machine
    in_order: tuple[StoredInformation, ...]
    p_value: float
    level: float
    shapes: tuple[tuple[Shape, float], ...]
    differences: tuple[Difference, ...]
    single: tuple[Difference, ...]
    unexplained: float
    scatter: float
    scatter_ci95: tuple[float, float]
    scatter_p_value: float
    rank: int
    job = Job.CHANGE

    @property
    def method(self) -> str:
        """A linear mixed model."""
        return METHOD

    @property
    def sessions(self) -> Mapping[str, StoredInformation]:
        """The sessions by their number."""
        return {f"session {k}": each for k, each in enumerate(self.in_order, 1)}

    @property
    def detected(self) -> bool:
        """Whether anything changed."""
        return self.p_value < self.level

    @property
    def shape(self) -> Shape:
        """The likeliest step or drift."""
        return self.shapes[0][0]

    def difference(self, name: str) -> Difference:
        """The change of one parameter."""
        return next(one for one in self.differences if one.name == name)

    @cached_property
    def findings(self) -> tuple[Diagnostic, ...]:
        """The change with its intervals, or that there is none; then how much sessions differ without any order."""
        found = [self._change()]
        if self.scatter_p_value < self.level:
            low, high = self.scatter_ci95
            most = [one.name for one in sorted(self.differences, key=lambda one: one.differs)
                    if one.differs < self.level]
            size = (f", by {100 * self.scatter:.2g} % of the friction force (95 %: {100 * low:.2g} to "
                    f"{100 * high:.2g} %)" if low > 0 else "")
            found.append(Diagnostic.of("sessions differ without any order", tuple(most), {
                "probability": probability(self.scatter_p_value), "scatter": number(self.scatter), "size": size,
                "most": f", {listed(most, 3)} most clearly" if most else "",
                "within": "" if self.steady else f" Halves of single logs differ as well (φ = {self.split_half:.2g})."},
                "Sessions differ by more than residuals explain ({probability}){size}{most}; a change must exceed "
                "that.{within}"))
        return tuple(found)

    def _change(self) -> Diagnostic:
        count = len(self.in_order)
        evidence = {"probability": probability(self.p_value), "p_value": self.p_value, "sessions": count}
        named = [one for one in self.differences if one.changed]
        if not self.detected:
            return Diagnostic.of("no change detected", (), evidence, (
                "No change over the {sessions} sessions ({probability})."))
        path = self.in_order[self.shape.session - 1].inputs[:1] if self.shape.session is not None else ()
        log = "".join(f" ({Path(str(one['path'])).name})" for one in path)
        sums = np.cumsum([share for _, share in self.shapes])
        likely = self.shapes[: int(np.searchsorted(sums, DECIDED)) + 1]
        where = f"{self.shape}{log}" if len(likely) == 1 else " or ".join(
            f"{shape} ({100 * share:.0f} %)" for shape, share in likely)
        what = [one.printed for one in named]
        if not named or self.unexplained < self.level:
            more = len(self.single) - EXPLANATIONS
            alike = [*(one.printed for one in self.single[:EXPLANATIONS]), *([f"{more} more"] if more > 0 else [])]
            open_ = (f"one alone explains it: {' or '.join(alike)}" if alike else
                     "several changed, which these logs do not separate")
            what.append(f"of the others, {open_}" if named else open_)
        return Diagnostic.of("change detected", tuple(one.name for one in named), {
            **evidence, "where": where, "what": "; ".join(what)}, "Changed by {where}: {what} ({probability}).")

    @cached_property
    def diagnostics(self) -> tuple[Diagnostic, ...]:
        """What contradicts the logs, and which changes they do not identify."""
        hidden = [one for one in self.differences if not one.identifiable]
        alike, unseen = (tuple(one.name for one in hidden if bool(np.any(np.isfinite(one.detectable))) is so)
                         for so in (True, False))
        found = list(self.of_logs)
        if alike:
            found.append(Diagnostic.of("change not separable", alike, {}, (
                "The logs cannot separate changes of {subject} from one another."),
                "Vary speed and range of the motion in every session.", Meaning.PROPERTY))
        if unseen:
            found.append(Diagnostic.of("change not identifiable", unseen, {}, (
                "The logs do not identify a change of {subject}."),
                "Drive a motion that excites it in every session.", Meaning.PROPERTY))
        return tuple(found)

    @cached_property
    def claims(self) -> tuple[Claim, ...]:
        """On which changes the sessions decide: from which size on they show one, where none is stated."""
        return tuple(_use(one) for one in self.differences)

    @property
    def next_steps(self) -> tuple[NextStep, ...]:
        """What to check, or what to drive to see more."""
        changed = [one.name for one in self.differences if one.changed]
        hidden = [claim.of for claim in self.claims if claim.usable is Usable.NO]
        steps = []
        if changed:
            steps.append(NextStep(Action.CHECK, (
                f"Check {', '.join(changed[:3])} on the machine: pins, seals, sensors' zeros.")))
        if self.detected and len(self.in_order) == 2:
            steps.append(NextStep(Action.DRIVE, (
                "Record a third session: two do not show whether friction differs as much from day to day anyway.")))
        if hidden:
            steps.append(NextStep(Action.DRIVE, (
                f"To see a change of {hidden[0]}, drive a motion that reverses and varies its speed, the same in all "
                "sessions.")))
        return tuple(steps)

    @cached_property
    def parameters(self) -> ParameterTable:
        """The changes by name of the parameter."""
        return ParameterTable([one.row() for one in self.differences])

    def details(self) -> Mapping[str, Any]:
        """Level, test of no change, what each parameter did, and the weights of each session."""
        return {"level": self.level, "differences": [one.as_dict() for one in self.differences],
                "test": {"p_value": self.p_value, "rank": self.rank, "phi": self.split_half,
                         "scatter": number(self.scatter), "scatter_p_value": number(self.scatter_p_value),
                         "scatter_ci95": [number(end) for end in self.scatter_ci95],
                         "left_over": number(self.unexplained)},
                "together": [{"shape": "drift" if shape.session is None else "step", "session": shape.session,
                              "probability": share} for shape, share in self.shapes],
                "single": [one.as_dict() for one in self.single], "weights": self.weights}

    def files(self) -> Mapping[str, str]:
        """What each parameter did, and its change since the first session in each session, as CSV."""
        lines = [{key: value for key, value in one.as_dict().items() if key not in ("detectable", "sessions")}
                 | {"detectable": number(one.largest_detectable)} for one in self.differences]
        values = [{"session": k, "name": one.name, "unit": one.unit, "change": number(change), "std": number(std)}
                  for one in self.differences for k, (change, std) in enumerate(one.sessions, 1)]
        return {"comparison.csv": csv_text([with_limits(line) for line in lines]), "sessions.csv": csv_text(values)}


def _use(one: Difference) -> Claim:
    if not one.identifiable or not np.isfinite(one.largest_detectable):
        return Claim(Purpose.CHANGE, one.name, Usable.NO, reason="the logs do not show its change by itself")
    return Claim(Purpose.CHANGE, one.name, Usable.YES, None if one.changed else one.largest_detectable, one.unit,
               condition="" if one.changed else "the change that shows with a probability of 95 %")


def compare(machine: GivenMachine, sessions: Sequence[Sequence[Log] | Log | str | Path], *,
            parts: Iterable[str] | None = None, level: float = 0.05, smoothing: Smoothing | None = None,
            seed: int = 0, progress: Progress = silent) -> SessionComparison:
    """What changed over two or more sessions in time order, by one linear mixed model (`session_model`).

    Fixed effects are a step of all parameters that may have changed, at any session, or a drift, linear in the
    session's number; all other parameters are shared. Random effects are differences of friction and offsets from
    session to session, whose variance is estimated beside each step or drift: a change must exceed it. Two sessions do
    not show that variance: their difference is held against what residuals explain, and against the scatter between the
    logs of a session that has several. Where friction already differs between the halves of a log by φ times what
    residuals explain (p < 1 %), squared differences count as 1/φ.

    `level` is the probability of a false alarm over all sessions. If anything changed, the parameters that did so
    whatever the others did are named, with intervals that hold for all parameters together; if none can be named, those
    that alone explain it. Values are those of least squares, without bounds and conditions on bodies.

    Args:
        machine: nominal description, the same for all sessions.
        sessions: in time order, each a log, several logs, or the folder that `hydroopt identify` wrote from them.
        parts: what may have changed: ``friction``, ``offset``, parameters, or parts whose parameters all may. By
            default friction and offsets.
        level: probability of a false alarm.
        smoothing: how angles are differentiated.
        seed: of the draws by which p-values are corrected.
        progress: receives the steps, see `hydroopt.support.progress`.

    Raises:
        LogError: a log cannot be used.
        ProblemError: there is one session only, no parameter has this name, the same samples are in two sessions, or a
            folder cannot be used.
        IdentifiabilityError: the logs identify no change of these parameters.

    Example:
        >>> import hydroopt as ho
        >>> model = ho.Model(ho.load_machine("patu655_lift"))
        >>> motions = [ho.random_trajectory(model, duration=20, rate=50, seed=k) for k in range(4)]
        >>> logs = [ho.simulate(model, motion, seed=k) for k, motion in enumerate(motions)]
        >>> found = ho.compare(model.machine, logs)
        >>> found.findings[0].kind, found.difference("lift_cylinder.f_coulomb").changed
        ('no change detected', False)
    """
    machine = machine_of(machine, "compare")
    if not 0 < level < 1:
        raise ProblemError(f"the level of significance must be between 0 and 1, not {level:g}", where="level",
                           remedy="use one such as 0.05")
    if len(sessions) < 2:
        raise ProblemError("one session has nothing to be compared with", where="sessions",
                           remedy="give two or more logs or directories in time order")
    model = Model(machine)
    names = usual_names(model.parameters) if parts is None else named_parts(model.parameters, parts)
    with threadpool_limits(limits=1, user_api="blas"):
        done = len(sessions) / (len(sessions) + 1)
        known = all_prepared(model, sessions, smoothing, progress, done)
        progress("testing which parameters changed", done)
        return session_comparison(model, names, known, level, seed)


def session_comparison(model: Model, names: Sequence[str], sessions: Sequence[StoredInformation], level: float,
                       seed: int = 0) -> SessionComparison:
    """What `compare` answers, from the information of the sessions."""
    found = session_model(model, names, sessions, seed=seed)
    fixed, detected = found.shapes[found.likeliest], found.p_value < level
    value, std, p_values, half = found.each
    scatter_p, differs = found.scatter(changed=detected)
    sizes, (changes, spread), rows = found.detectable(level), found.values, []
    for j, name in enumerate(names):
        k = model.parameters.index(name)
        changed = bool(detected and p_values[j] < level)
        low, high = float(value[j] - half[j]), float(value[j] + half[j])
        if not changed:  # what a stepwise test does not reject lies in its interval (Guilbaud 2008)
            low, high = min(low, 0.0 * low), max(high, 0.0 * high)
        rows.append(Difference(
            name, str(model.parameters.kinds[k]), model.parameters.units[k], float(value[j]), float(std[j]),
            (low, high), float(max(p_values[j], found.p_value)), changed, float(differs[j]),
            tuple(map(float, sizes[j])), tuple(zip(changes[j].tolist(), spread[j].tolist(), strict=True))))
    unexplained, own, left = fixed.alone([j for j, row in enumerate(rows) if row.changed])
    single = [j for j in np.argsort(-np.nan_to_num(left)) if left[j] >= level] if unexplained < level else []
    components = fixed.components
    return SessionComparison(
        model.machine, tuple(sessions), found.p_value, level, tuple(found.shares.items()), tuple(rows),
        tuple(_alone(rows[j], *(float(one[j]) for one in own)) for j in single if detected),
        unexplained, float(np.sqrt(components.variance[0])) if len(sessions) > 2 else np.nan,
        (float(components.interval[0, 0]), float(components.interval[0, 1])), scatter_p, found.rank)


def _alone(one: Difference, value: float, std: float, freedom: float) -> Difference:
    """The change of a parameter as if it were the only one, with an interval of its own."""
    half = float(stats.t.isf(SIGNIFICANT / 2, freedom)) * std
    return replace(one, value=value, std=std, ci95=(value - half, value + half))


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
