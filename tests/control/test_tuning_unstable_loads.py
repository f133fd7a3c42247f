"""Tuning where a load lightens along the motion, so that errors grow unless the position gain is high enough."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from control import StateSpace, feedback

from hydroopt import Model, Plant, load_machine
from hydroopt.control.axes import Axes
from hydroopt.control.cascade import linear_feedback
from hydroopt.control.linear_plant import Point, linearised, point, sampled
from hydroopt.control.loops import margins
from hydroopt.control.tuning import tuned
from hydroopt.control.valve_inversion import Valves

RATE = 100.0


States = dict[str, tuple[list[float], list[float]]]


def manipulator(states: States) -> tuple[Valves, list[Point], list[StateSpace]]:
    """Tampere's manipulator in positions and at speeds by name [rad, m]."""
    plant = Plant(Model(load_machine("tampere_manipulator")))
    psi, theta = plant.model.parameters.nominal, plant.parameters.nominal
    points = [point(plant, name, np.array(q), np.array(qd), psi, theta) for name, (q, qd) in states.items()]
    return Valves(plant, theta), points, [sampled(linearised(plant, each, psi, theta), plant.delays, 1 / RATE)
                                          for each in points]


@pytest.fixture(scope="module")
def upright() -> tuple[Valves, list[Point], list[StateSpace]]:
    """The lift goes up nearly upright, and slowly in the middle of its range."""
    return manipulator({"upright": ([1.21, -0.377, 0.36], [0.27, -0.082, -0.05]),
                        "middle": ([0.6, -1.0, 0.4], [-0.1, 0.1, 0.1])})


def growth(system: StateSpace) -> float:
    return float(np.log(np.max(np.abs(system.poles()))) * RATE)


def test_a_load_that_lightens_is_stabilised(upright: tuple[Valves, list[Point], list[StateSpace]]) -> None:
    valves, points, plants = upright
    assert growth(plants[0]) > 0.15
    gains = tuned(plants, points, valves)

    def closed(part: float) -> float:
        less = replace(gains, position=part * gains.position)
        return max(growth(feedback(plant, linear_feedback(Axes(valves.plant), valves, less, 1 / RATE, each), sign=1))
                   for plant, each in zip(plants, points, strict=True))

    assert closed(1.0) < 0
    assert closed(0.1) > 0  # which the sensitivity alone does not show


@pytest.mark.slow
def test_fast_loops_yield_to_one_that_finds_no_gains_beside_them() -> None:
    valves, points, plants = manipulator({"upright": ([1.413, -1.292, 0.006], [0.27, 0.412, 0.051]),
                                          "slow": ([0.571, -0.727, 0.876], [-0.035, -0.044, -0.03])})
    gains = tuned(plants, points, valves)
    assert np.all(gains.position > 1.0)
    for plant, each in zip(plants, points, strict=True):
        assert growth(feedback(plant, linear_feedback(Axes(valves.plant), valves, gains, 1 / RATE, each), sign=1)) < 0


@pytest.mark.slow
def test_robustness_yields_a_little_where_slower_loops_do_not_help() -> None:
    valves, points, plants = manipulator({"light": ([1.35, -0.445, 0.212], [0.27, 0.247, -0.217]),
                                          "slow": ([1.309, -1.6, 0.164], [-0.035, -0.044, -0.03]),
                                          "low": ([0.848, -0.785, 0.089], [0.035, -0.044, -0.03])})
    gains = tuned(plants, points, valves)
    names = [each.actuator.name for each in valves.plant.actuators]
    assert np.all(gains.position > 1.0)
    for plant, each in zip(plants, points, strict=True):
        cascade = linear_feedback(Axes(valves.plant), valves, gains, 1 / RATE, each)
        assert growth(feedback(plant, cascade, sign=1)) < 0
        for margin in margins(plant, cascade, names, each.name)[0]:
            assert margin.gain > 10 ** (6 / 20)
            assert np.degrees(margin.phase) > 36
