"""Diagnostics of a kinematic calibration."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import replace
from typing import Any

import numpy as np

from hydroopt.errors import SolverError
from hydroopt.estimation.inference.stated_numbers import contradicted
from hydroopt.estimation.kinematic.accuracy import PredictionTest
from hydroopt.estimation.kinematic.maximum_likelihood import maximum_likelihood
from hydroopt.estimation.kinematic.observability import linearise, observability
from hydroopt.estimation.kinematic.pose_faults import Suspect, SuspectKind
from hydroopt.estimation.kinematic.residuals import loop_fit, predicted
from hydroopt.estimation.kinematic.solution import JOINT, KinematicSolution, WidenedLimits
from hydroopt.machine.joint_limits import NarrowedLimits
from hydroopt.parameters.parameter_set import ParameterKind
from hydroopt.results.diagnostic import Diagnostic, Meaning, listed
from hydroopt.results.fit import Fit

OFF = 5.0
"""Distance from the most probable value, in standard deviations, from which on an estimate is off."""
LITTLE = 0.8
"""Part of the prior's standard deviation above which the data carry hardly any information."""
FAR = 3.0
"""Change in standard deviations of the prior from which on it is reported."""
FAR_LARGER, LARGE, SMALL = 10.0, 1.5, 0.5
"""Errors, relative to those stated, that make an answer suspect, and above and below which a diagnostic says so."""
HELD_OUT, CHANCE = 2.0, 1e-3
"""Error of held-out poses, relative to what their intervals state (or, without intervals, to that of training poses),
above which an answer is contradicted, unless stated errors give it with this probability or a larger one."""
ROUNDED, READING = 1e-3, 3.0
"""How far beyond the end of a stroke a pose may lie: an angle [rad] and so many standard deviations of its reading."""
FEW = 3
"""Single poses that are named one by one."""


def diagnose(solution: KinematicSolution, *, tested: PredictionTest | None, left_out: Sequence[Suspect],
             poses_left_out: int) -> Iterator[Diagnostic]:
    """All diagnostics, the most severe first.

    Args:
        solution: the calibration.
        tested: the held-out poses against their intervals; None where there are none.
        left_out: suspects whose poses were left out, and how many poses these are.
    """
    if left_out:
        where = listed([f"{suspect.kind} {suspect.name} ({suspect.place})" for suspect in left_out], 3)
        yield Diagnostic.of("poses left out", tuple(suspect.name for suspect in left_out), {
            "count": poses_left_out, "where": where},
            "{count} poses were left out because they contradict the others, which makes the fit look better than the "
            "measurement was: {where}.")
    yield from _poses(solution)
    yield from _suspects(solution)
    yield from _stated(solution)
    yield from _prediction(solution, tested)
    yield from _noise(solution)
    yield from _identifiability(solution)
    yield from _priors(solution)
    yield from _further_off(solution)
    yield from _uniqueness(solution)
    held = tuple(name for name, bound in zip(solution.problem.parameters.names, solution.at_bound, strict=True)
                 if bound)
    if held:
        yield Diagnostic.of("held at a bound", held, {}, "Held at a bound: {subject}.")
    for limits in solution.written.narrowed:
        k = solution.problem.model.joints.index(limits.joint)
        angles, least = solution.q[~solution.suspicious, k], READING * float(solution.problem.angle_sigma[k]) + ROUNDED
        beyond = 0 if limits.others else int(
            np.sum((angles < limits.after[0] - least) | (angles > limits.after[1] + least)))
        evidence = _limits(solution, limits) | {
            "cylinder": limits.cylinder, "beyond": beyond,
            "others": f" wherever {' and '.join(limits.others)} stands" if limits.others else ""}
        yield Diagnostic.of("poses beyond a stroke", (limits.joint,), evidence, (
            "With the calibrated geometry the stroke of {cylinder} moves {subject} from {after} only, but {beyond} "
            "poses lie beyond."),
            "Correct dead length and stroke of {cylinder} in the machine file.", Meaning.CONTRADICTION,
        ) if beyond else Diagnostic.of("joint limits narrowed", (limits.joint,), evidence, (
            "With the calibrated geometry the stroke of {cylinder} moves {subject} from {after}{others}. The "
            "calibrated machine has these limits instead of {before}."), meaning=Meaning.PROPERTY)
    for wider in solution.written.widened:
        sigma = float(solution.problem.angle_sigma[solution.problem.model.joints.index(wider.joint)])
        by = max(wider.before[0] - wider.after[0], wider.after[1] - wider.before[1])
        if by <= READING * sigma + ROUNDED:  # errors of readings at the end of the range
            continue
        yield Diagnostic.of("joint limits widened", (wider.joint,), _limits(solution, wider), (
            "Poses of {subject} lie beyond its limits, {before}. The calibrated machine has {after}."),
            "Check the sensor's zero.", Meaning.PROPERTY)
    if solution.written.reason:
        yield Diagnostic.of("no calibrated machine", (), {"reason": solution.written.reason.rstrip(".")}, (
            "No calibrated machine is written: {reason}."), "Correct limits in the machine file, or fix parameters.",
            Meaning.CONTRADICTION)


def _limits(solution: KinematicSolution, limits: NarrowedLimits | WidenedLimits) -> dict[str, Any]:
    """Limits of a joint before and after, in words and in its unit."""
    slides = solution.problem.model.machine.link(limits.joint).joint.type == "prismatic"
    before, after = (np.array(each) if slides else np.degrees(each) for each in (limits.before, limits.after))
    return {name: f"{low:.5g} to {high:.5g} {'m' if slides else 'deg'}" for name, (low, high) in
            (("before", before.tolist()), ("after", after.tolist()))}


def _suspects(solution: KinematicSolution) -> Iterator[Diagnostic]:
    for kind in dict.fromkeys(suspect.kind for suspect in solution.suspects):
        some = [suspect for suspect in solution.suspects if suspect.kind is kind]
        if kind is SuspectKind.POSE and len(some) > FEW:
            worst = some[0].diagnostic
            yield Diagnostic.of("single poses contradict the others", worst.subject, {
                **worst.evidence, "count": len(some)},
                "{count} single poses contradict the others; the worst is {subject} ({place}), with {strength:.1f} "
                "times the usual error.")
        else:
            yield from (suspect.diagnostic for suspect in some)


def _poses(solution: KinematicSolution) -> Iterator[Diagnostic]:
    problem, layout = solution.problem, solution.problem.layout
    idle = ~layout.present.any(axis=1)
    if np.any(idle):
        yield Diagnostic.of("poses not used", (), {
            "count": int(idle.sum()), "rows": listed([str(row) for row in problem.poses.row[idle]], 5)},
            "{count} poses name no fixture and read nothing else, so that they were not used (data rows {rows}).")
    readings = np.column_stack([layout.reading, layout.target, layout.place])
    labels = np.unique(problem.poses.stage, return_inverse=True)[1]
    twice = len(readings) - len(np.unique(np.column_stack([readings, labels]), axis=0))
    if twice:
        yield Diagnostic.of("poses repeated", (), {"count": twice}, (
            "{count} poses repeat others in every reading."),
            "If rows were copied, intervals are too narrow: remove them.")
    if solution.algorithm != JOINT:
        yield Diagnostic.of("no intervals link by link", (), {}, (
            "The link-by-link method gives no intervals."),
            "Use the method 'joint' for them.")
        off = _off_optimum(solution)
        if off:
            yield Diagnostic.of("link by link off the optimum", tuple(off), {
                "distances": listed([f"{name} (by {distance:.1f} σ)" for name, distance in off.items()], 5),
                "sigmas": list(off.values())},
                "Link by link, these lie far from the values that all poses together make most probable: {distances}.",
                "Use the method 'joint', or find what contradicts the poses.", Meaning.CONTRADICTION)


def _off_optimum(solution: KinematicSolution) -> dict[str, float]:
    """Parameters of a simpler method that are off the most probable values, and by how many of their standard
    deviations; the drift of locked joints is then free, too."""
    every = solution.problem
    drifts = {every.parameters.names[k] for k in every.parameters.places(ParameterKind.DRIFT)}
    problem = replace(every, fixed={name: value for name, value in every.fixed.items() if name not in drifts})
    with suppress(SolverError):
        theta, q = maximum_likelihood(problem, solution.theta, solution.q)
        rows = linearise(problem, theta, q)
        known = observability(problem, rows)
        freedom = max(int(rows.rank.sum()) + len(rows.shared_residual) - known.rank, 1)
        scale = np.sqrt(max(1.0, (np.sum(rows.pose_square) + np.sum(rows.shared_residual**2)) / freedom))
        away = np.abs(solution.theta - theta)[problem.free] / (known.std * scale)
        found = {name: float(distance) for name, distance in zip(known.names, away, strict=True)
                 if distance > OFF and name not in drifts}
        return dict(sorted(found.items(), key=lambda item: -item[1]))
    return {}


def _stated(solution: KinematicSolution) -> Iterator[Diagnostic]:
    """Stages whose errors disagree with what the machine file states."""
    stage, square = solution.problem.poses.stage, solution.linearised.pose_square
    scales = {label: float(np.sqrt(square[there].sum() / max(solution.linearised.rank[there].sum(), 1)))
              for label in dict.fromkeys(map(str, stage)) if np.any(there := stage == label)}
    large = {label: scale for label, scale in scales.items() if scale > LARGE}
    if large and len(large) < len(scales):
        yield Diagnostic.of("errors of a stage larger than stated", tuple(large), {
            "scales": listed([f"{label} {scale:.1f} times" for label, scale in large.items()]),
            "others": float(np.median([scale for label, scale in scales.items() if label not in large])),
            "factors": list(large.values())},
            "Errors are larger than stated in {scales}; in the other stages they are {others:.1f} times those stated.")


def _prediction(solution: KinematicSolution, tested: PredictionTest | None) -> Iterator[Diagnostic]:
    problem, nominal = solution.problem, dict[str, Fit]()
    if problem.validation is not None:
        nominal = loop_fit(*predicted(problem, problem.start, problem.validation))
    if tested is not None and tested.ratio > HELD_OUT and tested.chance < CHANCE:
        yield Diagnostic.of("held-out poses beyond their intervals", (), {
            "ratio": tested.ratio, "share": tested.coverage},
            "Errors of held-out poses are {ratio:.1f} times those that the intervals state, and only {share:.0f %} "
            "lie within 95 %: the machine moves there in a way that the model lacks, or those poses are worse.",
            "Look for the cause in those poses, or calibrate with them: the suspects are then named.",
            Meaning.CONTRADICTION)
    if "validation" not in solution.fits:
        yield Diagnostic.of("no validation poses", (), {}, (
            "No pose was held out, so that the prediction of unseen poses is not known."),
            "Give --validate, --holdout or --holdout-stage.")
    for channel, held_out in solution.fits.get("validation", {}).items():
        trained, before = solution.fits["train"].get(channel), nominal.get(channel)
        if before is not None and held_out.rms > before.rms:
            yield Diagnostic.of("held-out poses fit worse than before", (channel,), {
                "after_mm": 1e3 * held_out.rms, "before_mm": 1e3 * before.rms},
                "Held-out poses fit worse after calibration than before ({subject}: {after_mm:.3g} mm against "
                "{before_mm:.3g} mm).")
        elif tested is None and trained is not None and held_out.rms > HELD_OUT * trained.rms:
            yield Diagnostic.of("held-out poses fit worse than training poses", (channel,), {
                "ratio": held_out.rms / trained.rms},
                "Held-out poses have {ratio:.1f} times the error of the training poses ({subject}); this method has "
                "no intervals that show whether so much is to be expected.",
                "Use the method 'joint'.")


def _noise(solution: KinematicSolution) -> Iterator[Diagnostic]:
    scale = solution.noise_scale
    if not np.isfinite(scale):
        yield Diagnostic.of("no redundancy", (), {}, (
            "There are as many equations as parameters, so that the size of the errors is not known."),
            "Measure more poses.")
    elif scale > LARGE or scale < SMALL:
        far = scale > FAR_LARGER
        yield Diagnostic.of("errors far larger than stated" if far else "errors larger than stated", (), {
            "scale": scale},
            "Errors are {scale:.1f} times those stated: sensors or fixtures are worse than stated, or the geometry "
            "moves in a way that the model lacks; intervals are widened accordingly.",
            meaning=Meaning.CONTRADICTION if far else Meaning.NOTE,
        ) if scale > LARGE else Diagnostic.of("errors smaller than stated", (), {"scale": scale}, (
            "Errors are only {scale:.2f} times those stated: sensors or fixtures are better than stated; intervals "
            "follow what is stated."))


def _identifiability(solution: KinematicSolution) -> Iterator[Diagnostic]:
    for group in solution.combinations:
        yield Diagnostic.of("identifiable only together", group, {}, (
            "The poses identify only a combination of {subject}."), meaning=Meaning.PROPERTY)
    identified, gone = solution.observability, solution.without_poses
    lost = tuple(name for name, std in zip(identified.names, identified.std, strict=True)
                 if not np.isfinite(std) and name not in gone)
    if lost:
        yield Diagnostic.of("not determined", lost, {}, (
            "Neither poses nor priors determine {subject}."), meaning=Meaning.PROPERTY)
    pairs = solution.correlated_pairs
    if pairs:
        words = [f"{one} and {other} ({r:.3f})".replace("-", "−") for (one, other), r in pairs.items()]
        yield Diagnostic.of("correlated estimates", tuple(dict.fromkeys(name for pair in pairs for name in pair)), {
            "pairs": listed(words, 5), "correlations": [float(r) for r in pairs.values()]},
            "These poses hardly separate (correlation): {pairs}.", meaning=Meaning.PROPERTY)


def _priors(solution: KinematicSolution) -> Iterator[Diagnostic]:
    problem, parameters = solution.problem, solution.problem.parameters
    stated = np.diag(parameters.information) > 0
    posterior = dict(zip(solution.observability.names, np.asarray(solution.observability.std), strict=True))
    ratio, distance = dict[str, float](), dict[str, float]()
    for k in np.flatnonzero(stated & problem.free):
        name = parameters.names[k]
        ratio[name] = float(posterior[name]) / float(parameters.scale[k])
        distance[name] = abs(float(solution.theta[k] - parameters.nominal[k])) / float(parameters.scale[k])
    alone = tuple(name for name in ratio if solution.category(name) == "none" and problem.priors)
    if alone:
        yield Diagnostic.of("determined by the prior alone", alone, {}, (
            "The machine file's confidences alone determine {subject}."), meaning=Meaning.PROPERTY)
    little = tuple(name for name, part in ratio.items() if LITTLE < part < np.inf and name not in alone)
    if little:
        yield Diagnostic.of("little information beside the prior", little, {}, (
            "These poses add little to the machine file's confidences of {subject}."), meaning=Meaning.PROPERTY)
    far = sorted((name for name in distance if distance[name] > FAR and np.isfinite(ratio[name])),
                 key=lambda name: -distance[name])
    if far:
        evidence: dict[str, Any] = {"distances": listed([f"{name} (by {distance[name]:.1f} σ)" for name in far])}
        yield Diagnostic.of("far from the machine file", tuple(far),
            evidence | {"sigmas": [distance[name] for name in far]},
            "Further from the machine file than its confidences allow: {distances}.")


def _further_off(solution: KinematicSolution) -> Iterator[Diagnostic]:
    """Kinds of numbers that are further from what is stated than their sigmas say; suspects move numbers as well."""
    problem, found = solution.problem, solution.observability
    if solution.algorithm != JOINT or solution.suspects:
        return
    covariance = np.where(np.isfinite(found.covariance), found.covariance, 0.0)
    own = np.flatnonzero((np.diag(found.prior) > 0) & np.isfinite(found.std))
    sigma = 1 / np.sqrt(np.diag(found.prior)[own])
    # errors of the poses that are larger than stated move all numbers further
    more = max(1.0, solution.noise_scale) ** 2 - 1 if np.isfinite(solution.noise_scale) else 0.0
    moved = more * (covariance - covariance @ found.prior @ covariance) - covariance
    names = [found.names[k] for k in own]
    at = [problem.parameters.names.index(name) for name in names]
    yield from contradicted(names, [f"{problem.parameters.kinds[k].value}s" for k in at],
                            (solution.theta[at] - problem.parameters.nominal[at]) / sigma,
                            np.eye(len(own)) + moved[np.ix_(own, own)] / np.outer(sigma, sigma))


def _uniqueness(solution: KinematicSolution) -> Iterator[Diagnostic]:
    found = solution.uniqueness
    if found.null_directions:
        yield Diagnostic.of("solution not unique", (), {"count": found.null_directions}, (
            "The solution is not unique: {count} combinations are not identifiable."))
    elif not found.examined:
        yield Diagnostic.of("uniqueness not examined", (), {}, (
            "Other solutions were not searched for."),
            "Give --starts.")
    elif found.failed or found.worse:
        yield Diagnostic.of("initial guesses lead elsewhere", (), {"counts": str(found)}, (
            "Not all initial guesses lead to this solution: {counts}."))
