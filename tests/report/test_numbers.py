"""Digits end where the uncertainty begins."""

import math

import pytest

from hydroopt.report.numbers import NONE, percent, plain, quantity, unit_text
from hydroopt.report.page import prose, words
from hydroopt.report.panels import NUMBERS
from hydroopt.report.tables import parameter
from hydroopt.results.parameter_table import row


@pytest.mark.parametrize(("value", "std", "expected"), [
    (3599.88, 321.9, ("3\u202f600", "320")), (-864.5, 3071.2, ("−900", "3\u202f100")), (0.0018296, 0.00028, None),
    (49.392, 8.2375, ("49.4", "8.2")), (-0.002, 6.9, ("0.0", "6.9")), (0.0, 0.0, ("0.000", "0.000"))])
def test_value_and_std(value: float, std: float, expected: tuple[str, str] | None) -> None:
    made = quantity(value, std)
    assert (made.value, made.std) == (expected or ("1.83\u202f×\u202f10⁻³", "0.28\u202f×\u202f10⁻³"))


def test_row_shares_a_power_of_ten() -> None:
    made = quantity(1.6554e7, 1.0123e6, (1.4474e7, 1.8535e7), 1.62848966e7)
    power = "\u202f×\u202f10⁶"
    assert made == (f"16.28{power}", f"16.6{power}", f"14.5{power} … 18.5{power}", f"1.0{power}")


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


def test_sentences_show_commands_as_code_and_keep_units_on_the_line_of_their_number() -> None:
    text = str(prose("Run 'hydroopt excite crane.toml -o <dir>' for 12 s (3 %), `--loss huber` or --treat nan=drop."))
    assert ('<code>hydroopt excite crane.toml <span class="word">-o &lt;dir&gt;</span></code> for 12'
            "\N{NO-BREAK SPACE}s (3\N{NO-BREAK SPACE}%)") in text
    assert ('<code><span class="word">--loss huber</span></code> or '
            '<code><span class="word">--treat nan=drop</span></code>.') in text
    assert str(prose("a state-of-the-art <b> 'name'")) == "a state-of-the-art &lt;b&gt; &#39;name&#39;"
    assert str(words("hydroopt a-b x.csv -o out --quiet --tip-std '25 mm' && ls -a")) == (
        'hydroopt a-b x.csv <span class="word">-o out</span> <span class="word">--quiet</span> '
        '<span class="word">--tip-std &#39;25 mm&#39;</span> &amp;&amp; ls <span class="word">-a</span>')


def test_parameters_are_printed_in_units_that_people_read() -> None:
    one = row("jack.leakage", "leakage", "m^3/(s*Pa)", nominal=1e-12, value=2e-12, std=1e-13, ci95=(1.8e-12, 2.2e-12))
    shown = parameter(one, NUMBERS)
    numbers = shown.numbers
    assert (shown.unit, numbers.nominal, numbers.value, numbers.interval) == (
        "mL/(min·bar)", "6", "12.00", "10.80 … 13.20")
    assert parameter(row("boom.m", "mass", "kg", nominal=5.0), NUMBERS).unit == "kg"
