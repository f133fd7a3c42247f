"""What generated C needs beside it where it runs: wrappers for the languages and tools of integrators."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

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
