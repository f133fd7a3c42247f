"""The only place where units are converted; everything inside hydroopt is SI (m, rad, kg, s, N, Pa).

pint reads units, with the definitions of `units.txt`, where the angle has a dimension. It is imported when a unit is
first read.
"""

from __future__ import annotations

import difflib
import math
import re
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, cast

from hydroopt.errors import HydrooptError

if TYPE_CHECKING:
    import pint

_WITHOUT_ANGLE = {"N*m*s/rad": "N*m*s"}  # a friction coefficient may be stated per radian or not
_JOINED = re.compile(r"^((?>[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?))([a-zA-Z°%µ])")  # a number and its unit
_NO_UNIT = re.compile(r"\d{3}|//|[^\w\s*/^()·.%‰°⁰¹²³⁴⁵⁶⁷⁸⁹⁻+-]|"
                      r"(?:\^|\*\*|[⁰¹²³⁴-⁹])[^A-Za-z]*(?:\^|\*\*)|(?:\^|\*\*)[^A-Za-z]*[⁰¹²³⁴-⁹]")
"""What no unit has: characters of something else, a number of three digits, a power of a power."""

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


class ImplausibleError(UnitError):
    """A quantity has a unit of the right kind, and a size that no machine has."""


def in_print(unit: str) -> str:
    """A unit as print has it.

    >>> in_print("kg*m^2")
    'kg·m²'
    """
    return unit.replace("*", "·").replace("^2", "²").replace("^3", "³")


@cache
def _registry() -> pint.UnitRegistry[float]:
    import pint  # noqa: PLC0415

    return pint.UnitRegistry(Path(__file__).with_name("units.txt"), cache_folder=None)


@cache
def _parsed(unit: str) -> tuple[float, dict[str, float]]:
    """Size in base units (metre, kilogram, second, ampere, radian …) of a unit, and their powers.

    Raises:
        ValueError: it is no unit.
    """
    if len(unit) > 60 or _NO_UNIT.search(unit):
        raise ValueError(unit)
    try:
        found = _registry().Quantity(1.0, _registry().parse_units(unit)).to_base_units()
    except Exception as error:  # whatever pint raises, the text is at fault
        raise ValueError(unit) from error
    return float(found.magnitude), cast("dict[str, float]", dict(found.unit_items()))


def factor(unit: str, si: str, *, where: str = "unit") -> float:
    """Factor from `unit` to the SI unit `si`, e.g. ``factor("psi", "Pa") == 6894.757...``.

    Raises:
        UnitError: the unit is unknown or measures something else than `si`.
    """
    if unit.startswith("Grad"):
        raise UnitError(f"'{unit:.40}' would be a gigaradian here", where=where,
                        remedy=f"write '{unit.replace('Grad', 'deg'):.40}' for degrees, or 'gon'")
    found = _ratio(unit, si)
    if found is None:
        raise UnitError(f"'{unit:.40}' is not a unit of the kind '{si}'", where=where,
                        remedy=f"use '{_nearest(unit, si)}' or another unit of that kind")
    return found


@cache
def _ratio(unit: str, si: str) -> float | None:
    """The factor from one unit to another; None where they are of different kinds, or one is unknown."""
    for wanted in filter(None, (si, _WITHOUT_ANGLE.get(si))):
        try:
            (own, powers), (other, theirs) = _parsed(unit), _parsed(wanted)
        except ValueError:
            return None
        if powers == theirs:
            return own / other
    return None


def _nearest(unit: str, si: str) -> str:
    """The unit of a kind whose spelling is nearest to a text that is no unit, as ``MPa`` is to ``Mpa``."""
    try:
        _parsed(unit)
    except ValueError:
        names = [name for name in dir(_registry()) if name.isalpha() and same_kind(name, si)]
        spelled = {each.lower(): each for name in names for each in (
            *(prefix + name for prefix in "kmMch" if len(name) < 4), name)}
        return next((spelled[each] for each in difflib.get_close_matches(unit.lower(), spelled, 1)), si)
    return si


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
        raise ImplausibleError(implausible(value, si), where=where, remedy="correct it")
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
    return not unit.startswith("Grad") and _ratio(unit, si) is not None


def base(unit: str, *, where: str = "unit") -> tuple[float, dict[str, float]]:
    """Size of a unit in base units (metre, kilogram, second, ampere, radian …), and the power of each by its name.

    Raises:
        UnitError: the unit is unknown.

    >>> base("kN*mm")
    (1.0, {'kilogram': 1.0, 'meter': 2.0, 'second': -2.0})
    """
    factor(unit, unit, where=where)
    return _parsed(unit)


def base_unit(unit: str, *, where: str) -> str:
    """The SI unit of the same kind, such as ``kg*m`` of ``mm*t``.

    Raises:
        UnitError: the unit is unknown.
    """
    factor(unit, unit, where=where)
    found = _registry().Quantity(1.0, unit).to_base_units().units
    return f"{found:~C}" or "1"


def spread_to_si(text: str, like: str, *, where: str) -> float:
    """SI value of an uncertainty, which must be of the same kind as the quantity `like` it belongs to."""
    unit = like.strip().partition(" ")[2].strip() or "1"
    if not same_kind(unit, unit):
        raise UnitError(f"the value's unit '{unit:.40}' is unknown", where=where, remedy="correct it")
    in_unit = to_si(text, unit, where=where)
    value = in_unit * base(unit)[0]
    if not plausible(value, ""):
        raise UnitError(implausible(value, "SI units"), where=where, remedy="correct it")
    return value
