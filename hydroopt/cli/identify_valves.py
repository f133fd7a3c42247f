"""`hydroopt identify-valves`: valves and oil from commands, motion and pressures."""

from __future__ import annotations

from hydroopt.cli.options import Holdout, TrainingLogs, Validation
from hydroopt.cli.run import ANSWER, LOGS, Run, command


@command(*ANSWER, *LOGS)
def identify_valves(
    run: Run,
    logs: TrainingLogs,
    validate: Validation = None,
    holdout: Holdout = 0.0,
) -> None:
    """Identify valves and oil: DIR gets estimate.json, report.html, free runs and the calibrated machine.

    Example: hydroopt identify-valves patu655_lift driven.csv --holdout 0.3 -o out/valves
    """
    from hydroopt.estimation.hydraulic.estimate import METHOD
    from hydroopt.estimation.hydraulic.problem import hydraulic_problem
    from hydroopt.results.json_file import Job
    from hydroopt.solving import solve

    problem = hydraulic_problem(run.machine, *run.parted(logs, validate, holdout))
    with (run.progress(f"adjusting the volume balances of {run.machine.name}") as say,
          run.failure_saved(Job.HYDRAULICS, METHOD, lambda: problem.inputs)):
        estimate = run.saved(solve(problem), say)
    run.show(estimate)
