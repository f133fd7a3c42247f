"""Hybrid control: what is selected, what force is estimated, and that the demanded one comes about."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from hydroopt.control.cascade import Gains
from hydroopt.control.closed_loop import simulate
from hydroopt.control.hybrid import ForceGains, Hybrid, Pressing
from hydroopt.control.linear_plant import Reading
from hydroopt.control.reference import Demands, Reference
from hydroopt.control.setting import TRUE, ModelVariant
from hydroopt.control.valve_inversion import Valves
from hydroopt.errors import ProblemError
from hydroopt.machine.machine_file import load_machine
from hydroopt.model.inverse_kinematics import inverse_kinematics
from hydroopt.model.model import Model
from hydroopt.model.plant import Plant, Wall
from hydroopt.simulation.simulate import Trajectory

MODEL = Model(load_machine("cat215b"))
RATE, FORCE = 50.0, 8000.0
NORMAL = np.array([0.0, 0.0, 1.0])
PLACE = np.array([5.5, 0.5, -0.98])
FORCE_GAINS = ForceGains(1.1e-5, 1.0, 0.05, 0.1)
GAINS = Gains(np.array([2.5, 1.4, 2.8]), np.zeros(3), np.array([2.0, 3.5, 1.8]), np.zeros(3))


@cache
def pulling(seconds: float = 3.0) -> Trajectory:
    """All joints move slowly while the tip, first two centimetres above the floor, shall press on it."""
    q = inverse_kinematics(MODEL, PLACE)[0].q
    t = np.arange(round(seconds * RATE) + 1) / RATE
    wrench, ones = np.zeros((len(t), 6)), np.ones((len(t), 1))
    wrench[:, 2] = FORCE
    rate = np.array([0.02, -0.02, 0.05])
    return Trajectory(t, q + t[:, None] * rate, ones * rate, 0 * ones * rate, wrench)


def hybrid(demands: Demands, motion: Trajectory, psi: np.ndarray) -> Hybrid:
    assert motion.wrench is not None
    return Hybrid(demands.valves, demands.by(MODEL, psi), GAINS, 1 / RATE, variant=ModelVariant(TRUE, "", MODEL, psi),
                  pressing=Pressing(motion, NORMAL, motion.wrench[:, 2]), force_gains=FORCE_GAINS)


def demands_of(plant: Plant, motion: Trajectory) -> Demands:
    return Demands(Valves(plant, plant.parameters.nominal), Reference(motion), motion.t)


def test_selection_splits_the_motion_of_the_tip() -> None:
    motion = pulling(0.1)
    plant = Plant(MODEL)
    one = hybrid(demands_of(plant, motion), motion, MODEL.parameters.nominal)
    J = np.asarray(MODEL.tip_jacobian(motion.q[0]))[:3]
    T = np.column_stack([np.asarray(plant.actuator_motion(motion.q[0], unit)[1]).ravel() for unit in np.eye(3)])
    to_tip = J @ np.linalg.inv(T)
    np.testing.assert_allclose(to_tip @ one._across[0], -NORMAL, atol=1e-12)
    along = to_tip @ one._along[0] @ np.linalg.inv(to_tip)
    np.testing.assert_allclose(along, np.diag([1.0, 1.0, 0.0]), atol=1e-12)


def test_the_force_in_the_pressures_is_found() -> None:
    motion = pulling(0.1)
    rng = np.random.default_rng(1)
    moving = replace(motion, qd=0.1 * rng.standard_normal(motion.q.shape), qdd=rng.standard_normal(motion.q.shape))
    psi = MODEL.parameters.nominal
    one = hybrid(demands_of(Plant(MODEL), motion), moving, psi)
    wrench = np.array([300.0, -200.0, FORCE, 0, 0, 0])
    force = MODEL.inverse_dynamics(moving.q[2], moving.qd[2], moving.qdd[2], psi) + MODEL.wrench_forces(
        moving.q[2], wrench)
    reading = Reading(moving.q[2], np.zeros(3), np.asarray(force).ravel(), np.zeros((3, 2)), np.zeros(2))
    assert one.estimated_force(2, reading) == pytest.approx(FORCE, rel=1e-9)


@pytest.mark.slow
def test_the_tip_comes_to_the_wall_wherever_it_is_and_presses() -> None:
    """Without errors of model and sensors the demanded force comes about, with a floor 1 or 4 cm below the tip."""
    motion, psi = pulling(), MODEL.parameters.nominal
    for height in (-0.99, -1.02):
        plant = Plant(MODEL, Wall((0.0, 0.0, height), (0.0, 0.0, 1.0), 1e6, 0.5, 0.2))
        demands = demands_of(plant, motion)
        done = simulate(demands, hybrid(demands, motion, psi), plant, psi, plant.parameters.nominal, seed=None)
        pushed = done.contact[:, 2]
        assert not done.stopped
        assert pushed[0] == 0
        error = pushed[-50:] - FORCE  # the spool of the boom, which hardly moves, jumps across its dead band
        assert abs(np.mean(error)) < 0.05 * FORCE
        assert np.sqrt(np.mean(error**2)) < 0.15 * FORCE
        assert np.max(pushed) < 2 * FORCE


def test_a_machine_without_three_joints_is_refused() -> None:
    lift = Model(load_machine("patu655_lift"))
    plant, zero = Plant(lift), np.zeros((6, 1))
    motion = Trajectory(np.arange(6) / RATE, zero + 0.3, zero, zero, np.zeros((6, 6)))
    gains = Gains(*(np.ones(1) for _ in range(4)))
    with pytest.raises(ProblemError, match="1 joints move the tip"):
        Hybrid(Valves(plant, plant.parameters.nominal), None, gains, 1 / RATE,  # type: ignore[arg-type]
               variant=ModelVariant(TRUE, "", lift, lift.parameters.nominal),
               pressing=Pressing(motion, NORMAL, np.zeros(6)), force_gains=FORCE_GAINS)
