"""Numbers as a reader wants them: as many digits as the uncertainty leaves, units in print."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from hydroopt.results.diagnostic import LEAST_P
from hydroopt.units import in_print

NONE = "—"
"""What stands where there is no number."""

_SUPERSCRIPT = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
SPACE = "\N{NARROW NO-BREAK SPACE}"
"""Between groups of digits, and a number and its power of ten."""
_MINUS, _DIGITS = "−", 6


class Row(NamedTuple):
    """One quantity in print; `interval` is its 95 % interval, `std` its standard deviation."""

    nominal: str
    value: str
    interval: str
    std: str


def unit_text(unit: str) -> str:
    """A unit in print: ``kg*m^2`` as kg·m²."""
    return {"sigma": "σ", "1": NONE}.get(unit, in_print(unit))


def plain(value: float, digits: int = 4) -> str:
    """A number to some significant digits; a dash for NaN and infinity."""
    if not math.isfinite(value):
        return NONE
    magnitude = _magnitude(value)
    exponent = magnitude if magnitude >= 6 or magnitude < -3 else 0
    return _written(value, digits - 1 - _magnitude(value), exponent, trim=True)


def p_value(p: float) -> str:
    """A p-value; one that is only tiny is never zero. A dash for NaN.

    >>> p_value(0.0312), p_value(0.0)
    ('0.031', '< 1e-15')
    """
    return NONE if math.isnan(p) else f"< {LEAST_P:.0e}" if p < LEAST_P else f"{p:.2g}"


def percent(part: float) -> str:
    """A part of one in per cent, to two decimals; a dash for NaN and infinity."""
    return _written(100 * part, 2, 0) if math.isfinite(part) else NONE


def quantity(value: float, std: float, interval: tuple[float, float] = (math.nan, math.nan),
             nominal: float = math.nan) -> Row:
    """A quantity whose digits end where its uncertainty begins: at the second digit of the standard deviation.

    All numbers of the row share one power of ten.
    """
    shown = [abs(x) for x in (nominal, value, *interval, std) if math.isfinite(x)]
    exponent = _exponent(max(shown, default=0.0))
    if math.isfinite(std) and std > 0:
        decimals = min(1 - _magnitude(std), _DIGITS - 1 - _magnitude(value if value else std))
    else:
        decimals = 3 - _magnitude(value) if math.isfinite(value) else -_DIGITS
    low, high = (_written(x, decimals, exponent) for x in interval)
    return Row(_written(nominal, max(decimals, 3 - _magnitude(nominal)), exponent, trim=True),
               _written(value, decimals, exponent),
               f"{low} … {high}" if np.all(np.isfinite(interval)) else NONE, _written(std, decimals, exponent))


def _magnitude(value: float) -> int:
    return math.floor(math.log10(abs(value))) if value and math.isfinite(value) else 0


def _exponent(largest: float) -> int:
    """Power of ten, a multiple of three, that is split off very large and very small numbers."""
    magnitude = _magnitude(largest)
    return 3 * (magnitude // 3) if magnitude >= 6 or magnitude < -2 else 0


def _written(value: float, decimals: int, exponent: int, *, trim: bool = False) -> str:
    if not math.isfinite(value):
        return NONE
    rounded = round(value, decimals) / 10.0**exponent
    text = f"{rounded:,.{max(0, decimals + exponent)}f}".replace(",", SPACE).replace("-", _MINUS)
    if trim and "." in text:
        text = text.rstrip("0").rstrip(".")
    if not text.strip("−0."):
        text = text.removeprefix(_MINUS)
    power = f"{SPACE}×{SPACE}10{str(exponent).translate(_SUPERSCRIPT)}"
    return text + power if exponent and rounded else text
