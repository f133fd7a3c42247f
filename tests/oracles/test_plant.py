"""The machine on its valves: energy and oil along a motion, and MuJoCo for the bodies."""

import casadi as ca
import numpy as np
import pytest
from scipy.integrate import simpson

from hydroopt.machine.actuators import Cylinder
from hydroopt.machine.machine import Machine
from hydroopt.model.model import Model
from hydroopt.model.plant import SIGN_WIDTH, Plant
from hydroopt.model.workspace import sweeps
from oracles.mujoco_tree import MujocoTree
from oracles.pinocchio_tree import PinocchioTree
from oracles.subjects import model, random_bodies

STEP = 1e-3


def test_bodies_accelerate_as_mujoco_says():
    """Pressures accelerate the machine by q̈; to accelerate so, MuJoCo needs just the forces of these pressures."""
    subject = model("cat215b")
    plant, rng = Plant(subject), np.random.default_rng(31)
    psi, clouds = random_bodies(subject, rng)
    tree, theta, n = MujocoTree(subject.machine, clouds), plant.parameters.nominal, 3
    ranges = subject.machine.ranges
    for _ in range(40):
        x = np.zeros(len(plant.states))
        x[:n], x[n:2 * n] = rng.uniform(ranges[:, 0], ranges[:, 1]), rng.uniform(-0.5, 0.5, n)
        pressures = [k for k, name in enumerate(plant.states) if ".p_" in name]
        x[pressures] = rng.uniform(1e5, 2e7, len(pressures))
        seen = plant.outputs(x=x, u=np.zeros(n), supply=plant.supply, psi=psi, theta=theta)
        expected = tree.actuator_forces(x[:n], x[n:2 * n], np.asarray(seen["qdd"]).ravel())
        areas = np.array([each.areas for each in plant.actuators])
        chambers = x[[k for k in pressures if not plant.states[k].startswith("pump.")]].reshape(n, 2)
        assert np.allclose(areas[:, 0] * chambers[:, 0] - areas[:, 1] * chambers[:, 1], expected,
                           rtol=1e-9, atol=1e-9 * np.max(np.abs(expected)))


@pytest.fixture(scope="module")
def motion():
    """0.6 s of a CAT 215B whose valves open, with friction: states (N, nx), what is seen, and what it was."""
    subject = model("cat215b")
    plant, rng = Plant(subject), np.random.default_rng(32)
    psi = subject.parameters.nominal.copy()
    friction = {}
    for k, name in enumerate(subject.parameters.names):
        if name.endswith(("f_coulomb", "tau_coulomb")):
            psi[k] = friction[name] = rng.uniform(500, 3000)
        if name.endswith("_offset"):
            psi[k] = 1e4  # of transducers: must not act
    theta = plant.parameters.nominal
    integrator = plant.integrator(psi, theta)
    at = plant.steady(np.array([0.2, -0.5, 1.4]), np.zeros(3), psi, theta)
    u, x = np.array([0.3, 0.35, -0.3]), [at.x]
    for _ in range(600):
        x.append(integrator(x[-1], STEP, u, plant.supply))
    keys = plant.outputs.name_out()
    seen = dict(zip(keys, zip(*(map(np.asarray, plant.outputs(one, u, plant.supply, psi, theta)) for one in x),
                                strict=True), strict=True))
    return plant, psi, theta, friction, np.array(x), {key: np.array(value).squeeze() for key, value in seen.items()}


def test_what_pressures_put_in_is_what_bodies_hold_and_friction_takes(motion):
    plant, psi, _, friction, x, seen = motion
    names = plant.model.parameters.names
    clouds = {name[:-2]: psi[k:k + 10] for k, name in enumerate(names) if name.endswith(".m")}
    tree, n = PinocchioTree(plant.machine, clouds), 3
    work = simpson(np.sum(seen["force"] * seen["speed"], axis=1), dx=STEP)
    size = simpson(np.sum(np.abs(seen["force"] * seen["speed"]), axis=1), dx=STEP)
    owners = [each.actuator.name for each in plant.actuators]
    lost = 0.0
    for name, value in friction.items():
        owner = name.partition(".")[0]
        speed = (seen["speed"][:, owners.index(owner)] if owner in owners
                 else x[:, n + plant.machine.joints.index(owner)])
        lost += simpson(value * speed * np.tanh(speed / SIGN_WIDTH), dx=STEP)
    gained = tree.energy(x[-1, :n], x[-1, n:2 * n]) - tree.energy(x[0, :n], x[0, n:2 * n])
    assert lost > 1e-3 * size
    assert abs(work - lost - gained) < 1e-5 * size


@pytest.mark.slow
def test_oil_is_neither_made_nor_lost(motion):
    """Mass of oil in chamber and hose at both ends of the motion against what flowed in, by density, not by pressure.

    Density of the mixture by its volume at each pressure; walls of hoses widen linearly.
    """
    plant, _, theta, _, x, seen = motion
    machine = plant.machine
    air, beta, n = machine.oil.air, machine.oil.bulk_modulus, machine.oil.polytropic
    states = list(plant.states)

    def volume(p):  # of what fills one unit at ambient pressure
        return (1 - air) * (1 - p / beta) + air * (101325 / (101325 + p)) ** (1 / n)

    for k, each in enumerate(plant.actuators):
        value = plant.value(each, ca.DM(theta))
        names = [name for name in states if name.startswith(f"{each.actuator.name}.p_")]
        p = x[:, [states.index(name) for name in names]]
        p_supply = x[:, states.index("pump.p_supply")]
        flows = [each.flows(ca.DM(seen["spool"][i, k]), ca.DM(p[i, 0]), ca.DM(p[i, 1]),
                            ca.DM([p_supply[i], plant.supply[1]]), value) for i in range(len(x))]
        for port in range(2):
            into = np.array([float(flow[port]) for flow in flows])
            if isinstance(each.actuator, Cylinder):
                chamber = np.array([float(ca.DM(each.volumes(ca.DM(s))[port])) for s in seen["length"][:, k]])
            else:  # a motor holds nothing, but takes oil from one side to the other
                chamber, into = 0.0, into - (-1) ** port * each.areas[port] * seen["speed"][:, k]
            hose = [each.circuit.volume_a, each.circuit.volume_b][port]
            holds = chamber + hose * (1 + p[:, port] / each.circuit.hose_modulus)
            mass = holds / volume(p[:, port])
            gained, came = mass[-1] - mass[0], simpson(into / volume(p[:, port]), dx=STEP)
            assert abs(gained - came) < 2e-3 * simpson(np.abs(into), dx=STEP)


HALVED = ("friction", "rated_flow", "flow_pa", "flow_pb", "flow_at", "flow_bt", "volume_a", "volume_b", "leakage",
          "leakage_a", "leakage_b")


def _halved(part):
    """A cylinder's numbers for one of two that act alike: half of its areas, flows, volumes, friction and masses."""
    if isinstance(part, dict):
        return {key: _scaled(value) if key in HALVED or key == "body" else value / np.sqrt(2)
                if key in ("bore", "rod_diameter") else _halved(value) for key, value in part.items()}
    return part


def _scaled(value):
    if isinstance(value, dict):
        return {key: each if key in ("com", "shape", "symmetric", "stribeck_speed", "dead_zone") else _scaled(each)
                for key, each in value.items()}
    if isinstance(value, tuple):
        return tuple(_scaled(each) for each in value)
    return value / 2 if isinstance(value, float) else value


@pytest.fixture(scope="module")
def one_and_two() -> tuple[Machine, Machine]:
    """The crane with its one cylinder, and with two side by side that are half of it each."""
    one = model("patu655_lift").machine
    data = one.model_dump(exclude={"notes"})
    (cylinder,) = data["cylinders"]
    data["cylinders"] = [_halved(cylinder) | {"name": name} for name in ("left", "right")]
    return one, Machine.model_validate(data | {"sensors": ()})


def test_two_cylinders_side_by_side_swing_on_their_oil_as_one(one_and_two):
    found = []
    for machine in one_and_two:
        plant = Plant(Model(machine))
        (sweep, *_) = sweeps(plant, plant.model.parameters.nominal, plant.parameters.nominal, positions=2, postures=1)
        assert len(sweep.actuators) == len(plant.actuators)
        found.append([sweep.each(key) for key in ("frequency", "damping", "gain")])
    np.testing.assert_allclose(found[1], found[0], rtol=1e-6)


def test_two_cylinders_side_by_side_move_as_one_of_both_areas(one_and_two):
    found = []
    for machine in one_and_two:
        plant = Plant(Model(machine))
        psi, theta = plant.model.parameters.nominal, plant.parameters.nominal
        integrator = plant.integrator(psi, theta, tolerance=1e-9)
        at = plant.steady(np.array([0.3]), np.zeros(1), psi, theta)
        course = [at.x]
        for k in range(60):
            opened = at.u + 0.8 * np.sin(0.1 * k)
            course.append(integrator(course[-1], 0.01, opened, plant.supply))
        found.append(np.array(course))
    assert np.ptp(found[0][:, 0]) > 0.01
    np.testing.assert_allclose(found[1][:, :2], found[0][:, :2], rtol=1e-6, atol=1e-7)
    states = list(Plant(Model(one_and_two[1])).states)
    for chamber in ("p_head", "p_rod"):
        both = found[1][:, [states.index(f"{name}.{chamber}") for name in ("left", "right")]]
        np.testing.assert_allclose(both[:, 0], both[:, 1], rtol=1e-6)
