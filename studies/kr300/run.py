"""KUKA KR300, run A: fit on the first 70 %, predict the last 30 %."""

from pathlib import Path

from hydroopt import identification_problem, load_machine, read_log, solve

DATA = Path(__file__).parents[2] / "data" / "kr300"


def run() -> dict:
    """Relative residuals over all axes, ‖error‖/‖torque‖, and whether every body can exist."""
    log = read_log(DATA / "run_A.mat", mapping=DATA / "map.toml")
    first, last = log.split(0.7)
    problem = identification_problem(load_machine("kr300"), [first], [last])
    results: dict = {}
    for method in ("wls", "sdp"):
        estimate = solve(problem, method)
        results[f"{method}_train"] = round(estimate.fit["train"]["all"].relative, 4)
        results[f"{method}_validation"] = round(estimate.fit["validation"]["all"].relative, 4)
        results[f"{method}_inconsistent_bodies"] = sum(s < 0 for s in estimate.consistency.values())
    return results
