"""A designed motion: its samples, its functions of time, its use of the limits, and the accuracy to expect of it."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, ClassVar

import casadi as ca
import numpy as np

from hydroopt.errors import IdentifiabilityError, ProblemError
from hydroopt.estimation.dynamic.claims import expected_mass
from hydroopt.estimation.inference.identifiability import ROUNDING_TOLERANCE
from hydroopt.excitation.motion.approach import Approach, approach, start_of
from hydroopt.excitation.motion.expected_accuracy import ExpectedAccuracy, expected_accuracy
from hydroopt.excitation.motion.problem import ExcitationProblem, State
from hydroopt.excitation.motion.random_motion import best_random_motion, resting_posture, shrunk
from hydroopt.limits.limits import TIGHT, Course, UseOfLimit, courses
from hydroopt.limits.watch import Watch, reach, watch
from hydroopt.logs.forces_from_pressures import force_noise
from hydroopt.logs.table import encoded_columns
from hydroopt.machine.actuators import Cylinder, Motor
from hydroopt.machine.machine import Machine
from hydroopt.parameters.parameter_set import ParameterKind
from hydroopt.results import json_file
from hydroopt.results.answer import Answer
from hydroopt.results.diagnostic import Diagnostic, Meaning
from hydroopt.results.json_file import Job
from hydroopt.results.machine_diagnostics import machine_diagnostics
from hydroopt.results.parameter_table import ParameterTable, row
from hydroopt.results.readable import percentage
from hydroopt.results.tables import number
from hydroopt.results.verdict import Action, Claim, NextStep, Purpose, Usable
from hydroopt.simulation.passive_joints import passive_motion
from hydroopt.simulation.simulate import Trajectory
from hydroopt.spatial.inertia import Array

METHOD = "sequential quadratic programming"
COMPARED = {"condition": "condition number", "E": "largest standard deviation"}
"""What is compared with random motions, by criterion; by the others it is the standard deviations on average."""
SMALLEST, TRIES = 0.1, 10
"""Size of the smallest of so many copies of a motion that are tried with passive joints that swing."""
UNIMPROVED = 0.9
"""A parameter whose standard deviation stays above this part of what it was before is not improved."""


@dataclass(frozen=True, eq=False, repr=False)
class Excitation(Answer):
    """A designed motion, what it uses of the limits, and the accuracy to expect of an identification from it.

    Attributes:
        problem: the criterion, the limits, and the functions of time.
        x: the coefficients, see `ExcitationProblem`.
        seed: of the starts, and of the log that is simulated for the expected accuracy.
        starts: random motions from which the search started.
        stopped: what cut the search short, ``by Ctrl-C`` or ``after 5 s``; empty if it ended by itself.
        approach: from where the machine stands to the first posture, if that was stated.
        pace: part of the pace for which it was designed.

    Example:
        >>> import hydroopt as ho
        >>> from hydroopt.excitation.motion.basis import Fourier
        >>> problem = ho.excitation_problem(ho.load_machine("patu655_lift"), Fourier(period=6.0, harmonics=2))
        >>> x = problem.posture(problem.mean)  # what `solve` finds; here the mean posture and one sine
        >>> x[problem.basis.names.index("sin1")] = 0.2
        >>> motion = ho.Excitation(problem, x)
        >>> motion.trajectory.q.shape, motion.limits[0].name
        ((1001, 1), 'lift position')
        >>> motion.within_limits(x) is motion  # no joint swings
        True
        >>> motion.at_pace(0.5).problem.basis.duration
        20.0
        >>> motion.approached_from({"lift": float(motion.trajectory.q[0, 0]) + 0.05}).approach.postures.shape
        (2, 1)
    """

    job = Job.EXCITATION
    random_motions: ClassVar[int] = 100
    """Random motions with the best of which it is compared."""

    problem: ExcitationProblem
    x: Array
    seed: int = 0
    starts: int = 1
    stopped: str = ""
    approach: Approach | None = None
    pace: float = 1.0

    @property
    def machine(self) -> Machine:
        """The machine that it is about."""
        return self.problem.machine

    @property
    def method(self) -> str:
        """How it was computed, and first of all whether the search was cut short."""
        return METHOD + (f", a search cut short {self.stopped}" if self.stopped else "")

    @cached_property
    def diagnostics(self) -> tuple[Diagnostic, ...]:
        """What to know before the motion is driven."""
        return tuple(self._diagnostics())

    def _diagnostics(self) -> Iterator[Diagnostic]:
        model, accuracy = self.problem.information.model, self.accuracy
        yield from machine_diagnostics(model)
        if self.stopped:
            yield Diagnostic.of("search cut short", (), {"how": self.stopped}, (
                "The search was cut short {how}: the motion keeps all limits, but may not be the best."),
                "Search longer, without `--search-seconds` or with more of them.")
        if self.pace == 1 and self.gain < 1:  # random motions of a slower pace may be larger
            yield Diagnostic.of("a random motion tells more", (), {"motions": self.random_motions}, (
                "The best of {motions} random motions determines more than this one: the search ended too early."),
                "Search longer (`--search-seconds`) or from more starts (`--starts`).")
        if missing := _unlimited(self.machine):
            yield Diagnostic.of("not limited", missing, {}, "The machine file does not limit {subject}.",
                                "State what must be limited.", Meaning.PROPERTY)
        forces = tuple(balance.name for balance, std in zip(model.machine.balances, force_noise(model), strict=True)
                       if balance.actuators and not np.isfinite(std))
        if forces:
            yield Diagnostic.of("no accuracy of forces stated", forces, {}, (
                "The machine file states no accuracy for the force of {subject}; its noise is assumed as a tenth of a "
                "typical force."), "State the accuracy in [[sensors]].", Meaning.PROPERTY)
        if angles := tuple(joint for joint in model.machine.joints if model.machine.sensor(f"{joint}.q") is None):
            yield Diagnostic.of("no accuracy of angles stated", angles, {}, (
                "The machine file states no accuracy for the angle of {subject}; it counts as exact here: the true σ "
                "will be larger than stated."), "State the accuracy in [[sensors]].", Meaning.PROPERTY)
        if biased := int(np.sum(np.isfinite(accuracy.base) & (accuracy.bias > accuracy.base))):
            yield Diagnostic.of("bias by smoothing", (), {"biased": biased, "of": len(accuracy.base)}, (
                "Smoothing noisy angles will bias {biased} of {of} base parameters by more than their σ."),
                "Drive slower, or measure the angles more accurately.")
        names = model.parameters.names
        unimproved = tuple(name for name, before, after in zip(names, accuracy.before, accuracy.after, strict=True)
                           if not after <= UNIMPROVED * before)
        if unimproved:
            yield Diagnostic.of("parameters not improved", unimproved, {"count": len(unimproved), "of": len(names)}, (
                "{count} of {of} parameters will stay about as uncertain as they are: {subject}."),
                meaning=Meaning.PROPERTY)

    @cached_property
    def accuracy(self) -> ExpectedAccuracy:
        """Standard deviations to expect of an identification from this motion.

        Raises:
            ProblemError: the limits leave no motion that is fast enough.
        """
        problem = self.problem
        try:
            return expected_accuracy(problem.information.model, self.trajectory, problem.parameters.structure,
                                     problem.parameters.measured, seed=self.seed)
        except IdentifiabilityError:
            tight = ", ".join(use.name for use in self.limits if use.part < TIGHT) or "the limits together"
            raise ProblemError(f"{tight} leave no motion that is fast enough to identify anything", where="excitation",
                               remedy="correct these limits in the machine file, or give a longer motion") from None

    @cached_property
    def parameters(self) -> ParameterTable:
        """All parameters: `prior_std` by file and earlier logs, `std` with this motion; no values, as none is measured.
        """
        stated, structure = self.problem.information.model.parameters, self.problem.parameters.structure
        return ParameterTable([
            row(name, stated.kinds[k], stated.units[k], nominal=float(stated.nominal[k]),
                prior_std=float(self.accuracy.before[k]), std=float(self.accuracy.after[k]),
                identifiability=structure.category[k]) for k, name in enumerate(stated.names)])

    @property
    def headline(self) -> str:
        """What it is worth, beside what is known and beside random motions."""
        table = self.parameters.rows
        sharper = [each.std / each.prior_std for each in table
                   if each.std is not None and each.prior_std and each.std <= UNIMPROVED * each.prior_std]
        first = f"The search was cut short {self.stopped}. " if self.stopped else ""
        random = (f"the best of {self.random_motions} random motions has {self.gain:.2g} times the "
                  f"{self.compared}")
        if not sharper:
            return f"{first}No parameter is expected to become more certain; {random}."
        return (f"{first}{len(sharper)} of {len(table)} parameters are expected to become more certain, in the median "
                f"to {100 * float(np.median(sharper)):.2g} % of their standard deviation before; {random}.")

    @cached_property
    def claims(self) -> tuple[Claim, ...]:
        """That it keeps the limits, and which masses an identification from it will determine."""
        tight = min(self.limits, key=lambda use: use.part, default=None)
        condition = "all limits are kept, with their reserves" + (
            f"; the least room is that of {tight.name}, {percentage(max(tight.part, 0.0))}" if tight else "")
        masses = (expected_mass(each) for each in self.parameters.rows if each.kind == ParameterKind.MASS)
        return (Claim(Purpose.DRIVING, "", Usable.YES, condition=condition), *masses)

    @property
    def next_steps(self) -> tuple[NextStep, ...]:
        """Drive it, and identify."""
        return (NextStep(Action.DRIVE, "Go through sheet.html with the operator."),
                NextStep(Action.DRIVE, "Drive trajectory.csv, or c/ on the controller, and log angles and pressures."),
                NextStep(Action.USE, "Then, with its log as log.csv:",
                         f"hydroopt identify {self.problem.machine.source} log.csv --holdout 0.3 -o identified"))

    @property
    def inputs(self) -> tuple[Mapping[str, Any], ...]:
        """The logs already measured."""
        return self.problem.inputs

    def details(self) -> Mapping[str, Any]:
        """Criterion, functions and coefficients, use of the limits, and the base parameters' expected accuracy."""
        problem, basis = self.problem, self.problem.basis
        return {
            "criterion": problem.information.criterion, "value": self.value,
            "condition_numbers": self.condition_numbers, "excited": self.excited,
            "best_random": {
                "motions": self.random_motions, "value": number(self.best_random.value), "ratio": number(self.gain),
                "condition_numbers": self.best_random.condition_numbers, "excited": self.best_random.excited},
            "stopped": self.stopped,
            "focus": list(problem.parameters.focus_names), "priors": problem.parameters.bayesian,
            "seed": self.seed, "starts": self.starts, "rate": problem.rate, "duration": basis.duration,
            "samples": problem.samples, "resting": problem.resting,
            "reserves": problem.limits.reserves._asdict(), "first_posture": self._first_posture,
            "approach": None if self.approach is None else {
                "postures": self.approach.postures.tolist(), "arrivals": self.approach.arrivals.tolist(),
                "less_than_reserves_at_start": list(self.approach.short)},
            "basis": {"kind": type(basis).__name__.lower(), **asdict(basis)}, "pace": self.pace,
            "functions": list(basis.names),
            "coefficients": {joint: self.coefficients[:, k].tolist() for k, joint in enumerate(problem.machine.joints)},
            "limits": [{"name": use.name, "unit": use.unit, "lower": number(use.lower), "lowest": use.lowest,
                        "highest": use.highest, "upper": number(use.upper), "room": use.room, "margin": use.margin}
                       for use in self.limits],
            "people": self.watch.as_dict(),
            "base_parameters": [{"expression": name, "unit": unit, "std": number(std), "bias": number(bias)}
                                for name, unit, std, bias in zip(self.names, self.units, self.accuracy.base,
                                                                 self.accuracy.bias, strict=True)]}

    def files(self, *, parquet: bool = False) -> Mapping[str, str | bytes]:
        """Trajectory and approach as CSV or Parquet: position, speed and acceleration of every joint at the rate."""
        paths = {"trajectory": self.trajectory} | ({} if self.approach is None else
                                                   {"approach": self.approach.trajectory})
        return {f"{name}.{'parquet' if parquet else 'csv'}": encoded_columns(self._columns(path), parquet=parquet)
                for name, path in paths.items()}

    def _columns(self, path: Trajectory) -> dict[str, Array]:
        columns = {"t [s]": path.t}
        for k, joint in enumerate(self.problem.machine.joints):
            unit = self.problem.machine.channel_units[f"{joint}.q"]
            columns |= {f"{joint}.q [{unit}]": path.q[:, k], f"{joint}.qd [{unit}/s]": path.qd[:, k],
                        f"{joint}.qdd [{unit}/s^2]": path.qdd[:, k]}
        return columns

    @property
    def _first_posture(self) -> dict[str, float]:
        return dict(zip(self.problem.machine.joints, self.trajectory.q[0].tolist(), strict=True))

    def approached_from(self, stated: Mapping[str, float]) -> Excitation:
        """Itself with an approach from where the machine stands: positions [rad, m]; other joints stand as it starts.

        Raises:
            ProblemError: the machine cannot stand there, or no way was found.
        """
        goal = self.trajectory.q[0]
        start = start_of(self.problem.machine, stated, goal)
        return replace(self, approach=approach(self.problem.limits, start, goal, self.problem.rate, seed=self.seed))

    def at_pace(self, pace: float) -> Excitation:
        """The same path, driven at a part of its pace, above 0 and at most 1; made smaller where slower motion asks for
        more, as of pressures.

        Raises:
            ProblemError: the pace is not above 0 and at most 1, or passive joints swing beyond limits.
        """
        refuse_pace(pace)
        if pace == 1:
            return self
        own = self.problem
        problem = ExcitationProblem(own.information, own.limits, own.basis.at_pace(pace), own.rate, own.resting,
                                    own.inputs)
        rest = resting_posture(problem, np.random.default_rng(self.seed))
        return replace(self, problem=problem, x=shrunk(problem, self.x, rest),
                       pace=self.pace * pace).within_limits(rest)

    def save(self, directory: str | Path, *, pages: Mapping[str, str | bytes | None] | None = None,
             wall_s: float = float("nan"), parquet: bool = False) -> None:
        """As `Answer.save`, the trajectory as CSV or Parquet.

        Raises:
            ProblemError: the directory cannot be written.
        """
        json_file.write(directory, self.job, self.content(wall_s=wall_s),
                        {**self.files(parquet=parquet), **(pages or {})})

    def __str__(self) -> str:
        problem = self.problem
        moving = [joint for joint in problem.machine.joints if joint not in problem.resting]
        tight = sorted((use for use in self.limits if math.isfinite(use.part)), key=lambda use: use.part)[:3]
        return (f"{self.machine_name}: {problem.basis.duration:g} s of {', '.join(moving)} at {problem.rate:g} Hz, "
                f"optimal by criterion {problem.information.criterion}\n"
                f"  It excites {self.excited} of {len(self.names)} base parameters; condition number of their "
                f"regressor {self.condition_numbers['unit_columns']:.2g}, in columns of unit length.\n"
                f"  Nearest to their limits: {', '.join(f'{use.name} ({100 * use.part:.1f} % left)' for use in tight)}."
                )

    @cached_property
    def tip(self) -> Array:
        """Path (N, 3) [m] of the last link's far end."""
        model = self.problem.information.model
        return np.asarray(model.over(model.forward_kinematics, self.trajectory.q)[-1][:, :3, 3])

    @cached_property
    def watch(self) -> Watch:
        """What people beside the machine keep, on the approach too."""
        limits = self.problem.limits
        q = np.vstack([self.trajectory.q, *([] if self.approach is None else [self.approach.trajectory.q])])
        return watch(limits.model, reach(limits.model, q), self.limits, limits.reserves)

    @property
    def base_nominal(self) -> Array:
        """Nominal values (r,) of the base parameters."""
        nominal = self.problem.information.model.parameters.nominal
        return np.asarray(self.problem.parameters.structure.grouping @ nominal)

    @cached_property
    def coefficients(self) -> Array:
        """(m, n) of the functions, for all joints [rad, m], those that rest included."""
        return self.problem.coefficients(self.x)

    @cached_property
    def trajectory(self) -> Trajectory:
        """Samples at the controller's rate."""
        return Trajectory(self.problem.t, *self._states)

    @cached_property
    def _states(self) -> State:
        states, model = self.problem.states(self.x, self.problem.fine), self.problem.information.model
        return State(*passive_motion(model, self.problem.t, states, model.parameters.nominal))

    @cached_property
    def function(self) -> ca.Function:
        """Time (1, 1) [s] → q, qd and qdd (n,): as the controller computes it."""
        t = ca.SX.sym("t")
        c = ca.DM(self.coefficients.T)
        still = self.problem.idle
        made = [ca.densify(c @ each) for each in self.problem.basis.expressions(t)]
        for order, each in enumerate(made):
            each[still] = self.problem.resting_position[still] if order == 0 else 0
        return ca.Function("excitation", [t], made, ["t"], ["q", "qd", "qdd"])

    @cached_property
    def courses(self) -> Mapping[str, Course]:
        """Each limited quantity over time, by the limit's name."""
        return courses(self.problem.limits, *self._states)

    @property
    def limits(self) -> tuple[UseOfLimit, ...]:
        """What it uses of each limit."""
        return tuple(course.use for course in self.courses.values())

    @cached_property
    def value(self) -> float:
        """Of the criterion, over all samples and with the sign of friction as it is."""
        return self.problem.information.exact_value(*self._states)

    @cached_property
    def factor(self) -> Array:
        """R (r, r) with RᵀR the information of all samples and of the prior, on scaled base parameters."""
        return self.problem.information.factor(*self._states, 1.0)

    @property
    def names(self) -> tuple[str, ...]:
        """Base parameters in words."""
        return self.problem.parameters.names

    @property
    def units(self) -> tuple[str, ...]:
        """Their units."""
        units = self.problem.information.model.parameters.units
        return tuple(units[k] for k in self.problem.parameters.columns)

    @cached_property
    def _regressors(self) -> dict[str, Array]:
        """Triangles (r, r) of the regressor of all base parameters, by scaling; see `condition_numbers`."""
        parameters = self.problem.parameters
        K = self.problem.information.model.over(self.problem.information.regressor, *self._states)[0]
        rows = (K / (parameters.weight[:, None] * parameters.scale)).reshape(-1, K.shape[2])
        raw = np.asarray(np.linalg.qr(rows, mode="r"))
        lengths = np.linalg.norm(raw, axis=0)
        return {"raw": raw, "unit_columns": raw / np.where(lengths > 0, lengths, 1.0), "scaled": self.factor}

    @cached_property
    def excited(self) -> int:
        """Number of base parameters that the motion excites."""
        return len(_sizes(self._regressors["unit_columns"]))

    @cached_property
    def condition_numbers(self) -> dict[str, float]:
        """Condition numbers of the regressor in the base parameters that are `excited`, by scaling.

        ``raw`` in SI units; ``unit_columns`` with columns of length one; ``scaled`` as the design sees it: forces in
        standard deviations, parameters in their scales, and prior information added.
        """
        return {name: float(s[0] / s[-1]) for name, R in self._regressors.items() if len(s := _sizes(R))}

    @cached_property
    def best_random(self) -> Excitation:
        """The best of `random_motions` random motions with the same functions of time within the same limits."""
        problem, rest = self.problem, resting_posture(self.problem, np.random.default_rng(self.seed))
        return Excitation(problem, best_random_motion(problem, self.random_motions, self.seed),
                          self.seed).within_limits(rest)

    def within_limits(self, rest: Array) -> Excitation:
        """Itself, or the motion made smaller about a resting posture until passive joints that swing keep limits, too.

        Raises:
            ProblemError: they are not kept however small the motion is.
        """
        if not self.problem.limits.hanging.joints:
            return self
        for part in np.linspace(1.0, SMALLEST, TRIES):
            one = self if part == 1 else replace(self, x=self.problem.hung(rest + part * (self.x - rest)))
            try:
                if min(use.room for use in one.limits) >= 0:
                    return one
            except ProblemError:  # a passive joint leaves its range
                continue
        raise ProblemError("passive joints swing beyond limits in every motion that was tried", where="excitation",
                           remedy="give a slower motion: fewer harmonics, or a longer period")

    @property
    def compared(self) -> str:
        """What `gain` is a ratio of."""
        return COMPARED.get(self.problem.information.criterion, "standard deviations")

    @property
    def gain(self) -> float:
        """Standard deviations of the best random motion over those of this one, as its criterion means them: their
        geometric mean for D, root mean square for A, the largest for E; or the ratio of condition numbers.
        """
        criterion, other = self.problem.information.criterion, self.best_random.value
        return float(np.exp((other - self.value) / (1.0 if criterion == "condition" else 2.0)))


def refuse_pace(pace: float) -> None:
    """Refuse a part of the pace that is not above 0 and at most 1.

    Raises:
        ProblemError: it is not.
    """
    if not 0 < pace <= 1:
        raise ProblemError(f"a motion cannot be driven at {100 * pace:.4g} % of its speed", where="--speed",
                           remedy="give more than 0 and at most 100 %, such as '50 %'")


def _unlimited(machine: Machine) -> tuple[str, ...]:
    """What a motion could break of which the machine file states no limit."""
    limits = {"the flow of the pump": machine.pump.max_flow if machine.pump else None,
              "the height above ground": machine.ground, "the workspace of the tip": machine.workspace,
              "tipping over": machine.footprint}
    hydraulic = any(isinstance(each, Cylinder | Motor) for each in machine.actuators)
    missing = [text for text, stated in limits.items()
               if stated is None and (hydraulic or text not in ("the flow of the pump", "tipping over"))]
    missing += [f"the effort of {each.name}" for each in machine.actuators
                if (each.relief_pressure if isinstance(each, Cylinder | Motor) else each.max_torque) is None]
    for joint in machine.joints:
        own = machine.link(joint).joint
        missing += [f"the {what} of {joint}" for what, value in (
            ("speed", own.max_speed), ("acceleration", own.max_acceleration)) if value is None]
    return tuple(missing)


def _sizes(R: Array) -> Array:
    """Singular values that are no rounding errors."""
    s = np.linalg.svd(R, compute_uv=False)
    return np.asarray(s[s > ROUNDING_TOLERANCE * s[0]])
