"""Several sessions in time order: which parameters agree over all, drifted, or changed at which session."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from scipy import stats
from threadpoolctl import threadpool_limits

from hydroopt.errors import ProblemError
from hydroopt.estimation.dynamic.change import amount, holm, named_parts, printed, refuse_level, usual_names
from hydroopt.estimation.dynamic.change_space import ChangeSpace, Shape, SubspaceTest
from hydroopt.estimation.dynamic.session_answer import Quantity, SessionAnswer, decidable, session_steps
from hydroopt.estimation.dynamic.session_scan import SessionScan, session_scan
from hydroopt.estimation.dynamic.stored_information import (
    StoredInformation,
    all_prepared,
)
from hydroopt.logs.log import Log
from hydroopt.logs.smoothing import Smoothing
from hydroopt.machine.given_machine import GivenMachine, machine_of
from hydroopt.machine.machine import Machine
from hydroopt.model.model import Model
from hydroopt.progress import Progress, silent
from hydroopt.results.diagnostic import Diagnostic, probability
from hydroopt.results.json_file import Job
from hydroopt.results.parameter_table import ParameterTable
from hydroopt.results.tables import csv_text, number, with_limits
from hydroopt.results.verdict import NextStep, Use
from hydroopt.results.wording import Kind
from hydroopt.spatial.inertia import Array

DECIDED = 0.95
"""Probability above which one explanation among those that are not refuted is stated as the one."""
EXPLANATIONS = 3
"""Changes of a single parameter that are named at most."""


class Course(StrEnum):
    """What a parameter did over the sessions; not visible if no change up to its assumed size would have been detected.
    """

    AGREES = "agrees"
    STEP = "step"
    DRIFT = "drift"
    VARIES = "varies"
    SCATTERS = "scatters"
    UNDECIDED = "undecided"
    NOT_VISIBLE = "not visible"
    NOT_IDENTIFIABLE = "not identifiable"


@dataclass(frozen=True)
class SessionValue:
    """A parameter's change since the first session, in SI; NaN where it is not identifiable."""

    change: float
    std: float
    ci95: tuple[float, float]

    def as_dict(self) -> dict[str, Any]:
        """The entry of comparison.json."""
        return {"change": number(self.change), "std": number(self.std),
                "ci95": list(self.ci95) if np.all(np.isfinite(self.ci95)) else None}


@dataclass(frozen=True)
class Alternative:
    """A shape that the sessions do not refute, and its probability among all shapes."""

    shape: Shape
    share: float

    def as_dict(self) -> dict[str, Any]:
        """The entry of comparison.json."""
        return {"shape": "drift" if self.shape.session is None else "step", "session": self.shape.session,
                "probability": self.share}


@dataclass(frozen=True)
class ParameterHistory(Quantity):
    """What one parameter did over the sessions.

    Its value is the change by its step or drift, otherwise from the first session to the last.

    Attributes:
        course: what it did.
        session: the first with the new value, counted from 1; None where there is no step.
        p_value: of no step or drift, corrected for all parameters, sessions and shapes.
        detectable: the step that would have been detected with a probability of 95 % at each later session (N−1,); inf
            where none is.
        alternatives: steps and drift that the sessions do not refute, the likeliest first.
        values: change since the first session (N,), whatever the other parameters do.
        size: assumed size of the parameter.
        partners: parameters whose changes cannot be separated from this one.
        log: a log of that session.
    """

    course: Course
    session: int | None
    p_value: float
    detectable: tuple[float, ...]
    alternatives: tuple[Alternative, ...]
    values: tuple[SessionValue, ...]
    size: float
    partners: tuple[str, ...] = ()
    log: str = ""

    @property
    def identifiable(self) -> bool:
        """Whether the logs determine a change at any session."""
        return self.course is not Course.NOT_IDENTIFIABLE

    @property
    def changed(self) -> bool:
        """Whether it changed at all."""
        return self.course in (Course.STEP, Course.DRIFT, Course.VARIES, Course.UNDECIDED)

    @property
    def largest_detectable(self) -> float:
        """The step detected with a probability of 95 % at each session where there is one; NaN where there is none."""
        return max((size for size in self.detectable if np.isfinite(size)), default=float("nan"))

    @property
    def finding(self) -> Diagnostic:
        """The result in a sentence."""
        subject, evidence = (self.name,), {"p_value": self.p_value, "probability": probability(self.p_value),
                                           "unit": printed(self.unit)}
        if self.course is Course.NOT_IDENTIFIABLE:
            kind = Kind.CHANGE_CONFOUNDED if self.partners else Kind.CHANGE_NOT_IDENTIFIABLE
            return Diagnostic(kind, subject, {"partners": ", ".join(self.partners)} if self.partners else {})
        if self.course is Course.STEP:
            return Diagnostic(Kind.PARAMETER_STEPPED, subject, evidence | amount(self.value, self.std) | {
                "session": self.session, "log": f" ({self.log})" if self.log else ""})
        if self.course is Course.DRIFT:
            return Diagnostic(Kind.PARAMETER_DRIFTED, subject, evidence | amount(self.value, self.std))
        if self.course is Course.VARIES:
            return Diagnostic(Kind.PARAMETER_VARIES, subject, evidence)
        if self.course is Course.UNDECIDED:
            return Diagnostic(Kind.PARAMETER_UNDECIDED, subject, evidence | {"alternatives": " or ".join(
                f"{one.shape} ({100 * one.share:.0f} %)" for one in likeliest(self.alternatives))})
        blind = [str(k) for k, size in enumerate(self.detectable, 2) if not np.isfinite(size)]
        kind = {Course.AGREES: Kind.PARAMETER_AGREES, Course.SCATTERS: Kind.PARAMETER_SCATTERS}.get(
            self.course, Kind.PARAMETER_NOT_VISIBLE)
        return Diagnostic(kind, subject, evidence | {
            "detectable": float(f"{self.largest_detectable:.2g}"), "size": float(f"{self.size:.2g}"),
            "where": f"any session but {', '.join(blind)}" if blind else "any session"})

    def as_dict(self) -> dict[str, Any]:
        """The entry of comparison.json."""
        return super().as_dict() | {
            "course": str(self.course), "session": self.session, "p_value": number(self.p_value),
            "detectable": [number(size) for size in self.detectable],
            "alternatives": [one.as_dict() for one in self.alternatives],
            "sessions": [one.as_dict() for one in self.values], "finding": self.finding.text}


@dataclass(frozen=True, eq=False, repr=False)
class ChangeHistory(SessionAnswer):
    """What changed over several sessions; `detect_changes` returns it.

    Attributes:
        machine: of all sessions.
        in_order: the sessions.
        p_value: of no step or drift of any parameter, corrected for all tests.
        scatter: κ, how much friction and offsets differ from session to session without any order: their RMS force
            relative to the friction force.
        scatter_p_value: of no such differences.
        tests: number of tests.
        rank: number of identifiable combinations of changes.
        level: below which a p-value is significant.
        histories: one for each parameter that may have changed.
        together: shapes that all parameters together may have followed, the likeliest first; empty if nothing changed.
        single: changes of one parameter that alone explain what no named change does, the likeliest first.
        left_over: p-value of no change of the parameters that are not said to have changed.

    Example:
        See `detect_changes`.
    """

    machine: Machine
    in_order: tuple[StoredInformation, ...]
    p_value: float
    scatter: float
    scatter_p_value: float
    tests: int
    rank: int
    level: float
    histories: tuple[ParameterHistory, ...]
    together: tuple[Alternative, ...]
    single: tuple[ParameterHistory, ...]
    left_over: float
    job = Job.CHANGE_HISTORY

    @property
    def method(self) -> str:
        """One least squares over all sessions, with a scan for changes."""
        return METHOD

    @property
    def sessions(self) -> Mapping[str, StoredInformation]:
        """The sessions by their number."""
        return {f"session {k}": each for k, each in enumerate(self.in_order, 1)}

    @property
    def detected(self) -> bool:
        """Whether anything changed."""
        return self.p_value < self.level

    def history(self, name: str) -> ParameterHistory:
        """What one parameter did."""
        return next(one for one in self.histories if one.name == name)

    @cached_property
    def findings(self) -> tuple[Diagnostic, ...]:
        """Whether the sessions agree, what all parameters together did, and each of them."""
        whole = Diagnostic(Kind.SESSIONS_DIFFER if self.detected else Kind.SESSIONS_AGREE, (), {
            "count": len(self.histories), "sessions": len(self.in_order), "tests": self.tests,
            "p_value": self.p_value, "probability": probability(self.p_value)})
        scatter = Diagnostic(Kind.SESSIONS_SCATTER, (), {
            "scatter": self.scatter, "p_value": self.scatter_p_value,
            "probability": probability(self.scatter_p_value)})
        return (whole, *((scatter,) if self.scatter_p_value < self.level else ()),
                *(self._explained() if self.detected else ()),
                *(one.finding for one in self.histories if one.identifiable))

    def _explained(self) -> Sequence[Diagnostic]:
        shapes = " or ".join(f"{one.shape} ({100 * one.share:.0f} %)" for one in likeliest(self.together))
        course = (Diagnostic(Kind.CHANGED_TOGETHER, (), {"shapes": shapes}) if shapes
                  else Diagnostic(Kind.VARY_TOGETHER))
        named = any(one.changed for one in self.histories)
        if named and self.left_over >= self.level:
            return (course,)
        more = Diagnostic(Kind.MORE_CHANGED, (), {"p_value": self.left_over,
                                                  "probability": probability(self.left_over)})
        return (course, *((more,) if named else ()), *(Diagnostic(
            Kind.SINGLE_COURSE, (one.name,), amount(one.value, one.std) | {
                "unit": printed(one.unit), "shape": str(one.alternatives[0].shape), "share": one.alternatives[0].share,
                "what": "the rest" if named else "it"})
            for one in self.single), *(() if self.single else (Diagnostic(Kind.NO_SINGLE_CHANGE),)))

    @cached_property
    def diagnostics(self) -> tuple[Diagnostic, ...]:
        """What contradicts the logs, and which changes they do not identify."""
        return (*self.of_logs, *(one.finding for one in self.histories if not one.identifiable))

    @cached_property
    def uses(self) -> tuple[Use, ...]:
        """On which changes the sessions decide."""
        return tuple(decidable(one, one.largest_detectable) for one in self.histories)

    @property
    def next_steps(self) -> tuple[NextStep, ...]:
        """What to check, or what to drive to see more."""
        return session_steps([one.name for one in self.histories if one.changed], self.uses)

    @cached_property
    def parameters(self) -> ParameterTable:
        """The changes by name of the parameter."""
        return ParameterTable([one.row() for one in self.histories])

    def details(self) -> Mapping[str, Any]:
        """Level, joint test, what each parameter did, and the weights of each session."""
        return {"level": self.level, "histories": [one.as_dict() for one in self.histories],
                "test": {"p_value": self.p_value, "tests": self.tests, "rank": self.rank, "scatter": self.scatter,
                         "scatter_p_value": self.scatter_p_value, "phi": self.split_half,
                         "left_over": number(self.left_over)},
                "together": [one.as_dict() for one in self.together],
                "single": [one.as_dict() for one in self.single], "weights": self.weights}

    def files(self) -> Mapping[str, str]:
        """What each parameter did, and its change since the first session in each session, as CSV."""
        lines = [{key: value for key, value in one.as_dict().items()
                  if key not in ("detectable", "alternatives", "sessions")}
                 | {"detectable": number(one.largest_detectable)} for one in self.histories]
        values = [{"session": k, "name": one.name, "unit": one.unit} | value.as_dict()
                  for one in self.histories for k, value in enumerate(one.values, 1)]
        return {"comparison.csv": csv_text([with_limits(line) for line in lines]),
                "sessions.csv": csv_text([with_limits(value) for value in values])}


METHOD = "scan over sessions"
"""One least squares over all sessions, and tests of steps at each session and drifts."""


def detect_changes(machine: GivenMachine, sessions: Sequence[Sequence[Log] | Log | str | Path], *,
                   parts: Iterable[str] | None = None, level: float = 0.05, smoothing: Smoothing | None = None,
                   seed: int = 0, progress: Progress = silent) -> ChangeHistory:
    """Which parameters agree over several sessions in time order, drifted, or changed at which session.

    One least squares over all sessions, in which parameters that may not have changed are shared. Tested are a step
    at each session and a linear drift (in the session's number): of all parameters together, and of each by itself,
    whatever the others do. `level` is the probability that any of these raises an alarm where nothing changed, and that
    any parameter is named that did not change: the distribution of the smallest of all p-values is drawn, and names
    follow Holm's steps. A step or drift is refuted where values of each session's own explain significantly more. The
    likeliest, if it is not refuted, is stated if it has 95 % of all likelihood; otherwise the alternatives are named.

    Measured again, friction and offsets differ by more than residuals explain, without any order. Steps and drifts are
    held against this scatter, which is estimated from the sessions themselves (`session_scatter`), beside variances
    of residuals by frequency and their degrees of freedom. Where friction already differs between the halves of a log
    by φ times what these explain (p < 1 %), squared differences count as 1/φ. Scatter raises no alarm; it is stated
    where it is significant. Values are those of least squares, without bounds and conditions on bodies.

    Args:
        machine: nominal description, the same for all sessions.
        sessions: at least three in time order, each a log, several logs, or the folder that `hydroopt identify` wrote
            from them.
        parts: what may have changed: ``friction``, ``offset``, parameters, or parts whose parameters all may. By
            default friction and offsets.
        level: probability of a false alarm, over all parameters and sessions.
        smoothing: how angles are differentiated.
        seed: of the draws.
        progress: receives the steps, see `hydroopt.progress`.

    Raises:
        LogError: a log cannot be used.
        ProblemError: there are fewer than three sessions, no parameter has this name, the same samples are in two
            sessions, or a folder cannot be used.
        IdentifiabilityError: the logs identify no change of these parameters.

    Example:
        >>> import hydroopt as ho
        >>> model = ho.Model(ho.load_machine("patu655_lift"))
        >>> motions = [ho.random_trajectory(model, duration=20, rate=50, seed=k) for k in range(4)]
        >>> logs = [ho.simulate(model, motion, seed=k) for k, motion in enumerate(motions)]
        >>> history = ho.detect_changes(model.machine, logs)
        >>> history.findings[0].kind, str(history.history("lift_cylinder.f_coulomb").course)
        (<Kind.SESSIONS_AGREE: 'sessions agree'>, 'agrees')
    """
    machine = machine_of(machine, "detect_changes")
    refuse_level(level)
    if len(sessions) < 3:
        raise ProblemError(f"changes over sessions need at least three, not {len(sessions)}", where="sessions",
                           remedy="give more, or compare two by `detect_change`")
    model = Model(machine)
    names = usual_names(model.parameters) if parts is None else named_parts(model.parameters, parts)
    with threadpool_limits(limits=1, user_api="blas"):
        done = len(sessions) / (len(sessions) + 1)
        known = all_prepared(model, sessions, smoothing, progress, done)
        progress("testing which parameters changed", done)
        return change_history(model, names, known, level, seed)


def change_history(model: Model, names: Sequence[str], sessions: Sequence[StoredInformation], level: float,
                   seed: int = 0, progress: Progress = silent) -> ChangeHistory:
    """What `detect_changes` answers, from the information of the sessions."""
    scan = session_scan(model, names, sessions, seed=seed)
    detected, best = scan.p_value < level, scan.likeliest
    space = scan.space(best)
    together = ({} if not detected else
                space.explanations({shape: space.together(shape) for shape in scan.together}, space.whole, level))
    named_steps, steps = scan.detectable(level)
    residual = scan.residual
    disorder = (residual.left_over(residual.together(best)) if detected else residual.whole).p_value
    own = holm(np.array([residual.own(j).p_value if scan.separate[j] else np.nan for j in range(len(names))]))
    histories = tuple(_history(model, scan, j, sessions, level, named_steps[j] if detected else steps[j],
                               max(disorder, own[j])) for j in range(len(names)))
    named = space.all_of([j for j, one in enumerate(histories) if one.changed])
    rest = space.left_over(named)
    return ChangeHistory(
        model.machine, tuple(sessions), scan.p_value, float(np.sqrt(scan.variance(best))), disorder, scan.tests,
        scan.rank, level, histories, tuple(Alternative(*one) for one in together.items()),
        tuple(_single(model, scan, sessions, level, named, rest, steps)) if detected and rest.p_value < level else (),
        rest.p_value)


def likeliest(alternatives: Sequence[Alternative]) -> tuple[Alternative, ...]:
    """The fewest alternatives that together have a probability of 95 %."""
    sums = np.cumsum([one.share for one in alternatives])
    return tuple(alternatives[: int(np.searchsorted(sums, DECIDED)) + 1])


def _history(model: Model, scan: SessionScan, j: int, sessions: Sequence[StoredInformation], level: float,
             steps: Array, disorder: float) -> ParameterHistory:
    name, space = scan.names[j], scan.space_of(j)
    values = _values(space, j)
    if not scan.separate[j]:
        partners = tuple(scan.names[i] for i in scan.partners[j])
        nothing = _value(np.nan, np.nan, np.nan)
        return _made(model, name, values, nothing, Course.NOT_IDENTIFIABLE, None, np.nan, steps, (), partners)
    p_value = float(scan.p_values[j])
    if not (scan.p_value < level and p_value < level):
        course = Course.SCATTERS if disorder < level else Course.AGREES
        return _made(model, name, values, values[-1], course, None, p_value, steps, ())
    shapes = space.separate(j)
    kept = tuple(Alternative(*one) for one in space.explanations(shapes, space.own(j), level).items())
    if not kept:
        return _made(model, name, values, values[-1], Course.VARIES, None, p_value, steps, ())
    if kept[0].share < DECIDED:
        return _made(model, name, values, values[-1], Course.UNDECIDED, None, p_value, steps, kept)
    shape = kept[0].shape
    course = Course.DRIFT if shape.session is None else Course.STEP
    value = _value(*space.size(j, shape, shapes[shape]))
    return _made(model, name, values, value, course, shape.session, p_value, steps, kept, log=_log(sessions, shape))


def _single(model: Model, scan: SessionScan, sessions: Sequence[StoredInformation],
            level: float, named: Array, rest: SubspaceTest, steps: Array) -> Iterable[ParameterHistory]:
    """The changes of one more parameter that leave nothing significant of the rest, the likeliest first."""
    space = scan.space(scan.likeliest)
    tests: dict[tuple[int, Shape], SubspaceTest] = {
        (j, shape): test for j in range(len(scan.names)) for shape in space.shapes
        if (test := space.alone(j, shape, named)) is not None}
    for (j, shape), share in list(space.explanations(tests, rest, level).items())[:EXPLANATIONS]:
        course = Course.DRIFT if shape.session is None else Course.STEP
        value = _value(*space.size(j, shape, tests[j, shape]))
        yield _made(model, scan.names[j], _values(space, j, named), value, course, shape.session,
                    scan.p_value, steps[j], (Alternative(shape, share),),
                    log=_log(sessions, shape))


def _made(model: Model, name: str, values: tuple[SessionValue, ...], value: SessionValue, course: Course,
          session: int | None, p_value: float, sizes: Iterable[float], kept: tuple[Alternative, ...],
          partners: tuple[str, ...] = (), log: str = "") -> ParameterHistory:
    kind, unit = model.parameters.kind(name), model.parameters.units[model.parameters.index(name)]
    size, steps = float(model.parameters.scale[model.parameters.index(name)]), tuple(map(float, sizes))
    if course is Course.AGREES and min(steps) > size:
        course = Course.NOT_VISIBLE
    return ParameterHistory(name, str(kind), unit, value.change, value.std, value.ci95, course, session, p_value, steps,
                            kept, values, size, partners, log)


def _values(space: ChangeSpace, j: int, given: Array | None = None) -> tuple[SessionValue, ...]:
    return tuple(_value(*one) for one in zip(*space.values(j, given), strict=True))


def _value(change: float, std: float, freedom: float) -> SessionValue:
    half = float(stats.t.ppf(0.975, freedom) * std)
    return SessionValue(float(change), float(std), (float(change - half), float(change + half)))


def _log(sessions: Sequence[StoredInformation], shape: Shape) -> str:
    inputs = sessions[shape.session - 1].inputs if shape.session is not None else ()
    return Path(str(inputs[0]["path"])).name if inputs else ""
