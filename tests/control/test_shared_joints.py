"""Closed loops where two cylinders share a joint, one of them is not measured, and a grapple swings freely."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from fixtures.drives import crane, oiled, sloping, twin
from hydroopt.control.axes import Axes
from hydroopt.control.cascade import Cascade, Gains
from hydroopt.control.closed_loop import Run, simulate
from hydroopt.control.comparison import FEEDFORWARD, LQG, compare
from hydroopt.control.reference import Demand
from hydroopt.control.setting import COMPLETE, TRUE, ModelVariant, Setting
from hydroopt.control.tuning import _singular_values
from hydroopt.errors import ProblemError
from hydroopt.machine.machine import Machine
from hydroopt.model.hanging import Hanging
from hydroopt.model.model import Model
from hydroopt.model.plant import Plant
from hydroopt.report.closed_loop import render
from hydroopt.simulation.simulate import Trajectory, random_trajectory

RATE = 50.0


def setting(machine: Machine, duration: float = 5.0) -> Setting:
    """The machine with its true parameters and exact sensors; its boom moves, and its grapple hangs at the start.

    The boom keeps away from where the lever arm of one of its cylinders vanishes.
    """
    model = Model(oiled(machine).with_joint_limits({"boom": (-0.3, 0.45), "grapple": (-2.5, 2.5)}))
    t, joints = np.arange(round(duration * RATE)) / RATE, model.machine.joints
    omega, size = 2 * np.pi / duration, 0.05 * np.array([joint == "boom" for joint in joints])
    start = np.array([{"boom": 0.0, "stick": -1.2}.get(joint, 0.0) for joint in joints])
    motion = Trajectory(t, Hanging(model).postures(start[None]) + np.outer(1 - np.cos(omega * t), size),
                        omega * np.outer(np.sin(omega * t), size), omega**2 * np.outer(np.cos(omega * t), size))
    true, theta = ModelVariant(TRUE, "nominal", model, model.parameters.nominal), Plant(model).parameters.nominal
    return Setting(Plant(model), motion, true, theta, theta, RATE, None)


@pytest.fixture(scope="module")
def asked() -> Setting:
    return setting(twin())


@pytest.fixture(scope="module")
def followed(asked: Setting) -> tuple[Demand, Run]:
    demand = asked.demands.by(asked.true.model, asked.true.psi)
    gains = Gains(np.array([1.2]), np.full(2, 3e-8), np.array([4.0]), np.array([0.1]))
    controller = Cascade(asked.demands.valves, demand, gains, 1 / RATE)
    return demand, simulate(asked.demands, controller, asked.plant, asked.true.psi, asked.true_theta, seed=None)


def test_the_joint_is_the_axis_of_both_cylinders(asked: Setting) -> None:
    axes = Axes(asked.plant)
    assert axes.names == ("boom",)
    assert axes.of.tolist() == [0, 0]
    arms = np.array([[0.5, 0.0], [-0.2, 0.0]])
    np.testing.assert_array_equal(axes.shares(arms), [[0.5], [-0.2]])
    np.testing.assert_array_equal(axes.slopes(arms), [[1.0, 0.0]])


def test_an_exact_model_follows_and_the_grapple_swings_as_predicted(followed: tuple[Demand, Run]) -> None:
    demand, run = followed
    assert not run.stopped
    for k, (least, most) in enumerate(((0.09, 0.02), (0.05, 0.1))):
        size = np.ptp(demand.q[:, k])
        assert size > least
        assert np.sqrt(np.mean((run.q - demand.q)[:, k] ** 2)) < most * size


def test_neither_cylinder_works_against_the_other(asked: Setting, followed: tuple[Demand, Run]) -> None:
    """Forces stay near those of the least sum of (force/capacity)², whatever the loops do."""
    demand, run = followed
    force = np.einsum("nks,ks->nk", run.pressure * [1, -1], [each.areas for each in asked.plant.actuators])
    assert np.max(np.abs(force - demand.measured_force)) < 0.1 * np.max(np.abs(demand.measured_force))


@pytest.mark.slow
def test_controllers_are_tuned_compared_and_reported(asked: Setting) -> None:
    shared = compare(asked, [asked.true._replace(name=COMPLETE)], [FEEDFORWARD, LQG])
    assert list(shared.parameters) == ["boom.position_gain", "boom_left.force_gain", "boom_right.force_gain",
                                       "boom.integral_time", "boom.filter_time"]
    for outcome in shared.outcomes:
        assert not outcome.run.stopped
        assert np.sqrt(np.mean(outcome.error[:, 0] ** 2)) < 0.02 * np.ptp(shared.reference[:, 0])
        assert min(margin.damping for margin in outcome.margins) > 0
    rows = shared.details()["candidates"][0]["joints"]
    assert [(one["joint"], one["actuator"]) for one in rows] == [
        ("boom", "boom_left and boom_right"), ("grapple", None)]
    assert rows[1]["peak_pressure"] is None
    page = render(shared)
    assert "No actuator moves grapple" in page


@pytest.mark.slow
def test_without_its_pressures_a_cylinder_has_no_force_feedback() -> None:
    asked = setting(crane("boom_right"))
    found = compare(asked, [asked.true._replace(name=COMPLETE)], [FEEDFORWARD, LQG])
    names = [each.actuator.name for each in asked.plant.actuators]
    assert found.gains.force[names.index("boom_right")] == 0 < found.gains.force[names.index("boom_left")]
    boom = asked.plant.machine.joints.index("boom")
    for outcome in found.outcomes:
        assert np.sqrt(np.mean(outcome.error[:, boom] ** 2)) < 0.02 * np.ptp(found.reference[:, boom])


def test_singular_values_in_closed_form() -> None:
    rng = np.random.default_rng(5)
    for size in (1, 2, 3):
        matrix = rng.standard_normal((40, size, size)) + 1j * rng.standard_normal((40, size, size))
        for found, expected in zip(_singular_values(matrix), np.linalg.svd(matrix)[1][:, [-1, 0]].T, strict=True):
            np.testing.assert_allclose(found, expected, rtol=1e-9)


def test_a_base_that_moves_is_refused() -> None:
    plant = Plant(Model(sloping()))
    motion = random_trajectory(plant.model, duration=2.0, rate=RATE, seed=0)
    asked = Setting(plant, motion, ModelVariant(TRUE, "", plant.model, plant.model.parameters.nominal),
                    plant.parameters.nominal, plant.parameters.nominal, RATE, None)
    with pytest.raises(ProblemError, match="the base moves in this motion; let it stand still"):
        _ = asked.reference
    still = np.where([joint in plant.machine.base_joints for joint in plant.machine.joints], 0.0, 1.0)
    standing = replace(asked, motion=Trajectory(motion.t, motion.q * still, motion.qd * still, motion.qdd * still))
    points = standing.points(plant, plant.model.parameters.nominal, plant.parameters.nominal)
    assert all(not point.qd[:2].any() and point.system.nstates for point in points if point.on_motion)
