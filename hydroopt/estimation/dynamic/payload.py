"""The load that a machine carries: mass and centre of mass from logs with it and without it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from scipy import stats
from threadpoolctl import threadpool_limits

from hydroopt.errors import ProblemError, SolverError
from hydroopt.estimation.dynamic.diagnostics import sampling_not_converged
from hydroopt.estimation.dynamic.session_answer import Quantity, SessionAnswer, rounded
from hydroopt.estimation.dynamic.stored_information import PREPARED, StoredInformation, all_prepared
from hydroopt.estimation.dynamic.training_logs import explained
from hydroopt.estimation.dynamic.two_session_problem import (
    TwoSessionOptimum,
    TwoSessionProblem,
    Wald,
    doubled,
    joined,
    second_parameters,
    solve_both,
    wald,
)
from hydroopt.estimation.dynamic.usability import scale_assumed
from hydroopt.estimation.inference.posterior import Posterior
from hydroopt.logs.log import Log
from hydroopt.logs.smoothing import Smoothing
from hydroopt.machine.given_machine import GivenMachine, machine_of
from hydroopt.machine.machine import Machine
from hydroopt.machine.parameter_kind import INERTIAL_KINDS, ParameterKind
from hydroopt.model.carried_load import carried_load
from hydroopt.model.model import Model, recent_model
from hydroopt.parameters.dynamic import bodies
from hydroopt.parameters.parameter_set import ParameterSet
from hydroopt.progress import Progress, silent
from hydroopt.results.diagnostic import Diagnostic, probability
from hydroopt.results.json_file import Job
from hydroopt.results.parameter_table import ParameterTable
from hydroopt.results.tables import csv_text, with_limits
from hydroopt.results.verdict import Action, NextStep, Purpose, Usable, Use, judged
from hydroopt.spatial import inertia
from hydroopt.spatial.inertia import Array

LOAD = "load"
"""Owner of the load's parameters."""
METHOD = "joint least squares"
"""One least squares over both sessions, with an F test."""
NO_LOAD = 0.05
"""p-value of no load above which no load is detected."""


@dataclass(frozen=True, eq=False, repr=False)
class Payload(SessionAnswer):
    """A load, in the frame P_i of the link that carries it; `payload` returns it.

    Attributes:
        machine: of both sessions.
        statistic, rank, degrees_of_freedom, p_value: of the joint test of no load: F with `rank` (identifiable
            directions) and `degrees_of_freedom`.
        before, after: the sessions without and with the load.
        posterior: samples of all unknowns; None where bounds leave no interior.
        notes: how it was computed, in sentences.
        link: that carries it.
        mass: [kg].
        com: the three coordinates of its centre of mass [m].
        moment: the three first moments m·com [kg·m], which may be identifiable where mass and centre are not.
        phi: (10,) the most probable load that is physically consistent.
        friction: changes of friction between the sessions, if they were allowed.
        gains: relative errors of the actuators' force readings, if they were allowed.

    Example:
        See `payload`.
    """

    machine: Machine
    statistic: float
    rank: int
    degrees_of_freedom: float
    p_value: float
    before: StoredInformation
    after: StoredInformation
    posterior: Posterior | None
    notes: tuple[str, ...]
    link: str
    mass: Quantity
    com: tuple[Quantity, ...]
    moment: tuple[Quantity, ...]
    phi: Array
    friction: tuple[Quantity, ...]
    gains: tuple[Quantity, ...]
    job = Job.PAYLOAD

    @property
    def method(self) -> str:
        """One least squares over both sessions, with an F test."""
        return METHOD

    @property
    def sessions(self) -> dict[str, StoredInformation]:
        """Both sessions by role."""
        return {"unloaded": self.before, "loaded": self.after}

    @property
    def p_value_repeat(self) -> float:
        """p-value of the statistic over φ: whether the sessions differ more than the halves of their own logs do."""
        return float(stats.f.sf(self.statistic / self.split_half, self.rank, self.degrees_of_freedom))

    @property
    def quantities(self) -> tuple[Quantity, ...]:
        """All numbers in the order of the table."""
        return (self.mass, *self.com, *self.moment, *self.friction, *self.gains)

    @cached_property
    def findings(self) -> tuple[Diagnostic, ...]:
        """Mass and centre of mass in one sentence."""
        com, moment = (", ".join(f"{one.name[-1]} = {rounded(one.value, one.std)}" for one in some
                                 if one.identifiable) for some in (self.com, self.moment))
        mass = rounded(self.mass.value, self.mass.std) if self.mass.identifiable else ""
        link = (self.link,)
        if self.p_value > NO_LOAD:
            return (Diagnostic.of("no payload detected", link, {
                "p_value": self.p_value, "probability": probability(self.p_value),
                "mass": f"; a load of {mass} kg is consistent with the logs" if mass else ""},
                "No load is detected on {subject} ({probability}){mass}."),)
        if mass:
            place = f", its centre of mass lies at {com} m in the frame of that link" if com else ""
            return (Diagnostic.of("payload identified", link, {"mass": mass, "place": place}, (
                "The load on {subject} is {mass} kg{place}.")),)
        return (Diagnostic.of("mass of the payload not identifiable", link, {
            "moment": f", but its moment is {moment} kg·m in the frame of that link" if moment else ""},
            "These logs do not identify the mass of the load on {subject}{moment}."),)

    @cached_property
    def diagnostics(self) -> tuple[Diagnostic, ...]:
        """What contradicts the logs, what the intervals assume, and what of the load these motions do not identify."""
        missing = tuple(one.name for one in self.com if not one.identifiable)
        partly = (Diagnostic.of("payload partly identifiable", missing, {}, (
            "These motions do not identify {subject} of the load."),
            "Move the load about more axes."),) if missing else ()
        if not self.mass.identifiable:
            partly = (Diagnostic.of("mass of the payload not separable", (self.link,), {}, (
                "These motions cannot separate the mass of the load on {subject} from its other parameters."),
                "Vary speed and range of the motion with the load."),)
        scale = () if self.gains else (scale_assumed(),)
        sampling = () if self.posterior is not None and self.posterior.converged else (
            sampling_not_converged() if self.posterior is not None else Diagnostic.of(
                "intervals of least squares", (), {},
                "Bounds or bodies leave no interior to sample: intervals are those of least squares without bounds."),)
        return (*self.of_logs, *sampling, *partly, *scale)

    @cached_property
    def uses(self) -> tuple[Use, ...]:
        """How well the load is weighed, and where its centre of mass lies."""
        condition = f"95 % interval; forces read to scale {'as estimated' if self.gains else 'exactly'}"
        return tuple(self._use(one, condition) for one in (self.mass, *self.com))

    def _use(self, one: Quantity, condition: str) -> Use:
        half = (one.ci95[1] - one.ci95[0]) / 2
        if self.p_value > NO_LOAD:
            return Use(Purpose.LOAD, one.name, Usable.UNTESTED, reason="no load was detected")
        if not one.identifiable or not np.isfinite(half):
            return Use(Purpose.LOAD, one.name, Usable.NO, reason="not determined by these motions")
        if one.name != self.mass.name:
            return Use(Purpose.LOAD, one.name, Usable.YES, half, one.unit, condition=condition)
        return judged(Purpose.LOAD, one.name, half, one.unit, half / abs(one.value), condition=condition)

    @property
    def next_steps(self) -> tuple[NextStep, ...]:
        """What would weigh the load better."""
        if self.p_value > NO_LOAD or all(use.usable is Usable.YES for use in self.uses):
            return ()
        return (NextStep(Action.DRIVE, "Drive the same motion, reversing all joints, longer, with and without the "
                                       "load."),)

    @cached_property
    def parameters(self) -> ParameterTable:
        """Mass, centre of mass and moments of the load, changes of friction, gains of force readings."""
        return ParameterTable([one.row(one.name if "." in one.name else f"{LOAD}.{one.name}")
                               for one in self.quantities])

    def details(self) -> Mapping[str, Any]:
        """Link, all quantities, joint test, weights of both sessions, and notes."""
        return {"link": self.link,
                "quantities": [one.as_dict() for one in (self.mass, *self.com, *self.moment)],
                "phi": self.phi.tolist(), "friction": [one.as_dict() for one in self.friction],
                "gains": [one.as_dict() for one in self.gains],
                "test": {"statistic": self.statistic, "rank": self.rank, "degrees_of_freedom": self.degrees_of_freedom,
                         "p_value": self.p_value, "phi": self.split_half, "p_value_over_phi": self.p_value_repeat,
                         "steady": self.steady},
                "weights": self.weights, "notes": list(self.notes)}

    def files(self) -> Mapping[str, str]:
        """All quantities as CSV."""
        return {"payload.csv": csv_text([with_limits(one.as_dict()) for one in self.quantities])}


def payload(machine: GivenMachine, unloaded: Log | Sequence[Log] | str | Path,
            loaded: Log | Sequence[Log] | str | Path, *, link: str | None = None,
            friction_changes: bool = False, gain: float | None = None,
            smoothing: Smoothing | None = None, seed: int = 0, progress: Progress = silent) -> Payload:
    """Mass and centre of mass of a load that one session carries and another does not.

    Both sessions share the machine's parameters; the load is a body of its own on a link. Its mass is not negative, and
    `Payload.phi` is the most probable body whose pseudo-inertia is positive definite. A scale that all forces are
    misread by, such as a motor's torque constant, changes the mass by as much; with `gain` it is an unknown of each
    actuator, which the machine file's priors on masses then determine, and the intervals include it.

    Args:
        machine: nominal description without the load, the same for both sessions.
        unloaded: logs, or the folder that `hydroopt identify` wrote from them.
        loaded: logs, or such a folder.
        link: that carries the load; the last one by default.
        friction_changes: whether friction may differ between the sessions: in gears it grows with the load.
        gain: standard deviation of the relative error of each actuator's force reading, the same in both sessions; by
            default the machine file's ``[faults] gain``, or else 0.
        smoothing: how angles are differentiated.
        seed: of the sampling of intervals.
        progress: receives the steps, see `hydroopt.progress`.

    Raises:
        LogError: a log cannot be used.
        ProblemError: there is no such link, it cannot carry a load, or a session cannot be used.
        IdentifiabilityError: the logs identify nothing of the load.
        SolverError: no trustworthy answer.

    Example:
        >>> import hydroopt as ho
        >>> model = ho.Model(ho.load_machine("patu655_lift"))
        >>> motions = [ho.random_trajectory(model, duration=20, rate=50, seed=k) for k in (1, 2)]
        >>> unloaded, loaded = (ho.simulate(model, motion, seed=k) for k, motion in enumerate(motions))
        >>> load = ho.payload(model.machine, [unloaded], [loaded], link="lift")
        >>> load.findings[0].kind
        'no payload detected'
    """
    machine = machine_of(machine, "payload")
    gain = (machine.faults.gain or 0.0) if gain is None else gain
    if not 0 <= gain < 1:
        raise ProblemError(f"a relative error must be at least 0 and less than 1, not {gain:g}", where="gain",
                           remedy="give a part of one, such as 0.05")
    model = recent_model(machine)
    carrier = machine.links[-1].name if link is None else link
    columns = carried_load(model, carrier)
    names = model.parameters.grouped("friction") if friction_changes else ()
    with threadpool_limits(limits=1, user_api="blas"):
        first, second = all_prepared(model, (unloaded, loaded), smoothing, progress, PREPARED)
        if gain and {len(first.triangles), len(second.triangles)} != {len(machine.balances)}:
            raise ProblemError("gains are not identifiable from residuals that were weighted jointly", where="gain",
                               remedy="identify without --fitted-motion, --instruments and --correlated")
        progress("weighing the load", PREPARED)
        try:
            return _weighed(model, columns, names, gain, first, second, carrier, seed)
        except SolverError as error:
            raise explained(error, (*first.of_logs, *second.of_logs)) from None


def _weighed(model: Model, columns: Array, names: Sequence[str], gain: float, first: StoredInformation,
             second: StoredInformation, carrier: str, seed: int) -> Payload:
    total = sum(owned.body.m for owned in bodies(model.machine).values())
    problem = _problem(model, columns, names, gain, mass=0.1 * total)
    test = wald(problem, *problem.rows(first, second))
    if np.isfinite(test.std[0]):  # the load's approximate size sets the width of the prior
        problem = _problem(model, columns, names, gain, mass=max(abs(float(test.value[0])), float(test.std[0])))
    both = problem.rows(first, second)
    test = wald(problem, *both)
    possible = solve_both(problem, *both, intervals=False, seed=seed).x
    # Most loads are small, at the edge of physical consistency: samples on one side of the edge only would lie too
    # far from it, and intervals would not hold. Every mass and centre of mass has a consistent body.
    found = solve_both(replace(problem, unconstrained=(LOAD,)), *both, intervals=True, seed=seed)
    return _payload(problem, carrier, test, found, possible, first, second)


def _problem(model: Model, columns: Array, names: Sequence[str], gain: float, *, mass: float) -> TwoSessionProblem:
    """Two sessions of which the second has one more body, of about this mass within the machine's reach."""
    parameters, p, n = model.parameters, len(model.parameters), len(model.machine.balances) if gain else 0
    twice = doubled(parameters, names)
    chosen, c = np.eye(p)[twice], len(twice)
    unknowns = joined(parameters, _load(model.machine, mass), second_parameters(parameters, twice), _gains(model, gain))
    nothing = np.zeros((10, p))
    return TwoSessionProblem(
        model, (), unknowns=unknowns, labels=(*unknowns.names[p : p + 10], *names),
        second=np.hstack([np.eye(p) - chosen.T @ chosen, columns, chosen.T, np.zeros((p, n))]),
        null=np.hstack([np.vstack([np.eye(p), nothing, chosen, np.zeros((n, p))]),
                        np.eye(len(unknowns))[:, p + 10 + c :]]),
        change=np.eye(len(unknowns))[:, p : p + 10 + c], gains=tuple(range(p + 10 + c, p + 10 + c + n)))


def _load(machine: Machine, mass: float) -> ParameterSet:
    """A body with a weak prior: it lies within the machine's reach."""
    reach = sum(float(np.hypot(one.joint.a, one.joint.d)) for one in machine.links) or 1.0
    scale = mass * np.array([1.0, *[reach] * 3, *[reach**2] * 6])
    nominal = scale * np.array([1, 0, 0, 0, 1, 0, 0, 1, 0, 1])
    lower = np.array([0.0, *[-np.inf] * 9])
    wide = scale * np.array([10.0, *[1.0] * 9])
    return ParameterSet(tuple(f"{LOAD}.{name}" for name in inertia.NAMES), INERTIAL_KINDS, inertia.UNITS, nominal,
                        lower, np.full(10, np.inf), scale, np.diag(1 / wide**2))


def _gains(model: Model, gain: float) -> ParameterSet:
    names = tuple(f"{balance.name}.gain" for balance in model.machine.balances) if gain else ()
    n = len(names)
    return ParameterSet(names, (ParameterKind.FORCE_GAIN,) * n, ("1",) * n, np.zeros(n), np.full(n, -np.inf),
                        np.full(n, np.inf), np.full(n, gain), np.eye(n) / (gain or 1.0) ** 2)


def _payload(problem: TwoSessionProblem, link: str, test: Wald, found: TwoSessionOptimum, possible: Array,
             first: StoredInformation, second: StoredInformation) -> Payload:
    p, unknowns = len(problem.second), problem.unknowns
    identified = np.isfinite(test.std[:10])
    samples = found.posterior.samples if found.posterior is not None else np.full((2, len(found.x)), np.nan)
    load, centre = samples[:, p : p + 10], found.centre[p : p + 10]
    difference = (problem.second - np.eye(*problem.second.shape))[problem.model.parameters.select(problem.labels[10:])]
    axes = "xyz"
    return Payload(
        problem.model.machine, test.statistic, test.rank, test.freedom, test.p_value, first, second, found.posterior,
        found.notes, link,
        _quantity("m", ParameterKind.MASS, "kg", centre[0], load[:, 0], identifiable=identified[0]),
        tuple(_quantity(f"com_{axis}", ParameterKind.POSITION, "m", centre[1 + k] / centre[0],
                        load[:, 1 + k] / load[:, 0], identifiable=identified[0] and identified[1 + k])
              for k, axis in enumerate(axes)),
        tuple(_quantity(f"mc_{axis}", ParameterKind.FIRST_MOMENT, "kg*m", centre[1 + k], load[:, 1 + k],
                        identifiable=identified[1 + k]) for k, axis in enumerate(axes)),
        possible[p : p + 10],
        tuple(_quantity(name, unknowns.kind(name), unknowns.units[unknowns.index(name)], row @ found.centre,
                        samples @ row, identifiable=np.isfinite(std))
              for name, row, std in zip(problem.labels[10:], difference, test.std[10:], strict=True)),
        tuple(_quantity(unknowns.names[k], ParameterKind.FORCE_GAIN, "1", found.centre[k], samples[:, k],
                        identifiable=True) for k in problem.gains))


def _quantity(name: str, kind: ParameterKind, unit: str, value: float, samples: Array, *,
              identifiable: bool) -> Quantity:
    nan = float("nan")
    if not identifiable:
        return Quantity(name, str(kind), unit, nan, nan, (nan, nan))
    low, high = np.quantile(samples, [0.025, 0.975])
    return Quantity(name, str(kind), unit, float(value), float(np.std(samples)), (float(low), float(high)))
