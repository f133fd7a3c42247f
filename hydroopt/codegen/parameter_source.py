"""Source of the parameters of generated C and controllers: a machine file, or the folder of an estimate."""

from __future__ import annotations

import hashlib
import os
from pathlib import Path
from typing import NamedTuple

from hydroopt.errors import ProblemError
from hydroopt.machine.machine import Machine
from hydroopt.machine.machine_file import bundled, load_machine
from hydroopt.results import json_file
from hydroopt.results.answer import load
from hydroopt.results.status import Status


class Origin(NamedTuple):
    """Origin of the parameters in words, and the digest of the file that they were read from."""

    text: str
    sha256: str


def read(source: str, *, parameter_set: str | None = None) -> tuple[Machine, Origin]:
    """A machine with its nominal values, or the calibrated one of an estimate's folder.

    Raises:
        MachineError: the machine cannot be read.
        ProblemError: the folder holds no estimate, one that failed, or no calibrated machine.
    """
    folder = Path(source)
    if source in bundled() or not os.path.isdir(folder):
        machine = load_machine(source, parameter_set=parameter_set)
        return machine, Origin(f"nominal values of the machine {machine.name}{_suspect(machine)}", machine.sha256)
    if parameter_set is not None:
        raise ProblemError("an estimate has one set of parameters", where="--set", remedy="leave it out")
    answer = load(folder)
    file = json_file.find(folder)
    if answer.status is Status.FAILED:
        raise ProblemError("the estimate failed, so that there is nothing to export", where=str(file),
                           remedy="see its 'reason', then identify or calibrate again")
    if answer.text_of(f"{answer.machine_name}.toml") is None:
        raise ProblemError("there is no calibrated machine beside it", where=str(file),
                           remedy="see its 'diagnostics', then identify or calibrate with more data or another method")
    machine = load_machine(folder / f"{answer.machine_name}.toml")
    created = str(answer.content().get("created", "an unknown day"))
    return machine, Origin(f"estimate of {machine.name} by {_plain(answer.method)} on {_plain(created)}"
                           f"{_suspect(machine)}",
                           hashlib.sha256(file.read_bytes()).hexdigest())


def _suspect(machine: Machine) -> str:
    """What C and controllers say of numbers that are not to be trusted."""
    return ", SUSPECT, see its machine file" if machine.suspect else ""


def _plain(text: str) -> str:
    """Text without characters that could end a C comment."""
    return "".join(c for c in text if c.isascii() and (c.isalnum() or c in " :._+-"))[:60]
