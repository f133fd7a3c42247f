"""The geometry as numbers beside ψ: what the samples of one log say of it, about the motion that is being fitted.

At each sample the rows of `KinematicModel.observed` must vanish: the gap of the loop, and predicted less read lengths.
The machine's joints follow the fitted motion, whose own readings count there. The calibrator's joints belong to the
sample alone. With rows r + J·δg + B·δq + C·δc = 0, those that are read err by Σ, which gives the rows the covariance
C·Σ·Cᵀ + R, and what the others may be is projected out.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Self

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from hydroopt.errors import ProblemError
from hydroopt.estimation.dynamic.experiment import Experiment
from hydroopt.estimation.dynamic.fitted_motion import Linear
from hydroopt.estimation.dynamic.with_calibrator import fixture_of
from hydroopt.estimation.kinematic.observability import Linearised, linearise, shared_rows
from hydroopt.estimation.kinematic.problem import CalibrationProblem, calibration_problem
from hydroopt.kernels.expression_graph import program
from hydroopt.kernels.native import Runner
from hydroopt.logs.log import Log
from hydroopt.logs.poses import Poses, joined
from hydroopt.machine.calibration_chain import Stage
from hydroopt.machine.geometry import Geometry
from hydroopt.machine.machine import Machine
from hydroopt.model.closed_chain import KinematicModel
from hydroopt.model.kinematics import coordinates
from hydroopt.model.model import Model
from hydroopt.model.regressor import Dynamics
from hydroopt.spatial.inertia import Array


class ForcesByGeometry:
    """Forces (r,) of a model's machine as a function of its motion (n,), ψ (p,) and numbers g (k,) of its geometry.

    Attributes:
        function: (q, qd, qdd[, pressure], psi, g) → the forces (r,), and their derivatives by q, qd, qdd (r, n), by ψ
            (r, p) and by g (r, k); jumps of dry friction count as zero.
    """

    def __init__(self, model: Model, numbers: Sequence[str]) -> None:
        own = coordinates(model.machine)
        symbols = {name: ca.SX.sym(name) for name in numbers}
        dynamics = Dynamics(Geometry(model.machine, symbols), own, model.terms, actuator_inertia=model.actuator_inertia)
        psi, g = ca.SX.sym("psi", len(model.parameters)), ca.vertcat(ca.SX(0, 1), *symbols.values())
        pressure = {"pressure": dynamics.pressure} if model.needs_pressure else {}
        given = {**own._asdict(), **pressure, "psi": psi, "g": g}
        force = dynamics.forces(psi)
        outputs = [force, *(ca.jacobian(force, x) for x in (*own, psi, g))]
        made = ca.Function("forces_by_geometry", [*given.values()], [ca.densify(x) for x in outputs], [*given],
                           ["force", "by_q", "by_qd", "by_qdd", "by_psi", "by_g"])
        self.function = program(made).function()
        self._runner = Runner()

    def over(self, *state: Array) -> list[Array]:
        """The outputs of `function` at N samples of the motion, each (N, r, columns)."""
        return self._runner.over(self.function, *state)

    def at(self, data: Experiment, psi: Array, g: Array) -> Linear:
        """The forces of an experiment, linearised about its motion, ψ (p,) and g (k,)."""
        force, by_q, by_qd, by_qdd, by_psi, by_g = self.over(*data.inputs(), psi, g)
        right = data.force - force[:, :, 0] + by_psi @ psi + by_g @ g
        return Linear([by_q, by_qd, by_qdd], np.concatenate([by_g, by_psi], axis=2), right)


STAGE = "log"
"""Stage that the samples of all logs belong to."""


def postures(machine: Machine, experiments: Sequence[Experiment]) -> CalibrationProblem:
    """The kinematic calibration from every sample of some logs: angles, lengths, places of the tip, and the loop that a
    calibrator closes whose angles were read.

    A joint of the calibrator without readings is at rest if a stage of the machine file locks it and none moves it: its
    angle is unknown, and drifts as the stage says. Otherwise it moves.

    Raises:
        ProblemError: a log reads nothing of the geometry.
    """
    chain = KinematicModel(machine)
    every = [_of_log(chain, data.log) for data in experiments]
    return calibration_problem(_with_stage(machine, chain, every), joined(every))


def _of_log(chain: KinematicModel, log: Log) -> Poses:
    """The readings of a log that poses may have; where the calibrator's joints were read, its tip is in the fixture
    nearest to where they place it."""
    machine = chain.machine
    accurate = {name for name in log.channels if (sensor := machine.sensor(name)) is not None and sensor.std > 0}
    angles = {f"{joint}.q" for joint in chain.joints}
    units = {f"{imu.name}.{axis}" for imu in machine.imus for axis in ("accel_x", "accel_y", "accel_z")}
    rows = set(chain.channels) - units  # at rest they tell inclinations, in motion they do not
    read = {name: values for name, values in log.channels.items()
            if name in angles or (name in rows and name in accurate)}
    own = {f"{joint}.q" for joint in chain.joints[len(machine.joints):]}
    where = log.path or log.name
    if not (own | rows) & read.keys():
        raise ProblemError("the log reads nothing of the geometry but the joints' angles", where=where,
                           remedy="record the calibrator's angles or lengths of cylinders, and state their accuracy")
    known = {joint: read[f"{joint}.q"] for joint in chain.joints if f"{joint}.q" in read}
    fixture = fixture_of(chain, known, where).name if own & read.keys() else ""
    count = log.size
    return Poses(log.name, np.full(count, STAGE), np.full(count, fixture), t=log.t, channels=read,
                 units={name: log.units[name] for name in read}, file=np.full(count, where), sha256={where: log.sha256})


def _with_stage(machine: Machine, chain: KinematicModel, every: Sequence[Poses]) -> Machine:
    """The machine with a stage that says what the calibrator's joints without readings did, if it was attached."""
    if not any(np.any(poses.fixture != "") for poses in every):
        return machine.model_copy(update={"stages": (*machine.stages, Stage(name=STAGE))})
    unread = [joint for joint in chain.joints if not any(f"{joint}.q" in poses.channels for poses in every)]
    moved = {joint for stage in machine.stages for joint in stage.moves}
    locked = {joint: angle for stage in machine.stages for joint, angle in stage.locked.items()
              if joint in unread and joint not in moved}
    moves = tuple(joint for joint in unread if joint not in locked and joint not in machine.joints)
    drift = max((stage.drift for stage in machine.stages if stage.locked.keys() & locked.keys()), default=0.0)
    stage = Stage(name=STAGE, moves=moves, locked=locked, drift=drift)
    return machine.model_copy(update={"stages": (*machine.stages, stage)})


@dataclass(frozen=True, eq=False)
class LogGeometry:
    """The geometry's numbers at some values, and the samples of one log.

    Attributes:
        postures: of this log alone; its parameters are those of all logs.
        force: how forces depend on the geometry.
        theta: (P,) all parameters; those that are not fixed are the numbers.
        own: (N, c) joints of the calibrator [rad, m].
    """

    postures: CalibrationProblem
    force: ForcesByGeometry
    theta: Array
    own: Array

    @property
    def names(self) -> tuple[str, ...]:
        """Of the numbers."""
        return tuple(name for name in self.postures.parameters.names if name not in self.postures.fixed)

    @property
    def value(self) -> Array:
        """(k,) the numbers [SI]."""
        return self.theta[self.postures.free]

    @property
    def known(self) -> Array:
        """Rows (·, k+1) of what the machine file states of the numbers, and of distances between fixtures."""
        rows, left = shared_rows(self.postures, self.theta)
        by_free = rows[:, self.postures.free]
        return np.column_stack([by_free, by_free @ self.value - left])

    @property
    def unread(self) -> NDArray[np.bool_]:
        """(n,) joints of the machine whose position no channel reads itself."""
        return np.asarray(~self.postures.layout.sensed[:, : self._joints].any(axis=0))

    @cached_property
    def _joints(self) -> int:
        return len(self.postures.model.machine.joints)

    def readings(self, q: Array) -> Linear:
        """The readings about a motion (N, n) and the present numbers."""
        rows = self._linearised(q)
        by_free = rows.jacobian[:, :, self.postures.free]
        return Linear([rows.by_angles[:, :, : self._joints]], by_free, by_free @ self.value - rows.residual)

    def forces(self, data: Experiment, psi: Array) -> Linear:
        """The forces of an experiment about its motion, ψ (p,) and the present numbers."""
        geometry = len(self.postures.model.parameters)  # fixtures and locked joints come behind, and do not matter
        made = self.force.at(data, psi, self.theta[:geometry])
        every = np.zeros((*made.right.shape, len(self.theta)))
        every[:, :, :geometry], by_psi = np.split(made.by_common, [geometry], axis=2)
        held = np.where(self.postures.free, 0.0, self.theta)
        by_common = np.concatenate([every[:, :, self.postures.free], by_psi], axis=2)
        return made._replace(by_common=by_common, right=made.right - every @ held)

    def moved(self, before: Array, after: Array, value: Array) -> Self:
        """With other numbers (k,), when the motion (N, n) has moved along: the calibrator's joints follow."""
        theta = self.theta.copy()
        theta[self.postures.free] = value
        given = np.zeros(self.postures.layout.reading.shape)
        given[:, : self._joints] = after - before
        q = self._linearised(before).followed(self._given, self._angles(before), theta - self.theta, given)
        return replace(self, theta=theta, own=q[:, self._joints :])

    @cached_property
    def _given(self) -> CalibrationProblem:
        """The postures with the machine's joints neither sensed nor moving: the motion that is fitted gives them."""
        layout, own = self.postures.layout, np.arange(self.postures.layout.reading.shape[1]) >= self._joints
        return replace(self.postures, layout=replace(
            layout, sensed=layout.sensed & own, moving=layout.moving & own))

    def _angles(self, q: Array) -> Array:
        return self.postures.angles(self.theta, np.hstack([q, self.own]))

    def _linearised(self, q: Array) -> Linearised:
        return linearise(self._given, self.theta, self._angles(q))
