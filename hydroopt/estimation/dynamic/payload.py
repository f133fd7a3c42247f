"""The load that a machine carries: mass and centre of mass from logs with it and without it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from scipy import special, stats
from scipy.linalg import block_diag
from threadpoolctl import threadpool_limits

from hydroopt.errors import IdentifiabilityError, ProblemError, SolverError
from hydroopt.estimation.dynamic.claims import scale_assumed
from hydroopt.estimation.dynamic.problem import IdentificationProblem
from hydroopt.estimation.dynamic.session_answer import Quantity, SessionAnswer, rounded
from hydroopt.estimation.dynamic.stored_information import PREPARED, StoredInformation, all_prepared
from hydroopt.estimation.dynamic.training_logs import explained
from hydroopt.estimation.inference.band_variances import f_test, students
from hydroopt.estimation.inference.conditions import consistency, scaled_bodies
from hydroopt.estimation.inference.convex_program import cones, nearest_point
from hydroopt.estimation.inference.mixed_model import Projected, projected
from hydroopt.estimation.inference.whitening import GaussianPosterior, gaussian, marginal
from hydroopt.logs.log import Log
from hydroopt.logs.smoothing import Smoothing
from hydroopt.machine.machine import Machine
from hydroopt.machine.machine_file import GivenMachine, machine_of
from hydroopt.machine.parameter_kind import INERTIAL_KINDS, ParameterKind
from hydroopt.model.carried_load import carried_load
from hydroopt.model.model import Model, recent_model
from hydroopt.parameters.dynamic import bodies
from hydroopt.parameters.parameter_set import ParameterSet
from hydroopt.results.diagnostic import Diagnostic, probability
from hydroopt.results.json_file import Job
from hydroopt.results.parameter_table import ParameterTable
from hydroopt.results.tables import csv_text, with_limits
from hydroopt.results.verdict import Action, Claim, NextStep, Purpose, Usable, judged
from hydroopt.spatial import inertia
from hydroopt.spatial.inertia import Array
from hydroopt.support.progress import Progress, silent

LOAD = "load"
"""Owner of the load's parameters."""
METHOD = "joint least squares"
"""One least squares over both sessions, with an F test."""
NO_LOAD = 0.05
"""p-value of no load above which no load is detected."""
DRAWS = 20_000
"""Draws of load, friction and gains: limits of intervals are known to a hundredth of their width."""
MOST_STEPS = 100
"""Linearisations about uncertain gains."""


@dataclass(frozen=True, eq=False, repr=False)
class Payload(SessionAnswer):
    """A load, in the frame P_i of the link that carries it; `payload` returns it.

    Attributes:
        machine: of both sessions.
        statistic, rank, degrees_of_freedom, p_value: of the joint test of no load: F with `rank` (identifiable
            directions) and `degrees_of_freedom`.
        before, after: the sessions without and with the load.
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
        return (*self.of_logs, *partly, *scale)

    @cached_property
    def claims(self) -> tuple[Claim, ...]:
        """How well the load is weighed, and where its centre of mass lies."""
        condition = f"95 % interval; forces read to scale {'as estimated' if self.gains else 'exactly'}"
        return tuple(self._use(one, condition) for one in (self.mass, *self.com))

    def _use(self, one: Quantity, condition: str) -> Claim:
        half = (one.ci95[1] - one.ci95[0]) / 2
        if self.p_value > NO_LOAD:
            return Claim(Purpose.LOAD, one.name, Usable.UNTESTED, reason="no load was detected")
        if not one.identifiable or not np.isfinite(half):
            return Claim(Purpose.LOAD, one.name, Usable.NO, reason="not determined by these motions")
        if one.name != self.mass.name:
            return Claim(Purpose.LOAD, one.name, Usable.YES, half, one.unit, condition=condition)
        return judged(Purpose.LOAD, one.name, half, one.unit, half / abs(one.value), condition=condition)

    @property
    def next_steps(self) -> tuple[NextStep, ...]:
        """What would weigh the load better."""
        if self.p_value > NO_LOAD or all(claim.usable is Usable.YES for claim in self.claims):
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
                "weights": self.weights}

    def files(self) -> Mapping[str, str]:
        """All quantities as CSV."""
        return {"payload.csv": csv_text([with_limits(one.as_dict()) for one in self.quantities])}


def payload(machine: GivenMachine, unloaded: Log | Sequence[Log] | str | Path,
            loaded: Log | Sequence[Log] | str | Path, *, link: str | None = None,
            friction_changes: bool = False, gain: float | None = None,
            smoothing: Smoothing | None = None, seed: int = 0, progress: Progress = silent) -> Payload:
    """Mass and centre of mass of a load that one session carries and another does not.

    One least squares over both sessions, which share the machine's parameters and its priors, but for the load, the
    step of a body of its own on a link. Its mass is not negative, and `Payload.phi` is the most probable body whose
    pseudo-inertia is positive definite; bounds of the machine's own parameters do not matter to what was added. A
    scale that all forces are misread by, such as a motor's torque constant, changes the mass by as much; with `gain` it
    is an unknown of each actuator, which the machine file's priors on masses then determine, and the intervals include
    it.

    Args:
        machine: nominal description without the load, the same for both sessions.
        unloaded: logs, or the folder that `hydroopt identify` wrote from them.
        loaded: logs, or such a folder.
        link: that carries the load; the last one by default.
        friction_changes: whether friction may differ between the sessions: in gears it grows with the load.
        gain: standard deviation of the relative error of each actuator's force reading, the same in both sessions; by
            default the machine file's ``[faults] gain``, or else 0.
        smoothing: how angles are differentiated.
        seed: of the draws of intervals.
        progress: receives the steps, see `hydroopt.support.progress`.

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
    mass = 0.1 * sum(owned.body.m for owned in bodies(model.machine).values())
    added = np.hstack([columns, np.eye(len(columns))[:, model.parameters.select(names)]])
    for _ in range(2):  # the load's approximate size sets the width of its prior
        both = _BothSessions(model, added, gain, _load(model.machine, mass), (first, second))
        value, std = (float(abs(one[0])) for one in (both.change.solution @ both.change.sums,
                                                     np.linalg.norm(both.change.solution, axis=1)))
        mass = max(value, std) if np.isfinite(std) else mass
    return both.payload(carrier, names, seed)


def _load(machine: Machine, mass: float) -> ParameterSet:
    """A body with a weak prior: it is about so heavy, and lies within the machine's reach."""
    reach = sum(float(np.hypot(one.joint.a, one.joint.d)) for one in machine.links) or 1.0
    scale = mass * np.array([1.0, *[reach] * 3, *[reach**2] * 6])
    nominal = scale * np.array([1, 0, 0, 0, 1, 0, 0, 1, 0, 1])
    lower = np.array([0.0, *[-np.inf] * 9])
    wide = scale * np.array([10.0, *[1.0] * 9])
    return ParameterSet(tuple(f"{LOAD}.{name}" for name in inertia.NAMES), INERTIAL_KINDS, inertia.UNITS, nominal,
                        lower, np.full(10, np.inf), scale, np.diag(1 / wide**2))


@dataclass(frozen=True, eq=False)
class _BothSessions:
    """Forces ``(1 + γ)·K·(ψ + s·added·δ)`` of two sessions, without (s = 0) and with (s = 1) what the second adds.

    The unknowns are x = [ψ, γ, δ]: gains γ of the force readings, if these are uncertain, and δ (d,), the ten numbers
    of the load and changes of friction, of which `added` (p, d) are the columns.
    """

    model: Model
    added: Array
    gain: float
    load: ParameterSet
    sessions: tuple[StoredInformation, StoredInformation]

    @cached_property
    def scale(self) -> Array:
        """(P,) sizes of the unknowns."""
        own, gains = self.model.parameters.scale, len(self.model.machine.balances) if self.gain else 0
        return np.concatenate([own, np.full(gains, self.gain), self.load.scale, own @ self.added[:, 10:]])

    @property
    def shared(self) -> int:
        """Number of the unknowns that both sessions share, which come first."""
        return len(self.scale) - int(self.added.shape[1])

    @cached_property
    def priors(self) -> tuple[Array, Array]:
        """Rows (·, P) and right-hand side of all priors, the ten of the load last."""
        rows, right = IdentificationProblem(self.model, ()).prior_rows
        load, d = np.sqrt(np.diag(self.load.information)), self.added.shape[1]
        gains = np.diag(1 / self.scale[len(self.added) : self.shared])
        return (block_diag(rows, gains, np.eye(10, d) * load[:, None]),
                np.concatenate([right, np.zeros(len(gains)), load * self.load.nominal]))

    @property
    def freedom(self) -> Array:
        """Degrees of freedom of the variances of both sessions' rows."""
        return np.concatenate([session.freedom.ravel() for session in self.sessions])

    @property
    def nominal(self) -> Array:
        """(P,) the nominal machine without a load."""
        return np.pad(self.model.parameters.nominal, (0, len(self.scale) - len(self.added)))

    def rows(self, x: Array) -> tuple[Array, Array]:
        """Rows (m, P) and right-hand side of both sessions with unit variance, linearised at x (P,)."""
        p, made, right = len(self.added), [], []
        for s, session in enumerate(self.sessions):
            K, f = session.triangles[:, :, :p], session.triangles[:, :, p]
            A = np.concatenate([K, np.zeros((*f.shape, self.shared - p)), s * (K @ self.added)], axis=2)
            if self.gain:
                gain, predicted = x[p : self.shared, None], A @ x
                A, f = (1 + gain[:, None]) * A, f + gain * predicted
                A[np.arange(len(A)), :, p + np.arange(len(A))] = predicted
            made.append(A.reshape(-1, len(x)))
            right.append(f.ravel())
        return np.vstack(made), np.concatenate(right)

    @cached_property
    def posterior(self) -> GaussianPosterior:
        """The Gaussian of the unknowns, whose normal intervals are as wide as those of Student's t.

        Raises:
            SolverError: gains, which make forces bilinear, did not converge.
        """
        prior, known = self.priors
        size, x = students(self.freedom), self.nominal
        for _ in range(MOST_STEPS):
            A, b = self.rows(x)
            found = gaussian(np.vstack([A * size[:, None], prior]), np.append(b * size, known), self.nominal,
                             self.scale)
            last, x = x, found.offset
            if not self.gain or np.all(np.abs(x - last) < 1e-9 * self.scale):
                return found
        raise SolverError("the gains of the force readings did not converge", where=self.model.machine.name,
                          remedy="state a smaller sigma of the gains, or smaller sigmas of masses")

    @cached_property
    def change(self) -> Projected:
        """What the sessions say of δ without a prior of it, beside all that they share.

        Raises:
            IdentifiabilityError: nothing.
        """
        (A, b), (prior, known) = self.rows(self.posterior.offset), (one[:-10] for one in self.priors)
        rows, k = np.vstack([A, prior]), self.shared
        found = projected(rows[:, :k] * self.scale[:k], rows[:, k:], np.append(b, known) - rows @ self.nominal,
                          self.scale[k:])
        if not len(found.sums):
            raise IdentifiabilityError("these logs do not identify a load", where=self.model.machine.name,
                                       remedy="drive longer motions, in both sessions")
        return found

    def payload(self, link: str, names: Sequence[str], seed: int) -> Payload:
        """The load on a link, and changes of friction by name."""
        k, change = self.shared - len(self.added), self.change
        own = marginal(self.posterior, np.s_[len(self.added) :])  # of γ (k,) and δ
        mean, root = own.offset, own.slope
        draws = np.random.default_rng(seed).standard_normal((DRAWS, len(mean)))
        axis, length = root[k] / np.linalg.norm(root[k]), float(np.linalg.norm(root[k]))
        along = stats.truncnorm.ppf(special.ndtr(draws @ axis), -mean[k] / length, np.inf)  # no mass is negative
        samples = mean + (draws + np.outer(along - draws @ axis, axis)) @ root.T
        value = mean if mean[k] > 0 else samples.mean(axis=0)
        test = f_test(change.sums, change.left**2,
                      np.pad(self.freedom, (0, len(change.left) - len(self.freedom)), constant_values=np.inf))
        known, parameters, columns = np.isfinite(change.solution[:, 0]), self.model.parameters, samples.T
        mass = _quantity("m", ParameterKind.MASS, "kg", value[k], columns[k], known[0])
        moment = tuple(_quantity(f"mc_{axis}", ParameterKind.FIRST_MOMENT, "kg*m", value[k + j], columns[k + j],
                                 known[j]) for j, axis in enumerate("xyz", 1))
        com = tuple(_quantity(f"com_{axis}", ParameterKind.POSITION, "m", value[k + j] / value[k],
                              columns[k + j] / columns[k], known[0] and known[j]) for j, axis in enumerate("xyz", 1))
        friction = tuple(_quantity(name, parameters.kind(name), parameters.units[parameters.index(name)],
                                   value[k + j], columns[k + j], known[j]) for j, name in enumerate(names, 10))
        gains = tuple(_quantity(f"{balance.name}.gain", ParameterKind.FORCE_GAIN, "1", value[j], columns[j], True)
                      for j, balance in enumerate(self.model.machine.balances[:k]))
        return Payload(self.model.machine, test.statistic, test.rank, test.freedom, test.p_value, *self.sessions, link,
                       mass, com, moment, self._possible(), friction, gains)

    def _possible(self) -> Array:
        """The most probable load (10,) that can exist."""
        load = marginal(self.posterior, np.s_[self.shared : self.shared + 10])
        [body] = scaled_bodies(self.load)
        nearest = nearest_point(np.zeros(10), cones([consistency(body, 10)], load), self.model.machine.name)
        assert nearest is not None  # some body exists
        return np.asarray(load.offset + load.slope @ nearest[0])


def _quantity(name: str, kind: ParameterKind, unit: str, value: float, samples: Array, known: bool) -> Quantity:
    nan = float("nan")
    if not known:
        return Quantity(name, str(kind), unit, nan, nan, (nan, nan))
    low, high = np.quantile(samples, [0.025, 0.975])
    return Quantity(name, str(kind), unit, float(value), float(np.std(samples)), (float(low), float(high)))
