"""A robot file, whatever its format, to the tables of a machine file."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from hydroopt.errors import MachineError
from hydroopt.machine.machine import BASE
from hydroopt.machine.robot_formats.machine_tables import Placed, RobotFile, machine_tables
from hydroopt.machine.robot_formats.mjcf_in import read_mjcf
from hydroopt.machine.robot_formats.sidecar import beside, with_sidecar
from hydroopt.machine.robot_formats.xml_in import read_sdf, read_urdf

READERS = {".urdf": read_urdf, ".xml": read_mjcf, ".sdf": read_sdf, ".xacro": read_urdf}
"""What reads the files of an ending."""


def read_robot(path: str | Path, *, tip: str | None = None) -> RobotFile:
    """The tables of a robot file; see `hydroopt.machine.robot_formats.machine_tables.machine_tables`.

    A sidecar beside the file (``arm.sidecar.toml`` of ``arm.urdf``) is read with it; no `tip` can be named then.

    Raises:
        MachineError: the file is missing, malformed, incomplete or contradictory.
    """
    tree, file = READERS[Path(path).suffix](path), beside(path)
    if not file.exists():
        return machine_tables(tree, tip=tip)
    if tip is not None:
        raise MachineError("a tip cannot be named of a robot with a sidecar", where=str(path),
                           remedy=f"leave it out, or move {file} away")
    tables = with_sidecar(tree, file)
    links = {name: Placed(name, np.eye(4)) for name in (BASE, *(link["name"] for link in tables["links"]))}
    return RobotFile(tables, tree.lost, links, beside=True)
