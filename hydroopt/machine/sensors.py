"""What channels are measured with: sensors, inertial measurement units, rangefinders, usual sizes of their faults."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from difflib import get_close_matches
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from hydroopt.machine.quantity import (
    CHANNEL_UNITS,
    Acceleration,
    AccelerationDensity,
    Angle,
    AngularRate,
    AngularRateDensity,
    Duration,
    ImpossibleError,
    Length,
    Lengths,
    Noun,
    Number,
    Part,
    Rate,
    Reading,
)

LAGGING = ("q", "qd", "qdd", "length", "tau", "force", "p_head", "p_rod", "p_a", "p_b", "roll", "pitch",
           "gyro_x", "gyro_y", "gyro_z", "accel_x", "accel_y", "accel_z")
"""Endings of the channels whose lag counts."""


class Lag(NamedTuple):
    """How a channel's readings lag: a name, which all channels of a sensor or IMU have in common, the time constant [s]
    and its standard deviation, 0 where it is known."""

    name: str = ""
    value: float = 0.0
    sigma: float = 0.0


class Sensor(Noun):
    """What a set of channels is measured with."""

    channels: tuple[str, ...] = Field(min_length=1)
    """Channels, all of one unit."""
    accuracy: Reading = Field(ge=0)
    """Bound of a uniform error, or standard deviation of a Gaussian one, in the channels' unit."""
    resolution: Reading = Field(0.0, ge=0)
    """Step of the reading, in the channels' unit."""
    rate: Rate | None = Field(None, gt=0)
    """Samples per second."""
    lag: Duration = Field(0.0, ge=0)
    """Time constant of a first-order system that readings follow the true values with."""
    distribution: Literal["uniform", "gaussian"] = "uniform"
    """Distribution of the error."""

    def _mistakes(self) -> Iterator[ImpossibleError]:
        endings = {channel: channel.rpartition(".")[2] for channel in self.channels}
        for unknown in [name for name, ending in endings.items() if ending not in CHANNEL_UNITS]:
            part, _, quantity = unknown.rpartition(".")
            close = get_close_matches(quantity, CHANNEL_UNITS, 1)
            yield ImpossibleError(f"'{unknown}' is the name of no channel", f"did you mean '{part}.{close[0]}'"
                                  if close else "write a part and a quantity, as 'boom.q' or 'boom_cylinder.p_head'",
                                  "channels")
        if len({CHANNEL_UNITS[ending] for ending in endings.values()}) > 1:
            yield ImpossibleError(f"the channels {', '.join(self.channels)} have no unit in common",
                                  "state angles, lengths and pressures in a [[sensors]] entry each", "channels")
        idle = [channel for channel in self.channels if channel.rpartition(".")[2] not in LAGGING]
        if self.lag and idle:
            yield ImpossibleError(f"a lag of '{idle[0]}' has no meaning here",
                                  f"state it for channels that end in .{', .'.join(LAGGING)}", "lag")

    @property
    def std(self) -> float:
        """Standard deviation of one reading, noise and quantisation together.

        A uniform band ±a has variance a²/3, a quantisation step r (spread over several steps) r²/12.
        """
        noise = self.accuracy / math.sqrt(3) if self.distribution == "uniform" else self.accuracy
        return math.hypot(noise, self.resolution / math.sqrt(12))

    def read(self, true: NDArray[np.float64], rng: np.random.Generator | None) -> NDArray[np.float64]:
        """Readings of true values (any shape), with noise, then in steps of the resolution; without `rng` the
        true values."""
        if rng is None:
            return true
        half = self.accuracy
        noise = rng.uniform(-half, half, true.shape) if self.distribution == "uniform" else rng.normal(
            0.0, half, true.shape)
        read = true + noise
        return np.round(read / self.resolution) * self.resolution if self.resolution > 0 else read


class Measuring(Part):
    """A part that poses are measured with, with channels of its own."""


    def channel_units(self, targets: Sequence[str]) -> dict[str, str]:
        """Its channels in a log or a table of poses, with their SI units; `targets` are the names of all targets."""
        raise NotImplementedError

    def sensor(self, channel: str) -> Sensor | None:
        """What a channel is measured with, where the part itself states it."""


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


class Imu(Measuring):
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

    def channel_units(self, targets: Sequence[str]) -> dict[str, str]:
        """Those of `channels`, and of the inclination."""
        return {channel: CHANNEL_UNITS[channel.rpartition(".")[2]][0]
                for channel in (*self.channels, *(f"{self.name}.{angle}" for angle in INCLINATION))}

    def part(self, channel: str) -> Gyroscope | Accelerometer | None:
        """What measures a channel."""
        return self.gyroscope if channel.rpartition(".")[2] in GYROSCOPE else self.accelerometer

    def sensor(self, channel: str) -> Sensor | None:
        """What a channel is measured with: white noise of the stated density up to half of the rate."""
        if channel not in self.channels or (part := self.part(channel)) is None:
            return None
        return Sensor(channels=(channel,), accuracy=part.noise * math.sqrt(self.rate / 2), rate=self.rate,
                      lag=self.lag, distribution="gaussian")


class _Ranging(Sensor):
    """What reads positive values up to the `largest`, and nothing else."""

    largest: Length

    def read(self, true: NDArray[np.float64], rng: np.random.Generator | None) -> NDArray[np.float64]:
        """As of any sensor; NaN where nothing is read."""
        return np.where((true > 0) & (true <= self.largest), super().read(true, rng), np.nan)


class Rangefinder(Measuring):
    """A laser on a link or on the base that reads the distance to the level ground, at the height `ground`.

    Poses read in the column ``<name>.length`` how far the ground is along the beam; they read nothing where the beam
    points away from it or its `range` ends before.

    >>> Rangefinder(name="stick_laser", link="stick", position=(1, 0, 0), direction=(1, 0.1, 0), accuracy="2 mm",
    ...             range="30 m").across
    ('y', 'z')
    """

    link: str
    """Link that carries it, or `base`."""
    position: Lengths
    """Where distances start (3,), in the frame in which pins of that link are stated."""
    direction: tuple[Number, Number, Number]
    """Direction of the beam there (3,), of any length. Its largest component is exact: the others turn the beam."""
    accuracy: Length = Field(gt=0)
    """Standard deviation of a reading."""
    range: Length = Field(gt=0)
    """Largest distance that it reads."""

    def _mistakes(self) -> Iterator[ImpossibleError]:
        if not any(self.direction):
            yield ImpossibleError(f"the beam of '{self.name}' has no direction", "state one other than zero",
                                  "direction")

    @property
    def across(self) -> tuple[str, ...]:
        """The two axes whose components of `direction` a calibration may change."""
        sizes = dict(zip("xyz", map(abs, self.direction), strict=True))
        return tuple(axis for axis in sizes if axis != max(sizes, key=sizes.__getitem__))

    @property
    def channel(self) -> str:
        """What it reads."""
        return f"{self.name}.length"

    def channel_units(self, targets: Sequence[str]) -> dict[str, str]:
        """That of `channel`."""
        return {self.channel: "m"}

    def sensor(self, channel: str) -> Sensor | None:
        """Gaussian errors within its range."""
        return _Ranging(channels=(channel,), accuracy=self.accuracy, distribution="gaussian",
                        largest=self.range) if channel == self.channel else None


class FaultSizes(Noun):
    """Standard deviations of faults; what is not stated has a usual size.

    >>> FaultSizes(delay="10 ms", gain="2 %").gain
    0.02
    """

    delay: Duration | None = Field(None, gt=0)
    """Delay of readings."""
    lag: Duration | None = Field(None, gt=0)
    """Lag of readings."""
    clock: Duration | None = Field(None, gt=0)
    """Drift of one clock against the other over a log."""
    tilt: Angle | None = Field(None, gt=0)
    """Tilt of the base."""
    offset: Angle | None = Field(None, gt=0)
    """Offset of an angle."""
    play: Angle | None = Field(None, gt=0)
    """Play of a joint against its sensor."""
    gain: Number | None = Field(None, gt=0)
    """Error of a force reading's gain, as a part of it; intervals of `identify` and `weigh` contain it if stated."""
    drift: Number | None = Field(None, gt=0)
    """Drift of a force reading over a log, as a part of the RMS force."""
    friction: Number | None = Field(None, gt=0)
    """A missing term of friction, as a part of the RMS force."""
