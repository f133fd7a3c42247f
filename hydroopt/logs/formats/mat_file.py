"""MATLAB files up to version 7 as tables."""

import json
import os
import re
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from hydroopt.errors import LogError
from hydroopt.logs import stamps
from hydroopt.logs.column_map import Key, LogMap
from hydroopt.logs.table import Array, RawKey, Table, find_column, selected, unreadable

PROGRAM = Path(__file__).with_name("mat_process.py")
MEMORY = 2 * 1000**3
"""Memory [bytes] that reading a file may take beside the file's own size."""
SECONDS = 50
"""After which a file that is not yet read counts as damaged."""
_ROW = re.compile(r"(.+)\[(\d+)\]")


class MatFile:
    """A MATLAB file up to version 7; keys are (variable, row), with dots for fields of a struct, or ``variable[row]``.

    A process of its own reads it, since damaged files crash SciPy's reader. It starts in about half a second.
    """

    own_stamps, shown = False, ""

    def __init__(self, data: bytes, where: str, layout: LogMap | None, *, listed: bool = False) -> None:
        if layout is None and not listed:
            raise LogError("a .mat file says nothing about units", where=where,
                           remedy="give a map with --map, which hydroopt map proposes")
        if data[:128].startswith(b"MATLAB 7.3") or data[:4] == b"\x89HDF":
            raise LogError("this is a MATLAB 7.3 file", where=where, remedy="save it with save(..., '-v7')")
        self.where, self._data, self._rows = where, data, layout.rows if layout else None
        # vectors, and rows of matrices with few of them
        self.header: list[str] = [str(name) for name in self._said(None)[0]["names"]] if listed else []
        # of a file that is listed all are read at once, since each question starts a process
        listed_keys = [self._variable(name) for name in self.header]
        self._listed = dict(zip(listed_keys, self._vectors(listed_keys), strict=True)) if listed_keys else {}

    def read(self, keys: Sequence[RawKey], texts: Sequence[Key] = (), time: RawKey | None = None) -> Table:
        """The variables `keys` as numbers, all of one length; there are no texts."""
        wanted = [key if isinstance(key, tuple) else self._variable(key) for key in keys]
        columns = [self._listed[key] for key in wanted] if self._listed.keys() >= {*wanted} else self._vectors(wanted)
        sizes = {column.size for column in columns}
        if len(sizes) > 1:
            raise LogError(f"the mapped variables have different lengths {sorted(sizes)}", where=self.where,
                           remedy="map variables of one recording")
        rows = selected(columns[0].size, self._rows, self.where)
        found: dict[RawKey, Array] = {key: column[rows - 1] for key, column in zip(keys, columns, strict=True)}
        return Table(found, rows, stamps=None if time is None else stamps.of_column(found[time]))

    def _variable(self, key: Key) -> tuple[str, int | None]:
        """The variable and row of a name such as ``angles[2]``, or of a place in the header of a file that is listed.
        """
        name = key if isinstance(key, str) else self.header[find_column(key, self.header, len(self.header), self.where)]
        match = _ROW.fullmatch(name)
        return (match[1], int(match[2])) if match else (name, None)

    def _vectors(self, keys: list[tuple[str, int | None]]) -> list[Array]:
        said, numbers = self._said(keys)
        return np.split(np.frombuffer(numbers), np.cumsum(said["sizes"])[:-1])

    def _said(self, keys: list[tuple[str, int | None]] | None) -> tuple[dict[str, Any], bytes]:
        """The answer to a question for vectors, or for the names of all: its line, and the numbers behind it.

        Raises:
            LogError: the file is damaged, or has no such vectors.
        """
        line, _, numbers = self._answer(keys).partition(b"\n")
        said = json.loads(line)
        if "unreadable" in said:
            raise unreadable("MATLAB", self.where, ValueError(said["unreadable"]))
        if "what" in said:
            raise LogError(said["what"], where=f"{self.where}, variable '{said['variable']}'", remedy=said["remedy"])
        return said, numbers

    def _answer(self, keys: list[tuple[str, int | None]] | None) -> bytes:
        limits = json.dumps([keys, MEMORY + 2 * len(self._data), SECONDS])
        try:
            done = subprocess.run([sys.executable, "-P", str(PROGRAM), limits], input=self._data, capture_output=True,
                                  timeout=SECONDS, check=False, env=os.environ | {"OPENBLAS_NUM_THREADS": "1"})
        except subprocess.TimeoutExpired:
            raise unreadable("MATLAB", self.where, TimeoutError(f"not read within {SECONDS} s")) from None
        if done.returncode or not done.stdout:
            raise unreadable("MATLAB", self.where, ValueError("it crashes the reader"))
        return done.stdout
