"""The machines that the oracles judge, and random states and bodies for them."""

from __future__ import annotations

from functools import cache

import numpy as np

from hydroopt.machine.machine import Machine
from hydroopt.machine.machine_file import load_machine
from hydroopt.model.model import Model
from hydroopt.parameters.dynamic import bodies

SUBJECTS = ("cat215b", "kr300", "patu655_lift", "lift_with_bodies", "made_up")
BODY = {"m": 1.0, "com": (0, 0, 0), "inertia_com": (1, 0, 0, 1, 0, 1)}

MADE_UP = {
    "name": "made_up",
    "description": "nothing is aligned: tilted base, twisted axes, a locked link, a sliding and a branching "
                   "one, ball-jointed cylinders out of any plane, one upside down, one across two joints",
    "orientation": (0.2, -0.3, 0.5),
    "links": [
        {"name": "column", "parent": "base", "body": BODY,
         "joint": {"type": "revolute", "theta": 0.3, "d": 0.4, "a": 0.3, "alpha": -1.4, "beta": 0.12,
                   "lower": -2.0, "upper": 2.0}},
        {"name": "bracket", "parent": "column", "body": BODY,
         "joint": {"type": "locked", "theta": 0.2, "d": 0.05, "a": 0.2, "alpha": 0.09, "beta": -0.07}},
        {"name": "boom", "parent": "bracket", "body": BODY,
         "joint": {"type": "revolute", "d": -0.1, "a": 2.0, "alpha": 0.05, "beta": -0.1,
                   "lower": -1.0, "upper": 0.3, "friction": {"coulomb": 0, "viscous": 0}}},
        {"name": "slide", "parent": "boom", "body": BODY,
         "joint": {"type": "prismatic", "theta": 1.5, "d": 0.5, "a": 0.1, "alpha": 1.3, "beta": 0.04,
                   "lower": 0.0, "upper": 0.8, "friction": {"coulomb": 0, "viscous": 0}}},
        {"name": "arm", "parent": "slide", "body": BODY,
         "joint": {"type": "revolute", "theta": -0.4, "d": 0.2, "a": 1.1, "alpha": 0.3, "beta": 0.2,
                   "lower": 0.3, "upper": 1.4}},
        {"name": "mast", "parent": "column", "body": BODY,
         "joint": {"type": "revolute", "theta": 0.1, "d": 0.3, "a": 0.5, "alpha": 0.7,
                   "lower": 0.2, "upper": 1.8}}],
    "motors": [{"name": "column_motor", "joint": "column", "torque_per_pressure": 1e-4,
                "friction": {"offset": 0, "coulomb": 0, "viscous": 0}}],
    "drives": [{"name": "mast_drive", "joint": "mast", "gear": 40, "rotor_inertia": 0.01,
                "friction": {"coulomb": 0, "viscous": 0}}],
    "cylinders": [
        {"name": "boom_cylinder", "bore": 0.1, "rod_diameter": 0.06, "dead_length": 0.5, "stroke": 1.0,
         "barrel": {"link": "column", "pin": (0.5, -0.3, -0.5), "body": BODY},
         "rod": {"link": "boom", "pin": (0.9, -0.4, 0.25), "body": BODY},
         "friction": {"offset": 0, "coulomb": 0, "viscous": 0}},
        {"name": "slide_cylinder", "bore": 0.1, "rod_diameter": 0.06, "dead_length": 0.5, "stroke": 1.0,
         "barrel": {"link": "slide", "pin": (0.1, -0.2, 0.5), "body": BODY},
         "rod": {"link": "boom", "pin": (0.6, 0.2, -0.2), "body": BODY}, "friction": {"coulomb": 0}},
        {"name": "arm_cylinder", "bore": 0.1, "rod_diameter": 0.06, "dead_length": 0.5, "stroke": 2.0,
         "barrel": {"link": "boom", "pin": (0.8, -0.9, 0.1), "body": BODY},
         "rod": {"link": "arm", "pin": (0.4, 0.5, -0.15), "body": BODY},
         "friction": {"viscous": 0}}],
    "gas_cylinders": [
        {"name": "balance", "acts": "push", "area": 0.002, "volume": 0.004, "reference_length": 0.8,
         "precharge": 5e6, "polytropic": 1.3, "barrel": {"link": "column", "pin": (0.4, 0.3, 0.6)},
         "rod": {"link": "mast", "pin": (0.6, -0.2, 0.1)}}],
}


@cache
def model(name: str, *, actuator_inertia: bool = True) -> Model:
    return Model(machine(name), actuator_inertia=actuator_inertia)


def machine(name: str) -> Machine:
    """A bundled machine, the made-up one, or the log crane with a barrel that hangs on the base and a rod."""
    if name == "made_up":
        return Machine.model_validate(MADE_UP)
    if name != "lift_with_bodies":
        return load_machine(name)
    data = load_machine("patu655_lift").model_dump()
    for end in ("barrel", "rod"):
        data["cylinders"][0][end]["body"] = BODY
    return Machine.model_validate(data)


def states(machine: Machine, rng: np.random.Generator, count: int) -> list[np.ndarray]:
    """Random q, q̇, q̈ (count, n) inside the limits; unstated speeds and accelerations are of order one."""
    joints = [machine.link(name).joint for name in machine.joints]
    middle = np.array([(j.upper + j.lower) / 2 for j in joints])
    half = np.array([(j.upper - j.lower) / 2 for j in joints])
    fastest = np.array([j.max_speed or 1.5 for j in joints])
    strongest = np.array([j.max_acceleration or 3 for j in joints])
    q, qd, qdd = (rng.uniform(-1, 1, (count, len(joints))) * s for s in (half, fastest, strongest))
    return [middle + q, qd, qdd]


def random_body(rng: np.random.Generator) -> np.ndarray:
    """φ (10,) of a cloud of point masses: any element may be large, and yet such a body exists."""
    masses, points = rng.uniform(5, 60, 6), rng.uniform(-1, 1, (6, 3)) + rng.uniform(-1, 1, 3)
    inertia = sum(m * (p @ p * np.eye(3) - np.outer(p, p)) for m, p in zip(masses, points, strict=True))
    return np.array([masses.sum(), *masses @ points, *inertia[np.triu_indices(3)]])


def random_bodies(subject: Model, rng: np.random.Generator) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """ψ (p,) with random bodies and nothing else, and the same bodies by owner."""
    owners = bodies(subject.machine, actuator_inertia=subject.actuator_inertia)
    clouds = {owner: random_body(rng) for owner in owners}
    psi = np.zeros(len(subject.parameters))
    for owner, phi in clouds.items():
        first = subject.parameters.index(f"{owner}.m")
        psi[first:first + 10] = phi
    return psi, clouds


def forces(subject: Model, state: list[np.ndarray], psi: np.ndarray) -> np.ndarray:
    """Actuator forces (N, n) that the library predicts."""
    (found,) = subject.over(subject.inverse_dynamics, *state, np.tile(psi, (len(state[0]), 1)))
    return found[:, :, 0]


def balances(machine: Machine, arms: np.ndarray, torque: np.ndarray) -> np.ndarray:
    """What the balances measure (r,): unknown forces of lone measured actuators and of one unmeasured actuator a joint,
    or generalised forces at joints, as of those that more actuators than joints move together."""
    columns = np.eye(len(machine.joints))
    for j, joint in enumerate(machine.joints):
        drivers = machine.drivers[joint]
        lost = [each for each in drivers if not each.measured]
        chosen = lost[:1] or (drivers if len(drivers) == 1 and joint not in machine.redundant else ())
        for each in chosen:
            columns[:, j] = arms[machine.actuators.index(each)]
    found = np.linalg.solve(columns, torque)
    return found[[machine.joints.index(each.joint) for each in machine.balances]]


def relative_error(found: np.ndarray, expected: np.ndarray) -> float:
    """Largest deviation over N samples (N, n), as a part of each column's largest value."""
    return float(np.max(np.max(np.abs(found - expected), axis=0) / np.max(np.abs(expected), axis=0)))
