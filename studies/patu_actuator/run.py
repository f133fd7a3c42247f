"""PATU 655 log crane, one slow lift: valve, oil and friction from its first half, the whole of it in free run."""

from pathlib import Path

import numpy as np

from hydroopt import load_machine, read_log
from hydroopt.estimation.hydraulic.estimate import free_run_fit, identify_hydraulics
from hydroopt.estimation.hydraulic.problem import hydraulic_problem
from hydroopt.results.diagnostic import of_kind
from hydroopt.results.wording import Kind

HERE = Path(__file__).parent
DATA = HERE.parents[2] / "shared" / "data" / "patu_log_crane" / "patu_measured_100Hz.csv"
BEGINS, ENDS = 1.6, 20.6
"""The lift moves between these times [s]."""


def run() -> dict | None:
    """Free run over the whole log, of which the first half of the motion was fitted; None where the set is missing."""
    if not DATA.exists():
        return None
    log = read_log(DATA, mapping=HERE / "map.toml")
    half = int(np.searchsorted(log.t, (BEGINS + ENDS) / 2))
    problem = hydraulic_problem(load_machine("patu655_lift"), [log.slice(0, half)], bodies=True)
    estimate = identify_hydraulics(problem)
    whole = estimate.run(problem.records(log)[0], estimate.shooting.solution.points[0][0])
    fit, found = free_run_fit(problem, [whole]), estimate.shooting
    results = {"length_largest_mm": round(1e3 * fit["lift_cylinder.length"].largest, 1),
               "p_head_of_range": round(fit["lift_cylinder.p_head"].of_range, 4),
               "p_rod_of_range": round(fit["lift_cylinder.p_rod"].of_range, 4),
               "air_beside_volume_reported": any(
                   {"lift_cylinder.volume_b", "lift_cylinder.air_b"} == set(each.subject) for each in of_kind(
                       estimate.diagnostics, Kind.RATIO_OR_PRODUCT_ONLY, Kind.COMBINATION_ONLY))}
    for name in ("f_coulomb", "rated_flow", "dead_band", "leakage"):
        k = problem.parameters.index(f"lift_cylinder.{name}")
        results[f"{name}_interval"] = "{:.3g} … {:.3g} {}".format(*found.ci95[k], problem.parameters.units[k])
    return results
