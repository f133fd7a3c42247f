"""Dry friction at standstill does not follow the sign of rounding."""

import numpy as np
import pytest

import hydroopt as ho
from hydroopt.simulation.simulate import Trajectory


@pytest.mark.parametrize("name", ["cat215b", "backhoe"])
def test_rounding_of_speeds_does_not_show_in_forces(name: str) -> None:
    """One actuator a joint, and several: the speed of a joint that stands still is rounding."""
    model = ho.Model(ho.load_machine(name))
    middle = np.array([np.mean(model.machine.link(joint).joint.range) for joint in model.machine.joints])
    still = np.zeros((20, len(middle)))
    rounding = 1e-15 * np.random.default_rng(0).standard_normal(still.shape)
    log = ho.simulate(model, Trajectory(np.arange(20) / 50, still + middle, rounding, still), noise=False)
    for channel, values in log.channels.items():
        if ".p_" in channel:
            assert np.ptp(values) < 1.0, channel
