"""Diagnostics of a kinematic calibration."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from hydroopt.estimation.inference.identifiability import INFORMATION_TOLERANCE, significant
from hydroopt.estimation.inference.stated_numbers import contradicted
from hydroopt.estimation.kinematic.accuracy import PredictionTest
from hydroopt.estimation.kinematic.observability import Linearised
from hydroopt.estimation.kinematic.pose_faults import Suspect, SuspectKind
from hydroopt.estimation.kinematic.problem import CalibrationProblem
from hydroopt.estimation.kinematic.solution import JOINT, KinematicSolution, WidenedLimits
from hydroopt.machine.joint_limits import NarrowedLimits
from hydroopt.parameters.parameter_set import ParameterKind
from hydroopt.results.diagnostic import Diagnostic, Meaning, listed
from hydroopt.results.fit import Fit
from hydroopt.spatial.inertia import Array

CONTRADICTS = 4.0
"""Difference, in standard deviations, from which on a stated distance is contradicted."""
OFF = 5.0
"""Distance from the most probable value, in standard deviations, from which on an estimate is off."""


class WrongDistance(NamedTuple):
    """A distance between fixtures [m] as stated and as the poses alone show it, with standard deviations."""

    name: str
    between: tuple[str, str]
    stated: float
    stated_std: float
    measured: float
    measured_std: float


def wrong_distances(problem: CalibrationProblem, linearised: Linearised, noise_scale: float) -> Iterator[WrongDistance]:
    """Distances that the poses contradict; one that several stages show counts by its mean.

    With the leverages H of its rows, the poses without them show the distance by ``(I − H)⁻¹·r`` standard deviations
    beside the stated one, with the covariance ``H·(I − H)⁻¹``.
    """
    free, known = np.flatnonzero(problem.free), problem.distances
    rows = np.vstack([linearised.jacobian[:, :, free].reshape(-1, len(free)), linearised.shared[:, free]])
    if not len(known.length):
        return
    left, s, _ = np.linalg.svd(rows * problem.parameters.scale[free], full_matrices=False)
    left = left[:, s > 1e-9 * s[0]]
    start, names = rows.shape[0] - len(linearised.shared), problem.parameters.names
    ends = [tuple(names[side[0]].partition(".")[0] for side in pair) for pair in known.ends]
    scale = max(1.0, noise_scale) if np.isfinite(noise_scale) else 1.0
    for name in dict.fromkeys(known.names):
        own = [k for k, each in enumerate(known.names) if each == name]
        part = left[[start + k for k in own]]
        leverage = part @ part.T
        values, vectors = np.linalg.eigh(np.eye(len(own)) - leverage)
        if values[0] < 1e-6:  # the poses say nothing without it
            continue
        inverse = vectors / values @ vectors.T
        sigma, mean = float(known.sigma[own[0]]), np.full(len(own), 1 / len(own))
        difference = sigma * float(mean @ inverse @ linearised.shared_residual[own])
        std = sigma * scale * float(np.sqrt(max(mean @ (leverage @ inverse) @ mean, 0.0)))
        if abs(difference) > CONTRADICTS * np.hypot(sigma, std):
            stated = float(known.length[own[0]])
            one, other = ends[own[0]]
            yield WrongDistance(name, (one, other), stated, sigma, stated + difference, std)


def off_optimum(problem: CalibrationProblem, linearised: Linearised, noise_scale: float) -> dict[str, float]:
    """Parameters that are off the most probable values, and by how many of their standard deviations.

    Args:
        problem: also with the drift of locked joints, which simpler methods take as zero.
        linearised: rows about a simpler estimate.
        noise_scale: of its residuals.
    """
    free = problem.free
    free[problem.parameters.places(ParameterKind.DRIFT)] = True
    some = np.flatnonzero(free)
    rows = np.vstack([linearised.jacobian[:, :, some].reshape(-1, len(some)), linearised.shared[:, some]])
    residual = np.concatenate([linearised.residual.ravel(), linearised.shared_residual])
    size = np.linalg.norm(rows, axis=0)
    size = np.where(size > 0, size, 1.0)
    values, vectors = np.linalg.eigh((rows / size).T @ (rows / size))
    good = significant(values, INFORMATION_TOLERANCE)
    half: Array = vectors[:, good] / np.sqrt(values[good])
    step = -half @ (half.T @ ((rows / size).T @ residual))
    freedom = max(len(residual) - len(problem.parameters.names) - int(good.sum()), 1)
    left = residual + rows / size @ step
    scale = max(1.0, min(noise_scale, float(np.sqrt(left @ left / freedom))))
    away = np.abs(step) / np.maximum(np.linalg.norm(half, axis=1) * scale, 1e-300)
    lost = np.linalg.norm(vectors[:, ~good], axis=1) > 1e-5
    found = {problem.parameters.names[k]: float(distance) for k, distance, unknown in zip(some, away, lost, strict=True)
             if not unknown and distance > OFF and problem.free[k]}
    return dict(sorted(found.items(), key=lambda item: -item[1]))


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


def diagnose(solution: KinematicSolution, *, nominal_prediction: Mapping[str, Fit], tested: PredictionTest | None,
             impossible: str, narrowed: Sequence[NarrowedLimits], widened: Sequence[WidenedLimits],
             left_out: Sequence[Suspect], poses_left_out: int) -> Iterator[Diagnostic]:
    """All diagnostics, the most severe first.

    Args:
        solution: the calibration.
        nominal_prediction: fit of the held-out poses by the nominal geometry, by channel.
        tested: the held-out poses against their intervals; None where there are none.
        impossible: why no machine can have the geometry; "" where one can.
        narrowed: joint limits of the calibrated machine that gave way to strokes.
        widened: joint limits of the calibrated machine that gave way to poses.
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
    yield from _prediction(solution, nominal_prediction, tested)
    yield from _noise(solution)
    yield from _identifiability(solution)
    yield from _priors(solution)
    yield from _further_off(solution)
    yield from _uniqueness(solution)
    held = tuple(name for name, bound in zip(solution.problem.parameters.names, solution.at_bound, strict=True)
                 if bound)
    if held:
        yield Diagnostic.of("held at a bound", held, {}, "Held at a bound: {subject}.")
    for limits in narrowed:
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
    for wider in widened:
        sigma = float(solution.problem.angle_sigma[solution.problem.model.joints.index(wider.joint)])
        by = max(wider.before[0] - wider.after[0], wider.after[1] - wider.before[1])
        if by <= READING * sigma + ROUNDED:  # errors of readings at the end of the range
            continue
        yield Diagnostic.of("joint limits widened", (wider.joint,), _limits(solution, wider), (
            "Poses of {subject} lie beyond its limits, {before}. The calibrated machine has {after}."),
            "Check the sensor's zero.", Meaning.PROPERTY)
    if impossible:
        yield Diagnostic.of("no calibrated machine", (), {
            "reason": impossible.rstrip("."), "remedy": "Correct limits in the machine file, or fix parameters"},
            "No calibrated machine is written: {reason}.", "{remedy}.", Meaning.CONTRADICTION)


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
        off = off_optimum(problem, solution.linearised, solution.noise_scale)
        if off:
            yield Diagnostic.of("link by link off the optimum", tuple(off), {
                "distances": listed( [f"{name} (by {distance:.1f} σ)" for name, distance in off.items()], 5),
                "sigmas": list(off.values())},
                "Link by link, these lie far from the values that all poses together make most probable: {distances}.",
                "Use the method 'joint', or find what contradicts the poses.", Meaning.CONTRADICTION)


def _stated(solution: KinematicSolution) -> Iterator[Diagnostic]:
    """Distances and stages that disagree with what the machine file states."""
    if solution.algorithm == JOINT:
        named = [suspect.name for suspect in solution.suspects if suspect.kind is SuspectKind.DISTANCE]
        for found in wrong_distances(solution.problem, solution.linearised, solution.noise_scale):
            if found.name in named:
                continue
            yield Diagnostic.of("distance contradicts the machine file", found.between, {
                "one": found.between[0], "other": found.between[1], "measured_mm": 1e3 * found.measured,
                "measured_std_mm": 1e3 * found.measured_std, "stated_mm": 1e3 * found.stated,
                "stated_std_mm": 1e3 * found.stated_std},
                "The poses place {one} and {other} {measured_mm:.2f} ± {measured_std_mm:.2f} mm apart (one standard "
                "deviation), where the machine file states {stated_mm:.2f} ± {stated_std_mm:.2f} mm.",
                "Measure the distance again, or state its sigma.", Meaning.CONTRADICTION)
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


def _prediction(solution: KinematicSolution, nominal: Mapping[str, Fit],
                tested: PredictionTest | None) -> Iterator[Diagnostic]:
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
