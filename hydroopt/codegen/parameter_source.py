"""What C is generated from: a machine file, or the folder of an estimate."""

from __future__ import annotations

import hashlib
import json
import re
from pathlib import Path
from typing import NamedTuple

from hydroopt.errors import ProblemError
from hydroopt.machine.machine import Machine
from hydroopt.machine.machine_file import bundled, load_machine


class Origin(NamedTuple):
    """Where the values of the parameters are from, in words, and the digest of what they were read from."""

    text: str
    sha256: str


def read(given: str, *, parameter_set: str | None = None) -> tuple[Machine, Origin]:
    """A machine with its nominal values, or the calibrated one of an estimate's folder.

    Raises:
        MachineError: the machine cannot be read.
        ProblemError: the folder holds no estimate, one that failed, or no calibrated machine.
    """
    folder = Path(given)
    if given in bundled() or not folder.is_dir():
        machine = load_machine(given, parameter_set=parameter_set)
        return machine, Origin(f"nominal values of the machine {machine.name}", machine.sha256)
    if parameter_set is not None:
        raise ProblemError("an estimate has one set of parameters", where="--set", remedy="leave it out")
    file = folder / "estimate.json"
    try:
        data = file.read_bytes()
        content = json.loads(data)
        name, created, status = content["machine"]["name"], content.get("created", "a day unknown"), content["status"]
        if not re.fullmatch(r"[A-Za-z]\w{0,199}", str(name), re.ASCII):
            raise ValueError
        words = [str(name), str(created), str(content["method"])]
    except OSError:
        raise ProblemError("this folder holds no estimate", where=given,
                           remedy="name a machine, or the folder that identify or calibrate wrote") from None
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError):
        raise ProblemError("this is no estimate that hydroopt wrote", where=str(file),
                           remedy="identify or calibrate again") from None
    if status == "failed":
        raise ProblemError("the estimate failed, so that there is nothing to export", where=str(file),
                           remedy="see its 'reason', then identify or calibrate again")
    calibrated = folder / f"{name}.toml"
    if not calibrated.is_file():
        raise ProblemError("no calibrated machine stands beside it, because it could not exist", where=str(file),
                           remedy="see its 'doubts', then identify or calibrate with more data or another method")
    machine = load_machine(calibrated)
    return machine, Origin(f"estimate of {machine.name} by {_plain(words[2])} on {_plain(words[1])}",
                           hashlib.sha256(data).hexdigest())


def _plain(text: str) -> str:
    """Text that cannot end a comment."""
    return "".join(c for c in text if c.isascii() and (c.isalnum() or c in " :._+-"))[:60]
