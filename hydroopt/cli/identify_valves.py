"""`hydroopt identify-valves`: valves and oil from commands, motion and pressures."""

from __future__ import annotations

import time

from hydroopt.cli.answers import continued, failure_saved, print_answer
from hydroopt.cli.options import (
    AsJson,
    Directory,
    Holdout,
    MachineName,
    MapFile,
    ParameterSetName,
    Quiet,
    TrainingLogs,
    Treat,
    Validation,
    logs_read,
    parted,
    progress,
)


def identify_valves(
    machine: MachineName,
    logs: TrainingLogs,
    output: Directory,
    validate: Validation = None,
    holdout: Holdout = 0.0,
    map_file: MapFile = None,
    treat: Treat = None,
    parameter_set: ParameterSetName = None,
    quiet: Quiet = False,
    as_json: AsJson = False,
) -> None:
    """Identify valves and oil: DIR gets estimate.json, report.html, free runs and the calibrated machine.

    Example: hydroopt identify-valves patu655_lift driven.csv --holdout 0.3 -o out/valves
    """
    from hydroopt.estimation.hydraulic.estimate import METHOD
    from hydroopt.estimation.hydraulic.problem import hydraulic_problem
    from hydroopt.machine.machine_file import load_machine
    from hydroopt.report import valves
    from hydroopt.results.json_file import Job
    from hydroopt.solving import solve

    began, described = time.perf_counter(), load_machine(machine, parameter_set=parameter_set)
    problem = hydraulic_problem(described, *parted(
        logs_read(logs, described, map_file, treat), logs_read(validate or (), described, map_file, treat), holdout))
    with (progress(f"adjusting the volume balances of {described.name}", quiet) as say,
          failure_saved(output, Job.HYDRAULICS, described, METHOD, lambda: problem.inputs)):
        estimate = continued(solve(problem), output)
        say("running free over all logs, writing the report", 0.7)
        estimate.save(output, pages={"report.html": valves.render(estimate)}, wall_s=time.perf_counter() - began)
    print_answer(estimate, output, quiet=quiet, as_json=as_json)
