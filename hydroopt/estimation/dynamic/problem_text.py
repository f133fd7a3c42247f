"""An identification problem in plain text, as an optimisation model."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hydroopt.estimation.dynamic.weighted_residuals import LOSSES, ResidualProblem
from hydroopt.estimation.inference import listing
from hydroopt.estimation.inference.listing import counted
from hydroopt.estimation.inference.priors import Prior


def problem_text(problem: ResidualProblem, priors: Sequence[Prior]) -> str:
    """Variables, objective and constraints in lines of plain text."""
    parameters, machine = problem.parameters, problem.model.machine
    samples = sum(e.sample_count for e in problem.experiments)
    lines = [f"{problem.where}: {samples} samples in {counted(len(problem.experiments), 'training log')}",
             f"variables ψ ({len(parameters)})", *listing.variables(parameters, problem.fixed), "minimise the sum of"]
    for balance, std in zip(machine.balances, problem.force_std, strict=True):
        weight = f"σ = {listing.number(std)} {balance.unit}" if np.isfinite(std) else "σ unknown"
        again = ", re-estimated from the residuals" if problem.reweight else ""
        lines.append(f"  residuals of {balance.name}: {LOSSES[problem.loss]}, e = f − K·ψ [{balance.unit}], "
                     f"{weight}{again}")
    lines += ["  residuals of the actuators correlate: their covariance weights them"] * problem.correlated
    lines += ["  motion fitted together with the parameters: (q_measured − q)²/σ²"] * problem.fitted_motion
    lines += ["  instrumental variables from a second reading of the motion"] * bool(problem.instruments)
    known = int(np.sum(np.diag(parameters.information) > 0))
    lines.append(f"  priors of the machine file: (ψ − nominal)ᵀ·Λ·(ψ − nominal) over {known} parameters")
    lines += ["  log-det distance of every body from its nominal one"] * (problem.distance == "log-det")
    lines += [f"  {listing.prior(parameters, one)}" for one in priors]
    conditions = problem.statements(consistent=problem.consistent)
    return "\n".join([*lines, "subject to the bounds and", *listing.constraints(
        parameters, conditions, problem.constraints)])
