"""Poses, cylinders, triangles and gas, against formulas written here a second time in numpy."""

import numpy as np
import pytest

from hydroopt.machine.actuators import GasCylinder
from hydroopt.machine.machine import BASE, Machine
from hydroopt.machine.machine_file import load_machine
from hydroopt.model.model import Model
from hydroopt.model.regressor import gas_force

STEP = 1e-30


def A(theta, d, a=0.0, alpha=0.0, beta=0.0):
    """Eq. 3.10 as printed; complex arguments pass through it."""
    Ct, St, Ca, Sa, Cb, Sb = (f(x) for x in (theta, alpha, beta) for f in (np.cos, np.sin))
    return np.array([[Cb * Ct - Sa * Sb * St, -Ca * St, Sb * Ct + Sa * Cb * St, a * Ct],
                     [Cb * St + Sa * Sb * Ct, Ca * Ct, Sb * St - Sa * Cb * Ct, a * St],
                     [-Ca * Sb, Sa, Ca * Cb, d],
                     [0, 0, 0, 1]])


def poses(machine, q):
    """P_i and far end (4, 4) of every link."""
    found = {BASE: (np.eye(4), np.eye(4))}
    for link in machine.links:
        j = link.joint
        variable = q[machine.joints.index(link.name)] if link.name in machine.joints else 0.0
        theta = j.theta + (variable if j.type == "revolute" else 0.0)
        d = j.d + (variable if j.type == "prismatic" else 0.0)
        start = found[link.parent][1]
        found[link.name] = start @ A(theta, d), start @ A(theta, d, j.a, j.alpha, j.beta)
    return found


def lengths(machine, q):
    """Pin distances of all cylinders; analytic, so that a complex step through it is exact."""
    at = poses(machine, q)
    lines = [(at[c.rod.link][0] @ [*c.rod.pin, 1] - at[c.barrel.link][0] @ [*c.barrel.pin, 1])[:3]
             for c in (*machine.cylinders, *machine.gas_cylinders)]
    return np.array([np.sqrt(np.sum(line**2)) for line in lines])


def in_limits(machine, rng):
    joints = [machine.link(name).joint for name in machine.joints]
    return np.array([rng.uniform(j.lower, j.upper) for j in joints])


def random_chain(rng):
    """A tree of random joints of all three kinds, each moving one with a drive."""
    links, parents = [], [BASE]
    for k in range(7):
        kind = rng.choice(["revolute", "prismatic", "locked"], p=[0.5, 0.3, 0.2]) if k else "revolute"
        numbers = dict(zip(("theta", "d", "a", "alpha", "beta"), rng.uniform(-2, 2, 5), strict=True))
        limits = {} if kind == "locked" else {"lower": -1.0, "upper": 1.0}
        links.append({"name": f"l{k}", "parent": str(rng.choice(parents[-2:])),
                      "joint": {"type": str(kind), **numbers, **limits}})
        parents.append(f"l{k}")
    drives = [{"name": f"{link['name']}_drive", "joint": link["name"]} for link in links
              if link["joint"]["type"] != "locked"]
    return Machine.model_validate({"name": "chain", "links": links, "drives": drives})


@pytest.mark.parametrize("seed", range(6))
def test_forward_kinematics_is_the_product_of_eq_3_10(seed):
    rng = np.random.default_rng(seed)
    machine = random_chain(rng)
    model = Model(machine)
    q = rng.uniform(-1, 1, len(machine.joints))
    found = model.forward_kinematics.call({"q": q})
    for name, (_, far_end) in poses(machine, q).items():
        if name != BASE:
            np.testing.assert_allclose(np.array(found[name]), far_end, atol=1e-13)


@pytest.mark.parametrize("name", ["cat215b", "kr300", "patu655_lift"])
def test_cylinders_follow_their_pins(name):
    machine = load_machine(name)
    model = Model(machine)
    rng = np.random.default_rng(31)
    n = len(machine.joints)
    for _ in range(20):
        q, qd, qdd = in_limits(machine, rng), rng.uniform(-1, 1, n), rng.uniform(-1, 1, n)

        def rates(t, q=q, qd=qd, qdd=qdd):
            """Length, speed and lever arms at a time of a motion with these rates, by complex steps."""
            here, speed = q + qd * t + qdd * t**2 / 2, qd + qdd * t
            along = [lengths(machine, here + 1j * STEP * v).imag / STEP for v in (speed, *np.eye(n))]
            return lengths(machine, here), along[0], np.array(along[1:]).T

        found = model.cylinder_kinematics(q, qd, qdd)
        length, speed, acceleration, arm, arm_rate = (np.array(v) for v in found)
        expected = rates(0.0)
        h = 1e-3  # the fourth-order difference errs by about h⁴, and by rounding of 1e-13
        earliest, early, late, latest = (rates(k * h) for k in (-2, -1, 1, 2))
        _, expected_acceleration, expected_arm_rate = (
            (a - 8 * b + 8 * c - d) / (12 * h)
            for a, b, c, d in zip(earliest, early, late, latest, strict=True))
        np.testing.assert_allclose(length[:, 0], expected[0], rtol=1e-13)
        np.testing.assert_allclose(speed[:, 0], expected[1], atol=1e-13)
        np.testing.assert_allclose(arm, expected[2], atol=1e-13)
        np.testing.assert_allclose(acceleration[:, 0], expected_acceleration, atol=1e-9)
        np.testing.assert_allclose(arm_rate, expected_arm_rate, atol=1e-9)


# Table 3 and, for the offsets, Table 11 (measured angles); the file's pins are rounded to 0.01 mm
@pytest.mark.parametrize(("cylinder", "upper", "lower", "offset", "dead_length"), [
    ("boom_cylinder", 0.625, 2.000, -78.6, 1.423), ("stick_cylinder", 2.444, 0.720, 10.3, 1.799)])
def test_triangles_of_the_excavator(cylinder, upper, lower, offset, dead_length):
    machine = load_machine("cat215b")
    part = next(c for c in machine.cylinders if c.name == cylinder)
    joint = machine.link(machine.axis_of(part)).joint
    to_length, _ = Model(machine).triangles[cylinder]
    assert part.dead_length == dead_length
    for angle in np.linspace(joint.lower, joint.upper, 30):
        cosine = np.cos(angle + np.radians(offset))
        displacement = np.sqrt(upper**2 + lower**2 - 2 * upper * lower * cosine) - dead_length  # Eq. 3.26
        found = float(to_length(angle)) - part.dead_length
        assert found == pytest.approx(displacement, abs=1e-4)
        assert 0 <= found <= part.stroke


@pytest.mark.parametrize(("name", "cylinder"), [
    ("cat215b", "boom_cylinder"), ("cat215b", "stick_cylinder"), ("patu655_lift", "lift_cylinder")])
def test_triangles_both_ways(name, cylinder):
    machine = load_machine(name)
    part = next(c for c in machine.cylinders if c.name == cylinder)
    index = machine.joints.index(machine.axis_of(part))
    joint = machine.link(machine.joints[index]).joint
    to_length, to_angle = Model(machine).triangles[cylinder]
    row = machine.cylinders.index(part)
    for angle in np.linspace(joint.lower, joint.upper, 50):
        length = float(to_length(angle))
        q = np.where(np.arange(len(machine.joints)) == index, angle, 0.1)
        assert length == pytest.approx(lengths(machine, q)[row], rel=1e-13)
        assert float(to_angle(length)) == pytest.approx(angle, abs=1e-12)
    angles = np.linspace(-np.pi, np.pi, 721)
    closed = [float(to_length(angle)) for angle in angles]
    for length in (0.99 * min(closed), 1.01 * max(closed), 0.0):
        assert np.isnan(float(to_angle(length)))


def counterbalance():
    (gas,) = load_machine("kr300").gas_cylinders
    return gas


@pytest.mark.parametrize(("acts", "polytropic"), [("pull", 1.0), ("pull", 1.4), ("push", 1.0), ("push", 1.3)])
def test_gas_works_against_its_compression(acts, polytropic):
    gas = GasCylinder.model_validate(counterbalance().model_dump() | {"acts": acts, "polytropic": polytropic})
    for length in np.linspace(0.5, 0.8, 7):
        grown = gas.area * (length - gas.reference_length) * (1 if acts == "push" else -1)
        pressure = gas.precharge * (gas.volume / (gas.volume + grown)) ** polytropic
        force = gas.precharge * float(gas_force(gas, length))
        assert force == pytest.approx(pressure * gas.area * (1 if acts == "push" else -1), rel=1e-13)


# JonasWeigand/Robot_Identification (MIT licence), run A of the KR300: pressures read at the robot [bar] over
# the angle of axis 2 as its panel shows it, 90 deg less than the joint variable (upright at -90 deg)
PANEL = (-120, -110, -100, -90, -80, -70, -60, -50, -40)
PRESSURES = (170, 167, 164, 162, 164, 170, 180, 190, 200)


def test_counterbalance_as_measured():
    model = Model(load_machine("kr300"))
    gas = counterbalance()
    for panel, measured in zip(PANEL, PRESSURES, strict=True):
        q = np.zeros(6)
        q[1] = np.radians(panel + 90)
        length, _, _, arm, _ = (np.array(v) for v in model.cylinder_kinematics(q, np.zeros(6), np.zeros(6)))
        pressure = -gas.precharge * float(gas_force(gas, length[0, 0])) / gas.area
        # an isotherm through nominal numbers, against rounded readings of a gauge
        assert pressure / 1e5 == pytest.approx(measured, abs=4)
        # the law of the source: δ = axis angle + 95°, sides of 0.8 m and 0.2 m
        delta = np.radians(panel + 95)
        distance = np.sqrt(0.8**2 + 0.2**2 - 2 * 0.8 * 0.2 * np.cos(delta))
        assert length[0, 0] == pytest.approx(distance, abs=1e-9)
        assert arm[0, 1] == pytest.approx(0.8 * 0.2 * np.sin(delta) / distance, abs=1e-9)
        spare = 0.00096 - (distance - 0.6) * gas.area
        torque = arm[0, 1] * gas.area * 1.01 * 296.8 * 328 * 0.159 / spare
        column = model.parameters.index("counterbalance.precharge")
        K = np.array(model.regressor(q, np.zeros(6), np.zeros(6)))
        # the gas pulls the cylinder short: what it takes from the joint the drive must add
        assert K[1, column] * gas.precharge == pytest.approx(torque, rel=1e-6, abs=1e-6)
