"""Work and energy: what actuators put in is what bodies and gas hold and friction takes."""

import numpy as np
import pytest

from fixtures.tiers import tiered
from hydroopt.machine.actuators import Cylinder
from oracles.pinocchio_tree import PinocchioTree
from oracles.subjects import SUBJECTS, forces, model, random_bodies, relative_error, states


@pytest.mark.parametrize("name", tiered(SUBJECTS, lambda name: name != "made_up"))
def test_virtual_work(name):
    subject = model(name)
    machine = subject.machine
    rng = np.random.default_rng(25)
    psi, clouds = random_bodies(subject, rng)
    state = states(machine, rng, 40)
    tree = PinocchioTree(machine, clouds)
    joint_forces = np.array([tree.joint_forces(*row) for row in zip(*state, strict=True)])
    found = forces(subject, state, psi)
    _, speed, _, arm, _ = subject.over(subject.cylinder_kinematics, *state)
    names = [c.name for c in (*machine.cylinders, *machine.gas_cylinders)]
    rates, arms = np.empty_like(found), np.empty((*found.shape, len(machine.joints)))
    for k, actuator in enumerate(machine.actuators):
        if isinstance(actuator, Cylinder):
            row = names.index(actuator.name)
            rates[:, k], arms[:, k] = speed[:, row, 0], arm[:, row]
        else:
            joint = machine.joints.index(actuator.joint)
            rates[:, k], arms[:, k] = state[1][:, joint], np.eye(len(machine.joints))[joint]
    power, expected = np.sum(found * rates, axis=1), np.sum(joint_forces * state[1], axis=1)
    assert relative_error(np.einsum("ska,sk->sa", arms, found), joint_forces) < 1e-9
    assert relative_error(power[:, None], expected[:, None]) < 1e-9


@pytest.mark.parametrize("name", SUBJECTS)
def test_energy_balance(name):
    subject = model(name)
    machine = subject.machine
    rng = np.random.default_rng(26)
    psi, clouds = random_bodies(subject, rng)
    psi, scalars = with_scalars(subject, psi, rng)
    tree = PinocchioTree(machine, clouds)
    # what work and losses share cancels node by node, kinks at reversals included; the rest is smooth
    nodes, weights = np.polynomial.legendre.leggauss(160)  # on two seconds, from −1 to 1
    motion = smooth_motion(machine, rng, np.array([-1, *nodes, 1]))
    (first, *_, last), inner = zip(*motion[:2], strict=True), [series[1:-1] for series in motion]
    pairs = list(zip(*inner[:2], strict=True))
    speeds = [tree.transmission(q) @ qd for q, qd in pairs]
    power = np.sum(forces(subject, inner, psi) * speeds, axis=1)
    work, size = weights @ power, weights @ np.abs(power)
    lost = weights @ [dissipated(tree, scalars, q, qd) for q, qd in pairs]
    gained = total_energy(tree, scalars, *last) - total_energy(tree, scalars, *first)
    assert lost > 1e-3 * size
    assert abs(work - lost - gained) < 1e-9 * size


def with_scalars(subject, psi, rng):
    """ψ with friction, offsets and nominal rotor inertias and gas pressures, and these alone by name."""
    psi, scalars = psi.copy(), {}
    for k, parameter in enumerate(subject.parameters.names):
        kind = parameter.rpartition(".")[2]
        if kind in ("precharge", "rotor_inertia"):
            psi[k] = scalars[parameter] = subject.parameters.nominal[k]
        elif kind.startswith(("f_", "tau_", "n_")):
            psi[k] = scalars[parameter] = rng.uniform(100, 500)
    return psi, scalars


def smooth_motion(machine, rng, times):
    joints = [machine.link(name).joint for name in machine.joints]
    middle = np.array([(j.upper + j.lower) / 2 for j in joints])
    swing = np.array([min(0.45 * (j.upper - j.lower), 1.5) for j in joints])
    pace, phase = rng.uniform(1, 3, (2, len(joints)))
    angle = np.outer(times, pace) + phase
    return [middle + swing * np.sin(angle), swing * pace * np.cos(angle), -swing * pace**2 * np.sin(angle)]


def dissipated(tree, scalars, q, qd):
    """Power [W] that friction takes, and that an offset only seems to take."""
    machine, power = tree.machine, 0.0
    speeds = dict(zip(machine.joints, qd, strict=True))
    speeds |= {c.name: tree.centre_line(c, q, qd)[1] for c in machine.cylinders}
    speeds |= {a.name: speeds[a.joint] for a in (*machine.motors, *machine.drives)}
    for parameter, value in scalars.items():
        owner, kind = parameter.split(".")
        if kind.startswith("n_"):
            power += value * abs(pin_turn(tree, owner, kind, q, qd))
        elif kind.endswith("_offset"):
            power += value * speeds[owner]
        elif kind.endswith("_coulomb"):
            power += value * abs(speeds[owner])
        elif kind.endswith("_viscous"):
            power += value * speeds[owner] ** 2
    return power


def pin_turn(tree, name, kind, q, qd):
    """Rate of the angle at a pin of the planar triangle of joint axis and pins, by the law of cosines."""
    cylinder = next(c for c in tree.machine.cylinders if c.name == name)
    here, there = (tree.distance_to_axis(cylinder, end) for end in ("barrel", "rod"))
    here, there = (here, there) if kind == "n_barrel" else (there, here)
    length, speed = tree.centre_line(cylinder, q, qd)
    cosine = (length**2 + here**2 - there**2) / (2 * length * here)
    slope = (length**2 - here**2 + there**2) / (2 * length**2 * here)
    return -slope * speed / np.sqrt(1 - cosine**2)


def total_energy(tree, scalars, q, qd):
    energy = tree.energy(q, qd)
    for drive in tree.machine.drives:
        speed = drive.gear * qd[tree.machine.joints.index(drive.joint)]
        energy += scalars.get(f"{drive.name}.rotor_inertia", 0.0) * speed**2 / 2
    for gas in tree.machine.gas_cylinders:
        stretched = tree.centre_line(gas, q, qd)[0] - gas.reference_length
        volume = gas.volume + gas.area * (stretched if gas.acts == "push" else -stretched)
        start, n = scalars[f"{gas.name}.precharge"] * gas.volume, gas.polytropic
        # work done on the gas from its reference volume
        ratio = gas.volume / volume
        energy += start * (np.log(ratio) if n == 1 else (ratio ** (n - 1) - 1) / (n - 1))
    return energy
