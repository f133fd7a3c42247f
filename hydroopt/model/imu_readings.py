"""What inertial measurement units read: rates of rotation, specific forces, inclination."""

from __future__ import annotations

from collections.abc import Mapping

import casadi as ca

from hydroopt.machine.geometry import Geometry
from hydroopt.machine.sensors import ACCELEROMETER, GYROSCOPE, INCLINATION
from hydroopt.model.kinematics import UP, Motion
from hydroopt.spatial.poses import Pose, roll_pitch_yaw


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
