"""Diagnostics of an identification."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from hydroopt.errors import ProblemError
from hydroopt.estimation.dynamic.calibrated import calibrated_machine
from hydroopt.estimation.dynamic.identification import Identification, Intervals, body_groups
from hydroopt.estimation.dynamic.score_covariance import STEADY
from hydroopt.estimation.dynamic.training_logs import forces_not_measured
from hydroopt.estimation.inference.identifiability import NONE, Confounded
from hydroopt.estimation.inference.prior_conflict import CONFLICT
from hydroopt.logs.forces_from_pressures import force_noise
from hydroopt.logs.log import Log
from hydroopt.parameters.dynamic import owners_with_confidence
from hydroopt.parameters.parameter_set import ParameterKind, ParameterSet
from hydroopt.results.diagnostic import Diagnostic, probability
from hydroopt.results.machine_diagnostics import machine_diagnostics
from hydroopt.results.tables import number
from hydroopt.results.wording import Kind

OVERFITTED = 2.0
"""Validation error, as a multiple of the training error, that is worth a diagnostic."""
UNEXPLAINED = 0.4
"""Error of an actuator as a part of its force, sensors' noise taken out, beyond which the model does not explain it."""
ABOVE_NOISE, WEAK = 1.5, 2.0
"""Residuals as a multiple of the sensors' noise, and the growth of bodies that a log-det distance permits, beyond which
there is a diagnostic."""

SEVERAL, SHORT = 5, 5.0
"""Number of stretches of a log, and their median duration [s], from which on and below which gaps are worth smoothing
across."""
NOT_EXACT = 0.01
"""Part of an actuator's force by which the standard deviation of a position may change it."""
EXACT = 1e-4
"""RMS residual as a part of the RMS force that no sensor reaches: pressures are read to about 1e-3."""
_EFFECTS = {ParameterKind.MASS: "gravity", ParameterKind.FIRST_MOMENT: "gravity",
            ParameterKind.MOMENT_OF_INERTIA: "inertia", ParameterKind.STRIBECK_SPEED: "Stribeck friction"}
"""What parameters of a kind cause, where that is not the name of the kind."""


def diagnose(found: Identification) -> tuple[Diagnostic, ...]:
    """All diagnostics of an identification, the most severe first."""
    return (*machine_diagnostics(found.problem.model), *uncertain_positions(found), *_prediction(found),
            *_sampling(found), *_prior_conflict(found), *_consistency(found), *_findings(found), *_residuals(found),
            *_repeats(found),
            *_assumptions(found), *_active(found), *_identifiability(found),
            *_confounded(found.problem.parameters, found.confounded))


def _prediction(found: Identification) -> Iterator[Diagnostic]:
    """Prediction errors on validation data, and actuators that the model does not explain."""
    yield from _unexplained(found)
    if "validation" not in found.fit:
        yield Diagnostic(Kind.NO_VALIDATION)
        return
    passive = {each.name for each in found.problem.model.machine.balances if not each.actuators}
    for channel, held_out in found.fit["validation"].items():
        trained = found.fit["train"].get(channel)
        if channel == "all" or trained is None:
            continue
        if 1 < held_out.relative < np.inf:  # nothing is measured at a passive joint
            yield Diagnostic(Kind.WORSE_THAN_ZERO, (channel,), {"relative": number(held_out.relative)})
        elif held_out.vaf < 0:
            yield Diagnostic(Kind.CONSTANT_ERROR, (channel,), {"vaf": held_out.vaf})
        elif held_out.rms > OVERFITTED * trained.rms and channel not in passive:  # angles err as they move
            yield Diagnostic(Kind.LARGE_VALIDATION_ERROR, (channel,), {"ratio": number(held_out.rms / trained.rms)
                                                                       if trained.rms else None})


def _unexplained(found: Identification) -> Iterator[Diagnostic]:
    """Actuators, one by one, whose error beyond their sensors' noise is a large part of their force."""
    data = "validation" if "validation" in found.fit else "training"
    table = found.fit["validation" if data == "validation" else "train"]
    stated = np.nan_to_num(force_noise(found.problem.model, found.problem.experiments[0].log))
    for balance, noise in zip(found.problem.model.machine.balances, stated, strict=True):
        fit = table.get(balance.name)
        if fit is None:  # not measured in these logs
            continue
        beyond = np.sqrt(max(fit.rms**2 - (ABOVE_NOISE * noise) ** 2, 0.0))
        if beyond and UNEXPLAINED * fit.rms < fit.relative * beyond and fit.relative <= 1:
            yield Diagnostic(Kind.UNEXPLAINED_ACTUATOR, (balance.name,), {"relative": fit.relative, "data": data})


def uncertain_positions(found: Identification) -> Iterator[Diagnostic]:
    """Joints whose positions are fitted, and known so little that forces depend on it."""
    model, named = found.problem.model, set[str]()
    for data in (*found.problem.experiments, *found.problem.validation):
        each = data.plotted
        if each.position_std is None:
            continue
        rows = np.flatnonzero(each.inside)
        change = model.over(model.force_by_motion, *each.inputs(rows), found.psi)[0] * each.position_std
        force, read = each.force[rows], np.isfinite(each.force[rows])
        size = np.sqrt(np.sum(np.where(read, force, 0.0) ** 2, axis=0) / np.maximum(np.sum(read, axis=0), 1))
        # (r, n), none where no force is measured
        part = np.sqrt(np.mean(change**2, axis=0)) / np.where(size > 0, size, np.inf)[:, None]
        for j, joint in enumerate(model.machine.joints):
            k = int(np.argmax(part[:, j]))
            if part[k, j] > NOT_EXACT and joint not in named:
                named.add(joint)
                slides, std = model.machine.position_unit(joint) == "m", float(each.position_std[j])
                yield Diagnostic(Kind.POSITION_ASSUMED, (joint,), {
                    "log": each.log.path or each.log.name, "actuator": model.machine.balances[k].name,
                    "part": float(part[k, j]), "std": 1e3 * std if slides else float(np.degrees(std)),
                    "unit": "mm" if slides else "deg"})


def _sampling(found: Identification) -> Iterator[Diagnostic]:
    if found.posterior is not None and not found.posterior.converged:
        yield Diagnostic(Kind.SAMPLING_NOT_CONVERGED)
    if found.intervals is Intervals.NOT_SAMPLABLE:
        yield Diagnostic(Kind.NO_INTERVALS)


def _consistency(found: Identification) -> Iterator[Diagnostic]:
    inconsistent = tuple(owner for owner, smallest in found.consistency.items() if smallest < 0)
    if inconsistent:
        yield Diagnostic(Kind.INCONSISTENT_BODIES, inconsistent,
                         {"min_eigenvalue": min(found.consistency[owner] for owner in inconsistent)})
        return
    try:
        calibrated_machine(found)
    except ProblemError as error:
        yield Diagnostic(Kind.NO_CALIBRATED_MACHINE, (), {"reason": error.what, "remedy": error.remedy})


def short_stretches(found: Identification) -> Iterator[Diagnostic]:
    """Logs that gaps split into stretches too short to smooth alone."""
    for data in found.problem.experiments:
        log = data.log
        if not isinstance(log, Log) or not any(each.kind == "gap" for each in log.findings):
            continue
        begins = np.flatnonzero(np.diff(log.segment, prepend=log.segment[0] - 1))
        median = float(np.median(np.diff(log.t[np.append(begins, log.size - 1)])))
        if len(begins) > SEVERAL and median < SHORT:
            longest = float(np.max(np.diff(log.t)[begins[1:] - 1]))
            yield Diagnostic(Kind.SHORT_STRETCHES, (log.path or log.name,), {
                "median": median, "longest": longest, "count": len(begins)})


def _findings(found: Identification) -> Iterator[Diagnostic]:
    """Findings of data quality in the logs, without the rows and columns that were left out."""
    yield from forces_not_measured(found.problem.model, (*found.problem.experiments, *found.problem.validation))
    texts = [(data.log.path or data.log.name, finding.text)
             for data in (*found.problem.experiments, *found.problem.validation) for finding in data.log.findings
             if finding.kind not in ("rows", "ignored")]
    for log, text in dict.fromkeys(texts):  # both parts of a split log have the same findings
        yield Diagnostic(Kind.FINDING, (log,), {"text": text})


def _residuals(found: Identification) -> Iterator[Diagnostic]:
    """Residuals beyond the sensors' noise, or below that of any sensor."""
    model = found.problem.model
    exact = {name: fit.relative for name, fit in found.fit["train"].items() if name != "all" and fit.relative < EXACT}
    if exact:
        yield Diagnostic(Kind.NO_SENSOR_ERRORS, tuple(exact), {"part": max(exact.values())})
    stated = force_noise(model, found.problem.experiments[0].log)
    for k, balance in enumerate(model.machine.balances):
        if np.isfinite(stated[k]) and found.sigma[k] > ABOVE_NOISE * stated[k]:
            yield Diagnostic(Kind.RESIDUALS_ABOVE_NOISE, (balance.name,),
                             {"ratio": number(found.sigma[k] / stated[k]) if stated[k] else None,
                              "noise": float(stated[k]), "unit": balance.unit})


def _repeats(found: Identification) -> Iterator[Diagnostic]:
    """Differences of friction and offsets within logs and between them."""
    weighted = found.weighted_residuals
    for data, half in zip(found.problem.experiments, weighted.split_half, strict=True):
        if half.p_value < STEADY:
            yield Diagnostic(Kind.SPLIT_HALF, (data.log.path or data.log.name,), {
                "phi": half.phi, "rank": half.rank, "p_value": half.p_value, "probability": probability(half.p_value)})
    if weighted.between_logs.p_value < STEADY:
        yield Diagnostic(Kind.DIFFERENT_LOGS, (), {"part": weighted.between_logs.std})


def _prior_conflict(found: Identification) -> Iterator[Diagnostic]:
    """Bodies, and groups of them, whose nominal values the data contradict."""
    if not found.uses_priors:
        return
    for one in found.refuted_statements:
        unit = found.problem.parameters.units[int(np.argmax(np.abs(one.statement.row)))]
        yield Diagnostic(Kind.STATEMENT_CONTRADICTED, (one.statement.name,), {
            "stated": one.statement.value, "unit": unit,
            "relation": ">=" if one.statement.at_least else "=", "value": one.value, "std": one.std, "z": one.z,
            "p_value": one.p_value})
    test, worst = found.prior_test, found.prior_test.worst
    if worst is not None and worst.p_value < CONFLICT:
        groups = body_groups(found.problem.parameters, found.problem.model.machine)
        yield Diagnostic(Kind.BODIES_CONTRADICTED, groups[worst.group], {
            "factor": worst.factor, "std": worst.std, "p_value": worst.p_value,
            "probability": probability(worst.p_value), "tests": len(test.groups)})
    elif test.p_value < CONFLICT:
        yield Diagnostic(Kind.PRIORS_CONTRADICTED, (), {"directions": test.directions, "p_value": test.p_value,
                                                        "probability": probability(test.p_value)})


def _assumptions(found: Identification) -> Iterator[Diagnostic]:
    """Priors that were assumed, and priors that are too weak for a body."""
    model = found.problem.model
    stated = owners_with_confidence(model.machine, model.bodies)
    silent = tuple(owner for owner in model.bodies if owner not in stated)
    if silent and found.uses_priors:
        yield Diagnostic(Kind.NO_CONFIDENCE_STATED, silent)
    growth = {body.owner: body.spread for body in found.problem.bodies if body.weight and body.spread > WEAK}
    if growth:
        yield Diagnostic(Kind.WEAK_LOG_DET, tuple(growth), {"growth": float(max(growth.values()))})


def _active(found: Identification) -> Iterator[Diagnostic]:
    if found.active:
        yield Diagnostic(Kind.ACTIVE_CONSTRAINTS, found.active)


def _identifiability(found: Identification) -> Iterator[Diagnostic]:
    names = found.problem.parameters.names
    not_excited = tuple(name for k, name in enumerate(names) if found.category(k) == "not excited")
    if not_excited:
        yield Diagnostic(Kind.NOT_EXCITED, not_excited)
    never = tuple(name for k, name in enumerate(names) if found.structural.category[k] == NONE)
    if never:
        yield Diagnostic(Kind.NOT_IDENTIFIABLE, never)


def _confounded(parameters: ParameterSet, found: Sequence[Confounded]) -> Iterator[Diagnostic]:
    """One diagnostic for each set of parameters that can replace one another, the smallest sets first."""
    groups: list[set[str]] = []
    for one in found:
        joined = {one.name, *one.partners}
        for group in [g for g in groups if g & joined]:
            groups.remove(group)
            joined |= group
        groups.append(joined)
    for group in sorted(groups, key=len):
        effects = sorted({_EFFECTS.get(kind := parameters.kind(name), kind.value) for name in group})
        worst = max(one.inflation for one in found if one.name in group)
        yield Diagnostic(Kind.CONFOUNDED, tuple(sorted(group)), {
            "effects": effects[0] if len(effects) == 1 else f"{', '.join(effects[:-1])} and {effects[-1]}",
            "variance_inflation": float(worst), "decades": round(float(np.log10(worst)))})
