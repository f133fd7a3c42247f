"""`hydroopt identify`: masses, inertias, friction and offsets from logs."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from hydroopt.cli.options import LOSSES, Holdout, LossName, TrainingLogs, Validation, one_of
from hydroopt.cli.run import ANSWER, LOGS, SMOOTHING, Run, command
from hydroopt.errors import ProblemError

if TYPE_CHECKING:
    from hydroopt.estimation.dynamic.problem import IdentificationProblem

DISTANCES = ("gaussian", "log-det")


@command(*ANSWER, *LOGS, *SMOOTHING, "fix", "seed")
def identify(
    run: Run,
    logs: TrainingLogs,
    validate: Validation = None,
    holdout: Holdout = 0.0,
    method: Annotated[str, typer.Option(help="Method of estimation: sdp, qp, nlp, wls, ridge or tsvd.")] = "sdp",
    loss: LossName = "squares",
    distance: Annotated[str, typer.Option(
        help="How far a body is from its nominal one: gaussian, or log-det of pseudo-inertias.")] = "gaussian",
    fitted_motion: Annotated[bool, typer.Option("--fitted-motion", help=(
        "Fit the motion together with the parameters, from angles and forces, instead of smoothing it beforehand."))
        ] = False,
    geometry: Annotated[bool, typer.Option("--with-geometry", help=(
        "Estimate lengths, pins and other numbers of the geometry that state a sigma along with bodies and friction, "
        "from cylinder lengths, the angles of an attached calibrator or a tracked tip in the same logs."))] = False,
    instruments: Annotated[list[Path] | None, typer.Option(metavar="LOG", help=(
        "Second reading of each log's motion (the reference that was driven, a repetition), or 'lengths' of cylinders: "
        "instrumental variables; repeatable."))] = None,
    correlated: Annotated[bool, typer.Option("--correlated", help=(
        "Weigh the actuators' residuals by their covariance instead of one by one."))] = False,
    tolerance: Annotated[float, typer.Option(help="Singular value, relative to the largest, that counts as zero.",
                                             min=0.0, max=1.0)] = 1e-7,
    ridge: Annotated[float | None, typer.Option(help="Strength of ridge regression; else cross-validated.",
                                                min=0.0)] = None,
    friction: Annotated[str | None, typer.Option(help=(
        "Friction terms of all actuators instead of the file's: coulomb, viscous, stribeck, reverse, seal, dead_zone "
        "joined by +, or none. 'auto', or several sets separated by commas: the one that predicts held-out data best "
        "with the fewest terms."))] = None,
    constraint: Annotated[list[str] | None, typer.Option(metavar="RELATION", help=(
        "Linear relation that must hold, with ==, <= or >= and units, e.g. 'boom.m + 0.5*stick.m == 2518 kg'; "
        "repeatable."))] = None,
    prior: Annotated[list[str] | None, typer.Option(metavar="STATEMENT", help=(
        "Linear sum that is known to a standard deviation, e.g. 'boom.m + stick.m = 2518 +- 25 kg'; added to the "
        "confidences of the machine file; repeatable."))] = None,
    free: Annotated[str | None, typer.Option(help=(
        "Faults of instruments to estimate along, separated by commas: delay, lag, clock, tilt, gain, offset, drift, "
        "friction, one with its subject such as 'delay boom.q', or instruments."))] = None,
    reduced: Annotated[bool, typer.Option("--reduced", help="Leave out the inertia of barrels and rods.")] = False,
) -> None:
    """Identify masses, inertias, friction and offsets: DIR gets estimate.json, report.html, the calibrated machine.

    Example: hydroopt identify cat215b out/run/log.csv --holdout 0.3 -o out/estimate
    """
    from hydroopt.estimation.combined.estimate import CombinedProblem
    from hydroopt.estimation.dynamic.estimate import inputs_of
    from hydroopt.estimation.dynamic.friction_choice import choose_friction, friction_problem
    from hydroopt.estimation.dynamic.identify import METHODS
    from hydroopt.estimation.dynamic.problem import identification_problem
    from hydroopt.machine.machine_file import dump_machine
    from hydroopt.results.json_file import Job
    from hydroopt.solving import solve

    chosen = one_of(method, METHODS, "method")
    if ridge is not None and chosen != "ridge":
        raise ProblemError(f"the method '{method}' takes no strength", where="--ridge",
                           remedy="leave it out or choose --method ridge")
    sets = _friction(friction)
    if geometry and (friction == "auto" or len(sets) > 1):
        raise ProblemError("geometry cannot be estimated while friction terms are chosen", where="--with-geometry",
                           remedy="choose them first, and give the chosen set")
    described, smoothing = run.machine, run.smoothing
    train, held_out = run.parted(logs, validate, holdout)
    kind, far, full = one_of(loss, LOSSES, "loss"), one_of(distance, DISTANCES, "distance"), not reduced

    def prepared(problem: IdentificationProblem) -> IdentificationProblem:
        problem = _with_noisy_angles(problem.with_loss(kind).with_distance(far), fitted_motion, instruments,
                                     run.map_file)
        problem = problem.with_correlated_channels() if correlated else problem
        for name, value in run.fixed(problem.parameters).items():
            problem = problem.fix(name, value)
        for relation in constraint or ():
            problem = problem.subject_to(relation, relation)
        for statement in prior or ():
            problem = problem.with_prior(statement, statement)
        return problem.free(*(word.strip() for word in free.split(","))) if free else problem

    with run.progress(f"identifying {described.name}") as say:
        stated = partial(identification_problem, described, train, held_out, actuator_inertia=full,
                         smoothing=smoothing)
        with run.failure_saved(Job.IDENTIFICATION, method, lambda: inputs_of(stated())):
            if friction is None or len(sets) == 1:
                problem = prepared(stated() if friction is None else friction_problem(
                    described, train, held_out, sets[0], actuator_inertia=full, smoothing=smoothing))
                estimate = solve(CombinedProblem(problem, smoothing) if geometry else problem, chosen,
                                 tolerance=tolerance, ridge=ridge, seed=run.seed)
            else:
                estimate = choose_friction(described, train, held_out, sets or None, smoothing=smoothing,
                                           actuator_inertia=full, prepare=prepared, method=chosen, tolerance=tolerance,
                                           ridge=ridge, seed=run.seed)
        say("testing the fit", 0.4)
        _ = estimate.diagnostics  # computed here, and kept
        kept = {f"{estimate.machine_name}.toml": dump_machine(
            estimate.marked(estimate.machine))} if run.force and estimate.refuted else {}
        estimate = run.saved(estimate, say, kept)
    choice = estimate.friction_choice
    text = str(estimate) if choice is None else f"{choice}\n{choice.rule}\n{estimate}"
    run.show(estimate, text)


def _with_noisy_angles(problem: IdentificationProblem, fitted_motion: bool, instruments: list[Path] | None,
                       map_file: Path | None) -> IdentificationProblem:
    from hydroopt.logs.log_files import read_log

    if fitted_motion:
        problem = problem.with_fitted_motion()
    if instruments:
        problem = problem.with_instruments([] if instruments == [Path("lengths")]
                                           else [read_log(path, mapping=map_file) for path in instruments])
    return problem


def _friction(text: str | None) -> list[str]:
    """The sets of friction terms to compare; none for those of the file or the default ones."""
    from hydroopt.estimation.dynamic.friction_choice import terms_of

    if text is None or text.strip() == "auto":
        return []
    sets = text.split(",")
    for each in sets:
        terms_of(each)
    return sets
