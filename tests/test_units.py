"""Units: every quantity survives being written, and whatever is no quantity is refused in one sentence."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

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


@pytest.mark.parametrize(("text", "si", "size"), [  # as catalogues and standards state them
    ("psi", "Pa", 6894.757293168), ("kgf/cm^2", "Pa", 98066.5), ("mbar", "Pa", 100.0), ("kbar", "Pa", 1e8),
    ("inHg", "Pa", 3386.389), ("lbf", "N", 4.4482216152605), ("ft_lb", "N*m", 1.3558179483314),
    ("gal/min", "m^3/s", 6.30902e-5),
    ("cm^3/rev", "m^3/rad", 1e-6 / math.tau), ("rpm", "rad/s", math.pi / 30), ("gon", "rad", math.pi / 200),
    ("mg_0", "m/s^2", 9.80665e-3), ("mdeg/s", "rad/s", math.pi / 180e3), ("kN·m/°", "N*m/rad", 180e3 / math.pi),
    ("m s⁻²", "m/s^2", 1.0), ("m per s**2", "m/s^2", 1.0), ("kn", "m/s", 1852 / 3600), ("N*m*s", "N*m*s/rad", 1.0)])
def test_units_have_their_size(text: str, si: str, size: float) -> None:
    assert factor(text, si) == pytest.approx(size, rel=1e-6)


@pytest.mark.parametrize(("unit", "same"), [("mm*t", "kg*m"), ("kN*mm", "kg*m**2/s**2"), ("%", "1"), ("rpm", "rad/s")])
def test_the_si_unit_of_a_kind(unit: str, same: str) -> None:
    assert base_unit(unit, where="here") == same


@pytest.mark.parametrize(("text", "nearest"), [("KPA", "kPa"), ("Mpa", "MPa"), ("baar", "bar"), ("degr", "deg")])
def test_an_unknown_unit_is_refused_with_the_nearest_one(text: str, nearest: str) -> None:
    kind = next(si for si in ("Pa", "rad", "m") if same_kind(nearest, si))
    with pytest.raises(UnitError) as refused:
        factor(text, kind)
    assert f"'{nearest}'" in refused.value.remedy


@pytest.mark.parametrize("text", ["", "furlong", "m//s", "m/", "*m", "(m", "m)", "m^", "m^s", "2 m", "m!", "k", "m s",
                                  "-m", "m**9**9**9", "m^9⁹⁹", "m^(9*9^9)", "Context"])
def test_what_is_no_unit_of_length_is_refused(text: str) -> None:
    with pytest.raises(UnitError, match="is not a unit of the kind 'm'"):
        factor(text, "m")


@pytest.mark.parametrize("other", ["K", "degF"])
def test_a_temperature_above_another_zero_has_no_factor(other: str) -> None:
    assert same_kind("degC", "°C")
    assert not same_kind("degC", other)
