"""The only place where units are converted; everything inside hydroopt is SI (m, rad, kg, s, N, Pa)."""

import re
from functools import cache
from pathlib import Path
from tokenize import TokenError

import pint

from hydroopt.errors import HydrooptError

_registry: "pint.UnitRegistry[float]" = pint.UnitRegistry(Path(__file__).with_name("units.txt"))
_ANGLES = {"radian", "milliradian", "degree", "arcminute", "arcsecond", "grade", "turn", "revolution",
           "revolutions_per_minute", "revolutions_per_second"}
_COEFFICIENT = {"N*m*s/rad"}  # a friction coefficient may be stated per radian or not
_ABSURD = re.compile(r"\d{3}|(\^|\*\*)[^*/]*(\^|\*\*)|.{60}")  # pint would compute m^9^9^9 for hours

_TROUBLE = (pint.errors.PintError, AttributeError, TypeError, ValueError, AssertionError, TokenError, SyntaxError,
            ArithmeticError, LookupError)
"""What pint raises for a text that is not a unit."""


class UnitError(HydrooptError):
    """A quantity has no unit, an unknown unit or a unit of the wrong kind."""


@cache
def factor(unit: str, si: str, *, where: str = "unit") -> float:
    """Factor from `unit` to the SI unit `si`, e.g. ``factor("psi", "Pa") == 6894.757...``.

    Raises:
        UnitError: the unit is unknown or measures something else than `si`.
    """
    if _ABSURD.search(unit):
        raise _wrong(unit, si, where)
    try:
        quantity = _registry.Quantity(1.0, unit)
        value = float(quantity.to(si).magnitude)
        is_angle = bool(_ANGLES & set(quantity.units._units))
        wants_angle = bool(_ANGLES & set(_registry.Unit(si)._units))
    except _TROUBLE as error:
        raise _wrong(unit, si, where) from error
    if is_angle != wants_angle and si not in _COEFFICIENT:
        raise _wrong(unit, si, where)
    return value


def to_si(text: str, si: str, *, where: str) -> float:
    """Value of a quantity such as ``"27.8 deg"`` in the SI unit `si`.

    Raises:
        UnitError: no number, no unit (unless `si` is ``"1"``), or a unit of another kind.
    """
    number, _, unit = text.strip().partition(" ")
    try:
        value = float(number)
    except ValueError:
        raise UnitError(f"'{text:.60}' is not a number followed by a unit", where=where,
                        remedy=f"write it as in \"1.5 {si}\"") from None
    if si == "1" and unit.strip() in ("", "1"):
        return value
    if not unit.strip():
        raise UnitError(f"'{text:.60}' has no unit", where=where, remedy=f"add one of the kind of '{si}'")
    return value * factor(unit.strip(), si, where=where)


def same_kind(unit: str, si: str) -> bool:
    """Whether `unit` measures the same kind of quantity as the SI unit `si`."""
    try:
        factor(unit, si)
    except UnitError:
        return False
    return True


def _wrong(unit: str, si: str, where: str) -> UnitError:
    return UnitError(f"'{unit:.40}' is not a unit of the kind '{si}'", where=where,
                     remedy=f"use '{si}' or another unit of that kind")


def spread_to_si(text: str, like: str, *, where: str) -> float:
    """SI value of an uncertainty, which must be of the same kind as the quantity `like` it belongs to."""
    unit = like.strip().partition(" ")[2].strip() or "1"
    if not same_kind(unit, unit):
        raise UnitError(f"the value's unit '{unit:.40}' is unknown", where=where, remedy="correct it")
    in_unit = to_si(text, unit, where=where)
    return float(_registry.Quantity(in_unit, unit).to_base_units().magnitude)
