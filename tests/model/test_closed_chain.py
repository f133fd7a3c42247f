"""The closed chain beside the other model of the same machine."""

from __future__ import annotations

import numpy as np
import pytest

from hydroopt.machine.machine_file import load_machine
from hydroopt.model.closed_chain import KinematicModel
from hydroopt.model.model import Model


@pytest.mark.parametrize("name", ["backhoe", "excavator_bucket", "knuckle_boom_crane", "wheel_loader"])
def test_gravity_loads_joints_by_links_barrels_and_rods(name: str) -> None:
    machine = load_machine(name)
    chain, model = KinematicModel(machine), Model(machine)
    lower, upper = machine.ranges.T
    q = np.random.default_rng(3).uniform(lower, upper, (20, len(lower)))
    if name == "wheel_loader":  # not every pair of angles can be reached
        q = (lower + upper) / 2 + 0.1 * (q - (lower + upper) / 2)
    gravity = chain.over(chain.gravity_torque, chain.parameters.nominal, q)[0][:, :, 0]
    held = model.over(model.gravity_torques, q, np.tile(model.parameters.nominal, (len(q), 1)))[0][:, :, 0]
    assert np.abs(gravity + held).max() < 1e-9 * np.abs(held).max()
