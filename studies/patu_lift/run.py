"""PATU 655 log crane, one slow lift: what the nominal model explains, what a fit adds, and what it cannot tell."""

from pathlib import Path

import numpy as np

from hydroopt import identification_problem, load_machine, read_log, solve
from hydroopt.estimation.dynamic.regressor_qr import predict
from hydroopt.results.diagnostic import of_kind
from studies.patu_lift.tilt import with_tilt

HERE = Path(__file__).parent
DATA = HERE.parents[2] / "shared" / "data" / "patu_log_crane" / "patu_measured_100Hz.csv"


def run() -> dict | None:
    """Residuals relative to the force, ‖error‖/‖force‖; None where the data set is not at hand."""
    if not DATA.exists():
        return None
    log = read_log(DATA, mapping=HERE / "map.toml")
    problem = identification_problem(load_machine("patu655_lift"), [log])
    data = problem.experiments[0]
    nominal = predict(problem.model, data, problem.parameters.nominal)
    force, inside = data.force, data.inside
    estimate = solve(problem)
    friction = problem.parameters.index("lift_cylinder.f_coulomb")
    free = solve(problem, "wls")
    return {
        "nominal_residual": round(float(np.linalg.norm((force - nominal)[inside]) / np.linalg.norm(force[inside])), 4),
        "fit_residual": round(estimate.fit["train"]["all"].relative, 4),
        "least_squares_residual": round(free.fit["train"]["all"].relative, 4),
        "friction_against_gravity_reported": any(
            found.evidence["effects"] == "Coulomb friction and gravity"
            for found in of_kind(estimate.diagnostics, "not separable in this motion")),
        "friction_std_without_prior_N": round(float(free.std[friction]), 0),
        "friction_std_with_prior_N": round(float(estimate.std[friction]), 0),
        **with_tilt(DATA)}
