"""Cylinders in the place of a robot's drives: their pins are stated in the frames of the robot's own links."""

from __future__ import annotations

import copy
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from hydroopt.errors import MachineError
from hydroopt.machine.file_tables import build_machine
from hydroopt.machine.geometry import Geometry
from hydroopt.machine.machine import Machine
from hydroopt.machine.range_checks import over_range
from hydroopt.machine.robot_formats.machine_tables import RobotFile
from hydroopt.support.input_file import similar
from hydroopt.units import to_si

_MARGIN = 0.01
"""How far a stroke that is not stated exceeds what the joint's range takes, at each end, as a part of that."""
_ANY = {"dead_length": "1e-6 m", "stroke": "1e6 m"}
"""A stroke that no joint exceeds, until the joint's range shows which it takes."""


class Reach(NamedTuple):
    """Least and greatest length [m] of a cylinder over the range of its joints, and least lever arm [m or 1]."""

    shortest: float
    longest: float
    arm: float


class OnCylinders(NamedTuple):
    """The machine on cylinders, how far each of them moves, and what of the replaced drives is left out."""

    machine: Machine
    reaches: dict[str, Reach]
    lost: tuple[str, ...]


def with_cylinders(robot: RobotFile, stated: Mapping[str, Any], where: str) -> OnCylinders:
    """The machine of a robot file in which cylinders drive joints.

    Damping and friction of a replaced drive become those of its joint; limits of torque, gears and rotors are lost.

    Args:
        robot: the file, without a sidecar.
        stated: tables by cylinder. ``joint`` is the one whose drive it replaces; ``barrel`` and ``rod`` state a `link`
            of the robot and a `pin` in that link's own frame; ``bore`` and ``rod_diameter`` or the two areas as in a
            machine file. Of ``dead_length`` and ``stroke``, where neither is stated, the joint's range decides, with a
            margin of 1 % at each end. All else is as in a machine file.
        where: what states them, for errors.

    Raises:
        MachineError: a joint or link is unknown, a cylinder passes a dead point or does not reach, or its table is
            wrong.
    """
    tables = copy.deepcopy(robot.tables)
    drives = {drive["joint"]: drive for drive in tables.get("drives", [])}
    made: dict[str, dict[str, Any]] = {}
    lost: list[str] = []
    for name, table in stated.items():
        place = f"{where}: {name}"
        if not isinstance(table, dict):
            raise MachineError("must be a table", where=place, remedy="state joint, barrel, rod, bore and rod_diameter")
        cylinder = dict(table)
        joint = str(cylinder.pop("joint", ""))
        if joint not in drives:
            raise MachineError(f"no drive moves '{joint}'", where=f"{place}.joint",
                               remedy=f"name one of {', '.join(similar(joint, drives, 6))}")
        lost += _replaced(drives.pop(joint), next(link for link in tables["links"] if link["name"] == joint))
        for end in ("barrel", "rod"):
            cylinder[end] = _attached(robot, cylinder.get(end), f"{place}.{end}")
        made[name] = {"name": name} | cylinder
    tables["drives"] = list(drives.values())
    open_ended = [name for name, cylinder in made.items() if not {"dead_length", "stroke"} & cylinder.keys()]
    for name in open_ended:
        made[name] |= _ANY
    tables["cylinders"] = list(made.values())
    machine = build_machine(copy.deepcopy(tables), where)
    reaches = {name: _reach(machine, name) for name in made}
    for name in open_ended:
        shortest, longest, _ = reaches[name]
        margin = _MARGIN * (longest - shortest)
        made[name] |= {"dead_length": f"{shortest - margin!r} m", "stroke": f"{longest - shortest + 2 * margin!r} m"}
    return OnCylinders(build_machine(tables, where) if open_ended else machine, reaches, tuple(lost))


def _replaced(drive: dict[str, Any], link: dict[str, Any]) -> list[str]:
    """What a replaced drive says beside its friction, in sentences; the friction becomes that of the link's joint."""
    if friction := {key: drive["friction"][key] for key in ("coulomb", "viscous") if key in drive.get("friction", {})}:
        link["joint"]["friction"] = friction | link["joint"].get("friction", {})
    words = {"gear": "the gear", "max_torque": "the greatest torque", "rotor_inertia": "the rotor's inertia"}
    said = [words[key] for key in words if key in drive]
    return [f"{' and '.join(said)} of the drive of '{drive['joint']}', which a cylinder replaces"] if said else []


def _attached(robot: RobotFile, stated: Any, where: str) -> dict[str, Any]:
    """An end as the machine file has it: its pin in the frame P of the machine's link."""
    if not isinstance(stated, dict) or not {"link", "pin"} <= stated.keys():
        raise MachineError("needs a 'link' and a 'pin'", where=where,
                           remedy="write { link = \"LINK\", pin = [\"0 m\", \"0 m\", \"0 m\"] }")
    link, pin = str(stated["link"]), stated["pin"]
    if link not in robot.links:
        raise MachineError(f"the robot has no link '{link}'", where=f"{where}.link",
                           remedy=f"use {' or '.join(similar(link, robot.links, 4))}")
    if not isinstance(pin, list) or len(pin) != 3:
        raise MachineError("must be three lengths", where=f"{where}.pin", remedy="state x, y and z")
    point = np.array([*(to_si(str(value), "m", where=f"{where}.pin") for value in pin), 1.0])
    at = robot.links[link].pose @ point
    return stated | {"link": robot.links[link].carrier, "pin": [f"{float(value)!r} m" for value in at[:3]]}


def _reach(machine: Machine, name: str) -> Reach:
    cylinder = next(each for each in machine.cylinders if each.name == name)
    lengths, arms, _ = over_range(Geometry(machine), cylinder)
    return Reach(float(lengths.min()), float(lengths.max()), float(np.abs(arms).min()))
