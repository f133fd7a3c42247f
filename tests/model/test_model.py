"""What a model and a plant are made of, and what they say of themselves."""

from __future__ import annotations

import pytest

from hydroopt.errors import ProblemError
from hydroopt.machine.machine_file import load_machine
from hydroopt.model.model import Model
from hydroopt.model.plant import Plant


def test_a_plant_takes_a_machine_or_its_model() -> None:
    machine = load_machine("patu655_lift")
    assert Plant(machine).states == Plant(Model(machine)).states


@pytest.mark.parametrize("given", ["cat215b", None, 3])
@pytest.mark.parametrize("noun", [Model, Plant])
def test_what_is_no_machine_is_refused_in_a_sentence(noun, given) -> None:
    with pytest.raises(ProblemError, match=r"Model: this is \w+ .*, not a Machine; give .*load_machine"):
        noun(given)


def test_reprs_are_one_short_line() -> None:
    machine = load_machine("kr300")
    for text in (repr(machine), str(machine), repr(Model(machine))):
        assert "\n" not in text
        assert len(text) < 100
