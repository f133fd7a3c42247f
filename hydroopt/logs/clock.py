"""The clock of a group of channels: how late and how fast its stamps are."""

from __future__ import annotations

import re
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hydroopt.errors import LogError
from hydroopt.units import to_si


@dataclass(frozen=True)
class Clock:
    """What happened at t is stamped t·(1 + drift) + delay.

    Attributes:
        delay: by how much the stamps are late [s]; negative where they are early.
        delay_std: its standard deviation [s]; 0 where it is known.
        drift: by how much the clock is fast [s/s], and its standard deviation `drift_std`.

    >>> Clock.of("20 ms ± 50 ms", "0 % ± 0.5 %")
    Clock(delay=0.02, delay_std=0.05, drift=0.0, drift_std=0.005)
    """

    delay: float = 0.0
    delay_std: float = 0.0
    drift: float = 0.0
    drift_std: float = 0.0

    @classmethod
    def of(cls, delay: str = "0 s", drift: str = "0 %") -> Clock:
        """The clock that texts such as ``20 ms ± 50 ms`` state; without ± a value is known.

        Raises:
            LogError: a text is no value with unit, or a standard deviation is not positive.
            UnitError: a unit is of another kind.
        """
        return cls(*_measured(delay, "s", "delay"), *_measured(drift, "1", "drift"))

    def corrected(self, stamps: NDArray[np.float64]) -> NDArray[np.float64]:
        """When happened what is stamped so [s].

        >>> Clock(0.02).corrected(np.array([0.02, 1.02])).tolist()
        [0.0, 1.0]
        """
        return (stamps - self.delay) / (1 + self.drift)


def _measured(text: str, si: str, key: str) -> tuple[float, float]:
    """Value and standard deviation [`si`] of a text."""
    value, found, spread = (part.strip() for part in re.sub(r"\+/-|\+-", "±", text).partition("±"))
    numbers = [_value(value, si, key), _value(spread, si, key) if found else 0.0]
    if found and numbers[1] <= 0:
        raise LogError(f"the standard deviation in '{text:.40}' is not positive", where=key,
                       remedy="state a positive one, or leave it out where the value is known")
    return numbers[0], numbers[1]


def _value(text: str, si: str, key: str) -> float:
    if si == "1" and text.endswith("%"):
        return to_si(text.removesuffix("%").strip(), "1", where=key) / 100
    return to_si(text, si, where=key)
