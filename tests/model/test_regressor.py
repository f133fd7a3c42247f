"""Shape, order and structure of K, friction, residuals, and what K can tell about its parameters."""

import numpy as np
import pytest

from hydroopt.machine.machine import Machine
from hydroopt.machine.machine_file import load_machine
from hydroopt.model.model import Model
from hydroopt.spatial.inertia import NAMES

BUNDLED = ("cat215b", "kr300", "patu655_lift")


def states(machine, rng, count):
    joints = [machine.link(name).joint for name in machine.joints]
    lower, upper = np.array([(j.lower, j.upper) for j in joints]).T
    return [rng.uniform(lower, upper, (count, len(joints))), *rng.uniform(-1, 1, (2, count, len(joints)))]


@pytest.fixture(scope="module")
def excavator():
    return Model(load_machine("cat215b"))


def test_order_of_eq_4_53_and_4_54(excavator):
    def cylinder(link):
        own = f"{link}_cylinder"
        return [*[f"{body}.{name}" for body in (link, f"{own}.rod", f"{own}.barrel") for name in NAMES],
                f"{link}.tau_coulomb", f"{own}.f_offset", f"{own}.f_coulomb",
                f"{own}.n_barrel", f"{own}.n_rod"]

    motor = [*[f"swing.{name}" for name in NAMES], "swing_motor.tau_offset", "swing_motor.tau_coulomb"]
    expected = [*motor, *cylinder("boom"), *cylinder("stick")]
    assert (len(motor), len(expected)) == (12, 12 + 35 + 35)
    assert list(excavator.parameters.names) == expected
    assert excavator.regressor.size_out(0) == (3, 82)


def test_no_link_feels_those_before_it(excavator):
    K, = excavator.over(excavator.regressor, *states(excavator.machine, np.random.default_rng(41), 50))
    largest = np.max(np.abs(K), axis=(0, 1))
    for joint, before in ((1, 12), (2, 47)):  # Eq. 4.55 is block upper triangular
        assert np.all(np.abs(K[:, joint, :before]) <= 1e-12 * largest[:before])


@pytest.mark.parametrize("name", BUNDLED)
def test_reduced_model_is_complete_one_without_barrels_and_rods(name):
    complete, reduced = Model(load_machine(name)), Model(load_machine(name), actuator_inertia=False)
    state = states(complete.machine, np.random.default_rng(42), 20)
    kept = [p for p in complete.parameters.names if ".rod." not in p and ".barrel." not in p]
    assert list(reduced.parameters.names) == kept
    (whole,), (part,) = (m.over(m.regressor, *state) for m in (complete, reduced))
    np.testing.assert_allclose(part, whole[:, :, complete.parameters.select(kept)], rtol=1e-12, atol=1e-9)


@pytest.mark.parametrize("name", BUNDLED)
def test_friction_takes_power(name):
    model = Model(load_machine(name))
    q, qd, qdd = states(model.machine, np.random.default_rng(43), 200)
    K, = model.over(model.regressor, q, qd, qdd)
    power = np.einsum("sa,sap->ps", actuator_speeds(model, q, qd, qdd), K)
    frictions = [k for k, parameter in enumerate(model.parameters.names)
                 if parameter.endswith(("_coulomb", "_viscous", ".n_barrel", ".n_rod"))]
    assert frictions
    assert np.all(power[frictions] > 0)


def actuator_speeds(model, q, qd, qdd):
    """Speeds (N, n) of the actuators, in their order."""
    _, strokes, *_ = model.over(model.cylinder_kinematics, q, qd, qdd)
    cylinders = [c.name for c in model.machine.cylinders]
    return np.column_stack([strokes[:, cylinders.index(a.name), 0] if a.name in cylinders
                            else qd[:, model.machine.joints.index(a.joint)] for a in model.machine.actuators])


@pytest.mark.parametrize("name", BUNDLED)
def test_residual_and_its_jacobians(name):
    model = Model(load_machine(name))
    rng = np.random.default_rng(44)
    n, p = len(model.machine.joints), len(model.parameters)
    q, qd, qdd = (series[0] for series in states(model.machine, rng, 1))
    arguments = [q, qd, qdd, rng.uniform(-1e4, 1e4, n), rng.uniform(-100, 100, p)]
    value = np.array(model.residual(*arguments))
    expected = arguments[3] - np.array(model.regressor(q, qd, qdd)) @ arguments[4]
    np.testing.assert_allclose(value[:, 0], expected, rtol=1e-11, atol=1e-8)
    jacobians = [np.array(j) for j in model.residual_jacobian(*arguments, value)]
    for k, jacobian in enumerate(jacobians):
        for column, unit in enumerate(np.eye(len(arguments[k]))):
            def at(step, k=k, unit=unit):
                moved = [a + step * unit if i == k else a for i, a in enumerate(arguments)]
                return np.array(model.residual(*moved))[:, 0]

            h = 1e-4
            slope = (at(-2 * h) - 8 * at(-h) + 8 * at(h) - at(2 * h)) / (12 * h)
            atol = 1e-6 * np.max(np.abs(jacobian))
            np.testing.assert_allclose(jacobian[:, column], slope, rtol=1e-6, atol=atol)


# Nine of the swing's parameters are silent, as it only turns about the vertical. With d_2 = 0, so are the
# first moments mc_z of the boom and of its cylinder's barrel: across the plane of the machine they could act
# through the swing alone, and the origins of both bodies stay at one radius. (Those of boom rod, stick, stick
# barrel and stick rod move in that plane, which accelerates mc_z about the swing's axis.) With d_2 = -0.11 m
# the origins stand beside the swing's axis, and the parallel axis theorem adds 2·d_2·mc_z to the moment of
# inertia about it. It joins combinations that exist already: neither the rank nor the number of individual
# parameters changes.
@pytest.mark.parametrize(("d_2", "zero"), [(0.0, 11), (-0.11, 9)])
def test_what_the_excavator_can_tell(d_2, zero):
    machine = with_boom_offset(load_machine("cat215b"), d_2)
    model = Model(machine)
    K, = model.over(model.regressor, *states(machine, np.random.default_rng(45), 400))
    stacked = K.reshape(-1, 82)
    sizes = np.linalg.norm(stacked, axis=0)
    silent = sizes < 1e-9 * np.max(sizes)
    scaled = stacked / np.where(silent, 1.0, sizes) * ~silent
    _, values, rows = np.linalg.svd(scaled, full_matrices=False)
    rank = int(np.sum(values > 1e-10 * values[0]))
    assert values[rank] < 1e-9 * values[rank - 1]  # a gap, not a threshold, tells the rank
    free = np.linalg.norm(rows[rank:], axis=0) > 1e-8  # parameters that some unseen direction moves
    individual = int(np.sum(~free))
    assert (int(silent.sum()), rank, individual, 82 - zero - individual) == (zero, 45, 20, 62 - zero)


def with_boom_offset(machine, d_2):
    data = machine.model_dump()
    boom = next(link for link in data["links"] if link["name"] == "boom")
    boom["joint"]["d"] = d_2
    cylinder = next(c for c in data["cylinders"] if c["name"] == "boom_cylinder")
    x, _, z = cylinder["barrel"]["pin"]
    cylinder["barrel"]["pin"] = (x, d_2, z)  # keeps the triangle planar
    return Machine.model_validate(data)
