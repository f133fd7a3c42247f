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
from hydroopt.results.diagnostic import Diagnostic, Meaning, in_samples, probability
from hydroopt.results.machine_diagnostics import machine_diagnostics
from hydroopt.results.tables import number

OVERFITTED = 2.0
"""Validation error, as a multiple of the training error, that is worth a diagnostic."""
NOT_EXCITED = "not excited"
"""Kind of the diagnostic of parameters that this motion does not show, but another one would."""
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
            *_assumptions(found), *_active(found), *not_identified(found),
            *_confounded(found.problem.parameters, found.confounded))


def _prediction(found: Identification) -> Iterator[Diagnostic]:
    """Prediction errors on validation data."""
    if "validation" not in found.fit:
        yield Diagnostic.of("no validation data", (), {}, (
            "No log was held out, so the prediction of unseen data is not known."),
            "Give --validate or --holdout.")
        return
    passive = {each.name for each in found.problem.model.machine.balances if not each.actuators}
    for channel, held_out in found.fit["validation"].items():
        trained = found.fit["train"].get(channel)
        if channel == "all" or trained is None:
            continue
        larger = held_out.rms > OVERFITTED * trained.rms
        if larger and 1 < held_out.relative < np.inf:  # nothing is measured at a passive joint
            yield Diagnostic.of("validation forces predicted worse than by zero", (channel,), {
                "relative": number(held_out.relative)},
                "The forces of {subject} in the validation logs are predicted worse than by zero ({relative:.0f %} "
                "error).",
                "Check signs, units and clocks of these logs, and whether they are of the same machine.",
                Meaning.CONTRADICTION)
        elif held_out.vaf < 0:
            yield Diagnostic.of("validation forces off by a constant", (channel,), {"vaf": held_out.vaf}, (
                "The forces of {subject} in the validation logs are off by a constant: their mean predicts them "
                "better than the estimate."),
                "Check the offset of the pressure or torque readings, and whether the load differs.")
        elif larger and channel not in passive:  # angles err as they move
            yield Diagnostic.of("validation error much larger than training error", (channel,), {
                "ratio": number(held_out.rms / trained.rms) if trained.rms else None},
                "The validation error of {subject} is {ratio:.1f} times the training error.",
                "The model is overfitted, or the motions differ in kind: train with more varied motion.")


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
                yield Diagnostic.of("uncertain position of a joint taken as exact", (joint,), {
                    "log": each.log.path or each.log.name, "actuator": model.machine.balances[k].name,
                    "part": float(part[k, j]), "std": 1e3 * std if slides else float(np.degrees(std)),
                    "unit": "mm" if slides else "deg"},
                    "In {log}, the position of {subject} is known to {std:.2g} {unit} only (standard deviation): it "
                    "changes the forces of {actuator} by {part:.1f %}, which masses and intervals leave out.",
                    "Survey three points of the tip, or twelve postures at rest, and calibrate the sensors with them "
                    "(--at-rest).", Meaning.CONTRADICTION)


def _sampling(found: Identification) -> Iterator[Diagnostic]:
    if found.posterior is not None and not found.posterior.converged:
        yield sampling_not_converged()
    if found.intervals is Intervals.NOT_SAMPLABLE:
        yield Diagnostic.of("no intervals", (), {}, (
            "There are no intervals, because a constraint cannot be sampled: it is a nonlinear equality, has no "
            "interior, or only cvxpy understands it. Values are the most probable ones."))


def sampling_not_converged() -> Diagnostic:
    """Intervals that cannot be relied on."""
    return Diagnostic.of("sampling not converged", (), {}, (
        "The sampling of the posterior did not converge: the intervals are not reliable."),
        "State confidences of the parameters that are not separable.", Meaning.CONTRADICTION)


def _consistency(found: Identification) -> Iterator[Diagnostic]:
    inconsistent = tuple(owner for owner, smallest in found.consistency.items() if smallest < 0)
    if inconsistent:
        yield Diagnostic.of("bodies not physically consistent", inconsistent, {
            "min_eigenvalue": min(found.consistency[owner] for owner in inconsistent)},
            "The bodies {subject} are not physically consistent. Together their parameters predict the forces, but no "
            "single one is meaningful, and no calibrated machine is written.",
            "Use the method 'sdp', which keeps bodies physically consistent.")
        return
    try:
        calibrated_machine(found)
    except ProblemError as error:
        yield Diagnostic.of("no calibrated machine", (), {"reason": error.what, "remedy": error.remedy}, (
            "No calibrated machine is written: {reason}."),
            "{remedy}.")


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
            yield Diagnostic.of("log split into short stretches", (log.path or log.name,), {
                "median": median, "longest": longest, "count": len(begins)},
                "Gaps split {subject} into stretches of {median:.2g} s in the median, too short to tell motion from "
                "noise.",
                "Smooth across the gaps, which last {longest:.2g} s at most, if no fast motion falls into them: "
                "--treat gap=keep.", Meaning.CONTRADICTION)


def _findings(found: Identification) -> Iterator[Diagnostic]:
    """Findings of data quality in the logs, without the rows and columns that were left out."""
    yield from forces_not_measured(found.problem.model, (*found.problem.experiments, *found.problem.validation))
    texts = [(data.log.path or data.log.name, finding.text)
             for data in (*found.problem.experiments, *found.problem.validation) for finding in data.log.findings
             if finding.kind not in ("rows", "ignored")]
    for log, text in dict.fromkeys(texts):  # both parts of a split log have the same findings
        yield in_samples(log, text)


def _residuals(found: Identification) -> Iterator[Diagnostic]:
    """Residuals beyond the sensors' noise, or below that of any sensor."""
    model = found.problem.model
    exact = {name: fit.relative for name, fit in found.fit["train"].items() if name != "all" and fit.relative < EXACT}
    if exact:
        yield Diagnostic.of("no sensor errors in the log", tuple(exact), {"part": max(exact.values())}, (
            "The model explains the forces of {subject} to {part:.1g} of their size. No sensor reads so well: the log "
            "was simulated without errors of sensors, and all intervals are those of such a log."),
            "State the accuracy of the sensors in [[sensors]] of the machine file, and simulate again.")
    stated = force_noise(model, found.problem.experiments[0].log)
    for k, balance in enumerate(model.machine.balances):
        if np.isfinite(stated[k]) and found.sigma[k] > ABOVE_NOISE * stated[k]:
            yield Diagnostic.of("residuals above the sensors' noise", (balance.name,), {
                "ratio": number(found.sigma[k] / stated[k]) if stated[k] else None, "noise": float(stated[k]),
                "unit": balance.unit},
                "The residuals of {subject} are {ratio:.1f} times its sensors' noise of {noise:.3g} {unit}.",
                "Angles are noisy, or the model lacks an effect: see the figure of the residuals.")


def _repeats(found: Identification) -> Iterator[Diagnostic]:
    """Differences of friction and offsets within logs and between them."""
    weighted = found.weighted_residuals
    for data, half in zip(found.problem.experiments, weighted.split_half, strict=True):
        if half.p_value < STEADY:
            yield Diagnostic.of("halves of a log differ", (data.log.path or data.log.name,), {
                "phi": half.phi, "rank": half.rank, "p_value": half.p_value, "probability": probability(half.p_value)},
                "Friction and offsets in the two halves of {subject} differ by {phi:.1f} times what noise explains "
                "({probability}); a repeat may differ by as much, which the intervals do not include.",
                "Record several logs, whose differences then widen the intervals, and let the machine warm up.")
    if weighted.between_logs.p_value < STEADY:
        yield Diagnostic.of("logs differ", (), {"part": weighted.between_logs.std}, (
            "Friction and offsets differ from log to log by {part:.0f %} of the friction force (standard deviation): "
            "the intervals are those of their mean."),
            "Compare the logs in time order with `hydroopt compare`, which states a step or drift beyond their "
            "scatter.")


def _prior_conflict(found: Identification) -> Iterator[Diagnostic]:
    """Bodies, and groups of them, whose nominal values the data contradict."""
    if not found.uses_priors:
        return
    for one in found.refuted_statements:
        unit = found.problem.parameters.units[int(np.argmax(np.abs(one.statement.row)))]
        yield Diagnostic.of("statement contradicted", (one.statement.name,), {
            "stated": one.statement.value, "unit": unit, "relation": ">=" if one.statement.at_least else "=",
            "value": one.value, "std": one.std, "z": one.z, "p_value": one.p_value},
            "'{subject}' ({relation} {stated:.6g} {unit}) contradicts machine file and logs: without it, the value is "
            "{value:.6g} ± {std:.2g} {unit}, {z:.1f} standard deviations away.",
            "Correct the statement, or widen the sigmas of these parameters in the machine file.",
            Meaning.CONTRADICTION)
    test, worst = found.prior_test, found.prior_test.worst
    if worst is not None and worst.p_value < CONFLICT:
        groups = body_groups(found.problem.parameters, found.problem.model.machine)
        yield Diagnostic.of("prior of bodies contradicted", groups[worst.group], {
            "factor": worst.factor, "std": worst.std, "p_value": worst.p_value,
            "probability": probability(worst.p_value), "tests": len(test.groups)},
            "The logs contradict the nominal bodies of {subject}: a factor of {factor:.2f} ± {std:.2f} on all of "
            "their parameters together would agree ({probability}, corrected for {tests} tests).",
            "Check these bodies and their sigmas in the machine file, and scales and signs of the force readings.",
            Meaning.CONTRADICTION)
    elif test.p_value < CONFLICT:
        yield Diagnostic.of("priors contradicted", (), {
            "directions": test.directions, "p_value": test.p_value, "probability": probability(test.p_value)},
            "The logs contradict the priors of the machine file: {directions} combinations of parameters together "
            "({probability}); no single body explains it.",
            "Check the sigmas of the machine file, scales and offsets of the sensors, and the friction terms.",
            Meaning.CONTRADICTION)


def _assumptions(found: Identification) -> Iterator[Diagnostic]:
    """Priors that were assumed, and priors that are too weak for a body."""
    model = found.problem.model
    stated = owners_with_confidence(model.machine, model.bodies)
    silent = tuple(owner for owner in model.bodies if owner not in stated)
    if silent and found.uses_priors:
        yield Diagnostic.of("no confidence stated", silent, {}, (
            "The machine file states no confidence of {subject}: 100 % of their size is assumed."),
            "State how well their masses and centres of mass are known.", Meaning.PROPERTY)
    growth = {body.owner: body.spread for body in found.problem.bodies if body.weight and body.spread > WEAK}
    if growth:
        yield Diagnostic.of("weak log-det distance", tuple(growth), {"growth": float(max(growth.values()))}, (
            "The log-det distance of {subject} is weak: before any data the mean of the bodies is up to {growth:.0f} "
            "times the nominal one."),
            "State the confidence of their masses, at most 30 %.", Meaning.PROPERTY)


def _active(found: Identification) -> Iterator[Diagnostic]:
    if found.active:
        yield Diagnostic.of("active constraints", found.active, {}, (
            "Active at the most probable parameters: {subject}."), meaning=Meaning.PROPERTY)


def not_identified(found: Identification) -> Iterator[Diagnostic]:
    """Parameters that this motion, or any motion, does not show."""
    names = found.problem.parameters.names
    not_excited = tuple(name for k, name in enumerate(names) if found.category(k) == "not excited")
    if not_excited:
        yield Diagnostic.of(NOT_EXCITED, not_excited, {}, (
            "The machine could identify {subject}, which this motion does not excite."),
            "Drive a motion that `hydroopt excite` designs.", Meaning.PROPERTY)
    never = tuple(name for k, name in enumerate(names) if found.structural.category[k] == NONE)
    if never:
        yield Diagnostic.of("not identifiable", never, {}, (
            "No motion of this machine identifies {subject}."), meaning=Meaning.PROPERTY)


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
        yield Diagnostic.of("not separable in this motion", tuple(sorted(group)), {
            "effects": effects[0] if len(effects) == 1 else f"{', '.join(effects[:-1])} and {effects[-1]}",
            "variance_inflation": float(worst), "decades": round(float(np.log10(worst)))},
            "Not separable in this motion: {effects} ({subject}), whose variances are up to 10^{decades} times what "
            "they would be if the others were known.",
            "The data determine their joint effect only, and the priors the rest: reverse the motion, vary its speed "
            "and range, or state what is known.", Meaning.PROPERTY)
