"""The only place where units are converted; everything inside hydroopt is SI (m, rad, kg, s, N, Pa)."""

import math
import re
from functools import cache

from hydroopt.errors import HydrooptError
from hydroopt.unit_expressions import base, definitions, parsed, root

_ANGLES = {"radian", "milliradian", "degree", "arcminute", "arcsecond", "grade", "turn", "revolution",
           "revolutions_per_minute", "revolutions_per_second"}
_NO_DIMENSION = {"radian", "bit", "count"}
_COEFFICIENT = {"N*m*s/rad"}  # a friction coefficient may be stated per radian or not
_JOINED = re.compile(r"^((?>[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?))([a-zA-Z°%µ])")  # a number and its unit
_ABSURD = re.compile(r"\d{3}")  # no unit has such a power

SMALLEST = 1e-60
"""Smallest magnitude [SI] of a number that is not zero: powers of smaller ones underflow."""
LARGEST = {"m": 1e8, "rad": 1e6, "s": 1e10, "Hz": 1e6, "kg": 1e9, "N": 1e12, "N*m": 1e12, "Pa": 1e13, "m/s": 1e5,
           "rad/s": 1e6, "m/s^2": 1e7, "rad/s^2": 1e9}
"""Largest magnitude by SI unit that a machine file or a log may state: far beyond every machine, so that what is
computed from it stays finite."""
LARGEST_OTHERS = 1e15
"""The same for all other units [SI]."""


class UnitError(HydrooptError):
    """A quantity has no unit, an unknown unit or a unit of the wrong kind."""


def in_print(unit: str) -> str:
    """A unit as print has it.

    >>> in_print("kg*m^2")
    'kg·m²'
    """
    return unit.replace("*", "·").replace("^2", "²").replace("^3", "³")


@cache
def factor(unit: str, si: str, *, where: str = "unit") -> float:
    """Factor from `unit` to the SI unit `si`, e.g. ``factor("psi", "Pa") == 6894.757...``.

    Raises:
        UnitError: the unit is unknown or measures something else than `si`.
    """
    if unit.startswith("Grad"):
        raise UnitError(f"'{unit:.40}' would be a gigaradian here", where=where,
                        remedy=f"write '{unit.replace('Grad', 'deg'):.40}' for degrees, or 'gon'")
    if len(unit) > 60 or _ABSURD.search(unit):
        raise _wrong(unit, si, where)
    try:
        own, other = parsed(unit), parsed(si)
        left = root(own.times(other, -1))
    except (ValueError, ArithmeticError) as error:
        raise _wrong(unit, si, where) from error
    is_angle, wants_angle = (not _ANGLES.isdisjoint(each.powers) for each in (own, other))
    if own.number != 1 or left.powers.keys() - _NO_DIMENSION or (is_angle != wants_angle and si not in _COEFFICIENT):
        raise _wrong(unit, si, where)
    return left.number


def to_si(text: str, si: str, *, where: str) -> float:
    """Value of a quantity such as ``"27.8 deg"`` in the SI unit `si`.

    Raises:
        UnitError: no number, no unit (unless `si` is ``"1"``), or a unit of another kind.

    >>> to_si("1000kg", "kg", where="load"), to_si("-.5 m", "m", where="pin")
    (1000.0, -0.5)
    """
    number, _, unit = _JOINED.sub(r"\1 \2", text.strip()).partition(" ")
    try:
        value = float(number)
    except ValueError:
        raise UnitError(f"'{text:.60}' is not a number followed by a unit", where=where,
                        remedy=f"write it as in \"1.5 {si}\"") from None
    if not unit.strip() and si != "1":
        raise UnitError(f"'{text:.60}' has no unit", where=where, remedy=f"add one of the kind of '{si}'")
    if unit.strip() not in ("", "1") or si != "1":
        value *= factor(unit.strip(), si, where=where)
    if not plausible(value, si):
        raise UnitError(f"{implausible(value, si)}", where=where, remedy="correct it")
    return value


def largest(si: str) -> float:
    """Largest magnitude of a quantity in the SI unit `si` that is accepted."""
    return LARGEST.get(si, LARGEST_OTHERS)


def plausible(value: float, si: str) -> bool:
    """Whether a machine could have this value [`si`].

    >>> plausible(1e308, "Pa"), plausible(3.5e7, "Pa")
    (False, True)
    """
    return value == 0 or SMALLEST <= abs(value) <= largest(si)


def implausible(value: float, si: str) -> str:
    """What is wrong with a value [`si`] that is not `plausible`."""
    if not math.isfinite(value):
        return "must be a finite number"
    unit = "" if si == "1" else f" {si}"
    return (f"{value:.6g}{unit} is beyond any machine (at most {largest(si):g}{unit})" if abs(value) > 1
            else f"{value:.6g}{unit} is so small that it must be zero")


def same_kind(unit: str, si: str) -> bool:
    """Whether `unit` measures the same kind of quantity as the SI unit `si`."""
    try:
        factor(unit, si)
    except UnitError:
        return False
    return True


def base_unit(unit: str, *, where: str) -> str:
    """The SI unit of the same kind, such as ``kg*m`` of ``mm*t``.

    Raises:
        UnitError: the unit is unknown.
    """
    factor(unit, unit, where=where)
    symbols, powers = definitions().symbols | {"kilogram": "kg"}, base(unit).powers
    parts = {sign: [symbols[name] + (f"**{sign * power:g}" if sign * power != 1 else "")
                    for name, power in sorted(powers.items()) if sign * power > 0] for sign in (1, -1)}
    return "/".join(["*".join(parts[1]) or "1", *parts[-1]])


def _wrong(unit: str, si: str, where: str) -> UnitError:
    return UnitError(f"'{unit:.40}' is not a unit of the kind '{si}'", where=where,
                     remedy=f"use '{si}' or another unit of that kind")


def spread_to_si(text: str, like: str, *, where: str) -> float:
    """SI value of an uncertainty, which must be of the same kind as the quantity `like` it belongs to."""
    unit = like.strip().partition(" ")[2].strip() or "1"
    if not same_kind(unit, unit):
        raise UnitError(f"the value's unit '{unit:.40}' is unknown", where=where, remedy="correct it")
    in_unit = to_si(text, unit, where=where)
    value = in_unit * base(unit).number
    if not plausible(value, ""):
        raise UnitError(implausible(value, "SI units"), where=where, remedy="correct it")
    return value
