"""What a reader should know of a machine file before trusting anything that rests on it."""

from __future__ import annotations

import math
from collections.abc import Iterator
from itertools import chain
from pathlib import Path

import numpy as np

from hydroopt.machine.actuators import Cylinder, Drive, Motor
from hydroopt.machine.file_checks import idle_linkages
from hydroopt.machine.machine import Machine
from hydroopt.machine.machine_file import ROBOT_SUFFIXES
from hydroopt.machine.mechanism import Mechanism
from hydroopt.machine.parameter_kind import ParameterKind
from hydroopt.machine.quantity import LONGEST
from hydroopt.machine.range_checks import straight_and_wide
from hydroopt.model.hanging import Hanging
from hydroopt.model.model import Model
from hydroopt.parameters.dynamic import bodies
from hydroopt.parameters.unstated_bodies import LONG, link_sizes, reach, unstated_bodies
from hydroopt.results.diagnostic import Diagnostic, Meaning, listed
from hydroopt.results.readable import readable
from hydroopt.spatial import inertia
from hydroopt.spatial.inertia import Array

ROUNDED = 1e-6
"""Smallest eigenvalue of a pseudo-inertia, as a part of its trace, that rounded numbers of a point mass may give."""
POSTURES = 8
"""Postures in which gravity is computed."""
CLEAR = 0.25
"""A posture states clearly how a loop is assembled up to this part of its distance to the other way."""
BORE = (0.005, 1.0)
"""Bores of hydraulic cylinders [m]."""
PER_TURN = (5e-7, 2e-2)
"""What hydraulic motors displace per revolution [m³] in front of a gear."""
PER_TURN_OF_JOINT = 1.0
"""The same per revolution of the joint [m³], gear and all, at most."""
RELIEF = (5e5, 1e8)
"""Relief pressures [Pa]."""
HIGHEST = 4.2e7
"""Pressure [Pa] up to which mobile hydraulics work."""
LEAST_RANGE = math.radians(3.0)
"""Range of a joint that turns, below which its limits are probably radians [rad]."""
LEAST_ARM = 0.02
"""Lever arm [m] below which a few millimetres at a pin change a cylinder's force by much."""
FAR = 3.0
"""Distance of a centre of mass in lengths of its link, or in halves of all links together."""
RANDOM = 100
"""Random postures in which the machine is held, beside the corners of its ranges."""
CORNERS = 4
"""Joints of which all corners of the ranges are taken."""


def machine_diagnostics(model: Model) -> tuple[Diagnostic, ...]:
    """Diagnostics of a machine's nominal numbers; none if they can be true.

    >>> import hydroopt as ho
    >>> machine_diagnostics(ho.Model(ho.load_machine("cat215b")))
    ()
    """
    return (*_unstated(model), *_impossible_bodies(model), *_idle_gravity(model), *_unmeasured(model),
            *_implausible_sizes(model), *_straight_cylinders(model), *_idle_linkages(model), *_unclear_postures(model))


def _unstated(model: Model) -> Iterator[Diagnostic]:
    """Bodies that are missing or placeholders, and missing friction; a machine of geometry alone needs neither."""
    machine, kinds = model.machine, model.parameters.kinds
    read = {channel for sensor in machine.sensors for channel in sensor.channels}
    efforts = {channel for each in machine.measured_actuators for channel in each.effort_factors}
    if not machine.balances or (machine.sensors and not kinds and not efforts & read):
        return
    owners: dict[str, list[str]] = {}
    for owner, why in unstated_bodies(machine).items():
        owners.setdefault(why, []).append(owner)
    if owners:
        file = Path(machine.source.strip("'"))
        robot = file.suffix in ROBOT_SUFFIXES
        yield Diagnostic.of("bodies not stated", tuple(chain.from_iterable(owners.values())), {
            "found": "; ".join(f"{listed(names)} {why}" for why, names in owners.items()),
            "what": "mass, origin and inertia" if robot else "m, com and inertia_com",
            "where": f"in <inertial> of {file.name}" if robot else "in its 'body' table"},
            "Bodies are missing or placeholders, so that nominal forces are not the machine's: {found}.",
            "State {what} of each {where}, if need be as a guess with its sigma.", Meaning.LACK)
    if not any(kind.is_friction or kind is ParameterKind.COEFFICIENT for kind in kinds):
        yield Diagnostic.of("no friction stated", machine.joints, {}, (
            "No friction is stated of {subject} or their actuators: the option --friction coulomb+viscous of identify "
            "adds it."),
            "Identify with that option, or state coulomb and viscous in the 'friction' of its drives.", Meaning.LACK)


def _impossible_bodies(model: Model) -> Iterator[Diagnostic]:
    pseudo = {owner: inertia.pseudo_inertia(owned.body.phi)
              for owner, owned in bodies(model.machine, calibrator=True).items()}
    impossible = tuple(owner for owner, matrix in pseudo.items()
                       if np.linalg.eigvalsh(matrix)[0] < -ROUNDED * max(float(np.trace(matrix)), 1e-9))
    if impossible:
        yield Diagnostic.of("nominal bodies not physically consistent", impossible, {}, (
            "No body can have the mass, centre of mass and inertia that the machine file states of {subject}: a "
            "principal moment of inertia is negative or exceeds the sum of the other two."),
            "Correct them; moments of inertia of 'inertia_com' are about the centre of mass, those of 'inertia' about "
            "the origin of the frame.", Meaning.PROPERTY)


def _unmeasured(model: Model) -> Iterator[Diagnostic]:
    for each in model.machine.unmeasured_joints:
        yield Diagnostic.of("forces at a joint not measured", (each.joint,), {
            "unmeasured": " and ".join(each.unmeasured) + (" is" if len(each.unmeasured) == 1 else " are"),
            "remedy": each.remedy},
            "{unmeasured} not measured: the forces at {subject} are in no equation, neither predicted nor compared "
            "with any log.",
            "For {subject}, {remedy}.")


def _idle_gravity(model: Model) -> Iterator[Diagnostic]:
    """Bodies have mass, but no posture takes a torque to hold them."""
    machine, nominal = model.machine, model.parameters.nominal
    weight = machine.gravity * sum(owned.body.m for owned in bodies(machine).values())
    if weight <= 0:
        return
    lower, upper = machine.ranges.T
    postures = np.random.default_rng(0).uniform(lower, upper, size=(POSTURES, len(lower)))
    torques = [np.array(model.gravity_torques(q, nominal)) for q in postures]
    if np.abs(torques).max() < 1e-6 * weight:  # a micrometre of lever arm
        yield Diagnostic.of("gravity does no work", machine.joints, {}, (
            "Gravity does no work on any joint ({subject}): as the file states them, the axes of all joints that turn "
            "are vertical, so that holding still takes no force and shows nothing of masses."),
            "If joints turn about level axes, state it: orientation = [\"90 deg\", \"0 deg\", \"0 deg\"] turns the "
            "base frame's y axis up.")


def _straight_cylinders(model: Model) -> Iterator[Diagnostic]:
    for name, width in straight_and_wide(model.machine):
        yield Diagnostic.of("a cylinder without a linkage turns a joint far", (name,), {
            "range_deg": float(np.degrees(width))},
            "{subject} is pinned to the link itself and turns it by {range_deg:.0f} deg. Where a joint turns as far, "
            "a rocker and a coupler mostly stand between; left out, they make lever arms wrong by up to a fifth.",
            "If the machine has them, state them by [[linkages]] and pin the rod to the rocker.")


def _idle_linkages(model: Model) -> Iterator[Diagnostic]:
    for each in idle_linkages(model.machine):
        yield Diagnostic.of("a cylinder passes a linkage by", (each.loop,), {
            "moves": each.moves, "what": each.what, "remedy": each.remedy},
            "{what}.",
            "If the linkage moves {moves}, {remedy}.")


def _unclear_postures(model: Model) -> Iterator[Diagnostic]:
    machine = model.machine
    for each in Mechanism(machine).ways:
        if each.near > CLEAR * each.far:
            near, far = (f"{np.degrees(away):.1f} deg" if machine.turns(each.stated[0]) else f"{away:.3f} m"
                         for away in (each.near, each.far))
            stands = machine.in_words({joint: at for joint, at in each.own.items() if joint in each.stated})
            yield Diagnostic.of("a posture lies between two ways to assemble a loop", (each.loop,), {
                "near": near, "far": far, "stands": stands},
                "The posture of {subject} lies between the two ways to assemble it: {near} from the one that is taken "
                "and {far} from the other.",
                "State the posture of the machine more closely: {stands}.")


# --- sizes that no machine of its kind has ---


def _implausible_sizes(model: Model) -> Iterator[Diagnostic]:
    """Sizes that can be read and computed with, but that no machine of its kind has: mostly a wrong unit or pin."""
    machine = model.machine
    for cylinder in machine.cylinders:
        yield from _cylinder(cylinder)
    for motor in machine.motors:
        yield from _motor(motor)
    for each in machine.hydraulic_actuators:
        if each.relief_pressure is not None and not RELIEF[0] <= each.relief_pressure <= RELIEF[1]:
            yield _found(f"{each.name}'s relief_pressure", readable(each.relief_pressure, "Pa"),
                         "valves relieve 5 to 1000 bar", "Correct its unit")
    yield from _ranges(machine)
    yield from _links(machine)
    yield from _held(model)


def _found(subject: str, size: str, usual: str, remedy: str) -> Diagnostic:
    return Diagnostic.of("implausible size", (subject,), {"size": size, "usual": usual, "remedy": f"{remedy}."}, (
        "{subject} is {size}, but {usual}."),
        "{remedy}")


def _cylinder(cylinder: Cylinder) -> Iterator[Diagnostic]:
    bore = 2 * math.sqrt(cylinder.areas[0] / cylinder.jacks / math.pi)
    if not BORE[0] <= bore <= BORE[1]:
        yield _found(f"{cylinder.name}'s bore", readable(bore, "m"), "cylinders have 5 mm to 1 m",
                     "Correct the unit of its bore or areas" + f" ({bore:g} mm?)" * (bore > 1))
    if cylinder.stroke > cylinder.dead_length:
        yield _found(f"{cylinder.name}'s stroke", f"{cylinder.stroke:.3g} m", (
            f"the rod must fit into its dead length of {cylinder.dead_length:.3g} m, the distance of the pins when "
            "fully retracted"),
            "Correct them, or the pins that need them, unless it is telescopic or its barrel is not held at the end")


def _motor(motor: Motor) -> Iterator[Diagnostic]:
    own, whole = (2 * math.pi * each for each in (motor.torque_per_pressure, motor.areas[0]))
    if not PER_TURN[0] <= whole or whole > PER_TURN_OF_JOINT or (motor.gear > 1 and own > PER_TURN[1]):
        yield _found(f"{motor.name}'s torque_per_pressure", f"{1e6 * own:.4g} cm³/rev with a gear of {motor.gear:g}", (
            "motors displace 0.5 cm³ to 20 L per revolution before a gear, and up to 1000 L behind it"),
            "Correct its unit, or its gear")


def _ranges(machine: Machine) -> Iterator[Diagnostic]:
    together = {joint for group in machine.entangled for joint in group} | set(machine.base_joints)
    for joint in machine.joints:
        lower, upper = machine.link(joint).joint.range
        if machine.link(joint).joint.type == "revolute" and joint not in together and upper - lower < LEAST_RANGE:
            lower, upper = math.degrees(lower), math.degrees(upper)
            yield _found(f"{joint}'s range", f"{lower:.4g} to {upper:.4g} deg", "joints turn through more than 3 deg", (
                f"If these numbers are radians, write them as \"{lower:.4g} rad\" and \"{upper:.4g} rad\""))


def _links(machine: Machine) -> Iterator[Diagnostic]:
    sizes, half = link_sizes(machine), reach(machine) / 2
    for link in machine.links:
        longest = sizes[link.name]
        if longest > LONGEST:
            yield _found(f"{link.name}'s length, or the distance of a pin on it", f"{longest:.4g} m",
                         "links have up to 50 m", "Correct its unit")
        ends = longest == 0 and not any(each.parent == link.name for each in machine.links)  # its length is not stated
        if link.body is None or link.body.m <= 0 or ends:
            continue
        com = math.hypot(*link.body.phi[1:4]) / link.body.m
        if com > FAR * max(longest, half, LONG):
            yield _found(f"{link.name}'s centre of mass", f"{com:.4g} m from its frame's origin", (
                f"the link is {longest:.2g} m long"),
                "Correct its unit, or state 'mc' where mass times distance is meant")


def _held(model: Model) -> Iterator[Diagnostic]:
    """Lever arms, and pressures that hold the machine still, over the ranges of the joints."""
    machine = model.machine
    if not machine.joints:
        return
    lower, upper = machine.ranges.T
    q = lower + (upper - lower) * _unit_cube(len(lower))
    arms, = model.over(model.transmission, q)
    together = {joint for group in machine.entangled for joint in group}
    for k, each in enumerate(machine.actuators):
        joint = machine.main_joint(each)
        if isinstance(each, Cylinder) and len(machine.drivers[joint]) == 1 and joint not in together:
            least = np.abs(arms[:, k, machine.joints.index(joint)])
            if (worst := int(np.argmin(least))) >= 0 and least[worst] < LEAST_ARM:
                yield _found(f"{each.name}'s lever arm on {joint}", f"only {1e3 * least[worst]:.2g} mm at {joint} = "
                             + _place(machine, joint, q[worst]),
                             "a few millimetres at a pin then change its force by much",
                             "Correct its pins, the posture of its linkage, or the joint's limits")
    if not len(model.parameters):
        return
    q = Hanging(model).postures(q)
    pressure = [np.zeros((len(q), len(machine.actuators)))] if model.needs_pressure else []
    forces = model.over(model.regressor, q, 0 * q, 0 * q, *pressure)[0] @ model.parameters.nominal
    for balance, force in zip(machine.balances, forces.T, strict=True):
        alone = balance.alone
        if alone is None or isinstance(alone, Drive) or not np.all(np.isfinite(force)):
            continue
        head, rod = alone.areas
        needed = np.maximum(force / head, -force / rod)
        most, worst = alone.relief_pressure or HIGHEST, int(np.argmax(needed))
        if needed[worst] > most:
            usual = "hydraulic machines work at up to" if alone.relief_pressure is None else "a valve relieves it at"
            mass, owner = max((owned.body.m, name) for name, owned in model.bodies.items())
            yield _found(f"{alone.name}'s pressure that holds the machine still", (
                f"{needed[worst] / 1e5:.0f} bar at {balance.joint} = {_place(machine, balance.joint, q[worst])}"),
                f"{usual} {most / 1e5:.0f} bar", (
                f"Correct masses (the greatest is that of {owner}, {mass:.4g} kg), centres of mass, "
                "pins, bore or the number of jacks"))


def _place(machine: Machine, joint: str, q: Array) -> str:
    value = float(q[machine.joints.index(joint)])
    return f"{value:.3f} m" if machine.link(joint).joint.type == "prismatic" else f"{math.degrees(value):.1f} deg"


def _unit_cube(n: int) -> Array:
    """Corners and inner points (N, n) of a cube; of many joints both ends of each, the others in the middle."""
    ends = (np.array(np.meshgrid(*[[0.0, 1.0]] * n)).reshape(n, -1).T if n <= CORNERS
            else np.vstack([np.full((n, n), 0.5) + side * np.eye(n) / 2 for side in (-1, 1)]))
    return np.vstack([ends, np.random.default_rng(0).random((RANDOM, n))])
