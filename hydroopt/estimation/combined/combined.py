"""Geometry, bodies and friction together: the most probable ones of all readings, and their joint posterior.

Unknown are the motion (the coefficients c of its splines), the geometry g with fixtures and angles of locked joints,
and the parameters ψ of bodies and friction:

    Σ ((q_read − q)/σ_q)² + λ/σ_q²·∫ q'''² dt + Σ |rows(g, q, calibrator)|² + Σ ((f − f(q, q̇, q̈, ψ, g))/σ_f)²
        + ((g − g₀)/σ_g)² + …  →  min over c, g and ψ.

The sweep along time of `hydroopt.estimation.dynamic.fitted_motion` eliminates the motion, then g is eliminated from
what is left: ``‖R·ψ − r‖²``, to which priors, constraints and samplers of ψ apply as to any other logs. With ψ known, g
is Gaussian about a linear function of ψ, so that the posterior of ψ gives that of both, their correlation included.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from hydroopt.errors import ProblemError
from hydroopt.estimation.combined.estimate import CombinedEstimate
from hydroopt.estimation.combined.forces_by_geometry import ForcesByGeometry
from hydroopt.estimation.combined.log_geometry import LogGeometry
from hydroopt.estimation.combined.log_postures import postures
from hydroopt.estimation.combined.problem import CombinedProblem
from hydroopt.estimation.dynamic.identification import WITH_PRIORS
from hydroopt.estimation.dynamic.identify import Method, identify
from hydroopt.estimation.dynamic.numbers_beside import NumbersBeside
from hydroopt.estimation.dynamic.problem import IdentificationProblem
from hydroopt.estimation.dynamic.training_logs import prepared
from hydroopt.estimation.kinematic.calibrate import calibrate
from hydroopt.estimation.kinematic.calibration import Calibration
from hydroopt.machine.flat_loops import closed_flat
from hydroopt.machine.standing import standing_for
from hydroopt.model.model import Model


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
