"""Units: every quantity survives being written, and whatever is no quantity is refused in one sentence."""

from __future__ import annotations

import math

import pint
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hydroopt.unit_expressions import base, definitions
from hydroopt.units import (
    LARGEST,
    LARGEST_OTHERS,
    SMALLEST,
    UnitError,
    base_unit,
    factor,
    same_kind,
    spread_to_si,
    to_si,
)

UNITS = [("mm", "m", 1e-3), ("in", "m", 0.0254), ("deg", "rad", math.pi / 180), ("rpm", "rad/s", math.pi / 30),
         ("bar", "Pa", 1e5), ("psi", "Pa", 6894.757293168), ("L/min", "m^3/s", 1 / 60000), ("t", "kg", 1000.0),
         ("kN*m", "N*m", 1000.0), ("cm^2", "m^2", 1e-4), ("%", "1", 0.01), ("ms", "s", 1e-3), ("m", "m", 1.0)]
FINITE = st.floats(-1e4, 1e4, allow_subnormal=False).filter(lambda x: x == 0 or abs(x) > 1e-50)


@given(value=FINITE, unit=st.sampled_from(UNITS))
def test_a_quantity_is_its_number_times_its_factor(value: float, unit: tuple[str, str, float]) -> None:
    name, si, size = unit
    assert factor(name, si) == pytest.approx(size, rel=1e-12)
    assert to_si(f"{value!r} {name}", si, where="here") == value * factor(name, si)
    assert to_si(f"  {value!r}   {name} ", si, where="here") == value * factor(name, si)


@given(value=FINITE, unit=st.sampled_from(UNITS), other=st.sampled_from(UNITS))
def test_only_quantities_of_one_kind_are_converted(value: float, unit: tuple[str, str, float],
                                                   other: tuple[str, str, float]) -> None:
    if unit[1] == other[1]:
        assert same_kind(unit[0], other[1])
    else:
        with pytest.raises(UnitError, match="not a unit of the kind"):
            to_si(f"{value!r} {unit[0]}", other[1], where="here")


@given(text=st.one_of(st.text(max_size=30), st.from_regex(r"-?\d{1,3}(\.\d*)? ?[a-zA-Z*/^ ()0-9%°µ.-]{0,20}",
                                                          fullmatch=True)), si=st.sampled_from(["m", "rad", "Pa", "1"]))
def test_any_text_is_a_number_or_is_refused_with_its_place(text: str, si: str) -> None:
    found: float | UnitError
    try:
        found = to_si(text, si, where="boom.a")
    except UnitError as error:
        found = error
    assert isinstance(found, float) or (found.where == "boom.a" and found.remedy)


@pytest.mark.parametrize("si", [*LARGEST, "m^2", "1"])
def test_numbers_beyond_any_machine_are_refused(si: str) -> None:
    """Products of what passes stay finite, and quotients too."""
    most = LARGEST.get(si, LARGEST_OTHERS)
    for text in (f"{most!r}", f"{-most!r}", f"{SMALLEST!r}", "0", "-0.0", f"{most / 7!r}"):
        assert to_si(f"{text} {si}", si, where="here") == float(text)
    for text in ("inf", "-inf", "nan", "1e308", "1e309", "-1e200", f"{1.01 * most!r}", "1e-61", "-5e-324", "1" * 309):
        with pytest.raises(UnitError, match=r"^here: .*; correct it\.$") as caught:
            to_si(f"{text} {si}", si, where="here")
        assert len(str(caught.value)) < 120
    assert math.isfinite(max(*LARGEST.values(), LARGEST_OTHERS) ** 4 / SMALLEST ** 4)


@given(value=FINITE.map(abs), unit=st.sampled_from(UNITS))
def test_an_uncertainty_is_of_the_kind_of_its_value(value: float, unit: tuple[str, str, float]) -> None:
    name, si, _ = unit
    spread = spread_to_si(f"{value!r} {name}", f"3 {name}", where="here")
    assert spread == pytest.approx(to_si(f"{value!r} {name}", si, where="here"), rel=1e-12)


@pytest.fixture(scope="module")
def theirs() -> pint.UnitRegistry[float]:
    registry: pint.UnitRegistry[float] = pint.UnitRegistry(cache_folder=None)
    registry.define("rev = revolution")  # data sheets of motors state cm^3/rev, which pint does not know
    return registry


def test_every_unit_has_the_value_that_pint_gives_it(theirs: pint.UnitRegistry[float]) -> None:
    names = list(definitions().spellings)
    assert len(names) > 250
    for name in names:
        found, expected = base(name), theirs.Quantity(1.0, name).to_base_units()
        assert {unit: float(power) for unit, power in found.powers.items()} == {
            unit: float(power) for unit, power in expected.units._units.items()} or _of_its_own_zero(name), name
        assert found.number == expected.magnitude or _of_its_own_zero(name), name


def _of_its_own_zero(name: str) -> bool:
    """A temperature above another zero than that of kelvins, which has no factor to them."""
    return any(unit in ("degree_Celsius", "degree_Fahrenheit") for unit in base(name).powers)


WORDS = st.sampled_from(["m", "mm", "kN", "rad", "deg", "min", "L", "bars", "psi", "rev", "kilogram", "milliseconds",
                         "°"])
POWERS = st.sampled_from(["", "^2", "**-1", "²", "⁻¹", "^0.5", "^(1/2)"])
SIGNS = st.sampled_from(["*", "/", " ", " per ", "·", " * ", " / ", "/("])


@given(first=st.tuples(WORDS, POWERS), more=st.lists(st.tuples(SIGNS, WORDS, POWERS), max_size=2))
def test_an_expression_means_what_it_means_to_pint(theirs: pint.UnitRegistry[float], first: tuple[str, str],
                                                   more: list[tuple[str, str, str]]) -> None:
    text = "".join([*first, *(part for each in more for part in each)])
    text += ")" * text.count("/(")
    found, expected = base(text), theirs.Quantity(1.0, text).to_base_units()
    assert found.number == pytest.approx(expected.magnitude, rel=1e-13)
    assert base_unit(text, where="here") == (f"{expected.units:~C}" or "1")


@pytest.mark.parametrize("text", ["", "furlong", "m//s", "m/", "*m", "(m", "m)", "m^", "m^s", "2 m", "m!", "k", "m s",
                                  "-m"])
def test_what_is_no_unit_of_length_is_refused(text: str) -> None:
    with pytest.raises(UnitError, match="is not a unit of the kind 'm'"):
        factor(text, "m")


@pytest.mark.parametrize("other", ["K", "degF"])
def test_a_temperature_above_another_zero_has_no_factor(other: str) -> None:
    assert same_kind("degC", "°C")
    assert not same_kind("degC", other)
