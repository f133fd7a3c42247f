"""What a reader should know of a machine file before trusting anything that rests on it."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import chain
from pathlib import Path

import numpy as np

from hydroopt.machine.file_checks import idle_linkages
from hydroopt.machine.machine_file import ROBOT_SUFFIXES
from hydroopt.machine.mechanism import Mechanism
from hydroopt.machine.parameter_kind import ParameterKind
from hydroopt.machine.range_checks import straight_and_wide
from hydroopt.model.model import Model
from hydroopt.parameters.dynamic import bodies
from hydroopt.parameters.unstated_bodies import unstated_bodies
from hydroopt.results.diagnostic import Diagnostic, Meaning, listed
from hydroopt.results.implausible_sizes import implausible_sizes
from hydroopt.spatial import inertia

ROUNDED = 1e-6
"""Smallest eigenvalue of a pseudo-inertia, as a part of its trace, that rounded numbers of a point mass may give."""
POSTURES = 8
"""Postures in which gravity is computed."""
CLEAR = 0.25
"""A posture states clearly how a loop is assembled up to this part of its distance to the other way."""


def machine_diagnostics(model: Model) -> tuple[Diagnostic, ...]:
    """Diagnostics of a machine's nominal numbers; none if they can be true.

    >>> import hydroopt as ho
    >>> machine_diagnostics(ho.Model(ho.load_machine("cat215b")))
    ()
    """
    return (*_unstated(model), *_impossible_bodies(model), *_idle_gravity(model), *_unmeasured(model),
            *implausible_sizes(model), *_straight_cylinders(model), *_idle_linkages(model), *_unclear_postures(model))


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
    lower, upper = np.array([machine.link(name).joint.range for name in machine.joints]).T
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
