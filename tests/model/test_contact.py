"""A wall in the plant: what it does to the tip, and to the machine's accelerations."""

from __future__ import annotations

import pickle

import casadi as ca
import numpy as np
import pytest

from hydroopt.errors import ProblemError
from hydroopt.machine.machine_file import load_machine
from hydroopt.model.model import Model
from hydroopt.model.plant import Plant, Wall

WALL = Wall((1.0, 2.0, -1.0), (0.0, 0.6, 1.6), stiffness=1e6, damping=0.4, friction=0.3)
NORMAL = np.array([0.0, 0.6, 1.6]) / np.hypot(0.6, 1.6)
AT = np.array([1.0, 2.0, -1.0])


def force(place: np.ndarray, velocity: np.ndarray) -> np.ndarray:
    return np.asarray(ca.DM(ca.evalf(WALL.force(ca.SX(place), ca.SX(velocity))))).ravel()


def test_a_wall_pushes_and_never_pulls() -> None:
    still, sideways = np.zeros(3), np.cross(NORMAL, [1.0, 0.0, 0.0])
    assert np.all(force(AT + 1e-3 * NORMAL, still) == 0)
    np.testing.assert_allclose(force(AT - 2e-3 * NORMAL, still), 2000 * NORMAL, rtol=1e-12)
    np.testing.assert_allclose(force(AT - 2e-3 * NORMAL, -0.5 * NORMAL), 2600 * NORMAL, rtol=1e-12)
    assert np.all(force(AT - 2e-3 * NORMAL, 5 * NORMAL) == 0)  # it leaves faster than the wall follows
    sliding = force(AT - 2e-3 * NORMAL + 3 * sideways, 2 * sideways)
    assert sliding @ NORMAL == pytest.approx(2000)
    assert sliding @ sideways == pytest.approx(-600, rel=1e-4)


def test_an_impact_loses_energy_by_the_stated_restitution() -> None:
    """Mass on the wall: the coefficient of restitution is 1 − α·v for slow impacts (Hunt and Crossley 1975)."""
    mass, speed = 1000.0, 0.05
    x, v = ca.SX.sym("x"), ca.SX.sym("v")
    push = ca.dot(WALL.force(ca.SX(AT) + x * NORMAL, v * NORMAL), NORMAL)
    step = ca.integrator("impact", "cvodes", {"x": ca.vertcat(x, v), "ode": ca.vertcat(v, push / mass)}, 0.0, 0.2,
                         {"reltol": 1e-10, "abstol": 1e-12})
    after = float(step(x0=[0.0, -speed])["xf"][1])
    assert after / speed == pytest.approx(1 - WALL.damping * speed, abs=2 * (WALL.damping * speed) ** 2)
    assert after < speed


def test_the_plant_accelerates_by_the_wall_s_force() -> None:
    """D'Alembert: actuator forces are those of the motion that results, and what the wall's wrench adds."""
    model = Model(load_machine("cat215b"))
    free, rng = Plant(model), np.random.default_rng(4)
    q, qd = np.array([0.2, -0.3, 1.4]), 0.1 * rng.standard_normal(3)
    place = np.asarray(model.forward_kinematics(q)[-1])[:3, 3]
    plant = Plant(model, Wall(tuple(place + 0.01 * NORMAL), tuple(NORMAL), 1e6, 0.4, 0.3))
    psi = model.parameters.nominal
    steady = free.steady(q, qd, psi, free.parameters.nominal)
    given = {"x": steady.x, "u": steady.u, "supply": free.supply, "psi": psi, "theta": free.parameters.nominal}
    found = plant.outputs.call(given)
    contact = np.asarray(found["contact"]).ravel()
    velocity = np.asarray(model.tip_jacobian(q))[:3] @ qd
    assert contact @ NORMAL == pytest.approx(1e4 * (1 - 0.6 * (velocity @ NORMAL)))
    torque, own = (np.asarray(part).ravel() for part in plant._efforts(q, qd, found["qdd"], psi))
    smooth = np.linalg.solve(np.asarray(model.transmission(q)).T, torque) + own
    wall = np.asarray(model.wrench_forces(q, np.append(contact, np.zeros(3)))).ravel()
    np.testing.assert_allclose(smooth + wall, np.asarray(found["force"]).ravel(), rtol=1e-9)
    assert np.all(np.asarray(free.outputs.call(given)["contact"]) == 0)
    assert pickle.loads(pickle.dumps(plant)).wall == plant.wall


def test_an_impossible_wall_is_refused() -> None:
    with pytest.raises(ProblemError, match="positive stiffness"):
        Wall((0.0, 0.0, 0.0), (0.0, 0.0, 1.0), stiffness=-1.0)
