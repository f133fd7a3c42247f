"""The sidecar of a robot file: a machine file without what the robot file says."""

from __future__ import annotations

from typing import Any

from hydroopt.machine.machine import Machine
from hydroopt.machine.machine_file import dump_tables, machine_file_tables
from hydroopt.machine.robot_formats.machine_tree import mimicking
from hydroopt.machine.robot_formats.sidecar import is_zero

_BODY = ("m", "com", "inertia_com", "mc", "inertia")
_FRICTION = ("coulomb", "viscous")


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
