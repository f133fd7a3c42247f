"""What a reader should know of fitted motion before trusting it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from scipy import special

from hydroopt.estimation.inference.stated_numbers import contradicted
from hydroopt.estimation.motion.motion_fit import FittedPaths
from hydroopt.estimation.motion.observations import Observations
from hydroopt.estimation.motion.paths import Spline
from hydroopt.estimation.motion.problem import SensorProblem
from hydroopt.machine.parameter_kind import ParameterKind
from hydroopt.results.diagnostic import Diagnostic, Meaning, in_samples
from hydroopt.spatial.inertia import Array

PARTS = 8
"""Parts of a motion over which a bias should stay the same."""
SURE = 1e-6
"""Probability, over all channels, below which a bias counts as changing."""
FAR = 1.5
"""Residuals that are so many times the stated noise are worth a sentence."""
COARSE_ANGLE, COARSE_LENGTH = float(np.radians(0.5)), 5e-3
"""Uncertainty of a joint's position [rad, m] that is worth a sentence."""
GROUPS = {ParameterKind.BIAS: "biases", ParameterKind.DELAY: "delays", ParameterKind.CLOCK_DRIFT: "drifts of clocks",
          ParameterKind.LAG: "lags"}
MANY = 0.001
"""Part of the readings at the end of a sensor's range that is worth a sentence."""


def diagnose(problem: SensorProblem, found: FittedPaths, unknown: Sequence[str]) -> Iterator[Diagnostic]:
    """The most severe first; `unknown` are numbers that the data hardly determine."""
    pairs = [(stretch, data) for stretch in found.fit.stretches for data in stretch.data]
    far, drifting, full = [], [], []
    for stretch, data in pairs:
        left = found.fit.left(stretch, data)
        for k, channel in enumerate(data.channels):
            used = data.used[:, k]
            if not np.any(used):
                continue
            ratio = float(np.sqrt(np.mean(left[used, k] ** 2)))
            if ratio > FAR and np.sum(used) > 5:
                far.append((ratio, channel, data))
            if (share := float(np.mean(data.saturated[:, k]))) > MANY:
                full.append((share, channel, data))
            if data.biased[k] and (change := _changes(data, left[:, k], k)):
                drifting.append((change, channel, data))
    tests = sum(len(data.channels) for _, data in pairs)
    for (statistic, size, free), channel, data in drifting:
        if tests * special.chdtrc(free, statistic) < SURE:
            yield Diagnostic.of("bias drifts", (channel,), {
                "log": data.name, "size": size, "unit": data.units[data.channels.index(channel)]},
                "The bias of {subject} changes over {log}, by {size:.2g} {unit}: it counts as constant.",
                "Let the unit warm up, shorten the log, or state a larger noise.", Meaning.CONTRADICTION)
    for ratio, channel, data in sorted(far, key=lambda each: -each[0]):
        yield Diagnostic.of("readings not explained by the motion", (channel,), {"log": data.name, "ratio": ratio}, (
            "In {log}, the residuals of {subject} are {ratio:.1f} times its stated noise."),
            "Check the accuracy of the sensor, the bandwidth of the machine, and what the machine file leaves out.",
            Meaning.CONTRADICTION)
    for share, channel, data in full:
        yield Diagnostic.of("sensor saturated", (channel,), {"log": data.name, "share": share}, (
            "In {log}, {share:.1f %} of the readings of {subject} are at the end of its range; they do not count."),
            "Choose a larger range, or drive slower.")
    yield from _contradicted(problem, found)
    yield from _uncertain(problem, found)
    for log in problem.logs:
        for finding in log.findings:
            if finding.kind not in ("rows", "ignored"):
                yield in_samples(log.path or log.name, finding.text)
    if unknown:
        yield Diagnostic.of("not determined by motion and poses", tuple(unknown), {}, (
            "Motion and poses hardly determine {subject}: the confidence is that of the machine file."),
            "Drive other joints together, add postures at rest, or survey points of the tip.", Meaning.PROPERTY)


def _uncertain(problem: SensorProblem, found: FittedPaths) -> Iterator[Diagnostic]:
    """Joints of fitted motions whose positions are known less than identification needs."""
    machine = problem.machine
    for k, stretch in enumerate(found.fit.stretches):
        if not isinstance(stretch.path, Spline):
            continue
        std = np.sqrt(np.mean(found.std(k, stretch.path.support(stretch.data[0].stamped)) ** 2, axis=0))
        for joint, value in zip(machine.joints, std.tolist(), strict=True):
            slides = machine.position_unit(joint) == "m"
            if value > (COARSE_LENGTH if slides else COARSE_ANGLE):
                yield Diagnostic.of("position of a joint uncertain", (joint,), {
                    "log": stretch.data[0].name, "std": 1e3 * value if slides else float(np.degrees(value)),
                    "unit": "mm" if slides else "deg"},
                    "In {log}, the position of {subject} is uncertain by {std:.3g} {unit} (standard deviation), "
                    "although its changes are known.",
                    "Survey points of the tip at rest, read its joint or cylinder in some postures, or measure where "
                    "its IMU sits.")


def _contradicted(problem: SensorProblem, found: FittedPaths) -> Iterator[Diagnostic]:
    """Groups of common numbers that are further from what is stated than their sigmas say."""
    common = found.fit.common
    mounting = problem.machine.imu_numbers
    groups = ["places of the IMUs" if each.name in mounting else GROUPS.get(each.kind, "numbers of the geometry")
              for each in common]
    yield from contradicted([each.name for each in common], groups,
                            (found.fit.value - [each.prior for each in common]) / found.fit.sigma,
                            np.eye(len(common)) - found.covariance / np.outer(found.fit.sigma, found.fit.sigma))


def _changes(data: Observations, left: Array, k: int) -> tuple[float, float, int] | None:
    """How much the mean residual of a channel changes over the motion: chi², range [unit], and degrees of freedom."""
    used = np.flatnonzero(data.used[:, k])
    if used.size < 20 * PARTS:
        return None
    parts = np.array_split(left[used], PARTS)
    means = np.array([part.mean() for part in parts])
    # residuals of smooth motion are almost white; what they are not widens the means
    spread = np.array([part.std() * np.sqrt(max(_whole(part), 1.0) / part.size) for part in parts])
    statistic = float(np.sum(((means - means.mean()) / spread) ** 2))
    return statistic, float(np.ptp(means) * data.sigma[k]), PARTS - 1


def _whole(values: Array) -> float:
    """How many samples count as one: sum of the correlations up to the first that vanishes."""
    centred = values - values.mean()
    total, size = 1.0, float(centred @ centred)
    for lag in range(1, min(200, centred.size // 4)):
        r = float(centred[lag:] @ centred[:-lag]) / size
        if r < 0.05:
            break
        total += 2 * r
    return total
