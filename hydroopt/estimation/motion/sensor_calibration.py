"""The answer of a calibration of sensors: where IMUs sit, biases, clocks, geometry, and the motion of each log."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import special

from hydroopt.estimation.inference.band_variances import NORMAL
from hydroopt.estimation.inference.identifiability import DETERMINED
from hydroopt.estimation.inference.stated_numbers import contradicted
from hydroopt.estimation.motion.misread import examined_fit
from hydroopt.estimation.motion.motion_fit import FittedPaths
from hydroopt.estimation.motion.observations import Observations
from hydroopt.estimation.motion.paths import Spline, motion
from hydroopt.estimation.motion.problem import SensorProblem, sensor_problem
from hydroopt.logs.poses import Poses
from hydroopt.logs.table import encoded_columns
from hydroopt.machine.calibrated_numbers import with_calibrated
from hydroopt.machine.machine import Machine
from hydroopt.machine.machine_file import dump_machine
from hydroopt.machine.parameter_kind import ParameterKind
from hydroopt.model.model import recent_model
from hydroopt.model.scene_graph import SceneGraph
from hydroopt.results.answer import Answer
from hydroopt.results.diagnostic import Diagnostic, Meaning, in_samples
from hydroopt.results.fit import Fit
from hydroopt.results.json_file import Job, MachineId
from hydroopt.results.parameter_table import ParameterTable, row
from hydroopt.results.tables import number
from hydroopt.results.verdict import Action, Claim, NextStep, Purpose, Usable, determined
from hydroopt.simulation.simulate import Trajectory, random_trajectory, simulate
from hydroopt.spatial.inertia import Array

METHOD = "continuous-time batch estimation"
LITTLE = 0.9
"""The data hardly determine a number whose standard deviation remains more than this part of that before."""
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
DURATION, RATE = 20.0, 50.0
"""Length [s] and sampling rate [Hz] of the random motion by which a machine is judged."""
NAME = "expected"
"""Of the log that is expected."""


class Channel(NamedTuple):
    """One of the channels of some observations, with its residuals in standard deviations (N,)."""

    data: Observations
    place: int
    left: Array

    @property
    def name(self) -> str:
        """Of the channel."""
        return self.data.channels[self.place]

    @property
    def used(self) -> NDArray[np.bool_]:
        """(N,) readings that count."""
        return self.data.used[:, self.place]

    @property
    def ratio(self) -> float:
        """RMS residual over the stated noise."""
        return float(np.sqrt(np.mean(self.left[self.used] ** 2)))

    @property
    def change(self) -> tuple[float, float] | None:
        """How much the mean residual of a biased channel changes over the motion: chi² and range [unit]."""
        used = np.flatnonzero(self.used)
        if not self.data.biased[self.place] or used.size < 20 * PARTS:
            return None
        parts = np.array_split(self.left[used], PARTS)
        means = np.array([part.mean() for part in parts])
        # residuals of smooth motion are almost white; what they are not widens the means
        spread = np.array([part.std() * np.sqrt(max(_whole(part), 1.0) / part.size) for part in parts])
        statistic = float(np.sum(((means - means.mean()) / spread) ** 2))
        return statistic, float(np.ptp(means) * self.data.sigma[self.place])


@dataclass(frozen=True, eq=False, repr=False)
class SensorCalibration(Answer):
    """What sensors have in common, with intervals; `hydroopt.solve` returns it.

    Attributes:
        problem: what it answers.
        found: the most probable motions and numbers.
        misread: how an IMU is misread, if that explains why the sensors do not agree.

    See `sensor_problem`.
    """

    problem: SensorProblem
    found: FittedPaths
    misread: Diagnostic | None = None

    job = Job.SENSORS

    @property
    def machine_id(self) -> MachineId:
        """Which machine it is about."""
        return MachineId.of(self.problem.machine)

    @property
    def method(self) -> str:
        """How it was computed."""
        return METHOD

    @cached_property
    def std(self) -> Array:
        """Standard deviations (p,) of the common numbers."""
        return np.sqrt(np.diag(self.found.covariance))

    @cached_property
    def parameters(self) -> ParameterTable:
        """Numbers of the geometry, then biases and clocks; ``none`` where the data hardly determine them."""
        rows = []
        for each, value, std in zip(self.found.fit.common, self.found.fit.value, self.std, strict=True):
            kind = "full" if std < DETERMINED * each.sigma else "combination" if std < LITTLE * each.sigma else "none"
            rows.append(row(each.name, each.kind, each.unit, nominal=each.prior, prior_std=each.sigma, value=value,
                            std=std, ci95=(value - NORMAL * std, value + NORMAL * std), identifiability=kind))
        return ParameterTable(rows)

    @cached_property
    def machine(self) -> Machine:
        """The machine with the calibrated numbers and their confidences; a vector keeps the largest of its own."""
        found = {each.name: (float(value), float(std)) for each, value, std in zip(
            self.found.fit.common, self.found.fit.value, self.std, strict=True)}
        return with_calibrated(self.problem.machine, found, "calibrated by motion and postures at rest")

    @cached_property
    def fit(self) -> Mapping[str, Mapping[str, Fit]]:
        """How closely each channel is followed."""
        errors: dict[str, list[Array]] = {}
        signals: dict[str, list[Array]] = {}
        for each in self._channels:
            data, used = each.data, each.used
            errors.setdefault(each.name, []).append(each.left[used] * data.sigma[each.place])
            signals.setdefault(each.name, []).append(data.values[used, each.place])
        units = self.problem.machine.channel_units
        return {"train": {name: Fit.of(np.concatenate(errors[name]), np.concatenate(signals[name]), units[name])
                          for name in errors}}

    @cached_property
    def _channels(self) -> tuple[Channel, ...]:
        """Those with readings that count, stretch by stretch."""
        fit = self.found.fit
        read = [(data, fit.left(stretch, data)) for stretch in fit.stretches for data in stretch.data]
        return tuple(Channel(data, k, left[:, k]) for data, left in read for k in range(len(data.channels))
                     if np.any(data.used[:, k]))

    @cached_property
    def diagnostics(self) -> tuple[Diagnostic, ...]:
        """Diagnostics of the calibration, the most severe first."""
        cause = () if self.misread is None else (self.misread,)
        return (*cause, *self._of_readings(), *self._of_numbers(), *self._of_positions(), *self._of_data())

    def _of_readings(self) -> Iterator[Diagnostic]:
        """Biases that change, residuals larger than stated, and sensors at the end of their range."""
        channels = self._channels
        for each in channels:
            unit, change = each.data.units[each.place], each.change
            if change is not None and len(channels) * special.chdtrc(PARTS - 1, change[0]) < SURE:
                yield Diagnostic.of("bias drifts", (each.name,), {
                    "log": each.data.name, "size": change[1], "unit": unit},
                    "The bias of {subject} changes over {log}, by {size:.2g} {unit}: it counts as constant.",
                    "Let the unit warm up, shorten the log, or state a larger noise.", Meaning.CONTRADICTION)
        for each in sorted(channels, key=lambda each: -each.ratio):
            if each.ratio > FAR and np.sum(each.used) > 5:
                yield Diagnostic.of("readings not explained by the motion", (each.name,), {
                    "log": each.data.name, "ratio": each.ratio}, (
                    "In {log}, the residuals of {subject} are {ratio:.1f} times its stated noise."),
                    "Check the accuracy of the sensor, the bandwidth of the machine, and what the machine file leaves "
                    "out.", Meaning.CONTRADICTION)
        for each in channels:
            if (share := float(np.mean(each.data.saturated[:, each.place]))) > MANY:
                yield Diagnostic.of("sensor saturated", (each.name,), {"log": each.data.name, "share": share}, (
                    "In {log}, {share:.1f %} of the readings of {subject} are at the end of its range; they do not "
                    "count."), "Choose a larger range, or drive slower.")

    def _of_numbers(self) -> Iterator[Diagnostic]:
        """Groups of common numbers that are further from what is stated than their sigmas say."""
        fit, mounting = self.found.fit, self.problem.machine.imu_numbers
        groups = ["places of the IMUs" if each.name in mounting else GROUPS.get(each.kind, "numbers of the geometry")
                  for each in fit.common]
        yield from contradicted([each.name for each in fit.common], groups,
                                (fit.value - [each.prior for each in fit.common]) / fit.sigma,
                                np.eye(len(groups)) - self.found.covariance / np.outer(fit.sigma, fit.sigma))

    def _of_positions(self) -> Iterator[Diagnostic]:
        """Joints of fitted motions whose positions are known less than identification needs."""
        machine = self.problem.machine
        for k, stretch in enumerate(self.found.fit.stretches):
            if not isinstance(stretch.path, Spline):
                continue
            std = np.sqrt(np.mean(self.found.std(k, stretch.path.support(stretch.data[0].stamped)) ** 2, axis=0))
            for joint, value in zip(machine.joints, std.tolist(), strict=True):
                slides = machine.position_unit(joint) == "m"
                if value > (COARSE_LENGTH if slides else COARSE_ANGLE):
                    yield Diagnostic.of("position of a joint uncertain", (joint,), {
                        "log": stretch.data[0].name, "std": 1e3 * value if slides else float(np.degrees(value)),
                        "unit": "mm" if slides else "deg"},
                        "In {log}, the position of {subject} is uncertain by {std:.3g} {unit} (standard deviation), "
                        "although its changes are known.",
                        "Survey points of the tip at rest, read its joint or cylinder in some postures, or measure "
                        "where its IMU sits.")

    def _of_data(self) -> Iterator[Diagnostic]:
        """What was found in the logs, and what they hardly determine."""
        for log in self.problem.logs:
            for finding in log.findings:
                if finding.kind not in ("rows", "ignored"):
                    yield in_samples(log.path or log.name, finding.text)
        if unknown := tuple(name for name, each in self.parameters.items() if each.identifiability == "none"):
            yield Diagnostic.of("not determined by motion and poses", unknown, {}, (
                "Motion and poses hardly determine {subject}: the confidence is that of the machine file."),
                "Drive other joints together, add postures at rest, or survey points of the tip.", Meaning.PROPERTY)

    @cached_property
    def claims(self) -> tuple[Claim, ...]:
        """Which corrections of sensors, and which dimensions, the data determine."""
        imus, numbers = {imu.name for imu in self.problem.machine.imus}, self.problem.machine.numbers
        return tuple(determined(
            Purpose.SENSOR if name not in numbers or name.partition(".")[0] in imus else Purpose.LENGTH, each,
            condition="95 % intervals", unknown="hardly determined by motion and postures")
            for name, each in self.parameters.items())

    @property
    def next_steps(self) -> tuple[NextStep, ...]:
        """What would determine more, or how to use it."""
        weak = [claim.of for claim in self.claims if claim.usable is Usable.NO]
        more = (NextStep(Action.DRIVE, f"For {weak[0]}, move its joint alone through its range, and rest in postures "
                                       "far apart."),) if weak else ()
        return (*more, NextStep(Action.USE, *self.using_machine))

    @property
    def inputs(self) -> tuple[Mapping[str, Any], ...]:
        """The logs and tables of poses."""
        logs = [{"path": log.path or log.name, "sha256": log.sha256 or None,
                 "samples": sum(group.size for group in log.groups), "role": "train"} for log in self.problem.logs]
        tables = [{"path": path or table.name, "sha256": table.sha256.get(path),
                   "samples": int(np.sum(table.file == path)), "role": "train"}
                  for table in self.problem.poses for path in dict.fromkeys(map(str, table.file))]
        return (*logs, *tables)

    def details(self) -> Mapping[str, Any]:
        """Steps of the solver, and residuals over stated noise by channel."""
        return {"steps": self.found.steps, "geometry": self.problem.geometry,
                "residuals_over_noise": {channel: number(ratio) for channel, ratio in self.ratios.items()}}

    @cached_property
    def ratios(self) -> dict[str, float]:
        """RMS residual of each channel over its stated noise."""
        squares: dict[str, list[float]] = {}
        for each in self._channels:
            squares.setdefault(each.name, []).extend(each.left[each.used] ** 2)
        return {name: float(np.sqrt(np.mean(values))) for name, values in squares.items()}

    @cached_property
    def scene(self) -> SceneGraph:
        """The machine's bodies and how they move together."""
        return SceneGraph(self.machine)

    @cached_property
    def motions(self) -> tuple[dict[str, Array], ...]:
        """Of each uninterrupted motion: `t` (N,) [s] at the stamps of its first group, and by joint ``.q``, ``.qd``,
        ``.qdd`` and the standard deviation ``.q_std`` (N,), in SI."""
        return tuple(self._motions())

    def _motions(self) -> Iterator[dict[str, Array]]:
        for k, stretch in enumerate(self.found.fit.stretches):
            if not isinstance(stretch.path, Spline):
                continue
            t = stretch.data[0].stamped
            support = stretch.path.support(t)
            state, std = motion(stretch.path, support)[:3], self.found.std(k, support)
            made = {"t": t}
            for j, joint in enumerate(self.problem.machine.joints):
                made |= {f"{joint}.{order}": values[:, j] for order, values in zip(("q", "qd", "qdd"), state,
                                                                                   strict=True)}
                made[f"{joint}.q_std"] = std[:, j]
            yield made

    def files(self) -> Mapping[str, str | bytes]:
        """Tables as CSV, the calibrated machine, and the motion of each stretch."""
        units = self.problem.machine.channel_units
        made: dict[str, str | bytes] = {"parameters.csv": self.parameters.to_csv(),
                                        f"{self.machine_name}.toml": dump_machine(self.marked(self.machine))}
        for k, course in enumerate(self.motions, start=1):
            columns = {f"{name} [{'s' if name == 't' else units[name.replace('_std', '')]}]": values
                       for name, values in course.items()}
            made[f"motion_{k}.csv"] = encoded_columns(columns)
        return made


def calibrate_sensors(problem: SensorProblem) -> SensorCalibration:
    """Calibrate sensors, clocks and geometry by motion and postures at rest.

    Raises:
        LogError: no channel tells the motion of a joint.
        SolverError: the fit does not converge.
    """
    return SensorCalibration(problem, *examined_fit(problem))


def expected_calibration(machine: Machine, course: Trajectory | None = None,
                         poses: Sequence[Poses] = ()) -> SensorCalibration:
    """The calibration that a motion without noise would give: its standard deviations are those to expect.

    Args:
        machine: with IMUs.
        course: to be driven; by default a random one of `DURATION`.
        poses: tables of postures at rest to be read as well.

    >>> from hydroopt.machine.machine_file import load_machine
    >>> made = expected_calibration(load_machine("excavator_imu"))
    >>> made.parameters["boom_imu.x"].std < 0.01 < made.parameters["boom_imu.x"].prior_std
    True
    """
    model = recent_model(machine)
    driven = random_trajectory(model, duration=DURATION, rate=RATE, seed=0) if course is None else course
    log = simulate(model, driven, noise=False, name=NAME)
    return calibrate_sensors(sensor_problem(machine, [log], poses, geometry=False))


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
