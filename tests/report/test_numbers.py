"""Digits end where the uncertainty begins."""

import math

import pytest

from hydroopt.report.numbers import NONE, percent, plain, quantity, unit_text


@pytest.mark.parametrize(("value", "std", "expected"), [
    (3599.88, 321.9, ("3\u202f600", "320")), (-864.5, 3071.2, ("−900", "3\u202f100")), (0.0018296, 0.00028, None),
    (49.392, 8.2375, ("49.4", "8.2")), (-0.002, 6.9, ("0.0", "6.9")), (0.0, 0.0, ("0.000", "0.000"))])
def test_value_and_std(value: float, std: float, expected: tuple[str, str] | None) -> None:
    row = quantity(value, std)
    assert (row.value, row.std) == (expected or ("1.83\u202f×\u202f10⁻³", "0.28\u202f×\u202f10⁻³"))


def test_row_shares_a_power_of_ten() -> None:
    row = quantity(1.6554e7, 1.0123e6, (1.4474e7, 1.8535e7), 1.62848966e7)
    power = "\u202f×\u202f10⁶"
    assert row == (f"16.28{power}", f"16.6{power}", f"14.5{power} … 18.5{power}", f"1.0{power}")


def test_nothing_known() -> None:
    assert quantity(math.nan, math.nan) == (NONE,) * 4
    assert (plain(math.inf), percent(math.nan)) == (NONE, NONE)


def test_plain() -> None:
    assert [plain(v) for v in (1211.4, 0.05123, 1.306, 0.0)] == ["1\u202f211", "0.05123", "1.306", "0"]
    assert plain(4.4838e-5, 3) == "4.48\u202f×\u202f10⁻⁵"
    assert percent(-1.0669) == "−106.69"


def test_units() -> None:
    assert unit_text("N*m*s/rad") == "N·m·s/rad"
    assert unit_text("kg*m^2") == "kg·m²"
