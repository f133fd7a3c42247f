"""The test of valves: what its steps cover, and that no true machine leaves its limits."""

from __future__ import annotations

import numpy as np
import pytest

from hydroopt import load_machine, random_truth
from hydroopt.control.valve_test import MARGIN, SLEW, driven_test, valve_test
from hydroopt.errors import ProblemError
from hydroopt.model.model import Model
from hydroopt.model.plant import Plant
from hydroopt.simulation.drive_valves import random_numbers


@pytest.fixture(scope="module")
def plant() -> Plant:
    return Plant(Model(load_machine("cat215b")))


def test_each_valve_opens_wide_and_little_both_ways(plant: Plant) -> None:
    psi, theta = plant.model.parameters.nominal, plant.parameters.nominal
    log = driven_test(valve_test(plant), psi, theta)
    for each in plant.actuators:
        opening = (log.channels[f"{each.actuator.name}.u"] - each.valve.neutral) / each.valve.span
        assert np.max(np.abs(np.diff(opening))) <= SLEW / 50 * (1 + 1e-9)
        for least, most in ((0.95, 1.0 + 1e-9), (0.45, 0.55), (0.1, 0.14)):
            for way in (-1, 1):
                inside = (least <= way * opening) & (way * opening <= most)
                assert np.sum(inside) / 50 > 0.2, (each.actuator.name, least, way)
    active = np.stack([log.channels[name] != each.valve.neutral
                       for name, each in zip(plant.inputs, plant.actuators, strict=True)])
    assert np.all(active.sum(axis=0) <= 2)  # while one shuts the next may open
    assert np.mean(active.sum(axis=0) <= 1) > 0.95


@pytest.mark.parametrize("seed", [1, 5, *(pytest.param(seed, marks=pytest.mark.slow) for seed in range(6, 26))])
def test_no_joint_leaves_its_range_whatever_valves_and_bodies(plant: Plant, seed: int) -> None:
    """Machines drawn from the file's confidences; seed 5 is one that runs away fast."""
    log = driven_test(valve_test(plant), random_truth(plant.model, seed), random_numbers(plant, seed), seed=seed)
    for joint in plant.machine.joints:
        lower, upper = plant.machine.link(joint).joint.range
        spare = 0.3 * MARGIN * (upper - lower)
        q = log.channels[f"{joint}.q"]
        assert lower + spare < q.min() < q.max() < upper - spare
        assert np.ptp(q) > 0.3


def test_a_test_that_is_too_short_is_refused(plant: Plant) -> None:
    with pytest.raises(ProblemError, match="does not cover all openings; give 10 s or more"):
        valve_test(plant, seconds=3.0)
