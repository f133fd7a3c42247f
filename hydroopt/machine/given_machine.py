"""What public functions take for a machine: the machine, its name, its file, or what holds it."""

from __future__ import annotations

from pathlib import Path

from hydroopt.errors import ProblemError
from hydroopt.machine.machine import Machine
from hydroopt.machine.machine_file import load_machine

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
