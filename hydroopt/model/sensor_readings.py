"""What sensors read of a machine that moves, as functions of its motion and of its uncertain geometry."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence

import casadi as ca
import numpy as np

from hydroopt.kernels.expression_graph import program
from hydroopt.kernels.native import Runner
from hydroopt.machine.addresses import Number
from hydroopt.machine.geometry import Geometry
from hydroopt.machine.machine import Machine
from hydroopt.machine.sensors import ACCELEROMETER, GYROSCOPE, INCLINATION
from hydroopt.model.kinematics import UP, Motion, coordinates
from hydroopt.model.regressor import Dynamics
from hydroopt.spatial.inertia import Array
from hydroopt.spatial.poses import Pose, roll_pitch_yaw


class SensorReadings:
    """Readings of channels as functions of joints, speeds and accelerations (n,) and geometric numbers g (p,).

    Args:
        machine: the machine.
        channels: of motion: of joints (``.q``, ``.qd``, ``.qdd``), lengths of cylinders, IMUs, the tip (``tip.x``).
        free: which of the machine's geometric numbers may be unknown; those that no reading depends on are left out.

    Attributes:
        channels: as given.
        numbers: the geometric numbers g that readings depend on, in the order of the machine file.
        sigma: (p,) their stated standard deviations.

    >>> from hydroopt.machine.machine_file import load_machine
    >>> machine = load_machine("excavator_imu")
    >>> made = SensorReadings(machine, ["boom_imu.gyro_z"], machine.imu_numbers)
    >>> [number.name for number in made.numbers]
    ['boom_imu.roll', 'boom_imu.pitch', 'boom_imu.yaw']
    """

    def __init__(self, machine: Machine, channels: Sequence[str], free: Collection[str]) -> None:
        self.channels = tuple(channels)
        self._runner = Runner()
        symbols = {number.name: ca.SX.sym(number.name) for number in machine.geometry_numbers
                   if number.name in free and stated_sigma(machine, number)}
        own = coordinates(machine)
        dynamics = Dynamics(Geometry(machine, symbols), own)
        readings = _readings(dynamics)
        values = ca.vertcat(*(readings[channel] for channel in channels))
        names = [name for name, symbol in symbols.items() if ca.jacobian(values, symbol).nnz()]
        self.numbers = tuple(number for number in machine.geometry_numbers if number.name in names)
        self.sigma = np.array([stated_sigma(machine, number) for number in self.numbers], dtype=float)
        g = ca.vertcat(*(symbols[number.name] for number in self.numbers)) if names else ca.SX(0, 1)
        outputs = [values, *(ca.jacobian(values, each) for each in (*own, g))]
        made = ca.Function("sensor_readings", [*own, g], [ca.densify(out) for out in outputs],
                           ["q", "qd", "qdd", "g"], ["readings", "by_q", "by_qd", "by_qdd", "by_g"])
        self.function = program(made).function()

    def __call__(self, q: Array, qd: Array, qdd: Array, g: Array) -> tuple[Array, Array, Array, Array, Array]:
        """Readings (N, m), and their derivatives by q, qd, qdd (N, m, n) and g (N, m, p), at N states."""
        values, *by = self._runner.over(self.function, q, qd, qdd, np.broadcast_to(g, (len(q), len(g))))
        return values[:, :, 0], by[0], by[1], by[2], by[3]


def stated_sigma(machine: Machine, number: Number) -> float | None:
    """Standard deviation that the file states for a number of the geometry; None where it states none."""
    note = machine.notes.get(number.path)
    return None if note is None else note.spread(*(
        other.value for other in machine.geometry_numbers if other.path == number.path))


def _readings(dynamics: Dynamics) -> dict[str, ca.SX]:
    """All channels of motion by name."""
    geometry, machine = dynamics.geometry, dynamics.machine
    found = imu_readings(geometry, dynamics.links)
    for name, *values in zip(machine.tree_joints, *map(ca.vertsplit, dynamics.tree.values), strict=True):
        found |= dict(zip((f"{name}.q", f"{name}.qd", f"{name}.qdd"), values, strict=True))
    for cylinder in machine.cylinders:
        dead = geometry.value[f"{cylinder.name}.dead_length"]  # a transducer measures the stroke beyond it
        found[f"{cylinder.name}.length"] = (dynamics.cylinders[cylinder.name].length - dead + cylinder.dead_length)
    if machine.calibrator and machine.tracker and not machine.calibrator.links:
        link = machine.calibrator.parent
        end = dynamics.links[link].pose @ geometry.far_end(link)
        turn = roll_pitch_yaw(geometry.turn("tracker"))
        tip = turn.T @ (end.point(geometry.point("tip")) - geometry.point("tracker"))
        found |= {f"tip.{axis}": tip[k] for k, axis in enumerate("xyz")}
    return found


def imu_readings(geometry: Geometry, links: Mapping[str, Motion]) -> dict[str, ca.SX]:
    """Readings without bias [rad/s, m/s², rad] by channel, of links that move as `links` states.

    A unit at r on a link that turns with ω, whose frame accelerates with a = p̈ − g, reads ω and
    a + ω̇ × r + ω × (ω × r), both turned into its own axes. Its inclination is roll and pitch of these axes in a world
    whose z axis points up.
    """
    machine = geometry.machine
    up = roll_pitch_yaw(machine.orientation).T @ UP
    found: dict[str, ca.SX] = {}
    for imu in machine.imus:
        mounted = links[imu.link].fixed(Pose(roll_pitch_yaw(geometry.turn(imu.name)), geometry.point(imu.name)))
        x, y, z = ca.vertsplit(mounted.pose.rotation.T @ up)
        inclination = ca.vertcat(ca.atan2(y, z), ca.atan2(-x, ca.sqrt(y**2 + z**2)))
        for axes, values in ((GYROSCOPE, mounted.rotation), (ACCELEROMETER, mounted.acceleration),
                             (INCLINATION, inclination)):
            found |= {f"{imu.name}.{axis}": values[k] for k, axis in enumerate(axes)}
    return found
