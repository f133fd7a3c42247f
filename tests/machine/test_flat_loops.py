"""Calibrated numbers of planar loops still make a machine: its pins stay together along their axes."""

from __future__ import annotations

import numpy as np
import pytest

from hydroopt.errors import MachineError
from hydroopt.machine.calibrated_numbers import closed_flat
from hydroopt.machine.machine_file import dump_machine, load_machine, read_machine


@pytest.mark.parametrize(("name", "moved"), [
    ("excavator_bucket", "rocker.pin.z"), ("wheel_loader", "bellcrank.pin.z"), ("scissor_lift", "middle.z"),
    ("scissor_lift", "rail.d"), ("knuckle_boom_crane", "rocker.pin.z")])
def test_a_pin_beside_the_plane_is_followed(name: str, moved: str) -> None:
    machine = load_machine(name)
    values = {moved: machine.numbers[moved].value + 0.003}
    if moved != "middle.z":  # the pin that follows; it has nothing to follow itself
        with pytest.raises(MachineError, match="mm apart along its axes"):
            read_machine(dump_machine(machine.with_values(values)))
    followed = closed_flat(machine, values)
    made = read_machine(dump_machine(machine.with_values(followed)))
    assert {address for address, value in followed.items()
            if value != machine.numbers[address].value} <= {moved, *(f"{loop.name}.{axis}" for loop in machine.loops
                                                                     for axis in "xyz")}
    assert np.isclose(made.numbers[moved].value, followed[moved])


def test_what_leaves_the_plane_alone_is_left_alone() -> None:
    machine = load_machine("excavator_bucket")
    assert closed_flat(machine, {"rocker.a": 0.9, "boom.a": 6.2}) == {"rocker.a": 0.9, "boom.a": 6.2}
    assert closed_flat(load_machine("cat215b"), {"boom.a": 5.1}) == {"boom.a": 5.1}
