"""The test of valves: what its steps cover, and that no true machine leaves its limits."""

from __future__ import annotations

import numpy as np
import pytest

from hydroopt import identification_problem, load_machine, random_truth, solve
from hydroopt.control.valve_test import HEAVIER, MARGIN, SLEW, driven_test, valve_test
from hydroopt.errors import ProblemError
from hydroopt.estimation.dynamic.identify import identify
from hydroopt.estimation.hydraulic.problem import hydraulic_problem
from hydroopt.logs.smoothing import SmoothingSpline
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


@pytest.mark.parametrize("seed", [5, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (1, *range(6, 26)))])
def test_no_joint_leaves_its_range_whatever_valves_and_bodies(plant: Plant, seed: int) -> None:
    """Machines drawn from the file's confidences; seed 5 is one that runs away fast."""
    log = driven_test(valve_test(plant), random_truth(plant.model, seed), random_numbers(plant, seed), seed=seed)
    for joint in plant.machine.joints:
        lower, upper = plant.machine.link(joint).joint.range
        spare = 0.3 * MARGIN * (upper - lower)
        q = log.channels[f"{joint}.q"]
        assert lower + spare < q.min() < q.max() < upper - spare
        assert np.ptp(q) > 0.25


@pytest.mark.slow
@pytest.mark.parametrize("name", ["excavator_bucket", "mini_excavator", "tampere_manipulator", "wheel_loader"])
def test_steps_of_fast_joints_begin_away_from_a_near_limit(name: str) -> None:
    """Their machines as known left their ranges, but for the loader: a full step began beside a limit, towards it."""
    plant = Plant(Model(load_machine(name)))
    log = driven_test(valve_test(plant), plant.model.parameters.nominal, plant.parameters.nominal, rate=100.0)
    for joint in plant.machine.joints:
        lower, upper = plant.machine.link(joint).joint.range
        assert lower < log.channels[f"{joint}.q"].min() < log.channels[f"{joint}.q"].max() < upper


def test_friction_is_not_smoothed_away(plant: Plant) -> None:
    """At the machine's own bandwidth a fifth of the swing's friction was."""
    test, truth = valve_test(plant), random_truth(plant.model, 1103)
    assert test.bandwidth == 10.0
    assert "--bandwidth 10" in test.sheet()
    log = driven_test(test, truth, random_numbers(plant, 1103), seed=1103)
    place = plant.model.parameters.positions["swing_motor.tau_coulomb"]

    def off(bandwidth: float | None) -> float:
        problem = identification_problem(plant.model, [log], smoothing=SmoothingSpline(bandwidth=bandwidth))
        return float(identify(problem, intervals=False).psi[place] / truth[place] - 1)

    assert abs(off(test.bandwidth)) < 0.1
    assert off(plant.machine.bandwidth) < -0.15


def test_cylinders_of_one_joint_are_driven_together() -> None:
    """Opposed ones against each other, the one with the shorter lever arm less; `braking` is by the relief pressure."""
    plant = Plant(model := Model(load_machine("backhoe")))
    test, names = valve_test(plant), ("swing_cylinder_left", "swing_cylinder_right")
    assert {step.actuators for step in test.steps} == {names, ("boom_cylinder",), ("stick_cylinder",),
                                                       ("bucket_cylinder",)}
    assert test.duration == pytest.approx(40.0)
    sheet = " ".join(test.sheet().split())
    assert "swing_cylinder_left and swing_cylinder_right move swing: neither moves while the other is shut" in sheet
    assert "swing_cylinder_left 100 %, swing_cylinder_right -100 %" in sheet
    q = (test.lower + test.upper) / 2
    for swing in (-0.7, 0.3, 1.0):
        q[0] = swing
        arms = plant.transmission(q).full()[:2, 0]
        np.testing.assert_allclose(test.opened(q, "swing"), np.sign(arms[0]) * arms / np.abs(arms).max(), rtol=1e-12)
    psi = plant.model.parameters.nominal
    arm, boom = plant.transmission(q).full()[2, 1], plant.actuators[2]
    weight, mass = model.gravity_torques(q, psi).full()[1, 0], plant.mass(q, psi).full()[1, 1]
    held = 250e5 * abs(arm) * boom.areas[int(arm < 0)]
    assert test.braking(q, 1, -1.0) == pytest.approx((held - HEAVIER * weight) / (HEAVIER * mass), rel=1e-9)
    assert weight > 0


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(4))
def test_valves_of_opposed_cylinders_are_identified_apart(seed: int) -> None:
    """Drawn backhoes, of which seed 0 fell past its limit before tests counted the way that relief valves brake in."""
    plant = Plant(Model(load_machine("backhoe")))
    theta = random_numbers(plant, seed)
    log = driven_test(valve_test(plant), random_truth(plant.model, seed), theta, seed=seed, rate=100.0)
    found = solve(hydraulic_problem(plant.machine, [log])).parameters
    off = np.array([(row.value - theta[plant.parameters.positions[name]]) / row.std for name, row in found.items()
                    if name.startswith("swing_")])
    assert len(off) == 14
    assert np.sqrt(np.mean(off**2)) < 1.6
    assert all(row.std < 0.02 * row.value for name, row in found.items() if "swing" in name and "flow" in name)


def test_a_test_that_is_too_short_is_refused(plant: Plant) -> None:
    with pytest.raises(ProblemError, match="does not cover all openings; give 10 s or more"):
        valve_test(plant, seconds=3.0)
