"""The answer of a calibration of sensors: where IMUs sit, biases, clocks, geometry, and the motion of each log."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from hydroopt.estimation.motion.diagnostics import diagnose
from hydroopt.estimation.motion.misread import examined_fit
from hydroopt.estimation.motion.motion_fit import FittedPaths
from hydroopt.estimation.motion.paths import Spline, motion
from hydroopt.estimation.motion.problem import SensorProblem
from hydroopt.logs.table import encoded_columns
from hydroopt.machine.calibrated_numbers import with_calibrated
from hydroopt.machine.machine import Machine
from hydroopt.machine.machine_file import dump_machine
from hydroopt.model.scene_graph import SceneGraph
from hydroopt.results.answer import Answer
from hydroopt.results.diagnostic import Diagnostic
from hydroopt.results.fit import Fit
from hydroopt.results.json_file import Job, MachineId
from hydroopt.results.parameter_table import ParameterTable, row
from hydroopt.results.tables import number
from hydroopt.results.verdict import Action, NextStep, Purpose, Usable, Use, determined
from hydroopt.spatial.inertia import Array

METHOD = "continuous-time batch estimation"
DETERMINED = 0.5
"""A number is identified whose standard deviation the data reduce to less than this part of that before."""
LITTLE = 0.9
"""The data hardly determine a number whose standard deviation remains more than this part of that before."""


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
                            std=std, ci95=(value - 1.96 * std, value + 1.96 * std), identifiability=kind))
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
        units: dict[str, str] = {}
        for stretch in self.found.fit.stretches:
            for data in stretch.data:
                left = self.found.fit.left(stretch, data) * data.sigma
                for k, channel in enumerate(data.channels):
                    used = data.used[:, k]
                    errors.setdefault(channel, []).append(left[used, k])
                    signals.setdefault(channel, []).append(data.values[used, k])
                    units[channel] = data.units[k]
        return {"train": {channel: Fit.of(np.concatenate(errors[channel]), np.concatenate(signals[channel]),
                                          units[channel])
                          for channel in errors if sum(map(len, errors[channel]))}}

    @cached_property
    def diagnostics(self) -> tuple[Diagnostic, ...]:
        """Diagnostics of the calibration, the most severe first."""
        unknown = [name for name, each in self.parameters.items() if each.identifiability == "none"]
        cause = () if self.misread is None else (self.misread,)
        return (*cause, *diagnose(self.problem, self.found, unknown))

    @cached_property
    def uses(self) -> tuple[Use, ...]:
        """Which corrections of sensors, and which dimensions, the data determine."""
        imus, numbers = {imu.name for imu in self.problem.machine.imus}, self.problem.machine.numbers
        return tuple(determined(
            Purpose.SENSORS if name not in numbers or name.partition(".")[0] in imus else Purpose.DIMENSIONS, each,
            condition="95 % intervals", unknown="hardly determined by motion and postures")
            for name, each in self.parameters.items())

    @property
    def next_steps(self) -> tuple[NextStep, ...]:
        """What would determine more, or how to use it."""
        weak = [use.subject for use in self.uses if use.usable is Usable.NO]
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
        for stretch in self.found.fit.stretches:
            for data in stretch.data:
                left = self.found.fit.left(stretch, data)
                for k, channel in enumerate(data.channels):
                    squares.setdefault(channel, []).extend(left[data.used[:, k], k] ** 2)
        return {channel: float(np.sqrt(np.mean(values))) for channel, values in squares.items() if values}

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
                                        f"{self.machine_name}.toml": dump_machine(self.machine)}
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
