"""What generated C needs beside it where it runs: wrappers for the languages and tools of integrators."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import NamedTuple

from hydroopt.codegen.routines import Interface
from hydroopt.codegen.symbols import Field, Routine
from hydroopt.errors import ProblemError


class Host(NamedTuple):
    """A language or tool that calls the generated C.

    Attributes:
        text: what it is, in words.
        files: template by file, "" where no template alone makes it; ``{p}`` in the names stands for the prefix.
    """

    text: str
    files: Mapping[str, str]


VALUES = "{p}_values.c"
"""Part of the library for hosts that include no header of C."""
HOSTS: Mapping[str, Host] = {
    "cpp": Host("C++17 header", {"{p}.hpp": "host.hpp"}),
    "python": Host("Python module by ctypes and numpy", {"{p}.py": "host.py.jinja", VALUES: "values.c"}),
    "ros2_control": Host("C++17 components in the manner of ros2_control", {
        "{p}.hpp": "host.hpp", "{p}_ros2_control.hpp": "ros2_control.hpp"}),
    "simulink": Host("Simulink S-function", {"{p}_sfun.c": "sfun.c"}),
    "codesys": Host("declarations in structured text for CODESYS", {
        "{p}.st": "codesys.st", "{p}_codesys.c": "codesys.c"}),
    "fmi": Host("FMI 3.0, the plant for Model Exchange and Co-Simulation and the inverse dynamics for Co-Simulation", {
        "{p}_plant.fmu": "", "{p}_inverse_dynamics.fmu": ""})}


def templates(hosts: Sequence[str], prefix: str) -> dict[str, str]:
    """Template by file of some hosts.

    Raises:
        ProblemError: there is no such host.

    Example:
        >>> templates(["cpp"], "crane")
        {'crane.hpp': 'host.hpp'}
    """
    for name in hosts:
        if name not in HOSTS:
            raise ProblemError(f"no host '{ascii(name)[1:-1][:40]}'", where="--for", remedy=f"use {', '.join(HOSTS)}")
    return {file.format(p=prefix): template for name in hosts for file, template in HOSTS[name].files.items()}


ROS_NAMES = {"q": "position", "qd": "velocity", "qdd": "acceleration", "force": "effort", "actuator_force": "effort"}
"""What ros2_control calls members; all others keep their names."""


class Port(NamedTuple):
    """A member of a struct as a row of numbers: how many, and how the first is reached."""

    name: str
    width: int
    first: str


class Calls:
    """What wrappers that know no structs of C need to know of the routines."""

    def __init__(self, interface: Interface, routines: Mapping[str, Routine]) -> None:
        self._interface, self._routines = interface, routines

    def of_rank(self, *ranks: int) -> list[Routine]:
        """Routines whose members have one of these numbers of dimensions."""
        return [each for each in self._routines.values() if all(
            len(self._shape(struct, member)) in ranks for struct, members in (
                (each.takes, each.reads), (each.gives, each.outputs)) for member in members)]

    def ports(self, struct: str, members: Iterable[str]) -> list[Port]:
        """Members of a struct."""
        return [Port(name, math.prod(self._shape(struct, name)), "[0]" * len(self._shape(struct, name)))
                for name in members]

    @property
    def most_ports(self) -> int:
        """The largest number of members that a routine reads or gives."""
        return max(max(len(each.reads), len(each.outputs)) for each in self._routines.values())

    def signals(self, struct: str, members: Iterable[str]) -> list[str]:
        """Names of all numbers in members of a struct with one dimension, such as ``boom/position``."""
        found = []
        for field in (self._field(struct, name) for name in members):
            kind = field.shape[0]
            if isinstance(kind, str):
                name = ROS_NAMES.get(field.name, field.name)
                found += [f"{each}/{name}" for each in self._interface.kinds[kind].names]
            else:
                found += [f"{field.name}/{k}" for k in range(kind)]
        return found

    def _field(self, struct: str, member: str) -> Field:
        return next(each for each in self._interface.structs[struct].fields if each.name == member)

    def _shape(self, struct: str, member: str) -> tuple[int, ...]:
        return self._interface.size(self._field(struct, member))
