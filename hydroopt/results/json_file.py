"""The folder of an answer: the only reader and writer of estimate.json and its like."""

from __future__ import annotations

import json
import os
import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from datetime import UTC, datetime
from enum import StrEnum
from functools import cache
from hashlib import sha256
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from pydantic import TypeAdapter

from hydroopt.errors import HydrooptError, ProblemError
from hydroopt.results.status import Status
from hydroopt.results.verdict import Verdict
from hydroopt.support.files import claimed, encoded, lies_within, write_files
from hydroopt.support.input_file import read_bytes, read_json
from hydroopt.support.packages import versions

if TYPE_CHECKING:
    from hydroopt.machine.machine import Machine

TABLE_LIMIT = 256 * 1000**2
"""Largest file beside the JSON file that is read [bytes]."""
TEXTS = (".csv", ".txt", ".toml", ".html")
"""Endings of files of text."""
SCHEMA = 3
"""Version of the JSON files; it changes when a key changes its meaning or goes."""


class Job(StrEnum):
    """The jobs that leave an answer; the value stands in JSON files."""

    IDENTIFICATION = "identification"
    CALIBRATION = "kinematic calibration"
    SENSORS = "calibration of sensors"
    HYDRAULICS = "identification of valves and oil"
    EXCITATION = "excitation"
    POSE_PLAN = "pose plan"
    CALIBRATOR = "calibrator design"
    NEXT = "next measurements"
    CHANGE = "comparison of sessions"
    PAYLOAD = "identification of a payload"
    WEIGHING = "weighing of loads"
    CONTROL = "comparison of controllers"
    CHECK = "check of logs"
    MOTION_CHECK = "check of motions"
    POSTURE_CHECK = "check of poses"


FILES = {Job.IDENTIFICATION: "estimate.json", Job.CALIBRATION: "estimate.json", Job.SENSORS: "estimate.json",
         Job.HYDRAULICS: "estimate.json",
         Job.EXCITATION: "excitation.json", Job.POSE_PLAN: "plan.json",
         Job.CALIBRATOR: "design.json",
         Job.NEXT: "next.json",
         Job.CHANGE: "comparison.json",
         Job.PAYLOAD: "payload.json", Job.WEIGHING: "weighing.json", Job.CONTROL: "control.json",
         Job.CHECK: "check.json", Job.MOTION_CHECK: "check.json", Job.POSTURE_CHECK: "check.json"}
"""The JSON file of each job."""
COMMON = ("schema", "job", "machine", "created", "inputs", "method", "versions", "status", "verdict", "claims",
          "findings", "diagnostics", "parameters", "fit", "wall_s", "files", "answer")
"""Keys of the JSON file that all answers have."""


class MachineId(NamedTuple):
    """Which machine an answer is about: its name, its set of inertial parameters, and the digest of its description."""

    name: str
    parameter_set: str
    sha256: str

    @classmethod
    def of(cls, machine: Machine) -> MachineId:
        """Of a machine."""
        return cls(machine.name, machine.parameter_set, machine.sha256)


def title(machine: str, job: Job, method: str) -> str:
    """What an answer is called: machine, job and method."""
    return f"{machine}: {job} by {method}"


def header(job: Job, machine: MachineId, method: str,
           inputs: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """What every JSON file says first: schema, job, machine, date, inputs, method and versions."""
    return {"schema": SCHEMA, "job": str(job), "machine": machine._asdict(),
            "created": datetime.now(UTC).isoformat(timespec="seconds"), "inputs": [dict(each) for each in inputs],
            "method": method, "versions": versions()}


def write(directory: str | Path, job: Job, content: Mapping[str, Any],
          files: Mapping[str, str | bytes | None]) -> None:
    """Write an answer, its JSON file last; what an earlier answer left in the directory goes, and what is None.

    Raises:
        ProblemError: the directory cannot be written.
    """
    digests = {name: sha256(encoded(data)).hexdigest() for name, data in files.items() if data is not None}
    text = json.dumps({**content, "files": digests}, indent=1, allow_nan=False)
    with claimed(directory):
        earlier = dict.fromkeys(_left_by_answers(Path(directory)))
        earlier.pop(FILES[job], None)
        write_files(directory, {**earlier, **files, FILES[job]: text})


def write_failure(directory: str | Path, job: Job, machine: MachineId, method: str,
                  inputs: Sequence[Mapping[str, Any]], error: HydrooptError) -> None:
    """Write a JSON file that says why there is no answer, and nothing else.

    Raises:
        ProblemError: the directory cannot be written.
    """
    verdict = Verdict(title(machine.name, job, method), Status.FAILED, str(error))
    content = header(job, machine, method, inputs) | {"status": str(Status.FAILED), "verdict": verdict.as_dict(),
                                                      "reason": str(error)}
    write(directory, job, content, {})


class Beside(Mapping[str, str | bytes]):
    """The files that an answer's JSON file of some content says stand beside it, each read when it is asked for."""

    def __init__(self, directory: Path, content: Mapping[str, Any]) -> None:
        self.directory, listed = directory, content.get("files")
        self._digests = {name: digest for name, digest in (listed if isinstance(listed, dict) else {}).items()
                         if lies_within(directory, name)}

    def __iter__(self) -> Iterator[str]:
        return (name for name in self._digests if os.path.lexists(self.directory / name))

    def __len__(self) -> int:
        return sum(1 for _ in self)

    def __getitem__(self, name: str) -> str | bytes:
        """The content of a file, a text where its name is that of one.

        Raises:
            KeyError: no such file is listed, or it is gone.
            ProblemError: it is a symbolic link, cannot be read, or is not as it was saved.
        """
        file, digest = self.directory / name, self._digests[name]
        if not os.path.lexists(file):
            raise KeyError(name)
        _refuse_link(file)
        data = read_bytes(file, ProblemError, most=TABLE_LIMIT, noun="file of an answer")
        if sha256(data).hexdigest() != digest:
            raise ProblemError("this file of an answer is damaged, or was changed after it was saved", where=str(file),
                               remedy="run the command again, or name this file instead of the folder")
        return data.decode("utf-8", "backslashreplace") if name.endswith(TEXTS) else data


def _refuse_link(file: Path) -> None:
    if os.path.islink(file):
        raise ProblemError("this is a symbolic link", where=str(file), remedy="put the file itself in its place")


def _left_by_answers(directory: Path) -> Iterator[str]:
    """Names of the files that earlier answers left in a directory and that are unchanged since."""
    for json_name in dict.fromkeys(FILES.values()):
        try:
            content = read_json(directory / json_name, ProblemError)
        except ProblemError:
            continue
        if {"schema", "job"} <= content.keys():
            yield json_name
            beside = Beside(directory, content)
            for name in beside:
                with suppress(ProblemError):
                    beside[name]
                    yield name


def find(directory: Path) -> Path:
    """The JSON file of the answer in a directory.

    Raises:
        ProblemError: there is none, or it is a symbolic link.
    """
    for name in dict.fromkeys(FILES.values()):
        if os.path.lexists(directory / name):
            _refuse_link(directory / name)
            return directory / name
    raise ProblemError("this folder holds no estimate", where=str(directory),
                       remedy="name the folder that a hydroopt command wrote")


def read(directory: Path) -> dict[str, Any]:
    """The content of an answer's JSON file, checked for what all answers have.

    Raises:
        ProblemError: there is none, it is damaged, or another version of hydroopt wrote it.
    """
    file = find(directory)
    try:
        content = read_json(file, ProblemError)
        schema = content["schema"]
        known = {"job", "status"} <= content.keys() and {*MachineId._fields} <= content["machine"].keys()
        known = known and re.fullmatch(r"[A-Za-z]\w{0,199}", content["machine"]["name"], re.ASCII) is not None
    except (ProblemError, KeyError, TypeError, AttributeError):
        raise not_an_answer(directory) from None
    if schema != SCHEMA:
        raise ProblemError(f"its schema is {schema!r}, and this version of hydroopt reads {SCHEMA}", where=str(file),
                           remedy="run the command again with this version")
    if not known:
        raise not_an_answer(directory)
    return content


def validated(kind: Any, entry: Any) -> Any:
    """A dataclass, or a container of such, from its entry of a JSON file.

    Raises:
        ValueError: the entry is not of this kind.

    >>> validated(tuple[int, ...], [1, 2])
    (1, 2)
    """
    return _adapter(kind).validate_python(entry)


@cache
def _adapter(kind: Any) -> TypeAdapter[Any]:
    return TypeAdapter(kind)


def not_an_answer(directory: Path) -> ProblemError:
    """The error of a JSON file that is not an answer of hydroopt."""
    return ProblemError("hydroopt did not write this file, or it is damaged", where=str(find(directory)),
                        remedy="run the command again")
