"""Valves that drive a machine with shared and passive joints, and on a slope: MuJoCo for the bodies, and energy."""

import numpy as np
import pytest
from scipy.integrate import simpson

from fixtures.drives import crane, oiled, sloping
from hydroopt.machine.machine import Machine
from hydroopt.machine.machine_file import load_machine
from hydroopt.model.model import Model
from hydroopt.model.plant import Plant
from oracles.mujoco_loops import MujocoLoops
from oracles.pinocchio_tree import PinocchioTree
from oracles.subjects import random_bodies, relative_error, states

STEP = 1e-3


@pytest.mark.parametrize("machine", [
    pytest.param(oiled(crane()), id="shared and passive"), pytest.param(sloping(), id="moving base"),
    pytest.param(load_machine("forestry_crane"), id="forestry_crane", marks=pytest.mark.slow)])
def test_bodies_accelerate_as_mujoco_says(machine: Machine) -> None:
    """Pressures accelerate the joints; for these accelerations MuJoCo needs what the pressures do, and nothing at
    passive joints. The base keeps its speed, whatever the ground has to do for that."""
    plant, rng = Plant(Model(machine)), np.random.default_rng(51)
    psi, clouds = random_bodies(plant.model, rng)
    tree, n = MujocoLoops(machine, clouds), len(machine.joints)
    base = [machine.joints.index(joint) for joint in machine.base_joints]
    own = [machine.actuators.index(each) for each in machine.powered]
    free = [k for k in range(n) if k not in base]
    acting, expected = [], []
    for q, qd, _ in zip(*states(machine, rng, 5), strict=True):
        x = np.zeros(len(plant.states))
        x[:n], x[n:2 * n] = q, qd
        x[[k for k, name in enumerate(plant.states) if ".p_" in name]] = rng.uniform(
            1e5, 2e7, sum(".p_" in name for name in plant.states))
        seen = plant.outputs(x=x, u=np.zeros(len(own)), supply=plant.supply, psi=psi, theta=plant.parameters.nominal)
        qdd = np.asarray(seen["qdd"]).ravel()
        assert not qdd[base].any()
        torque, arms = tree.virtual_work(q, qd, qdd)
        acting.append((arms[own].T @ np.asarray(seen["force"]).ravel())[free])
        expected.append(torque[free])
    driven = [k for k, j in enumerate(free) if machine.drivers[machine.joints[j]]]
    assert relative_error(np.array(acting)[:, driven], np.array(expected)[:, driven]) < 1e-9
    passive = np.delete(np.array(expected), driven, axis=1)
    assert np.max(np.abs(passive), initial=0.0) < 1e-9 * np.max(np.abs(expected))


def test_what_pressures_put_in_swings_and_lifts_and_is_lost_in_the_free_joint() -> None:
    """0.6 s of the crane, whose grapple swings: work of cylinders, energy by Pinocchio, friction of the free joint."""
    machine = oiled(crane())
    data = machine.model_dump(exclude={"notes"})
    for cylinder in data["cylinders"]:
        cylinder["friction"] = {}
    plant = Plant(Model(Machine.model_validate(data | {"orientation": (0.1, -0.15, 0.0)})))
    psi, theta, n = plant.model.parameters.nominal, plant.parameters.nominal, 4
    friction = psi[plant.model.parameters.index("grapple.tau_viscous")]
    integrator = plant.integrator(psi, theta)
    at = plant.steady(np.array([0.2, 0.3, -1.2, 0.4]), np.zeros(n), psi, theta)
    x = [at.x]
    for _ in range(600):
        x.append(integrator(x[-1], STEP, at.u + np.array([0.3, -0.3, 0.25, 0.3, -0.3]), plant.supply))
    found = [plant.outputs(one, at.u, plant.supply, psi, theta) for one in x]
    force, speed = (np.array([np.asarray(each[plant.outputs.name_out().index(key)]).ravel() for each in found])
                    for key in ("force", "speed"))
    x = np.array(x)
    names = plant.model.parameters.names
    clouds = {name[:-2]: psi[k:k + 10] for k, name in enumerate(names) if name.endswith(".m")}
    tree = PinocchioTree(plant.machine, clouds)
    work, lost = (simpson(values, dx=STEP) for values in (np.sum(force * speed, axis=1), friction * x[:, n + 3] ** 2))
    size = simpson(np.sum(np.abs(force * speed), axis=1), dx=STEP)
    gained = tree.energy(x[-1, :n], x[-1, n:2 * n]) - tree.energy(x[0, :n], x[0, n:2 * n])
    assert np.ptp(x[:, 3]) > 0.1
    assert lost > 1e-4 * size
    assert abs(work - lost - gained) < 1e-5 * size
