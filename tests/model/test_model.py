"""What a model and a plant are made of, and what they say of themselves."""

from __future__ import annotations

from hydroopt.machine.machine_file import load_machine
from hydroopt.model.model import Model
from hydroopt.model.plant import Plant


def test_a_plant_takes_a_machine_or_its_model() -> None:
    machine = load_machine("patu655_lift")
    assert Plant(machine).states == Plant(Model(machine)).states


def test_reprs_are_one_short_line() -> None:
    machine = load_machine("kr300")
    for text in (repr(machine), str(machine), repr(Model(machine))):
        assert "\n" not in text
        assert len(text) < 100
