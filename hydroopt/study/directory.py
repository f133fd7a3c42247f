"""The directory in which a study stores its cells, so that a stopped run can be resumed."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from hydroopt.errors import ProblemError
from hydroopt.files import write_files
from hydroopt.input_file import read_json
from hydroopt.study.study import Outcome, Study, Value

IDENTITY = "study.json"


class Directory:
    """``study.json`` with the identity of the study, and ``cells/INDEX.json``; each file appears whole or not."""

    def __init__(self, path: str | Path, study: Study) -> None:
        """Open or create a study's directory.

        Raises:
            ProblemError: it holds the cells of another study, or cannot be written.
        """
        self.path, self.study = Path(path), study
        refuse(self.path, study)
        write_files(self.path, {IDENTITY: json.dumps(study.identity, indent=1)})

    def read(self) -> dict[int, Outcome]:
        """Outcomes of the finished cells, by index; a cell that cannot be read counts as unfinished."""
        found: dict[int, Outcome] = {}
        for index, cell in enumerate(self.study.cells):
            try:
                content = read_json(self.path / f"cells/{index}.json", ProblemError)
                kept = {key: value for key, value in content.items() if key in ("result", "error")}
                if content["cell"] == cell and len(kept) == 1 and isinstance(kept.get("result", {}), dict):
                    found[index] = kept
            except (ProblemError, TypeError, KeyError):
                continue
        return found

    def write(self, index: int, outcome: Outcome) -> Outcome:
        """Store a cell's outcome.

        Returns:
            The outcome as `read` will return it.
        """
        if "result" in outcome:
            outcome = {"result": {key: _value(value) for key, value in outcome["result"].items()}}
        write_files(self.path, {f"cells/{index}.json": json.dumps({"cell": self.study.cells[index], **outcome},
                                                                  allow_nan=False)})
        return outcome


def refuse(directory: Path, study: Study) -> None:
    """Refuse a directory that holds another study.

    Raises:
        ProblemError: the directory holds another study; the message names the first setting that differs.
    """
    where, remedy = str(directory), "choose another directory with -o"
    if directory.exists() and not directory.is_dir():
        raise ProblemError("this is a file", where=where, remedy=remedy)
    if not (directory / IDENTITY).exists():
        if (directory / "cells").exists():
            raise ProblemError(f"there are cells but no {IDENTITY}, so that their study is unknown", where=where,
                               remedy=remedy)
        return
    try:
        there = read_json(directory / IDENTITY, ProblemError)
    except ProblemError:
        raise ProblemError("the file cannot be read, so that the study of these cells is unknown",
                           where=str(directory / IDENTITY), remedy=remedy) from None
    different = _difference(there, study.identity)
    if different:
        raise ProblemError(f"this directory holds another study: {different}", where=where,
                           remedy=f"repeat the settings in its {IDENTITY}, or {remedy}")


def _difference(there: Mapping[str, Any], here: Mapping[str, Any], within: str = "") -> str:
    """The first setting that differs, in words; "" if none does."""
    for key in dict.fromkeys([*here, *there]):
        old, new = there.get(key), here.get(key)
        if isinstance(old, dict) and isinstance(new, dict):
            if inner := _difference(old, new, f"{within}{key} "):
                return inner
        elif old != new:
            return f"{within}{key} is {_short(old)} there and {_short(new)} here"
    return ""


def _short(value: object) -> str:
    text = "absent" if value is None else json.dumps(value)
    return text if len(text) <= 60 else f"{text[:28]}...{text[-28:]}"


def _value(value: Any) -> Value:
    """A number or a word as JSON stores it, without loss; None for NaN and infinity."""
    if value is None or isinstance(value, str):
        return value
    if isinstance(value, int):
        return int(value)
    return float(value) if math.isfinite(value) else None
