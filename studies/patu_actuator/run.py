"""PATU 655 log crane, one slow lift: valve, oil and forces from its first half, the whole of it in free run."""

from pathlib import Path

import numpy as np

from hydroopt import hydraulic_problem, identification_problem, load_machine, read_log, solve
from hydroopt.estimation.hydraulic.estimate import free_run_fit
from hydroopt.estimation.hydraulic.free_run import free_runs
from hydroopt.results.diagnostic import of_kind

HERE = Path(__file__).parent
DATA = HERE.parents[2] / "shared" / "data" / "patu_log_crane" / "patu_measured_100Hz.csv"
BEGINS, ENDS = 1.6, 20.6
"""The lift moves between these times [s]."""


def run() -> dict | None:
    """Free run over the whole log, of which the first half of the motion was fitted; None where the set is missing."""
    if not DATA.exists():
        return None
    log = read_log(DATA, mapping=HERE / "map.toml")
    half = log.slice(0, int(np.searchsorted(log.t, (BEGINS + ENDS) / 2)))
    forces = solve(identification_problem(load_machine("patu655_lift"), [half]))
    problem = hydraulic_problem(forces.machine, [half])
    estimate = solve(problem)
    (whole,) = free_runs(problem, log, estimate.adjustment.theta)
    fit, found = free_run_fit(problem, [whole]), estimate.adjustment
    results = {"length_largest_mm": round(1e3 * fit["lift_cylinder.length"].largest, 1),
               "p_head_of_range": round(fit["lift_cylinder.p_head"].of_range, 4),
               "p_rod_of_range": round(fit["lift_cylinder.p_rod"].of_range, 4),
               "air_beside_volume_reported": any(
                   {"lift_cylinder.volume_b", "lift_cylinder.air_b"} == set(each.subject) for each in of_kind(
                       estimate.diagnostics, "only a ratio or product identifiable",
                       "only a combination identifiable"))}
    for name in ("rated_flow", "dead_band", "leakage"):
        k = problem.parameters.index(f"lift_cylinder.{name}")
        results[f"{name}_interval"] = "{:.3g} … {:.3g} {}".format(*found.ci95[k], problem.parameters.units[k])
    return results
