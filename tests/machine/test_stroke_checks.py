"""Refusals of strokes state what lengths are needed: a machine with these is accepted."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from hydroopt.errors import MachineError
from hydroopt.machine.machine_file import read_machine

CAT = (Path(__file__).parents[2] / "models/cat215b.toml").read_text("utf-8")
BUCKET = """
name = "direct"
orientation = ["90 deg", "0 deg", "0 deg"]
[[links]]
name = "bucket"
joint = { type = "revolute", a = "1 m", lower = "LOW deg", upper = "60 deg" }
[links.body]
m = "100 kg"
com = ["0.5 m", "0 m", "0 m"]
inertia_com = ["1 kg*m^2", "0 kg*m^2", "0 kg*m^2", "9 kg*m^2", "0 kg*m^2", "9 kg*m^2"]
[[cylinders]]
name = "bucket_cylinder"
bore = "100 mm"
rod_diameter = "60 mm"
dead_length = "DEAD m"
stroke = "STROKE m"
barrel = { link = "base", pin = ["-1.5 m", "0.4 m", "0 m"] }
rod = { link = "bucket", pin = ["0 m", "0.35 m", "0 m"] }
"""
NEEDED = r"(?:takes|needs) (\d\.\d{3}) to (\d\.\d{3}) m"


def bucket(low: float, dead: float, stroke: float) -> str:
    return BUCKET.replace("LOW", str(low)).replace("DEAD", f"{dead:.4f}").replace("STROKE", f"{stroke:.4f}")


def test_lengths_of_a_refusal_are_those_that_are_accepted() -> None:
    with pytest.raises(MachineError, match=NEEDED) as refused:
        read_machine(bucket(-40, 1.3, 0.2))
    (needed,) = re.findall(NEEDED, str(refused.value))
    least, most = map(float, needed)
    read_machine(bucket(-40, least - 5e-4, most - least + 1e-3))
    for dead, end in ((least + 2e-3, most + 1e-3), (least - 1e-3, most - 2e-3)):
        with pytest.raises(MachineError, match="bucket_cylinder"):
            read_machine(bucket(-40, dead, end - dead))


def test_a_triangle_that_is_open_everywhere_states_them_too() -> None:
    with pytest.raises(MachineError, match=f"would be .* m long at bucket = .*only be 3.000 to 3.500 m.*{NEEDED}"):
        read_machine(bucket(-40, 3.0, 0.5))


def test_each_of_several_cylinders_states_them() -> None:
    strokes = re.findall(r'^stroke = \{ value = "([\d.]+) (m|mm|in)"', CAT, re.M)
    assert len(strokes) == 2
    short = re.sub(r'^(stroke = \{ value = ")[\d.]+ \w+"', r'\g<1>0.3 m"', CAT, flags=re.M)
    with pytest.raises(MachineError, match="strokes do not cover") as refused:
        read_machine(short)
    assert len(re.findall(NEEDED, str(refused.value))) == 2


@pytest.mark.parametrize(("low", "hinted"), [(-75, True), (-40, False)])
def test_a_wide_range_hints_at_a_missing_rocker(low: float, hinted: bool) -> None:
    with pytest.raises(MachineError) as refused:
        read_machine(bucket(low, 1.3, 0.2))
    assert ("or state a rocker between rod and link by [[linkages]]" in str(refused.value)) is hinted


@pytest.mark.parametrize(("old", "new", "words"), [
    ('lower = "-40 deg", upper = "60 deg"', 'lower = "-40 rad", upper = "60 rad"', "turns by 5730 deg, as if deg were"),
    ('["-1.5 m", "0.4 m", "0 m"]', '["-1.5 m", "0 m", "0.4 m"]', "400 mm apart along the axis of 'bucket'"),
    ('["-1.5 m", "0.4 m", "0 m"]', '["-1500 m", "400 m", "0 m"]', "(probably in mm)")])
def test_a_refusal_names_what_is_probably_wrong(old: str, new: str, words: str) -> None:
    with pytest.raises(MachineError) as refused:
        read_machine(bucket(-40, 1.3, 0.2).replace(old, new))
    assert words in str(refused.value)


def test_of_two_cylinders_at_one_joint_one_belongs_where_nothing_drives() -> None:
    """A Z-bar's tilt cylinder that is pinned to the lift arm."""
    loader = (Path(__file__).parents[2] / "models/wheel_loader.toml").read_text("utf-8")
    past = loader.replace('link = "bellcrank"', 'link = "lift"')
    assert past != loader
    with pytest.raises(MachineError, match="pin 'lift_cylinder' or 'tilt_cylinder' to 'bellcrank'; or add"):
        read_machine(past)
