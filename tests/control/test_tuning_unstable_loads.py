"""Tuning where a load lightens along the motion, so that errors grow unless the position gain is high enough."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hydroopt import Model, Plant, load_machine
from hydroopt.control.axes import Axes
from hydroopt.control.cascade import Feedback, Gains
from hydroopt.control.linear_plant import Point, point
from hydroopt.control.loops import Loops
from hydroopt.control.tuning import tuned
from hydroopt.control.valve_inversion import Valves

RATE = 100.0


States = dict[str, tuple[list[float], list[float]]]


def manipulator(states: States) -> tuple[Valves, list[Point]]:
    """Tampere's manipulator in positions and at speeds by name [rad, m]."""
    plant = Plant(Model(load_machine("tampere_manipulator")))
    psi, theta = plant.model.parameters.nominal, plant.parameters.nominal
    return Valves(plant, theta), [point(plant, name, np.array(q), np.array(qd), psi, theta, 1 / RATE)
                                  for name, (q, qd) in states.items()]


def closed(valves: Valves, points: list[Point], gains: Gains) -> list[Loops]:
    axes = Axes(valves.plant)
    law = Feedback(axes, 1 / RATE)
    return [Loops.about(each, axes, law.about(each, valves, gains)) for each in points]


@pytest.fixture(scope="module")
def upright() -> tuple[Valves, list[Point]]:
    """The lift goes up nearly upright, and slowly in the middle of its range."""
    return manipulator({"upright": ([1.21, -0.377, 0.36], [0.27, -0.082, -0.05]),
                        "middle": ([0.6, -1.0, 0.4], [-0.1, 0.1, 0.1])})


def growth(poles: np.ndarray) -> float:
    return float(np.log(np.max(np.abs(poles))) * RATE)


def test_a_load_that_lightens_is_stabilised(upright: tuple[Valves, list[Point]]) -> None:
    valves, points = upright
    assert growth(points[0].system.poles()) > 0.15
    gains = tuned(points, valves)

    def fastest(part: float) -> float:
        less = replace(gains, position=part * gains.position)
        return max(growth(loops.poles) for loops in closed(valves, points, less))

    assert fastest(1.0) < 0
    assert fastest(0.1) > 0  # which the sensitivity alone does not show


@pytest.mark.slow
def test_fast_loops_yield_to_one_that_finds_no_gains_beside_them() -> None:
    valves, points = manipulator({"upright": ([1.413, -1.292, 0.006], [0.27, 0.412, 0.051]),
                                  "slow": ([0.571, -0.727, 0.876], [-0.035, -0.044, -0.03])})
    gains = tuned(points, valves)
    assert np.all(gains.position > 1.0)
    assert all(growth(loops.poles) < 0 for loops in closed(valves, points, gains))


@pytest.mark.slow
def test_robustness_yields_a_little_where_slower_loops_do_not_help() -> None:
    valves, points = manipulator({"light": ([1.35, -0.445, 0.212], [0.27, 0.247, -0.217]),
                                  "slow": ([1.309, -1.6, 0.164], [-0.035, -0.044, -0.03]),
                                  "low": ([0.848, -0.785, 0.089], [0.035, -0.044, -0.03])})
    gains = tuned(points, valves)
    assert np.all(gains.position > 1.0)
    for loops in closed(valves, points, gains):
        assert growth(loops.poles) < 0
        for margin in loops.margins:
            assert margin.gain > 10 ** (6 / 20)
            assert np.degrees(margin.phase) > 36
