"""The faults that a machine's logs are searched for, with the sizes that the machine file states or usual ones."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from hydroopt.estimation.dynamic.misfit.faults import (
    DRIFT,
    FRICTION,
    KNOWN,
    OF_FORCE,
    TYPICAL,
    Added,
    AngleLate,
    AngleOffset,
    Bodies,
    Fault,
    ForcesLate,
    Lag,
    Play,
    Scaled,
    Tilt,
)
from hydroopt.estimation.dynamic.misfit.view import View
from hydroopt.logs.forces_from_pressures import force_channels
from hydroopt.machine.actuators import Cylinder
from hydroopt.machine.balances import Balance
from hydroopt.model.kinematics import gravity_in_base
from hydroopt.parameters.dynamic import owners_with_confidence
from hydroopt.parameters.parameter_set import ParameterKind


def listed(view: View) -> Iterator[Fault]:
    """All faults that a log's readings are searched for, of the sizes that the machine file states."""
    forces = range(len(view.model.machine.balances))
    for fault in _usual(view):
        stated = stated_size(view, fault)
        if stated is not None and fault.group in OF_FORCE and isinstance(fault, Added) and fault.reading in forces:
            stated *= float(np.sqrt(np.mean(view.measured[:, fault.reading] ** 2)))
        fits = stated is not None and (fault.group not in ("offset", "play") or fault.unit == "deg")
        yield replace(fault, scale=stated) if stated is not None and fits else fault


def stated_size(view: View, fault: Fault) -> float | None:
    """The standard deviation [SI] that the machine file states: of a sensor's lag, or of the fault's group."""
    of_group, machine = view.model.machine.faults.of(fault.group), view.model.machine
    if not isinstance(fault, Lag):
        return of_group
    return max((machine.lag(channel).sigma for channel in force_channels(view.model, view.experiment.log)
                if fault.subject == ("forces",) or channel.partition(".")[0] in fault.subject), default=0.0) or of_group


def _usual(view: View) -> Iterator[Fault]:
    machine, n = view.model.machine, len(view.model.machine.balances)
    read = tuple(np.flatnonzero(view.read[:n]).tolist())  # no transducer of a passive joint can be late
    yield ForcesLate("delay", ("forces",), "all force readings are late against the angles", "ms", 0.03, 1e3,
                     motion=True, readings=read, opposite="all force readings are early against the angles")
    yield ForcesLate("clock", ("forces",), "the clock of the forces drifts against that of the angles, over the log",
                     "ms", 0.05, 1e3, motion=True, readings=read, drifts=True)
    yield Lag("lag", ("forces",), "all force readings lag behind", "ms", 0.03, 1e3, True, True, readings=read)
    if len(read) > 1:
        for k, name in ((k, machine.balances[k].name) for k in read):
            yield ForcesLate("delay", (name,), f"the force readings of {name} are late", "ms", 0.03, 1e3, motion=True,
                             readings=(k,), opposite=f"the force readings of {name} are early")
            yield Lag("lag", (name,), f"the force readings of {name} lag behind", "ms", 0.03, 1e3, True, True,
                      readings=(k,))
    yield from _of_joints(view)
    gravity = np.abs(np.asarray(gravity_in_base(machine), dtype=float).ravel())
    if np.any(gravity):
        for axis in np.argsort(gravity, kind="stable")[:2].tolist():
            yield Tilt("tilt", (f"base about {'xyz'[axis]}",), f"the base is tilted about its {'xyz'[axis]} axis",
                       "deg", np.radians(2.0), 180 / np.pi, axis=axis)
    for k in range(n):
        yield from _of_forces(view, k)
    for k in range(n, len(view.names)):
        yield from _of_lengths(view, k)
    yield from _of_bodies(view)


def _of_joints(view: View) -> Iterator[Fault]:
    machine = view.model.machine
    for j, joint in enumerate(machine.joints):
        turns = machine.channel_units[f"{joint}.q"] == "rad"
        unit, factor = ("deg", 180 / np.pi) if turns else ("mm", 1e3)
        angle = np.radians(1.0) if turns else 0.01
        if len(machine.joints) > 1 or view.lengths:
            yield AngleLate("delay", (f"{joint}.q",), f"the readings of {joint}.q are late", "ms", 0.03, 1e3,
                            motion=True, joint=j, opposite=f"the readings of {joint}.q are early")
        yield AngleOffset("offset", (f"{joint}.q",), f"{joint}.q reads too much", unit, angle, factor, motion=True,
                          joint=j, opposite=f"{joint}.q reads too little")
        yield Play("play", (f"{joint}.q",), f"{joint} has play against its sensor", unit, 0.3 * angle, factor, True,
                   True, joint=j)


def _of_forces(view: View, k: int) -> Iterator[Fault]:
    balance = view.model.machine.balances[k]
    actuator, name, unit, has = balance.alone, balance.name, balance.unit, set(_kinds_of(view, balance))
    size = TYPICAL * float(np.sqrt(np.mean(view.measured[:, k] ** 2)))
    if not balance.actuators:  # nothing is read, and forces that cancel have the size of the largest of them
        terms = view.regressor[:, k] * view.psi
        size = TYPICAL * float(np.sqrt(np.max(np.mean(terms**2, axis=0), initial=0.0)))
        yield from (Added("friction", (name,), f"{name} has {FRICTION[course]}, which the model lacks", unit, size,
                          course=course, reading=k) for course in ("viscous", "coulomb"))
        return
    factors = actuator.effort_factors if actuator else {}
    chambers = [channel for each in balance.actuators for channel in each.effort_factors if channel in view.pressures]
    for channel in chambers:
        yield Scaled("gain", (channel,), f"{channel} reads too much, or the area stated for it is too large",
                     "%", TYPICAL, 100.0,
                     opposite=f"{channel} reads too little, or the area stated for it is too small")
    if not chambers:
        yield Added("gain", (name,), f"the force readings of {name} are too large", "%", TYPICAL, 100.0,
                    course="reading", reading=k, opposite=f"the force readings of {name} are too small")
    drift = max(abs(f) for f in factors.values()) * DRIFT if chambers and factors else size
    yield Added("drift", (name,), f"the force readings of {name} drift over the log", unit, drift, course="time",
                reading=k)
    if ParameterKind.FORCE_OFFSET not in has:
        yield Added("bias", (name,), f"the force readings of {name} have an offset", unit, drift, course="constant",
                    reading=k)
    sealed = len(chambers) == len(factors) == 2 and isinstance(actuator, Cylinder)
    for course, words in FRICTION.items():
        if KNOWN.get(course) not in has and (sealed or course != "seal"):
            yield Added("friction", (name,), f"{name} has {words}, which the model lacks", unit, size, course=course,
                        reading=k)


def _kinds_of(view: View, balance: Balance) -> Iterator[ParameterKind]:
    parameters, owners = view.model.parameters, (balance.joint, *(each.name for each in balance.actuators))
    for name, kind in zip(parameters.names, parameters.kinds, strict=True):
        if not kind.is_inertial and parameters.owner(name) in owners:
            yield kind


def _of_lengths(view: View, k: int) -> Iterator[Fault]:
    name = view.names[k]
    yield ForcesLate("delay", (name,), f"the readings of {name} are late", "ms", 0.03, 1e3, motion=True, readings=(k,),
                     opposite=f"the readings of {name} are early")
    yield Added("drift", (name,), f"the readings of {name} drift over the log", "mm", 0.01, 1e3, course="time",
                reading=k)


def _of_bodies(view: View) -> Iterator[Fault]:
    stated = owners_with_confidence(view.model.machine, view.model.bodies)  # what is only assumed cannot be wrong
    owners = tuple(owner for owner in view.model.parameters.bodies if owner in stated)
    ends = tuple(owner for owner in owners if "." in owner)
    links = tuple(owner for owner in owners if "." not in owner)
    groups = {"all bodies": owners, "all links": links, "all barrels and rods": ends}
    for words, group in groups.items():
        if len(group) > 1 and (words == "all bodies" or len(group) < len(owners)):
            yield Bodies("bodies", (words,), f"{words} are heavier than stated", "%", 1.0, 100.0, free=False,
                         owners=group, opposite=f"{words} are lighter than stated")
    for owner in owners:
        yield Bodies("bodies", (owner,), f"{owner} is heavier than stated", "%", 1.0, 100.0, free=False,
                     owners=(owner,), opposite=f"{owner} is lighter than stated")
