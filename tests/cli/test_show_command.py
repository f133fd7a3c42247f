"""`hydroopt show`: one page of a screen, and everything with --all or --json."""

from __future__ import annotations

import json
from functools import cache

import pytest
from typer.testing import CliRunner

from fixtures.tiers import machines
from hydroopt.cli import app

WIDTH, LINES = 80, 60


@cache
def shown(*arguments: str, width: int = WIDTH) -> str:
    answer = CliRunner().invoke(app, ["show", *arguments], env={"COLUMNS": str(width)}, catch_exceptions=False)
    assert answer.exit_code == 0
    return answer.output


@pytest.mark.parametrize("name", machines())
def test_a_machine_fits_on_a_page(name: str) -> None:
    lines = shown(name).splitlines()
    assert sum(max(1, -(-len(line) // WIDTH)) for line in lines) <= LINES
    assert lines[-1].startswith("Each parameter and channel: --all.")


@pytest.mark.parametrize("name", ["cat215b", "excavator_imu", "forestry_crane"])
def test_all_names_each_parameter_and_channel_and_the_page_counts_them(name: str) -> None:
    facts = json.loads(shown(name, "--json"))
    text, page = shown(name, "--all", width=120), shown(name)
    for kind in ("parameters", "hydraulic_parameters"):
        assert all(row["name"] in text for row in facts[kind])
    assert all(row["channel"] in text for row in facts["sensors"])
    assert all(line.strip() in text for line in facts["calibration"]["lines"])
    assert f"Of {len(facts['parameters'])} parameters" in page
    if facts["hydraulic_parameters"]:
        assert f"{len(facts['hydraulic_parameters'])} hydraulic parameters" in page
    assert all(row["joint"] in page for row in facts["joints"])
    assert all(row["cylinder"] in page for row in facts["cylinders"])


@pytest.mark.parametrize("width", [30, 60, 80])
@pytest.mark.parametrize("arguments", [("cat215b",), ("kr300", "--all"), ("cat215b", "--hydraulics")])
def test_no_terminal_is_too_narrow_for_a_number(arguments: tuple[str, ...], width: int) -> None:
    wide, narrow = (shown(*arguments, width=each).replace("_", "").split() for each in (400, width))
    assert {word for word in wide if any(map(str.isdecimal, word))} <= set(narrow)
