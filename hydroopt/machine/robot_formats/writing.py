"""A machine as the files of a robot format, and what that format cannot say."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

from hydroopt.errors import MachineError
from hydroopt.machine.actuators import Cylinder
from hydroopt.machine.loops import Loop
from hydroopt.machine.machine import Machine
from hydroopt.machine.machine_file import dump_machine, dump_tables, machine_file_tables
from hydroopt.machine.robot_formats.machine_tree import machine_tree, mimicking, open_statements, without_body
from hydroopt.machine.robot_formats.mjcf_in import NEGLIGIBLE
from hydroopt.machine.robot_formats.mjcf_out import mjcf_text
from hydroopt.machine.robot_formats.sidecar import beside, is_zero
from hydroopt.machine.robot_formats.xml_out import sdf_text, urdf_text

_BODY = ("m", "com", "inertia_com", "mc", "inertia")
_FRICTION = ("coulomb", "viscous")


class Written(NamedTuple):
    """Files of one folder by name, and in sentences what the robot file among them cannot say."""

    files: dict[str, str]
    lost: tuple[str, ...]


def robot_files(machine: Machine, path: str | Path) -> Written:
    """A machine as a file of the format that the ending names: .toml, .urdf, .xml (MJCF), .sdf.

    Beside a URDF or MJCF there is a sidecar with what the format cannot say; hydroopt reads both together.

    Raises:
        MachineError: there is no such format.

    >>> from hydroopt.machine.machine_file import load_machine
    >>> list(robot_files(load_machine("cat215b"), "cat.urdf").files)
    ['cat.urdf', 'cat.sidecar.toml']
    """
    name, suffix = Path(path).name, Path(path).suffix
    if suffix not in _WRITERS:
        raise MachineError(f"no format is written to files that end in '{suffix}'", where=str(path),
                           remedy=f"use {', '.join(_WRITERS)}")
    return _WRITERS[suffix](machine, name)


def _toml(machine: Machine, name: str) -> Written:
    return Written({name: dump_machine(machine)}, ())


def _urdf(machine: Machine, name: str) -> Written:
    return Written({name: urdf_text(machine_tree(machine)), beside(name).name: sidecar_text(machine, name)},
                   (*_open_in_a_tree(machine), *_never_said(machine), *_not_beside(machine)))


def _mjcf(machine: Machine, name: str) -> Written:
    tree = machine_tree(machine, floating=True)
    bodies = without_body(tree)
    lost = [f"bodies of {NEGLIGIBLE:g} kg stand for {len(bodies)} that are not stated"] if bodies else []
    return Written({name: mjcf_text(machine), beside(name).name: sidecar_text(machine, name, motors=False)},
                   (*lost, *_never_said(machine, springs=True), *_not_beside(machine)))


def _sdf(machine: Machine, name: str) -> Written:
    geared = [drive.name for drive in machine.drives if drive.gear != 1.0 or drive.rotor_inertia]
    lost = [f"gears and rotors of {', '.join(geared)}"] if geared else []
    lost += [f"gravity of {machine.gravity:g} m/s^2, which is the world's"]
    return Written({name: sdf_text(machine_tree(machine))}, (*lost, *_open_in_a_tree(machine), *_never_said(machine)))


_WRITERS: dict[str, Callable[[Machine, str], Written]] = {".toml": _toml, ".urdf": _urdf, ".xml": _mjcf, ".sdf": _sdf}


def _open_in_a_tree(machine: Machine) -> list[str]:
    """What a format without loops leaves open."""
    lost = [f"the {'loop' if isinstance(each, Loop) else 'coupling'} '{each.name}' does not hold"
            for each in open_statements(machine)]
    return lost + [f"the rod of '{cylinder.name}' hangs on no pin" for cylinder in machine.cylinders]


def _never_said(machine: Machine, *, springs: bool = False) -> list[str]:
    """What no robot format says."""
    lost = [f"the friction of '{each.name}' is Coulomb's and viscous alone" for each in machine.actuators
            if {key for key, value in each.friction if value is not None} - {"coulomb", "viscous"}]
    lost += [f"the gas of '{each.name}' presses on nothing" for each in machine.gas_cylinders]
    lost += [f"the spring '{each.name}' pulls nothing" for each in machine.springs if not (springs and each.stiffness)]
    hydraulic = [each.name for each in machine.actuators if isinstance(each, Cylinder)]
    lost += [f"areas and chambers of {', '.join(hydraulic)}"] if hydraulic else []
    return lost + ([f"{len(machine.notes)} confidences, bounds and sources of numbers"] if machine.notes else [])


def _not_beside(machine: Machine) -> list[str]:
    """What neither a robot file says nor its sidecar."""
    moments = [path for path in machine.notes if path.endswith((".body.mc", ".body.inertia"))]
    return [f"{len(moments)} confidences of first moments and of inertias about origins, nor are they in the sidecar"
            ] * bool(moments)


def sidecar_text(machine: Machine, file: str, *, motors: bool = True) -> str:
    """Text of the sidecar of a robot `file` that describes a machine.

    Bodies, limits but of joints that follow others, places of joints, friction, gears and what mimics what stand in the
    robot file alone. What is known of such a number beside its value, its confidence and source, stands here without
    the value.

    Args:
        machine: the machine.
        file: name of the robot file.
        motors: whether the robot file states limits of speed and torque, and gears.
    """
    tables = machine_file_tables(machine)
    links = {link.name: link for link in machine.links}
    mimics = mimicking(machine)
    drives = {drive["joint"] for drive in tables.get("drives", ())}
    for table in tables["links"]:
        link = links[table["name"]]
        table.pop("parent", None)
        if link.body and link.body.phi.any():
            _said(table, "body", _BODY)
        joint = table["joint"]
        locked, limits = joint["type"] == "locked", ("lower", "upper") * (not link.joint.dependent)
        for key in ("type",) * (not locked) + ("theta", "d", *limits) + ("max_speed",) * motors:
            _drop(joint, key)
        if not drives & {link.name} and not _rotary(machine, link.name):
            _said(joint, "friction", _FRICTION)
    for table in tables.get("drives", ()):
        for key in ("gear", "max_torque") * motors:
            _drop(table, key)
        own = links[table["joint"]].joint.friction
        if not own.viscous and not own.coulomb:  # else the robot file states the sum of both
            _said(table, "friction", _FRICTION)
    for table in tables.get("couplings", ()):
        stated = next(each for each in machine.couplings if each.name == table["name"])
        if mimics.get(stated.joint) is stated:
            table.pop("ratios")
            _drop(table, "offset")
    for table in tables.get("cylinders", ()):
        for end in ("barrel", "rod"):
            _said(table[end], "body", _BODY)
    head = (f"# What {file} cannot say of this machine. hydroopt reads both together; the joints and links\n"
            "# there have the names of links here. Keep it beside that file.\n\n")
    return head + dump_tables(tables)


def _rotary(machine: Machine, joint: str) -> bool:
    return any(motor.joint == joint for motor in machine.motors)


def _said(table: dict[str, Any], key: str, inner: tuple[str, ...]) -> None:
    """Remove what the robot file says of a part's table; zeros stay, since it says nothing by a zero."""
    if key not in table:
        return
    for name in inner:
        value = table[key].get(name)
        if key == "friction" and is_zero(value):
            continue
        _drop(table[key], name, keep=name in ("m", "com", "inertia_com", *_FRICTION))
    if not table[key]:
        del table[key]


def _drop(table: dict[str, Any], key: str, *, keep: bool = True) -> None:
    """Remove a value; what is known of it beside stays."""
    value = table.pop(key, None)
    if keep and isinstance(value, dict) and (rest := {name: known for name, known in value.items() if name != "value"}):
        table[key] = rest
