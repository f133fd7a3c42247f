"""Readings that the motion must explain: channels sampled together, with their noise and what is not counted."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hydroopt.errors import LogError
from hydroopt.logs.clock import Clock
from hydroopt.logs.log import Log
from hydroopt.logs.poses import Poses
from hydroopt.machine.machine import Machine
from hydroopt.machine.parameter_kind import ParameterKind
from hydroopt.machine.sensors import Lag
from hydroopt.spatial.inertia import Array

MOTION = ("q", "qd", "qdd", "length", "gyro_x", "gyro_y", "gyro_z", "accel_x", "accel_y", "accel_z", "roll", "pitch",
          "x", "y", "z")
"""Endings of the channels that tell the motion."""
DERIVED = ("qd", "qdd", "roll", "pitch")
"""Endings of those that a unit may have derived from others, by filters of its own: they count where the machine file
states their accuracy."""
FULL = 0.999
"""Part of a sensor's range beyond which it counts as saturated."""


PAST, WEIGHTS = np.polynomial.laguerre.laggauss(4)
"""A reading with the lag τ is the mean of true values `PAST`·τ ago, by `WEIGHTS` (Gauss-Laguerre quadrature): exact for
polynomials to the seventh degree; for a sine of the frequency f to 2e-4 where 2πfτ = 0.6, to 2 % where it is 1.3."""
MARGIN = 3.0
"""How many standard deviations a lag may be longer than stated."""


KNOWN = Clock()
"""The clock of stamps that are right."""


def longest(value: float, sigma: float) -> float:
    """The longest that a lag of a stated value and standard deviation is taken to be [s]."""
    return value + MARGIN * sigma


class Common(NamedTuple):
    """A number that many readings have in common: name, kind, unit, value before and its standard deviation."""

    name: str
    kind: ParameterKind
    unit: str
    prior: float
    sigma: float


@dataclass(frozen=True, eq=False)
class Observations:
    """Channels sampled together.

    Attributes:
        name: of the file, and of the group where it has several.
        t: (N,) times [s], or numbers of postures.
        channels: their names; `units` theirs in SI.
        values: (N, m) in SI.
        sigma: (m,) standard deviation of one reading.
        used: (N, m) False where there is no reading, or none that counts.
        saturated: (N, m) True where a sensor's range ends.
        biased: (m,) standard deviation of a constant bias; 0 where there is none.
        clock: how late and how fast its stamps are.
        lags: how each channel lags behind the true values; empty where none does.
    """

    name: str
    t: Array
    channels: tuple[str, ...]
    units: tuple[str, ...]
    values: Array
    sigma: Array
    used: NDArray[np.bool_]
    saturated: NDArray[np.bool_]
    biased: Array
    clock: Clock = KNOWN
    lags: tuple[Lag, ...] = ()

    def thinned(self, keep: NDArray[np.bool_]) -> Observations:
        """Those of some samples (N,)."""
        return replace(self, t=self.t[keep], values=self.values[keep], used=self.used[keep],
                       saturated=self.saturated[keep])

    def taken(self, delay: float, drift: float, part: slice = slice(None)) -> Array:
        """When readings were taken (m,) [s], whose stamps are late and fast by so much."""
        return np.asarray((self.t[part] - delay) / (1 + drift))

    @property
    def by_lag(self) -> dict[Lag, NDArray[np.intp]]:
        """Places of the channels that have each lag in common."""
        lags = self.lags or (Lag(),) * len(self.channels)
        return {lag: np.array([k for k, own in enumerate(lags) if own == lag]) for lag in dict.fromkeys(lags)}

    @property
    def memory(self) -> float:
        """How long its channels remember what was [s], by what is known before."""
        return float(PAST[-1]) * max((longest(lag.value, lag.sigma) for lag in self.lags), default=0.0)

    @property
    def stamped(self) -> Array:
        """When readings were taken (N,) [s] as far as is known before."""
        return self.taken(self.clock.delay, self.clock.drift)

    def bias(self, channel: str) -> str:
        """Name of a channel's bias, of the clock's ``delay`` or of its ``drift``."""
        return f"{self.name}: {channel}"

    @property
    def own_numbers(self) -> dict[str, Common]:
        """Biases and lags of its channels, delay and drift of its clock."""
        found = [Common(self.bias(channel), ParameterKind.BIAS, unit, 0.0, float(sigma))
                 for channel, unit, sigma in zip(self.channels, self.units, self.biased, strict=True) if sigma]
        if (clock := self.clock).delay_std:
            found.append(Common(self.bias("delay"), ParameterKind.DELAY, "s", clock.delay, clock.delay_std))
        if clock.drift_std:
            found.append(Common(self.bias("drift"), ParameterKind.CLOCK_DRIFT, "1", clock.drift, clock.drift_std))
        found += [Common(lag.name, ParameterKind.LAG, "s", lag.value, lag.sigma) for lag in self.by_lag
                  if lag.sigma]
        return {each.name: each for each in found}


def motion_channels(machine: Machine, channels: Collection[str]) -> tuple[str, ...]:
    """Those of some channels that tell the machine's motion."""
    known = machine.channel_units
    tips = machine.calibrator is not None and machine.tracker is not None and not machine.calibrator.links
    calibrator = {link.name for link in machine.calibrator.links} if machine.calibrator else set()
    found = []
    for channel in channels:
        owner, _, ending = channel.rpartition(".")
        if channel not in known or ending not in MOTION or owner in calibrator:
            continue
        if (ending in DERIVED and not machine.sensor(channel)) or (ending in ("x", "y", "z") and (
                owner != "tip" or not tips)):
            continue
        found.append(channel)
    return tuple(found)


def observations(machine: Machine, group: Log, clock: Clock, where: str) -> Observations:
    """What a group of channels with its clock says about the motion.

    Raises:
        LogError: a channel measures another kind of quantity than the machine's part has.
    """
    name = f"{where} {group.name}" if group.name else where
    found = _of(machine, name, group.t, group.channels, group.units)
    return replace(found, clock=clock, lags=tuple(machine.lag(channel) for channel in found.channels))


def row_observations(machine: Machine, table: Poses) -> Observations:
    """What the rows of a table of poses say about their postures; times count the rows."""
    return _of(machine, table.name, np.arange(float(len(table.row))), table.channels, table.units)


def _of(machine: Machine, name: str, t: Array, held: Mapping[str, Array], units: Mapping[str, str]) -> Observations:
    channels = motion_channels(machine, held)
    for channel in channels:
        if units[channel] != (want := machine.channel_units[channel]):
            raise LogError(f"'{channel}' is of the kind '{units[channel]}', but the machine's part needs '{want}'",
                           where=name, remedy="correct the column's unit or the joint's type")
    values = np.column_stack([held[channel] for channel in channels]) if channels else np.zeros((len(t), 0))
    sigma = np.array([_sigma(machine, channel, values[:, k]) for k, channel in enumerate(channels)])
    limits, biases = np.full(len(channels), np.inf), np.zeros(len(channels))
    for imu in machine.imus:
        for channel in set(imu.channels) & set(channels):
            part = imu.part(channel)
            assert part is not None
            biases[channels.index(channel)] = part.bias
            limits[channels.index(channel)] = np.inf if part.range is None else part.range
    saturated = np.abs(values) >= FULL * limits
    used = np.isfinite(values) & ~saturated
    return Observations(name, np.asarray(t, dtype=float), channels,
                        tuple(machine.channel_units[channel] for channel in channels),
                        np.where(used, values, 0.0), sigma, used, saturated, biases)


def _sigma(machine: Machine, channel: str, values: Array) -> float:
    """Standard deviation of a reading: stated, or by its fourth differences, which hardly hold motion."""
    sensor = machine.sensor(channel)
    if sensor is not None and sensor.std > 0:
        return sensor.std
    rough = np.diff(values[np.isfinite(values)], 4)
    size = float(np.median(np.abs(rough))) / 0.6745 / np.sqrt(70) if rough.size else 0.0
    return max(size, 1e-6)
