"""Inertial measurement units: where they sit on a link, and how well they measure."""

from __future__ import annotations

import math

from pydantic import Field

from hydroopt.machine.quantity import (
    Acceleration,
    AccelerationDensity,
    Angle,
    AngularRate,
    AngularRateDensity,
    Duration,
    Lengths,
    Name,
    Noun,
    Rate,
)
from hydroopt.machine.sensor import Sensor

GYROSCOPE = ("gyro_x", "gyro_y", "gyro_z")
ACCELEROMETER = ("accel_x", "accel_y", "accel_z")
INCLINATION = ("roll", "pitch")


class Gyroscope(Noun):
    """Rates of rotation."""

    noise: AngularRateDensity = Field(gt=0)
    """One-sided spectral density of the noise."""
    bias: AngularRate = Field(gt=0)
    """Standard deviation of each axis's constant error in a log."""
    range: AngularRate | None = Field(None, gt=0)
    """Largest magnitude."""


class Accelerometer(Noun):
    """Specific forces, +g upwards at rest."""

    noise: AccelerationDensity = Field(gt=0)
    """One-sided spectral density of the noise."""
    bias: Acceleration = Field(gt=0)
    """Standard deviation of each axis's constant error in a log."""
    range: Acceleration | None = Field(None, gt=0)
    """Largest magnitude."""


class Imu(Noun):
    """An inertial measurement unit on a link or on the base.

    Its channels are ``<name>.gyro_x`` to ``gyro_z`` and ``<name>.accel_x`` to ``accel_z`` along its own axes, and
    ``<name>.roll`` and ``<name>.pitch``, the inclination of its axes that some units compute themselves.

    >>> unit = Imu(name="boom_imu", link="boom", position=(1.0, 0.0, 0.0), rate=100.0,
    ...            gyroscope=Gyroscope(noise=1e-4, bias=5e-3))
    >>> unit.channels
    ('boom_imu.gyro_x', 'boom_imu.gyro_y', 'boom_imu.gyro_z')
    >>> round(unit.sensor("boom_imu.gyro_x").std, 9)
    0.000707107
    """

    name: Name
    """Name of the unit."""
    link: str
    """Link that carries it, or `base`."""
    position: Lengths
    """Place (3,) in the frame in which pins of that link are stated."""
    orientation: tuple[Angle, Angle, Angle] = (0.0, 0.0, 0.0)
    """Roll, pitch, yaw of its axes there."""
    rate: Rate = Field(gt=0)
    """Samples per second."""
    lag: Duration = Field(0.0, ge=0)
    """Time constant of a first-order system that readings of its own channels follow the true values with."""
    gyroscope: Gyroscope | None = None
    """Its gyroscope."""
    accelerometer: Accelerometer | None = None
    """Its accelerometer."""

    @property
    def channels(self) -> tuple[str, ...]:
        """The channels that it measures itself, without the inclination."""
        return (*(f"{self.name}.{axis}" for axis in GYROSCOPE if self.gyroscope),
                *(f"{self.name}.{axis}" for axis in ACCELEROMETER if self.accelerometer))

    def part(self, channel: str) -> Gyroscope | Accelerometer | None:
        """What measures a channel."""
        return self.gyroscope if channel.rpartition(".")[2] in GYROSCOPE else self.accelerometer

    def sensor(self, channel: str) -> Sensor | None:
        """What a channel is measured with: white noise of the stated density up to half of the rate."""
        if channel not in self.channels or (part := self.part(channel)) is None:
            return None
        return Sensor(channels=(channel,), accuracy=part.noise * math.sqrt(self.rate / 2), rate=self.rate,
                      lag=self.lag, distribution="gaussian")
