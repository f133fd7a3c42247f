"""The machine file beside a robot file, which says what that one cannot; what both say counts as the robot file has it.

A robot file that was changed differs from the one that would be written of the machine file beside it. These
differences are put into the machine file's tables.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np

from hydroopt.errors import MachineError
from hydroopt.machine.actuators import Drive, Motor, TorqueFriction
from hydroopt.machine.file_tables import build_machine, machine_file_tables
from hydroopt.machine.links import JointFriction
from hydroopt.machine.machine import Machine
from hydroopt.machine.robot_formats.frames import APART, central, inverse
from hydroopt.machine.robot_formats.machine_tree import machine_tree, mimicking
from hydroopt.machine.robot_formats.tree import RobotTree, TreeJoint
from hydroopt.spatial.inertia import Array
from hydroopt.support.input_file import read_text, toml


def beside(path: str | Path) -> Path:
    """Where the sidecar of a robot file is."""
    return Path(path).with_suffix(".sidecar.toml")


def with_sidecar(tree: RobotTree, file: Path) -> dict[str, Any]:
    """Tables of the machine file beside a robot file, with what the robot file says otherwise in their place.

    From the robot file are bodies, places of joints along and about their axes, limits, friction, drives and what
    mimics what. Of friction that a joint and its actuator have together, the actuator's changes.

    Raises:
        MachineError: the sidecar is no machine file, or the robot file does not fit it.
    """
    text = read_text(file, MachineError, noun="sidecar")
    machine = build_machine(toml(text, MachineError, where=str(file)), str(file))
    own, made = machine_tree(machine, floating=tree.gravity is not None), machine_file_tables(machine)
    parts = {part["name"]: part for kind in ("links", "cylinders", "motors", "drives", "couplings")
             for part in made.get(kind, [])}
    alone = [*(name for name in own.joints if name not in tree.joints),
             *(name for name, joint in tree.joints.items() if name not in own.joints and joint.kind != "fixed"),
             *(name for name, mass in tree.masses.items() if name not in own.masses and mass is not None)]
    if alone:
        raise MachineError(f"'{alone[0]}' is either not in it or not in its sidecar", where=tree.file,
                           remedy=f"state it in both, or move {file} away")
    for link, before in own.masses.items():
        owner, _, end = link.partition(".")
        mass = tree.masses.get(link)
        if owner in parts and mass is not None and (
                before is None or np.abs(mass - before).max() > APART * np.abs(before).max()):
            _change_body(parts[owner][end] if end else parts[owner], mass)
    for name, joint in own.joints.items():
        now, turns = tree.joints[name], name.endswith((".barrel", ".barrel_turn"))
        if turns and np.abs(joint.origin[:3, 3] - now.origin[:3, 3]).max() > APART:
            raise MachineError("the barrel's pin is not where the sidecar has it", where=f"{tree.file}: joint '{name}'",
                               remedy=f"move it in cylinders[{name.partition('.')[0]}].barrel.pin of {file} as well")
        if name in parts:
            rest = inverse(joint.origin) @ now.origin
            if max(map(_size, (rest[:2, 3], rest[:3, 2] - [0, 0, 1], now.axis - joint.axis))) > APART:
                raise MachineError("its axis is not where the sidecar has the end of the link before",
                                   where=f"{tree.file}: joint '{name}'",
                                   remedy=f"undo the change, correct links[{name}] in {file}, or remove that")
            _change_joint(machine, parts, joint, now, rest)
    return made


def _size(difference: Array) -> float:
    return float(np.abs(difference).max())


def _change_body(table: dict[str, Any], mass: Array) -> None:
    """State a body by another pseudo-inertia (4, 4); what is known of the same numbers stays."""
    body, (m, com, six) = table.setdefault("body", {}), central(mass)
    for key in ("mc", "inertia"):
        body.pop(key, None)
    _put(body, "m", f"{m!r} kg")
    _put(body, "com", [f"{each!r} m" for each in com.tolist()])
    _put(body, "inertia_com", [f"{each!r} kg*m^2" for each in six.tolist()])


def _change_joint(machine: Machine, parts: dict[str, Any], before: TreeJoint, now: TreeJoint, rest: Array) -> None:
    """State what is otherwise of a joint, of its drive and of the coupling that it follows.

    Where a robot file states nothing, nothing changes. `rest` is the joint's place now, seen from the one before.
    """
    name, stated = before.name, machine.link(before.name).joint
    unit, effort = ("m", "N") if before.kind == "prismatic" else ("rad", "N*m")
    joint: dict[str, Any] = parts[name]["joint"]
    friction: JointFriction | TorqueFriction = stated.friction
    rows: list[tuple[dict[str, Any], str, float | None, float | None, str]] = [
        (joint, "theta", 0.0, math.atan2(rest[1, 0], rest[0, 0]), "rad"), (joint, "d", 0.0, float(rest[2, 3]), "m"),
        (joint, "max_speed", before.max_speed, now.max_speed, f"{unit}/s")]
    if not stated.dependent:
        rows += [(joint, key, getattr(before, key), getattr(now, key), unit) for key in ("lower", "upper")]
    carrier: dict[str, Any] = joint
    for each in machine.drivers.get(name, ()):
        if isinstance(each, Motor | Drive):
            carrier, friction = parts[each.name], each.friction
        if isinstance(each, Drive):
            rotor = now.rotor_inertia * (now.gear / before.gear)**2  # of MJCF that of the joint, without a gear
            rows += [(carrier, "gear", before.gear, now.gear if now.gear != 1 else None, "1"),
                     (carrier, "max_torque", before.max_effort, now.max_effort, effort),
                     (carrier, "rotor_inertia", before.rotor_inertia, rotor or None, "kg*m^2")]
    for key, per in (("coulomb", effort), ("viscous", f"{effort}*s/{unit}")):
        if getattr(now, key) != getattr(before, key):
            rows.append((carrier.setdefault("friction", {}), key, getattr(before, key),
                         getattr(now, key) - getattr(before, key) + (getattr(friction, key) or 0.0), per))
    coupling = mimicking(machine).get(name)
    if before.mimic and now.mimic and coupling and coupling.joint == name:
        table = parts[coupling.name]
        rows += [(table["ratios"], before.mimic.master, before.mimic.ratio, now.mimic.ratio,
                  machine.ratio_unit(name, before.mimic.master)),
                 (table, "offset", before.mimic.offset, now.mimic.offset, unit)]
    for table, key, old, new, si in rows:
        if new is None or abs(new - (old or 0.0)) <= APART * max(1.0, abs(old or 0.0)):
            continue
        value = new + getattr(stated, key) if key in ("theta", "d") else new
        _put(table, key, value if si == "1" else f"{value!r} {si}")


def _put(table: dict[str, Any], key: str, value: Any) -> None:
    """State a value; what is known of it beside stays."""
    table[key] = table[key] | {"value": value} if isinstance(table.get(key), dict) else value
