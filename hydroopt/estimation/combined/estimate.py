"""Geometry, bodies and friction together: the most probable ones of all readings, and their joint posterior.

Unknown are the motion (the coefficients c of its splines), the geometry g with fixtures and angles of locked joints,
and the parameters ψ of bodies and friction:

    Σ ((q_read − q)/σ_q)² + λ/σ_q²·∫ q'''² dt + Σ |rows(g, q, calibrator)|² + Σ ((f − f(q, q̇, q̈, ψ, g))/σ_f)²
        + ((g − g₀)/σ_g)² + …  →  min over c, g and ψ.

`hydroopt.estimation.dynamic.fitted_motion` eliminates the motion, then g is eliminated from
what is left: ``‖R·ψ − r‖²``, to which priors, constraints and samplers of ψ apply as to any other logs. With ψ known, g
is Gaussian about a linear function of ψ, so that the posterior of ψ gives that of both, their correlation included.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from typing import Any

import numpy as np

from hydroopt.errors import ProblemError
from hydroopt.estimation.combined.log_geometry import ForcesByGeometry, LogGeometry, postures
from hydroopt.estimation.dynamic.calibrated import calibrated_machine
from hydroopt.estimation.dynamic.estimate import Estimate
from hydroopt.estimation.dynamic.fitted_motion import NumbersBeside, NumbersGiven
from hydroopt.estimation.dynamic.identify import Method, identify
from hydroopt.estimation.dynamic.misfit.naming import Misfit
from hydroopt.estimation.dynamic.problem import IdentificationProblem, identification_problem
from hydroopt.estimation.dynamic.reduced_model import WITH_PRIORS
from hydroopt.estimation.dynamic.training_logs import prepared, refuse_added
from hydroopt.estimation.inference.band_variances import NORMAL
from hydroopt.estimation.inference.identifiability import DETERMINED, FULL
from hydroopt.estimation.inference.listing import counted
from hydroopt.estimation.kinematic.calibration import Calibration, calibrate
from hydroopt.logs.log import Log
from hydroopt.logs.smoothing import Smoothing
from hydroopt.machine.calibrated_numbers import closed_flat, standing_for, with_calibrated
from hydroopt.machine.joint_limits import within_strokes
from hydroopt.machine.machine import Machine
from hydroopt.machine.machine_file import GivenMachine
from hydroopt.model.model import Model
from hydroopt.results.diagnostic import Diagnostic
from hydroopt.results.json_file import MachineId
from hydroopt.results.parameter_table import ParameterTable, row
from hydroopt.results.tables import COVARIANCE, covariance_csv, number
from hydroopt.results.verdict import Claim, Purpose, determined
from hydroopt.spatial.inertia import Array
from hydroopt.support.notebook_card import Shown


@dataclass(frozen=True, eq=False)
class CombinedProblem(Shown):
    """Geometry, bodies and friction, to be estimated together from the same logs.

    Attributes:
        identification: the problem of bodies and friction, with all that is stated of them.
        smoothing: how angles are differentiated for the initial guess, and for validation.

    See `combined_problem`.
    """

    identification: IdentificationProblem
    smoothing: Smoothing | None = None

    def __post_init__(self) -> None:
        problem = self.identification
        refuse_added("geometry", problem.experiments)
        taken = {"instruments": bool(problem.instruments), "correlated channels": problem.correlated,
                 "freed faults": bool(problem.freed), f"the loss '{problem.loss}'": problem.loss != "squares",
                 "fitted rates and accelerations": any(
                     data.position_std is not None for data in problem.experiments)}
        if named := [what for what, so in taken.items() if so]:
            raise ProblemError(f"geometry cannot be estimated together with {named[0]}", where="geometry",
                               remedy="choose one of the two")

    def __repr__(self) -> str:
        problem = self.identification
        return (f"CombinedProblem({problem.model.machine.name}: geometry and {len(problem.parameters)} parameters, "
                f"{counted(len(problem.experiments), 'training log')})")


def combined_problem(machine: GivenMachine, logs: Log | Sequence[Log], validation: Log | Sequence[Log] = (),
                     *, smoothing: Smoothing | None = None) -> CombinedProblem:
    """The problem of geometry, bodies and friction together.

    Args:
        machine: nominal description; numbers of its geometry with a stated `sigma` are unknown, within that.
        logs: training data with forces or pressures and, besides the joints' angles, readings that depend on the
            geometry: angles of an attached calibrator, lengths of cylinders, places of the tip.
        validation: logs for validation only.
        smoothing: how angles are differentiated for the initial guess; a smoothing spline by default.

    Raises:
        LogError: a channel is missing or a log is too short.
        ProblemError: there is no log, one is read in pieces, or the calibrator's bodies load the machine.

    >>> import hydroopt as ho
    >>> log = ho.simulate("cat215b", ho.random_trajectory("cat215b", duration=5.0, rate=20.0, seed=1))
    >>> ho.combined_problem("cat215b", log)
    CombinedProblem(cat215b: geometry and 82 parameters, 1 training log)
    """
    return CombinedProblem(identification_problem(machine, logs, validation, smoothing=smoothing), smoothing)




@dataclass(frozen=True, eq=False, repr=False)
class CombinedEstimate(Estimate):
    """Geometry, bodies and friction from the same logs; `hydroopt.solve` returns it.

    What an `Estimate` has is that of the machine with the calibrated geometry: fit, predictions, base parameters. The
    uncertainty of the geometry is part of all intervals.

    Attributes:
        asked: the problem.
        kinematics: the calibration by the same samples without their forces, from which the search started.

    See `combined_problem`.
    """

    asked: CombinedProblem = field(kw_only=True)
    kinematics: Calibration = field(kw_only=True)

    @classmethod
    def of(cls, estimate: Estimate, asked: CombinedProblem, kinematics: Calibration) -> CombinedEstimate:
        """From the estimate of bodies and friction with the geometry beside them."""
        return cls(**{each.name: getattr(estimate, each.name) for each in fields(Estimate)}, asked=asked,
                   kinematics=kinematics)

    @property
    def machine_id(self) -> MachineId:
        """Which machine it is about."""
        return MachineId.of(self.asked.identification.model.machine)

    @cached_property
    def numbers(self) -> NumbersGiven:
        """Geometry, fixtures and locked joints as functions of the parameters ψ, for any nearby."""
        fit = self.weighted_residuals.fit
        assert fit is not None
        assert fit.numbers is not None
        return fit.numbers

    @cached_property
    def geometry(self) -> Array:
        """(k,) numbers of geometry, fixtures and locked joints [SI], named as `numbers`."""
        return self.numbers.at(self.psi)

    @cached_property
    def covariance(self) -> Array:
        """(k+p, k+p) of [geometry, ψ]: all NaN without intervals."""
        k, p = len(self.numbers.names), len(self.psi)
        if self.posterior is None:
            return np.full((k + p, k + p), np.nan)
        of_psi, slope = np.atleast_2d(np.cov(self.posterior.samples.T)), self.numbers.slope
        across = slope @ of_psi
        return np.block([[self.numbers.covariance + across @ slope.T, across], [across.T, of_psi]])

    @cached_property
    def geometry_std(self) -> Array:
        """(k,) standard deviations of the geometry; NaN without intervals."""
        return np.sqrt(np.diag(self.covariance)[: len(self.numbers.names)])

    @cached_property
    def parameters(self) -> ParameterTable:
        """The geometry, fixtures and angles of locked joints, then the parameters of bodies and friction."""
        calibrated = self.kinematics.parameters
        rows = []
        for name, value, std in zip(self.numbers.names, self.geometry.tolist(), self.geometry_std.tolist(),
                                    strict=True):
            before = calibrated[name]
            stated = np.nan if before.prior_std is None else before.prior_std
            known = std < DETERMINED * stated
            rows.append(row(
                name, before.kind, before.unit, nominal=before.nominal if before.nominal is not None else np.nan,
                prior_std=stated, value=value, std=std,
                ci95=(value - NORMAL * std, value + NORMAL * std),
                identifiability=FULL if known else before.identifiability))
        held = [each for name, each in calibrated.items() if name not in self.numbers.names]
        return ParameterTable([*rows, *held, *super().parameters.rows])

    @cached_property
    def claims(self) -> tuple[Claim, ...]:
        """As of an `Estimate`, and which dimensions are determined."""
        dimensions = [name for name in self.kinematics.problem.model.parameters.names if name in self.numbers.names]
        return (*super().claims, *(determined(Purpose.LENGTH, self.parameters[name], condition="95 % intervals",
                                            unknown="the logs do not determine it") for name in dimensions))

    @cached_property
    def diagnostics(self) -> tuple[Diagnostic, ...]:
        """What contradicts the readings of the geometry, then those of an `Estimate`."""
        return (*self.kinematics.contradictions, *super().diagnostics)

    @cached_property
    def misfit(self) -> Misfit | None:
        """The test of fit with smoothed motion and the calibrated geometry, since a fitted motion explains faults."""
        problem = self.problem
        experiments = tuple(prepared(data.log, problem.model, self.asked.smoothing) for data in problem.experiments)
        own = {each.name: getattr(self, each.name) for each in fields(Estimate)}
        return Estimate(**own | {"problem": replace(problem, experiments=experiments, fitted_motion=False,
                                                    beside=())}).misfit

    @cached_property
    def machine(self) -> Machine:
        """The calibrated machine: the nominal description with all estimated numbers and their confidences.

        Raises:
            ProblemError, MachineError: no machine can have these numbers.
        """
        logs = ", ".join(data.log.path or data.log.name for data in self.problem.experiments)
        found = {name: (value, std) for name, value, std in zip(
            self.numbers.names, self.geometry.tolist(), self.geometry_std.tolist(), strict=True) if np.isfinite(std)}
        made = with_calibrated(calibrated_machine(self), found, f"calibrated together with bodies from {logs}")
        return within_strokes(made)[0]

    def details(self) -> Mapping[str, Any]:
        """As of an `Estimate`, and what joins geometry and bodies."""
        return {**super().details(), "geometry": {
            "noise_scale": number(self.kinematics.noise_scale),
            "correlations": [{"name": name, "other": other, "correlation": number(r)}
                             for name, (other, r) in self.correlations.items()]}}

    @cached_property
    def correlations(self) -> dict[str, tuple[str, float]]:
        """For each number of the geometry the parameter of bodies and friction that it correlates with most."""
        k, std = len(self.numbers.names), np.sqrt(np.diag(self.covariance))
        across = self.covariance[:k, k:] / np.outer(std[:k], np.where(std[k:] > 0, std[k:], np.inf))
        names, best = self.problem.parameters.names, np.argmax(np.abs(np.nan_to_num(across)), axis=1)
        return {name: (names[j], float(across[i, j])) for i, (name, j) in enumerate(
            zip(self.numbers.names, best.tolist(), strict=True))}

    def files(self) -> Mapping[str, str]:
        """As of an `Estimate`, and the covariance of all numbers [SI]."""
        names = (*self.numbers.names, *self.problem.parameters.names)
        return {**super().files(), COVARIANCE: covariance_csv(names, self.covariance)}


def identify_with_geometry(problem: CombinedProblem, method: Method = "sdp", *, intervals: bool = True, seed: int = 0,
                           **options: Any) -> CombinedEstimate:
    """Solve the combined problem.

    Args:
        problem: what to solve.
        method: ``sdp``, ``qp`` or ``nlp``, see `hydroopt.estimation.dynamic.identify.identify`.
        intervals: whether to sample the posterior.
        seed: of that sampling.
        options: `tolerance`, as of `identify`.

    Raises:
        ProblemError: a log reads nothing of the geometry, or the method knows no confidences.
        IdentifiabilityError: nothing determines a number of the geometry, or no joint moves.
        SolverError: no trustworthy answer.
    """
    if method not in WITH_PRIORS:
        raise ProblemError(f"method '{method}' knows no confidences, by which geometry and bodies are separated",
                           where="geometry", remedy=f"use {', '.join(WITH_PRIORS)}")
    nominal = problem.identification
    kinematics = calibrate(postures(nominal.model.machine, nominal.experiments))
    force = ForcesByGeometry(nominal.model, kinematics.problem.model.parameters.names)
    about = _about(problem, _beside(nominal, force, kinematics), kinematics)
    about = _about(problem, identify(about, method, intervals=False, **options).problem.beside, kinematics)
    final = identify(about, method, intervals=intervals, seed=seed, **options)
    return CombinedEstimate.of(final, problem, kinematics)


def _about(problem: CombinedProblem, beside: Sequence[NumbersBeside], kinematics: Calibration) -> IdentificationProblem:
    """The identification of the machine with a geometry, whose numbers are unknown about it."""
    nominal, chain = problem.identification, kinematics.problem.model
    machine = nominal.model.machine
    theta = dict(zip(kinematics.problem.parameters.names, kinematics.theta.tolist(), strict=True))
    theta |= dict(zip(beside[0].names, beside[0].value.tolist(), strict=True))
    geometry = {name: theta[name] for name in chain.parameters.names}
    calibrated = standing_for(machine.with_values(closed_flat(machine, geometry)), machine)
    model = Model(calibrated, actuator_inertia=nominal.model.actuator_inertia, calibrator=nominal.model.calibrator,
                  terms=nominal.model.terms)
    train, held_out = ([prepared(data.log, model, problem.smoothing) for data in some]
                       for some in (nominal.experiments, nominal.validation))
    return replace(nominal, model=model, experiments=tuple(train), validation=tuple(held_out), fitted_motion=True,
                   beside=tuple(beside))


def _beside(problem: IdentificationProblem, force: ForcesByGeometry, kinematics: Calibration) -> list[LogGeometry]:
    """The calibrated geometry for each experiment; numbers at a bound are held there."""
    every = kinematics.problem
    names, bound = np.array(every.parameters.names), kinematics.at_bound
    held = every.fixing(**dict(zip(names[bound], kinematics.theta[bound].tolist(), strict=True)))
    found, first = [], 0
    for data in problem.experiments:
        others = np.ones(len(every.poses), dtype=bool)
        others[first : first + data.log.size] = False
        own = kinematics.q[~others, len(every.model.machine.joints):]
        found.append(LogGeometry(held.without(others), force, kinematics.theta, own))
        first += data.log.size
    return found
