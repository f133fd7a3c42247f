"""A machine as the files of a robot format, and what that format cannot say."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

from hydroopt.errors import MachineError
from hydroopt.machine.actuators import Cylinder
from hydroopt.machine.loops import Loop
from hydroopt.machine.machine import Machine
from hydroopt.machine.machine_file import dump_machine
from hydroopt.machine.robot_formats.machine_tree import machine_tree, open_statements, without_body
from hydroopt.machine.robot_formats.mjcf_in import NEGLIGIBLE
from hydroopt.machine.robot_formats.mjcf_out import mjcf_text
from hydroopt.machine.robot_formats.sidecar import beside
from hydroopt.machine.robot_formats.xml_out import sdf_text, urdf_text


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
    return Written({name: urdf_text(machine_tree(machine))} | _beside(machine, name),
                   (*_open_in_a_tree(machine), *_never_said(machine)))


def _mjcf(machine: Machine, name: str) -> Written:
    tree = machine_tree(machine, floating=True)
    bodies = without_body(tree)
    lost = [f"bodies of {NEGLIGIBLE:g} kg stand for {len(bodies)} that are not stated"] if bodies else []
    return Written({name: mjcf_text(machine)} | _beside(machine, name),
                   (*lost, *_never_said(machine, springs=True)))


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


def _beside(machine: Machine, name: str) -> dict[str, str]:
    """The sidecar of a robot file of a machine."""
    head = (f"# The whole machine: what {name} cannot say of it, too. hydroopt reads both together, and what both say\n"
            "# counts as it stands there. Keep it beside that file.\n\n")
    return {beside(name).name: head + dump_machine(machine)}
