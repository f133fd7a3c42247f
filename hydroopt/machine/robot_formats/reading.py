"""A robot file, whatever its format, to the tables of a machine file."""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from hydroopt.errors import MachineError
from hydroopt.machine.machine import BASE
from hydroopt.machine.robot_formats.frames import inverse, roll_pitch_yaw, tidy
from hydroopt.machine.robot_formats.machine_tables import Placed, machine_tables
from hydroopt.machine.robot_formats.mjcf_in import read_mjcf
from hydroopt.machine.robot_formats.sidecar import beside, with_sidecar
from hydroopt.machine.robot_formats.xml_in import read_sdf, read_urdf

READERS = {".urdf": read_urdf, ".xml": read_mjcf, ".sdf": read_sdf, ".xacro": read_urdf}
"""What reads the files of an ending."""


FRAMES = "Frames of the machine's links in those of the robot file's links"
"""What heads the table of frames."""
FRAME = ("x [m]", "y [m]", "z [m]", "roll [deg]", "pitch [deg]", "yaw [deg]")
"""What states a frame, with its units."""


class RobotFile(NamedTuple):
    """What a robot file and its sidecar say.

    Attributes:
        tables: a machine file's.
        lost: what the robot file says and a machine file cannot, in sentences.
        links: each link of the robot with the machine's link that it is part of, and its pose in that link's frame P.
        beside: whether there is a sidecar, from which the tables are.
    """

    tables: dict[str, Any]
    lost: tuple[str, ...]
    links: dict[str, Placed]
    beside: bool = False

    @property
    def frames(self) -> list[dict[str, str | float]]:
        """Of each of the robot's links the machine's link that it is part of, and where that link's frame P is in the
        robot link's frame: origin ``x``, ``y``, ``z`` [m], and roll, pitch and yaw [deg]: Rot(z)·Rot(y)·Rot(x)."""
        found: list[dict[str, str | float]] = []
        for link, at in self.links.items():
            seen = inverse(at.pose)
            numbers = (*seen[:3, 3], *np.degrees(roll_pitch_yaw(seen[:3, :3])))
            found.append({"robot link": link, "machine link": at.carrier} | dict(
                zip(FRAME, map(tidy, numbers), strict=True)))
        return found


def read_robot(path: str | Path, *, tip: str | None = None) -> RobotFile:
    """The tables of a robot file; see `hydroopt.machine.robot_formats.machine_tables.machine_tables`.

    A sidecar beside the file (``arm.sidecar.toml`` of ``arm.urdf``) is read with it, unless a `tip` is named.

    Raises:
        MachineError: the file is missing, malformed, incomplete or contradictory.
    """
    tree, file = READERS[Path(path).suffix](path), beside(path)
    if not file.exists():
        made = machine_tables(tree, tip=tip)
        return RobotFile(made.tables, made.lost, made.links)
    if tip is not None:
        raise MachineError("a tip cannot be named of a robot with a sidecar", where=str(path),
                           remedy=f"leave it out, or move {file} away")
    tables = with_sidecar(tree, file)
    links = {name: Placed(name, np.eye(4)) for name in (BASE, *(link["name"] for link in tables["links"]))}
    return RobotFile(tables, tree.lost, links, beside=True)
