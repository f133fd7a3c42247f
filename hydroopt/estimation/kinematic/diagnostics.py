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
from hydroopt.results.diagnostic import Diagnostic, listed
from hydroopt.results.fit import Fit
from hydroopt.results.wording import Kind
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
        yield Diagnostic(Kind.POSES_LEFT_OUT, tuple(suspect.name for suspect in left_out),
                         {"count": poses_left_out, "where": where})
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
        yield Diagnostic(Kind.HELD_AT_BOUND, held)
    for limits in narrowed:
        k = solution.problem.model.joints.index(limits.joint)
        angles, least = solution.q[~solution.suspicious, k], READING * float(solution.problem.angle_sigma[k]) + ROUNDED
        beyond = 0 if limits.others else int(
            np.sum((angles < limits.after[0] - least) | (angles > limits.after[1] + least)))
        yield Diagnostic(Kind.STROKE_CONTRADICTS_POSES if beyond else Kind.JOINT_LIMITS_NARROWED, (limits.joint,), {
            **_limits(solution, limits), "cylinder": limits.cylinder, "beyond": beyond,
            "others": f" wherever {' and '.join(limits.others)} stands" if limits.others else ""})
    for wider in widened:
        sigma = float(solution.problem.angle_sigma[solution.problem.model.joints.index(wider.joint)])
        by = max(wider.before[0] - wider.after[0], wider.after[1] - wider.before[1])
        if by <= READING * sigma + ROUNDED:  # errors of readings at the end of the range
            continue
        yield Diagnostic(Kind.JOINT_LIMITS_WIDENED, (wider.joint,), _limits(solution, wider))
    if impossible:
        yield Diagnostic(Kind.NO_CALIBRATED_MACHINE, (), {
            "reason": impossible.rstrip("."), "remedy": "Correct limits in the machine file, or fix parameters"})


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
            yield Diagnostic(Kind.POSES_CONTRADICT, worst.subject, {**worst.evidence, "count": len(some)})
        else:
            yield from (suspect.diagnostic for suspect in some)


def _poses(solution: KinematicSolution) -> Iterator[Diagnostic]:
    problem, layout = solution.problem, solution.problem.layout
    idle = ~layout.present.any(axis=1)
    if np.any(idle):
        yield Diagnostic(Kind.POSES_NOT_USED, (), {
            "count": int(idle.sum()), "rows": listed([str(row) for row in problem.poses.row[idle]], 5)})
    readings = np.column_stack([layout.reading, layout.target, layout.place])
    labels = np.unique(problem.poses.stage, return_inverse=True)[1]
    twice = len(readings) - len(np.unique(np.column_stack([readings, labels]), axis=0))
    if twice:
        yield Diagnostic(Kind.POSES_REPEATED, (), {"count": twice})
    if solution.algorithm != JOINT:
        yield Diagnostic(Kind.NO_INTERVALS_LINK_BY_LINK)
        off = off_optimum(problem, solution.linearised, solution.noise_scale)
        if off:
            yield Diagnostic(Kind.OFF_OPTIMUM, tuple(off), {"distances": listed(
                [f"{name} (by {distance:.1f} σ)" for name, distance in off.items()], 5), "sigmas": list(off.values())})


def _stated(solution: KinematicSolution) -> Iterator[Diagnostic]:
    """Distances and stages that disagree with what the machine file states."""
    if solution.algorithm == JOINT:
        named = [suspect.name for suspect in solution.suspects if suspect.kind is SuspectKind.DISTANCE]
        for found in wrong_distances(solution.problem, solution.linearised, solution.noise_scale):
            if found.name in named:
                continue
            yield Diagnostic(Kind.DISTANCE_CONTRADICTS, found.between, {
                "one": found.between[0], "other": found.between[1],
                "measured_mm": 1e3 * found.measured, "measured_std_mm": 1e3 * found.measured_std,
                "stated_mm": 1e3 * found.stated, "stated_std_mm": 1e3 * found.stated_std})
    stage, square = solution.problem.poses.stage, solution.linearised.pose_square
    scales = {label: float(np.sqrt(square[there].sum() / max(solution.linearised.rank[there].sum(), 1)))
              for label in dict.fromkeys(map(str, stage)) if np.any(there := stage == label)}
    large = {label: scale for label, scale in scales.items() if scale > LARGE}
    if large and len(large) < len(scales):
        yield Diagnostic(Kind.STAGE_ABOVE_STATED, tuple(large), {
            "scales": listed([f"{label} {scale:.1f} times" for label, scale in large.items()]),
            "others": float(np.median([scale for label, scale in scales.items() if label not in large])),
            "factors": list(large.values())})


def _prediction(solution: KinematicSolution, nominal: Mapping[str, Fit],
                tested: PredictionTest | None) -> Iterator[Diagnostic]:
    if tested is not None and tested.ratio > HELD_OUT and tested.chance < CHANCE:
        yield Diagnostic(Kind.INTERVALS_TOO_NARROW, (), {"ratio": tested.ratio, "share": tested.coverage})
    if "validation" not in solution.fits:
        yield Diagnostic(Kind.NO_VALIDATION_POSES)
    for channel, held_out in solution.fits.get("validation", {}).items():
        trained, before = solution.fits["train"].get(channel), nominal.get(channel)
        if before is not None and held_out.rms > before.rms:
            yield Diagnostic(Kind.WORSE_THAN_NOMINAL, (channel,),
                             {"after_mm": 1e3 * held_out.rms, "before_mm": 1e3 * before.rms})
        elif tested is None and trained is not None and held_out.rms > HELD_OUT * trained.rms:
            yield Diagnostic(Kind.LARGER_ON_VALIDATION, (channel,), {"ratio": held_out.rms / trained.rms})


def _noise(solution: KinematicSolution) -> Iterator[Diagnostic]:
    scale = solution.noise_scale
    if not np.isfinite(scale):
        yield Diagnostic(Kind.NO_REDUNDANCY)
    elif scale > LARGE or scale < SMALL:
        larger = Kind.ERRORS_FAR_LARGER if scale > FAR_LARGER else Kind.ERRORS_LARGER
        kind = larger if scale > LARGE else Kind.ERRORS_SMALLER
        yield Diagnostic(kind, (), {"scale": scale})


def _identifiability(solution: KinematicSolution) -> Iterator[Diagnostic]:
    for group in solution.combinations:
        yield Diagnostic(Kind.ONLY_TOGETHER, group)
    identified, gone = solution.observability, solution.without_poses
    lost = tuple(name for name, std in zip(identified.names, identified.std, strict=True)
                 if not np.isfinite(std) and name not in gone)
    if lost:
        yield Diagnostic(Kind.NOT_DETERMINED, lost)
    pairs = solution.correlated_pairs
    if pairs:
        words = [f"{one} and {other} ({r:.3f})".replace("-", "−") for (one, other), r in pairs.items()]
        yield Diagnostic(Kind.CORRELATED_ESTIMATES, tuple(dict.fromkeys(name for pair in pairs for name in pair)),
                         {"pairs": listed(words, 5), "correlations": [float(r) for r in pairs.values()]})


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
        yield Diagnostic(Kind.PRIOR_ALONE, alone)
    little = tuple(name for name, part in ratio.items() if LITTLE < part < np.inf and name not in alone)
    if little:
        yield Diagnostic(Kind.LITTLE_BESIDE_PRIOR, little)
    far = sorted((name for name in distance if distance[name] > FAR and np.isfinite(ratio[name])),
                 key=lambda name: -distance[name])
    if far:
        evidence: dict[str, Any] = {"distances": listed([f"{name} (by {distance[name]:.1f} σ)" for name in far])}
        yield Diagnostic(Kind.FAR_FROM_FILE, tuple(far), evidence | {"sigmas": [distance[name] for name in far]})


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
        yield Diagnostic(Kind.NOT_UNIQUE, (), {"count": found.null_directions})
    elif not found.examined:
        yield Diagnostic(Kind.UNIQUENESS_NOT_EXAMINED)
    elif found.failed or found.worse:
        yield Diagnostic(Kind.OTHER_SOLUTIONS, (), {"counts": str(found)})
