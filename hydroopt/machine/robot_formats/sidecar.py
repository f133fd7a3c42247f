"""What a robot file cannot say of a machine: a machine file's tables beside it, read with it."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from hydroopt.errors import MachineError
from hydroopt.machine.file_schema import validate
from hydroopt.machine.robot_formats.frames import Numbers
from hydroopt.spatial.inertia import Array
from hydroopt.support.input_file import read_text, toml
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
        MachineError: it is no TOML, or states what no machine file may.
    """
    file = beside(path)
    if not file.exists():
        return None
    where = str(file)
    tables = toml(read_text(file, MachineError, noun="sidecar"), MachineError, where=where)
    plain = validate(tables, where, whole=False)
    links, drives, couplings, motors, cylinders = (
        {part["name"]: part for part in plain.get(kind, [])}
        for kind in ("links", "drives", "couplings", "motors", "cylinders"))
    joints = {name: link.get("joint", {}) for name, link in links.items()}
    for name, cylinder in cylinders.items():
        if "pin" not in cylinder.get("barrel", {}):
            raise MachineError("this key is missing", where=f"{where}: cylinders[{name}].barrel.pin", remedy="add it")
    return Sidecar(
        where, tables,
        frames={name: Numbers(0.0, 0.0, *(to_si(joint.get(key, f"0 {unit}"), unit, where=key)
                                          for key, unit in (("a", "m"), ("alpha", "rad"), ("beta", "rad"))))
                for name, joint in joints.items()},
        pins={name: _point(link["pin"]) for name, link in links.items() if "pin" in link},
        locked=frozenset(name for name, joint in joints.items() if joint.get("type") == "locked"),
        dependent=frozenset(name for name, joint in joints.items() if joint.get("dependent")),
        drives={drive.get("joint", ""): name for name, drive in drives.items()},
        couplings={each.get("joint", ""): name for name, each in couplings.items() if "ratios" not in each},
        rubbing=frozenset(name for name, joint in joints.items()
                          if not all(map(is_zero, joint.get("friction", {}).values()))),
        motors=frozenset(each.get("joint", "") for each in motors.values()),
        cylinders={name: _point(each["barrel"]["pin"]) for name, each in cylinders.items()})


def _point(stated: list[str]) -> Array:
    return np.array([to_si(value, "m", where="pin") for value in stated])


def is_zero(stated: Any) -> bool:
    """Whether a quantity is zero, or only what is known of it beside its value is stated."""
    value = stated.get("value") if isinstance(stated, dict) else stated
    return value is None or float(str(value).split()[0]) == 0.0
