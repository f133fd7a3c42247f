"""Machines by name or path: bundled ones, machine files ``.toml``, robots' files."""

from __future__ import annotations

import os
import shlex
from difflib import get_close_matches
from pathlib import Path

from hydroopt.errors import MachineError, ProblemError
from hydroopt.machine.bundled_files import bundled_files
from hydroopt.machine.file_tables import build_machine, dump_tables, machine_file_tables
from hydroopt.machine.machine import Machine
from hydroopt.support.input_file import read_text, toml

ROBOT_SUFFIXES = (".urdf", ".xml", ".sdf", ".xacro")
"""Endings of robot files; a template of xacro is none, and named in its refusal."""


def bundled() -> tuple[str, ...]:
    """Names of the machines that come with hydroopt.

    >>> "cat215b" in bundled()
    True
    """
    return tuple(bundled_files())


def load_machine(machine: str | Path, *, parameter_set: str | None = None, tip: str | None = None) -> Machine:
    """Read a machine: the name of a bundled one, or the path of a ``.toml`` file or a robot's ``.urdf``,
    ``.xml`` (MJCF) or ``.sdf``.

    Args:
        machine: name or path, also of the folder that a command wrote with the calibrated machine.
        parameter_set: which of the file's sets of inertial parameters; by default the one the file names. A robot file
            has none.
        tip: of a robot file, the link at the end of the chain to read; all joints by default. See
            `hydroopt.machine.robot_formats.machine_tables.machine_tables`.

    Raises:
        MachineError: the file is missing, malformed, incomplete, contradictory or geometrically impossible.

    >>> load_machine("cat215b")
    Machine('cat215b': 3 joints, 2 cylinders, 1 motor)
    """
    name, path = str(machine), Path(machine)
    if path.suffix in ROBOT_SUFFIXES:
        if parameter_set is not None:
            raise MachineError(f"there is no parameter set '{parameter_set}'", where=name,
                               remedy="leave it out: a robot file states its bodies once")
        from hydroopt.machine.robot_formats.reading import read_robot  # noqa: PLC0415 (most machines need no XML)

        found = read_robot(path, tip=tip)
        return _loaded(build_machine(found.tables, name), name)
    if tip is not None:
        raise MachineError(f"only of a robot file the chain to a tip such as '{tip}' can be read", where=name,
                           remedy="leave it out")
    if file := bundled_files().get(name):
        return _loaded(read_machine(file.read_text("utf-8"), where=name, parameter_set=parameter_set), name)
    if os.path.isdir(path) and len(machines := sorted(path.glob("*.toml"))) == 1:  # what a command wrote
        return _loaded(load_machine(machines[0], parameter_set=parameter_set), name)
    if path.suffix != ".toml":
        close = get_close_matches(name, bundled(), 2)
        raise MachineError(f"this is neither a bundled machine nor a .toml or {', '.join(ROBOT_SUFFIXES[:3])} file",
                           where=name, remedy=f"did you mean {' or '.join(close)}" if close else
                           "name a .toml file, or one of the machines that 'hydroopt models' lists")
    text = read_text(path, MachineError, noun="machine file")
    return _loaded(read_machine(text, where=name, parameter_set=parameter_set), name)


def _loaded(machine: Machine, source: str) -> Machine:
    """The machine with its `source`, which is not part of its description: equal machines may have different ones."""
    machine.__dict__["source"] = shlex.quote(source)
    return machine


GivenMachine = Machine | str | Path
"""What functions take for a machine, see `machine_of`."""


def machine_of(given: object, where: str) -> Machine:
    """A machine, that of a model, or the one of a name or path, as all public functions take them.

    Args:
        given: a machine, a model or plant, or what `load_machine` takes.
        where: the function, for errors.

    Raises:
        ProblemError: this is something else.
        MachineError: see `load_machine`.

    >>> machine_of("cat215b", "test").joints
    ('swing', 'boom', 'stick')
    """
    if isinstance(given, str | Path):
        return load_machine(given)
    found = given if isinstance(given, Machine) else getattr(given, "machine", None)
    if not isinstance(found, Machine):
        raise ProblemError(f"this is {type(given).__name__} {given!r:.40}, not a machine", where=where,
                           remedy="give a Machine, such as load_machine('cat215b') returns, its name, or its file")
    return found


def read_machine(text: str, *, where: str = "machine", parameter_set: str | None = None) -> Machine:
    """Machine from the text of a machine file; `where` names it in errors.

    Raises:
        MachineError: see `load_machine`.

    >>> machine = read_machine('''
    ... name = "pendulum"
    ... [[links]]
    ... name = "arm"
    ... joint = { type = "revolute", lower = "-90 deg", upper = "90 deg", a = "1.2 m" }
    ... [[drives]]
    ... name = "drive"
    ... joint = "arm"
    ... ''')
    >>> machine
    Machine('pendulum': 1 joint, 1 drive)
    """
    return build_machine(toml(text, MachineError, where=where), where, parameter_set)


def dump_machine(machine: Machine) -> str:
    """Text of a machine file (SI units) that `read_machine` turns into an equal machine.

    >>> machine = load_machine("cat215b")
    >>> read_machine(dump_machine(machine)) == machine
    True
    """
    return dump_tables(machine_file_tables(machine))
