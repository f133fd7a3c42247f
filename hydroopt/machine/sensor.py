"""What channels are measured with: accuracy, resolution and rate of a sensor."""

from __future__ import annotations

import math
from collections.abc import Mapping
from difflib import get_close_matches
from typing import Any, Literal, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, ValidationInfo, model_validator

from hydroopt.machine.quantity import CHANNEL_UNITS, Duration, ImpossibleError, Noun, Quantity, Rate, keyed

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
    accuracy: float = Field(ge=0, allow_inf_nan=False)
    """Bound of a uniform error, or standard deviation of a Gaussian one, in the channels' unit."""
    resolution: float = Field(0.0, ge=0, allow_inf_nan=False)
    """Step of the reading, in the channels' unit."""
    rate: Rate | None = Field(None, gt=0)
    """Samples per second."""
    lag: Duration = Field(0.0, ge=0)
    """Time constant of a first-order system that readings follow the true values with."""
    distribution: Literal["uniform", "gaussian"] = "uniform"
    """Distribution of the error."""

    @model_validator(mode="before")
    @classmethod
    def _units(cls, data: Any, info: ValidationInfo) -> Any:
        if not isinstance(data, Mapping) or not isinstance(data.get("channels"), list | tuple) or not data["channels"]:
            return data
        data = dict(data)
        for key in ("accuracy", "resolution"):
            if key in data:
                data[key] = cls._reading(data[key], data["channels"], info, key)
        return data

    @staticmethod
    def _reading(value: Any, channels: Any, info: ValidationInfo, key: str) -> Any:
        names = [str(channel) for channel in channels]
        kinds = {CHANNEL_UNITS.get(name.rpartition(".")[2], ()) for name in names}
        if unknown := [name for name in names if name.rpartition(".")[2] not in CHANNEL_UNITS]:
            part, _, quantity = unknown[0].rpartition(".")
            close = get_close_matches(quantity, CHANNEL_UNITS, 1)
            raise ImpossibleError(f"'{unknown[0]}' is the name of no channel", f"did you mean '{part}.{close[0]}'"
                                  if close else "write a part and a quantity, as 'boom.q' or 'boom_cylinder.p_head'",
                                  "channels")
        if len(kinds) > 1:
            raise ImpossibleError(f"the channels {', '.join(names)} have no unit in common",
                                  "state angles, lengths and pressures in a [[sensors]] entry each", "channels")
        problem: ImpossibleError | None = None
        for si in kinds.pop():
            try:
                return keyed(Quantity(si), value, info, key)
            except ImpossibleError as error:
                problem = problem or error
        assert problem is not None
        raise problem

    @model_validator(mode="after")
    def _can_lag(self) -> Self:
        idle = [channel for channel in self.channels if channel.rpartition(".")[2] not in LAGGING]
        if self.lag and idle:
            raise ImpossibleError(f"a lag of '{idle[0]}' has no meaning here",
                                  f"state it for channels that end in .{', .'.join(LAGGING)}", "lag")
        return self

    @property
    def std(self) -> float:
        """Standard deviation of one reading, noise and quantisation together.

        A uniform band ±a has variance a²/3, a quantisation step r (spread over several steps) r²/12.
        """
        noise = self.accuracy / math.sqrt(3) if self.distribution == "uniform" else self.accuracy
        return math.hypot(noise, self.resolution / math.sqrt(12))

    def read(self, true: NDArray[np.float64], rng: np.random.Generator) -> NDArray[np.float64]:
        """Readings of true values (any shape), with noise, then in steps of the resolution."""
        half = self.accuracy
        noise = rng.uniform(-half, half, true.shape) if self.distribution == "uniform" else rng.normal(
            0.0, half, true.shape)
        read = true + noise
        return np.round(read / self.resolution) * self.resolution if self.resolution > 0 else read
