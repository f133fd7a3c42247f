"""Quantities in the units that people measure in, in plain text for a terminal."""

from __future__ import annotations

import math

from hydroopt.units import in_print

_SCALES = {"N": ((1e3, 1e3, "kN"), (0, 1, "N")), "N*m": ((1e3, 1e3, "kN·m"), (0, 1, "N·m")),
           "m": ((1, 1, "m"), (1e-3, 1e-3, "mm"), (0, 1e-6, "µm")), "rad": ((0, math.pi / 180, "deg"),),
           "rad/s": ((0, math.pi / 180, "deg/s"),), "rad/s^2": ((0, math.pi / 180, "deg/s²"),),
           "Pa": ((0, 1e5, "bar"),), "s": ((1, 1, "s"), (0, 1e-3, "ms")), "1": ((0, 1, ""),),
           "m^3/s": ((0, 1 / 60_000, "L/min"),)}
"""By SI unit: least magnitude, factor and unit in print."""


def readable(value: float, unit: str, digits: int = 2) -> str:
    """A quantity in SI as people write it, to some significant digits.

    >>> readable(2588.0, "N"), readable(0.00123, "m"), readable(0.0174533, "rad"), readable(34.2, "kg")
    ('2.6 kN', '1.2 mm', '1.0 deg', '34 kg')
    """
    if not math.isfinite(value):
        return "unknown"
    scales = _SCALES.get(unit, ((0, 1, in_print(unit)),))
    _, factor, printed = next(scale for scale in scales if abs(value) >= scale[0])
    scaled = value / factor
    decimals = digits - 1 - math.floor(math.log10(abs(scaled))) if scaled else 0
    return f"{round(scaled, decimals):.{min(9, max(0, decimals))}f} {printed}".strip()


def percentage(part: float, digits: int = 2) -> str:
    """A part of one in per cent, to some significant digits.

    >>> percentage(0.0123), percentage(0.5), percentage(2.0)
    ('1.2 %', '50 %', '200 %')
    """
    return f"{readable(100 * part, '1', digits)} %"
