"""An identification problem that a user can read and extend; solving it never changes it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Self

import numpy as np

from hydroopt.errors import ProblemError
from hydroopt.estimation.dynamic.experiment import Experiment
from hydroopt.estimation.dynamic.fitted_motion import NumbersBeside
from hydroopt.estimation.dynamic.instruments import instrument
from hydroopt.estimation.dynamic.training_logs import prepared, refuse_added, refuse_repetition
from hydroopt.estimation.dynamic.weighted_residuals import LOSSES, Loss, weighted_residuals
from hydroopt.estimation.inference import conditions as physics
from hydroopt.estimation.inference import convex_program, listing, nlp, statements
from hydroopt.estimation.inference.conditions import Condition, ScaledBody
from hydroopt.estimation.inference.constraints import Constraint, Expression
from hydroopt.estimation.inference.identifiability import RANK_TOLERANCE
from hydroopt.estimation.inference.listing import counted
from hydroopt.estimation.inference.prior_conflict import Statement
from hydroopt.estimation.inference.priors import Prior, linear_prior, prior_squares, stated_priors
from hydroopt.estimation.inference.problem import Distance
from hydroopt.estimation.inference.program import NonlinearProgram
from hydroopt.estimation.inference.whitening import gaussian_posterior
from hydroopt.logs.calibrator_angles import calibrator_channels
from hydroopt.logs.forces_from_pressures import force_noise
from hydroopt.logs.frames import all_of
from hydroopt.logs.log import Log
from hydroopt.logs.smoothing import Motion, Smoothing
from hydroopt.machine.machine_file import GivenMachine, machine_of
from hydroopt.model.model import Model, recent_model
from hydroopt.parameters.parameter_set import ParameterSet
from hydroopt.spatial.inertia import Array
from hydroopt.support.notebook_card import Shown


@dataclass(frozen=True, eq=False)
class IdentificationProblem(Shown):
    """Weighted residuals f − K·ψ of some experiments, priors and constraints on ψ: an optimisation model.

    `identification_problem` makes one; each method returns a new one. It prints as variables, objective and
    constraints; `nlp` and `cvxpy` export it to other tools.

    >>> import hydroopt as ho
    >>> log = ho.simulate("cat215b", ho.random_trajectory("cat215b", duration=5.0, rate=20.0, seed=1))
    >>> problem = identification_problem("cat215b", log)
    >>> problem = problem.with_total_mass("scales", ["boom", "stick"], 2500.0, sigma=20.0).fix("swing.m")
    >>> print(str(problem).split("subject to")[0].splitlines()[-1].strip())
    prior scales: boom.m + stick.m = 2500 ± 20 kg
    >>> problem = problem.with_prior("boom", "boom.m = 1800 +- 50 kg").with_loss("huber").symmetric("boom", "xy")
    >>> problem.identical("rods", ["boom_cylinder.rod", "stick_cylinder.rod"]).stated_constraints[-4:]
    ('rods', 'scales', 'boom', 'swing.m fixed')
    >>> problem.with_distance("log-det").distance, problem.free("delay").freed, problem.by_data_alone().data_alone
    ('log-det', ('delay',), True)
    >>> problem.with_fitted_motion().fitted_motion, problem.with_correlated_channels().correlated
    (True, True)
    >>> len(problem.with_instruments([log]).instruments), problem.nlp().p_names[0], problem.cvxpy()
    (1, 'swing_motor.sigma', ConvexProgram(82 parameters, 16 constraints))

    Attributes:
        model: what predicts the forces; its parameters carry nominal values, bounds and the file's confidences.
        experiments, validation: training data, and data for validation only.
        force_std: (n,) standard deviations of force readings, NaN if unknown; residuals estimate them anew.
        constraints, priors, physics: what was added by name.
        fixed: parameters held at a value.
        consistent: whether every body must be physically possible (positive definite pseudo-inertia).
        loss: of the residuals; the robust ones are solved by iterative reweighting.
        correlated: whether the actuators' residuals in one sample may correlate; their correlation is estimated.
        fitted_motion: whether motion and parameters are fitted together, instead of smoothing the motion beforehand.
        beside: for each experiment the numbers that are fitted along, see `hydroopt.estimation.combined`.
        instruments: for each experiment another motion at its samples, whose errors are not those of the measured one.
        data_alone: whether statements of the machine file about bodies and bounds are left out.
        distance: of a body from its nominal one: ``gaussian`` takes the file's confidences of its ten numbers, and
            ``log-det`` the entropic divergence of pseudo-inertias, which knows no frame, weighted by the confidence of
            the mass (`hydroopt.estimation.inference.conditions.scaled_bodies`).
        freed: faults of instruments that are estimated with the parameters, see `free`.
    """

    model: Model
    experiments: tuple[Experiment, ...]
    validation: tuple[Experiment, ...] = ()
    force_std: Array = field(default_factory=lambda: np.empty(0))
    constraints: tuple[Constraint, ...] = ()
    priors: tuple[Prior, ...] = ()
    physics: tuple[Condition, ...] = ()
    fixed: Mapping[str, float] = field(default_factory=dict)
    consistent: bool = True
    loss: Loss = "squares"
    correlated: bool = False
    fitted_motion: bool = False
    beside: tuple[NumbersBeside, ...] = ()
    instruments: tuple[Motion, ...] = ()
    data_alone: bool = False
    distance: Distance = "gaussian"
    freed: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        for data in (*self.experiments, *self.validation):
            if data.model is not self.model and data.model.parameters.names != self.model.parameters.names:
                raise ProblemError("the log was prepared with a model that has other parameters than the problem's",
                                   where=data.log.path or data.log.name,
                                   remedy="give the problem and its experiments the same model")

    @property
    def where(self) -> str:
        """Subject for error messages."""
        return f"identification of {self.model.machine.name}"

    @property
    def parameters(self) -> ParameterSet:
        """The unknowns ψ."""
        return self.model.parameters

    def subject_to(self, name: str, relation: str | Expression) -> IdentificationProblem:
        """With a named constraint: a linear one as text, ``"boom.m + stick.m == 2518 kg"``, or a function.

        The function, e.g. ``lambda p: p["boom.m"] + p["stick.m"] == 2518``, is called with parameters [SI] in CasADi;
        one that is not linear is called again by the convex methods, which are the default, in cvxpy.

        Raises:
            ProblemError: the name exists already, or the text is no linear relation between parameters.
            UnitError: its units do not fit together.
        """
        if isinstance(relation, str):
            return self._with(statements.read_constraint(self.parameters, name, relation))
        constraint = Constraint(name, relation)
        if linear := statements.linear_relation(self.parameters, constraint):
            return self._with(linear)
        self._refuse_taken(name)
        return replace(self, constraints=(*self.constraints, constraint))

    def with_prior(self, name: str, expression: str | Expression, *, value: float | None = None,
                   sigma: float | None = None) -> IdentificationProblem:
        """With a linear expression or function, such as ``"boom.m + stick.m"``, known to be ``value ± sigma``, in SI.

        Without these a text states all with units: ``"boom.m + stick.m = 2518 +- 25 kg"``. It joins the file's priors.

        Raises:
            ProblemError: the expression is not linear in the parameters, sigma is not positive, or the name is taken.
            UnitError: units of the text do not fit together.
        """
        self._refuse_taken(name)
        if value is None or sigma is None:
            prior = statements.read_prior(self.parameters, name, str(expression))
        else:
            total = statements.sum_of(self.parameters, name, expression)
            prior = linear_prior(self.parameters, name, total, value, sigma)
        return replace(self, priors=(*self.priors, prior))

    def with_total_mass(self, name: str, bodies: Sequence[str], value: float,
                        sigma: float | None = None) -> IdentificationProblem:
        """With the mass [kg] of several bodies together: exactly, or as a prior ``value ± sigma``.

        Raises:
            ProblemError: an unknown body, none or one twice, a value or sigma that is not positive, or the name is
                taken.
        """
        if not 0 < value < np.inf:
            raise ProblemError(f"{value:g} kg is not a mass", where=f"'{name}'", remedy="give a positive number")
        row = physics.total_mass(self.parameters, name, bodies)
        if sigma is not None:
            return self.with_prior(name, lambda p: sum(p[f"{body}.m"] for body in bodies), value=value, sigma=sigma)
        return self._with(physics.equal(name, self.parameters, row, value))

    def identical(self, name: str, owners: Sequence[str]) -> IdentificationProblem:
        """With identical parts: bodies of equal inertial parameters, or actuators of equal friction.

        Raises:
            ProblemError: an unknown owner, fewer than two, bodies mixed with actuators, or the name is taken.
        """
        return self._with(physics.likeness(self.parameters, name, owners))

    def symmetric(self, owner: str, plane: str) -> IdentificationProblem:
        """With a body whose mass is symmetric about a plane of its frame: ``xy``, ``xz`` or ``yz``.

        Raises:
            ProblemError: an unknown body or plane, or the file or an earlier call states it already.
        """
        return self._with(physics.symmetry(self.parameters, owner, plane))

    def _with(self, condition: Condition) -> IdentificationProblem:
        self._refuse_taken(condition.name)
        return replace(self, physics=(*self.physics, condition))

    def with_distance(self, distance: Distance) -> IdentificationProblem:
        """With another distance of bodies from their nominal ones: ``gaussian`` or ``log-det``.

        With the relative confidence σ of a body's mass, the log-det one is least at the nominal body; as a density over
        the ten numbers, from which intervals come, it is that of a Wishart distribution, with the mean
        (1 + 10·σ²)·nominal and a spread of the mass of about 2·σ: state σ well below 30 %.

        Raises:
            ProblemError: there is no such distance, or a nominal body could not exist and has no log-det distance.
        """
        if distance not in ("gaussian", "log-det"):
            raise ProblemError(f"'{distance}' is not a distance", where="distance", remedy="use gaussian or log-det")
        changed = replace(self, distance=distance)
        assert changed.bodies is not None  # raises where there is no such distance
        return changed

    def _refuse_taken(self, name: str) -> None:
        if name in {*self.constraint_names, *(p.name for p in (*self.stated_priors, *self.priors))}:
            raise ProblemError("two constraints or priors have the same name", where=f"'{name}'",
                               remedy="give each its own name")

    def fix(self, name: str, value: float | None = None) -> IdentificationProblem:
        """With a parameter held at a value (SI), or at its nominal one.

        Raises:
            ProblemError: there is no such parameter.
        """
        k = self.parameters.index(name)
        if value is not None and not np.isfinite(value):
            raise ProblemError(f"it cannot be fixed at {value}", where=f"parameter '{name}'",
                               remedy="give a finite value")
        return replace(self, fixed={**self.fixed, name: float(self.parameters.nominal[k] if value is None else value)})

    def free(self, *faults: str) -> IdentificationProblem:
        """With faults of instruments estimated together with the parameters, their uncertainty in all intervals.

        Args:
            faults: groups such as ``delay`` (of all forces), ``lag``, ``clock``, ``tilt``, ``gain``, ``offset``,
                ``drift``, ``friction``, a group with its subject such as ``delay boom.q``, or ``instruments`` for
                gains, offsets, tilt and delay within what good instruments err.

        Raises:
            ProblemError: motion is fitted or has instruments, or channels correlate.
        """
        if self.fitted_motion or self.instruments or self.correlated:
            raise ProblemError("freed faults cannot be combined with a fitted motion, instruments or correlated "
                               "channels", where="faults", remedy="choose one of them")
        return replace(self, freed=(*self.freed, *faults))

    def with_loss(self, loss: Loss) -> IdentificationProblem:
        """With another loss: ``squares``, ``huber`` or ``student_t``."""
        if loss not in ("squares", "huber", "student_t"):
            raise ProblemError(f"'{loss}' is not a loss", where="loss", remedy="use squares, huber or student_t")
        return replace(self, loss=loss)

    def with_correlated_channels(self) -> IdentificationProblem:
        """With the covariance of the actuators' residuals estimated and used, instead of a weight for each.

        Raises:
            ProblemError: instruments were given.
        """
        if self.instruments:
            raise ProblemError("correlated channels cannot be combined with instruments", where="channels",
                               remedy="choose one of the two")
        return replace(self, correlated=True)

    def with_fitted_motion(self) -> IdentificationProblem:
        """With motion and parameters fitted together by maximum a posteriori.

        Angles have the accuracy that the machine file states; the training data's motion, not that of the validation
        data, is then what angles and forces together make most probable.

        Raises:
            ProblemError: instruments were given, or the calibrator is attached in a log.
        """
        refuse_added("a fitted motion", self.experiments)
        if self.instruments:
            raise ProblemError("a fitted motion cannot be combined with instruments", where="motion",
                               remedy="choose one of the two")
        return replace(self, fitted_motion=True)

    def with_instruments(self, logs: Sequence[Log] = ()) -> IdentificationProblem:
        """With instrumental variables from a second reading of the same motion.

        Args:
            logs: one for each training log, with channels ``<joint>.q`` (and ``.qd``, ``.qdd``, if known)
                that cover its time: the reference that was driven, or a repetition of the motion. Without logs the
                lengths of cylinders serve, which must stand beside the angles of all joints.

        Raises:
            ProblemError: another number of logs, a fitted or correlated problem, a joint without a second reading, or
                the calibrator is attached in a log.
            LogError: a reference does not cover its log, or lacks a joint.
        """
        refuse_added("instruments", self.experiments)
        if self.fitted_motion or self.correlated:
            raise ProblemError("instruments cannot be combined with a fitted motion or correlated channels",
                               where="motion", remedy="choose one of them")
        if logs and len(logs) != len(self.experiments):
            raise ProblemError(f"{len(logs)} instruments are given for {len(self.experiments)} logs",
                               where="instruments", remedy="give one for each training log")
        return replace(self, instruments=tuple(instrument(self.model, data, logs[k] if logs else None)
                                               for k, data in enumerate(self.experiments)))

    def by_data_alone(self) -> IdentificationProblem:
        """Without statements and bounds of the machine file about its bodies and friction, for method ``wls``."""
        return replace(self, data_alone=True)

    @property
    def stated_constraints(self) -> tuple[str, ...]:
        """What the machine file or the user demands of ψ, apart from confidences and physically consistent bodies."""
        machine = self.model.machine
        bounded = [] if self.data_alone else [
            f"the bounds of {name}" for name in self.parameters.names if name in machine.numbers
            and (note := machine.notes.get(machine.numbers[name].path)) and (note.lower, note.upper) != (None, None)]
        return (*self.constraint_names, *(prior.name for prior in (*self.stated_priors, *self.priors)),
                *(f"{name} fixed" for name in self.fixed), *bounded)

    @property
    def constraint_names(self) -> tuple[str, ...]:
        """Names of what the machine file states and of what was added."""
        return tuple(dict.fromkeys([c.name for c in self.conditions] + [c.name for c in self.constraints]))

    @cached_property
    def bodies(self) -> tuple[ScaledBody, ...]:
        """All bodies, scaled to about one, with the weight of their log-det distance if that is the one."""
        return physics.scaled_bodies(self.parameters, distances=self.distance == "log-det")

    @cached_property
    def conditions(self) -> tuple[Condition, ...]:
        """What the machine file states of its bodies, and what was added of this kind."""
        model = self.model
        stated = () if self.data_alone else physics.stated(model.machine, self.parameters,
                                                           actuator_inertia=model.actuator_inertia)
        return (*stated, *self.physics)

    def statements(self, *, consistent: bool) -> tuple[Condition, ...]:
        """Physically consistent bodies on request, and `conditions`."""
        p = len(self.parameters)
        return (*(physics.consistency(body, p) for body in self.bodies if consistent or self.distance == "log-det"),
                *self.conditions)

    def requirements(self, *, consistent: bool) -> tuple[Condition, ...]:
        """All conditions on ψ but the user's own functions: bounds and `statements`."""
        return (*physics.bounds(self.parameters, self.fixed, self.bodies if consistent else ()),
                *self.statements(consistent=consistent))

    @cached_property
    def stated_priors(self) -> tuple[Prior, ...]:
        """Total masses that the machine file states with a confidence."""
        return () if self.data_alone else stated_priors(self.model.machine, self.parameters)

    @cached_property
    def own_statements(self) -> tuple[Statement, ...]:
        """The linear constraints, priors and fixed values that were added, apart from those of the machine file."""
        size = {one.name: float(np.max(np.abs(one.rows))) for one in self.physics}
        priors = [Statement(one.name, one.row / (factor := float(np.max(np.abs(one.row)))), one.value / factor,
                            one.sigma / factor) for one in self.priors]
        fixed = [Statement(name, np.eye(len(self.parameters))[self.parameters.index(name)], value)
                 for name, value in self.fixed.items()]
        return (*(Statement(one.name, row / size[one.name], value / size[one.name], at_least=one.kind == "nonnegative")
                  for one in self.physics for row, value in zip(one.rows, one.right, strict=True)), *priors, *fixed)

    @property
    def without_statements(self) -> IdentificationProblem:
        """The problem without anything that was added, apart from faults that are estimated."""
        return replace(self, constraints=(), priors=(), physics=(), fixed={})

    @cached_property
    def prior_rows(self) -> tuple[Array, Array]:
        """Rows and right-hand side of ``‖A·ψ − b‖²``, the negative logarithm of all priors times two.

        A log-det distance is none of a square; the Gaussian of its mean and covariance stands in for it.
        """
        rows, right = self.file_prior_rows
        return (np.vstack([rows, *(one.row / one.sigma for one in self.priors)]),
                np.concatenate([right, [one.value / one.sigma for one in self.priors]]))

    @cached_property
    def file_prior_rows(self) -> tuple[Array, Array]:
        """The same of the machine file's priors alone."""
        parameters = self.parameters
        information, mean = parameters.information.copy(), parameters.nominal.copy()
        for body in self.bodies if self.distance == "log-det" else ():
            mean[body.columns] *= body.spread
            information[body.columns, body.columns] = body.information
        return prior_squares(information, mean, self.stated_priors)

    @cached_property
    def square_rows(self) -> tuple[Array, Array]:
        """Rows and right-hand side of the quadratic priors only, without the log-det distance of bodies."""
        information = self.parameters.information.copy()
        for body in self.bodies if self.distance == "log-det" else ():
            information[body.columns, body.columns] = 0.0
        return prior_squares(information, self.parameters.nominal, (*self.stated_priors, *self.priors))

    def with_experiments(self, experiments: Sequence[Experiment], beside: Sequence[NumbersBeside] = ()) -> Self:
        """With other training data, and other numbers fitted along, if there are any."""
        return replace(self, experiments=tuple(experiments), beside=tuple(beside) or self.beside)

    def nlp(self, point: Array | None = None) -> NonlinearProgram:
        """The problem as CasADi's nonlinear program; ``solve(problem, "nlp", intervals=False)`` has the same optimum.

        Variables are the parameters ψ in SI, then Cholesky factors of the matrices that must be positive semidefinite.
        The residuals have the weights that the solver ends with; the standard deviations in these weights are the
        program's fixed numbers p.

        Args:
            point: (p,) parameters at which forces are linearised that are not linear in them: an estimate's, which is
                then the optimum; the nominal ones by default.

        Raises:
            ProblemError: a constraint does not return a relation.
            IdentifiabilityError: no joint moves.
            SolverError: a fitted motion does not converge.
        """
        weighted = weighted_residuals(
            self, RANK_TOLERANCE, lambda R, r: nlp.interior_point(self, gaussian_posterior(self, R, r)).psi, point)
        return nlp.nonlinear_program(self, weighted.terms)

    def cvxpy(self, point: Array | None = None) -> convex_program.ConvexProgram:
        """The problem as cvxpy's convex program; ``solve(problem, "sdp", intervals=False)`` has the same optimum.

        Args:
            point: as of `nlp`.

        Raises:
            ProblemError: a constraint is not convex, or constraints contradict each other.
            IdentifiabilityError, SolverError: as of `nlp`.
        """
        def optimum(R: Array, r: Array) -> Array:
            posterior = gaussian_posterior(self, R, r)
            return convex_program.semidefinite_program(self, posterior, consistent=self.consistent).psi

        weighted = weighted_residuals(self, RANK_TOLERANCE, optimum, point)
        return convex_program.convex_program(self, weighted.R, weighted.r, weighted.rest)

    def prior_misfit(self, psi: Array) -> float:
        """The negative logarithm of all priors times two, at ψ (p,)."""
        rows, right = self.square_rows
        distances = sum(body.distance(psi[body.columns]) for body in self.bodies if body.weight)
        return float(np.sum((rows @ psi - right) ** 2)) + distances

    def __repr__(self) -> str:
        return (f"{type(self).__name__}({self.model.machine.name}: {len(self.parameters)} parameters, "
                f"{counted(len(self.experiments), 'training log')}, loss {self.loss}, "
                f"{counted(len(self.constraint_names), 'constraint')})")

    def __str__(self) -> str:
        parameters, machine = self.parameters, self.model.machine
        samples = sum(e.sample_count for e in self.experiments)
        lines = [f"{self.where}: {samples} samples in {counted(len(self.experiments), 'training log')}",
                 f"variables ψ ({len(parameters)})", *listing.variables(parameters, self.fixed), "minimise the sum of"]
        for balance, std in zip(machine.balances, self.force_std, strict=True):
            weight = f"σ = {listing.number(std)} {balance.unit}" if np.isfinite(std) else "σ unknown"
            lines.append(f"  residuals of {balance.name}: {LOSSES[self.loss]}, e = f − K·ψ [{balance.unit}], "
                         f"{weight}, re-estimated from the residuals")
        lines += ["  residuals of the actuators correlate: their covariance weights them"] * self.correlated
        lines += ["  motion fitted together with the parameters: (q_measured − q)²/σ²"] * self.fitted_motion
        lines += ["  instrumental variables from a second reading of the motion"] * bool(self.instruments)
        known = int(np.sum(np.diag(parameters.information) > 0))
        lines.append(f"  priors of the machine file: (ψ − nominal)ᵀ·Λ·(ψ − nominal) over {known} parameters")
        lines += ["  log-det distance of every body from its nominal one"] * (self.distance == "log-det")
        lines += [f"  {listing.prior(parameters, one)}" for one in (*self.stated_priors, *self.priors)]
        conditions = self.statements(consistent=self.consistent)
        return "\n".join([*lines, "subject to the bounds and", *listing.constraints(
            parameters, conditions, self.constraints)])


def identification_problem(machine: GivenMachine | Model, logs: Log | Sequence[Log],
                           validation: Log | Sequence[Log] = (), *,
                           smoothing: Smoothing | None = None, actuator_inertia: bool = True) -> IdentificationProblem:
    """The dynamic identification problem of a machine and its logs.

    Args:
        machine: nominal description, with its confidences; or its model, which need not be built again then.
        logs: training data.
        validation: logs for validation only.
        smoothing: how angles are differentiated; a smoothing spline by default.
        actuator_inertia: whether barrels and rods belong to the model that is built. The calibrator's bodies do if a
            log has angles of its joints.

    Raises:
        LogError: a channel is missing or a log is too short.
        ProblemError: there is no log, or one is given twice.

    >>> import hydroopt as ho
    >>> log = ho.simulate("cat215b", ho.random_trajectory("cat215b", duration=5.0, rate=20.0, seed=1))
    >>> identification_problem("cat215b", log).subject_to("arm", "boom.m + stick.m <= 2600 kg").stated_constraints
    ('arm',)
    """
    logs, validation = (all_of(some, (Log,), "log", "identification") for some in (logs, validation))
    machine = machine if isinstance(machine, Model) else machine_of(machine, "identification_problem")
    refuse_repetition([*logs, *validation])
    if not logs:
        raise ProblemError("there is no training log", where="identification", remedy="give at least one")
    model = machine if isinstance(machine, Model) else recent_model(
        machine, actuator_inertia=actuator_inertia, calibrator=any(
            calibrator_channels(machine, log) for log in (*logs, *validation)))
    train, held_out = ([prepared(log, model, smoothing) for log in some] for some in (logs, validation))
    return IdentificationProblem(model, tuple(train), tuple(held_out), force_noise(model, logs[0]))
