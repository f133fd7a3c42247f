"""What a robot file cannot say of a machine: a machine file's tables beside it, read and written with it."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from hydroopt.errors import MachineError
from hydroopt.input_file import read_text, toml
from hydroopt.machine.robot_formats.axes import Numbers
from hydroopt.spatial.inertia import Array
from hydroopt.units import to_si

SUFFIX = ".sidecar.toml"


@dataclass(frozen=True)
class Sidecar:
    """Tables that are merged over those of a robot file, and what of them tells how to read it.

    Attributes:
        file: its name, empty where there is none.
        tables: a machine file's, without what the robot file says.
        frames: far ends of links in their frames P, which are the robot links' frames.
        pins: where joints sit that do not sit at their parent's far end.
        locked, dependent: links whose joints are so.
        drives, couplings: names by joint; of couplings, those that a joint of the robot file states by what it mimics.
        rubbing: links whose joint and drive both have friction; the robot file has the sum, the sidecar the parts.
        motors: joints that motors drive, which state the friction there.
        cylinders: the barrel's pin by name; barrels and rods are links of the robot file.
    """

    file: str = ""
    tables: dict[str, Any] = field(default_factory=dict)
    frames: dict[str, Numbers] = field(default_factory=dict)
    pins: dict[str, Array] = field(default_factory=dict)
    locked: frozenset[str] = frozenset()
    dependent: frozenset[str] = frozenset()
    drives: dict[str, str] = field(default_factory=dict)
    couplings: dict[str, str] = field(default_factory=dict)
    rubbing: frozenset[str] = frozenset()
    motors: frozenset[str] = frozenset()
    cylinders: dict[str, Array] = field(default_factory=dict)

    @property
    def stated(self) -> bool:
        """Whether there is one."""
        return bool(self.file)


def beside(path: str | Path) -> Path:
    """Where the sidecar of a robot file is."""
    return Path(path).with_suffix(SUFFIX)


def read_sidecar(path: str | Path) -> Sidecar | None:
    """The sidecar beside a robot file; None where there is none.

    Raises:
        MachineError: it is no TOML, or its links are no tables.
    """
    file = beside(path)
    if not file.exists():
        return None
    where = str(file)
    tables = toml(read_text(file, MachineError, noun="sidecar"), MachineError, where=where)
    links = _named(tables, "links", where)
    joints = {name: link.get("joint", {}) for name, link in links.items()}
    if any(not isinstance(joint, dict) for joint in joints.values()):
        raise MachineError("a joint is no table", where=f"{where}: links", remedy="state it key by key")
    couplings = _named(tables, "couplings", where)
    return Sidecar(
        where, tables,
        frames={name: Numbers(0.0, 0.0, *(_number(joint.get(key), unit, f"{where}: links[{name}].joint.{key}")
                                          for key, unit in (("a", "m"), ("alpha", "rad"), ("beta", "rad"))))
                for name, joint in joints.items()},
        pins={name: _point(link["pin"], f"{where}: links[{name}].pin")
              for name, link in links.items() if "pin" in link},
        locked=frozenset(name for name, joint in joints.items() if joint.get("type") == "locked"),
        dependent=frozenset(name for name, joint in joints.items() if joint.get("dependent")),
        drives={str(drive.get("joint")): name for name, drive in _named(tables, "drives", where).items()},
        couplings={str(each.get("joint")): name for name, each in couplings.items() if "ratios" not in each},
        rubbing=frozenset(name for name, joint in joints.items() if isinstance(friction := joint.get("friction"), dict)
                          and any(not is_zero(value) for value in friction.values())),
        motors=frozenset(str(each.get("joint")) for each in _named(tables, "motors", where).values()),
        cylinders={name: _point(each.get("barrel", {}).get("pin"), f"{where}: cylinders[{name}].barrel.pin")
                   for name, each in _named(tables, "cylinders", where).items()})


def _named(tables: dict[str, Any], key: str, where: str) -> dict[str, dict[str, Any]]:
    """Parts of a kind by their names."""
    parts = tables.get(key, [])
    if not isinstance(parts, list) or not all(isinstance(part, dict) and isinstance(part.get("name"), str)
                                              for part in parts):
        raise MachineError("must be tables, each with a name", where=f"{where}: {key}",
                           remedy=f"write [[{key}]] above each of them, and its name")
    return {part["name"]: part for part in parts}


def _value(stated: Any) -> Any:
    return stated.get("value") if isinstance(stated, dict) else stated


def _point(stated: Any, where: str) -> Array:
    values = _value(stated)
    if not isinstance(values, list) or len(values) != 3:
        raise MachineError("must be three lengths", where=where, remedy="state x, y and z")
    return np.array([_number(value, "m", where) for value in values])


def _number(stated: Any, unit: str, where: str) -> float:
    value = _value(stated)
    return 0.0 if value is None else to_si(str(value), unit, where=where)


def is_zero(stated: Any) -> bool:
    """Whether a quantity is zero, or only what is known of it beside its value is stated."""
    value = _value(stated)
    try:
        return value is None or float(str(value).split()[0]) == 0.0
    except (ValueError, IndexError):
        return False
