"""Forces through loops against MuJoCo with pins that close them, Lagrange, and the power of friction."""

import numpy as np
import pytest

from fixtures.closures import crank, geared, scissor, six_bar, sleeve, spherical, steering, telescope
from fixtures.loops import cut_open, excavator, measured_at_the_rocker, z_bar
from fixtures.tiers import tiered
from hydroopt.kernels.expression_graph import program
from hydroopt.machine.geometry import Geometry
from hydroopt.machine.machine_file import load_machine
from hydroopt.machine.mechanism import Mechanism
from hydroopt.model.model import Model
from oracles.mujoco_loops import MujocoLoops
from oracles.subjects import forces, random_bodies, relative_error, states

MACHINES = {"excavator": excavator, "measured at the rocker": measured_at_the_rocker, "Z-bar": z_bar,
            "telescope": telescope, "geared": geared, "crank": crank, "sleeve": sleeve, "scissor": scissor,
            "six-bar": six_bar, "steering": steering, "spherical": spherical,
            "log crane": lambda: load_machine("patu655")}
QUICK = ("excavator", "telescope", "sleeve", "six-bar", "steering")


@pytest.fixture(scope="module", params=tiered(MACHINES, lambda name: name in QUICK))
def subject(request):
    return Model(MACHINES[request.param]())


@pytest.mark.slow
def test_bodies_of_links_barrels_and_rods(subject):
    rng = np.random.default_rng(41)
    psi, clouds = random_bodies(subject, rng)
    state = states(subject.machine, rng, 20)
    tree = MujocoLoops(subject.machine, clouds)
    expected = np.array([tree.actuator_forces(*row) for row in zip(*state, strict=True)])
    found = forces(subject, state, psi)
    assert relative_error(found, expected) < 1e-9
    (K,) = subject.over(subject.regressor, *state)
    assert relative_error(K @ psi, found) < 1e-12


@pytest.mark.parametrize("name", tiered(MACHINES, lambda name: name in ("telescope", "sleeve")))
def test_bodies_by_their_energies(name):
    subject, rng = Model(MACHINES[name]()), np.random.default_rng(41)
    psi, state = random_bodies(subject, rng)[0], states(subject.machine, rng, 20)
    (by_energy,) = subject.over(subject.lagrange_forces, *state, np.tile(psi, (20, 1)))
    assert relative_error(forces(subject, state, psi), by_energy[:, :, 0]) < 1e-9


def test_all_joints_stand_where_mujocos_pins_hold_them(subject):
    machine, rng = subject.machine, np.random.default_rng(42)
    tree = MujocoLoops(machine, random_bodies(subject, rng)[1])
    for q in states(machine, rng, 5)[0]:
        tree.actuator_forces(q, 0 * q, 0 * q)
        found = Mechanism(machine).positions(Geometry(machine), dict(zip(machine.joints, q, strict=True)))
        for joint, expected in tree.tree().items():
            assert abs(np.exp(1j * float(found[joint])) - np.exp(1j * expected)) < 1e-10


def test_pins_stay_together(subject):
    machine = subject.machine
    q = states(machine, np.random.default_rng(43), 500)[0]
    ends = dict(zip((link.name for link in machine.links), subject.over(subject.forward_kinematics, q), strict=True))
    for loop in machine.loops:
        to = np.asarray(subject.geometry.far_end(loop.to.link).inverse().point(subject.geometry.point(loop.name)))
        own = np.asarray(subject.geometry.far_end(loop.link).inverse().point(subject.geometry.loop_ends(loop)[0]))
        held, holds = (ends[name] @ np.append(at, 1.0) for name, at in ((loop.to.link, to), (loop.link, own)))
        away = np.linalg.norm((holds - held)[:, :3], axis=1)
        assert np.max(np.abs(away - (loop.length or 0.0))) < 1e-12


def test_friction_of_dependent_joints_takes_the_power_that_actuators_give():
    model = Model(z_bar())
    machine, geometry = model.machine, Geometry(z_bar())
    q, qd, qdd = states(machine, np.random.default_rng(44), 5)
    (K,) = model.over(model.regressor, q, qd, qdd)
    speeds = model.over(model.cylinder_kinematics, q, qd, qdd)[1]
    mechanism, step = Mechanism(machine), 1e-6
    for row in range(len(q)):
        ahead, behind = (mechanism.positions(geometry, dict(zip(machine.joints, q[row] + h * qd[row], strict=True)))
                         for h in (step, -step))
        rates = np.array([qd[row, 0], *speeds[row, :, 0]])
        for joint in ("lever", "link", "bucket"):
            turn = float(ahead[joint] - behind[joint]) / (2 * step)
            for term, power in (("tau_viscous", turn**2), ("tau_coulomb", abs(turn))):
                column = K[row, :, model.parameters.index(f"{joint}.{term}")]
                assert column @ rates == pytest.approx(power, rel=1e-6)


def test_the_loop_costs_a_tenth_of_the_operations_of_the_open_tree():
    closed, opened = (sum(program(Model(machine).regressor).operations.values())
                      for machine in (excavator(), cut_open()))
    assert closed < 1.1 * opened
