"""Files that a library reads in a process of its own: HDF5, MATLAB, NPZ, XLSX, TDMS, MDF, ROS bags and MCAP."""

from __future__ import annotations

import io
import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hydroopt.errors import LogError
from hydroopt.logs.column_map import LogMap
from hydroopt.logs.formats.sheet import Sheet
from hydroopt.logs.formats.text_file import TextFile
from hydroopt.logs.stamps import Stamps
from hydroopt.logs.table import check_size, unreadable
from hydroopt.support.packages import install

NAMES = {"hdf5": "HDF5", "mat": "MATLAB", "mat73": "MATLAB 7.3", "npz": "NPZ", "xlsx": "spreadsheet",
         "tdms": "TDMS", "mdf": "MDF", "bags": "ROS bag or MCAP"}
LIBRARIES = {"hdf5": "h5py", "mat73": "h5py", "xlsx": "python_calamine", "tdms": "nptdms", "mdf": "asammdf",
             "bags": "rosbags"}
"""The library that reads a kind of file."""
PROGRAM = Path(__file__).with_name("process.py")
ROOT = Path(__file__).parents[3]
MEMORY = 6 * 1000**3
"""Memory [bytes] that reading may take beside ten times the file's size."""
SECONDS = 60
"""Processor time [s] that reading may take, and as much again for each 50 MB."""


class ForeignFile:
    """A file that a process decodes; its sheets are read one by one until it is closed.

    Raises:
        LogError: the file is damaged, its library is missing, or it declares more than can be held.
    """

    def __init__(self, kind: str, path: str, size: int, layout: LogMap | None) -> None:
        self.kind, self.where = kind, path
        limits = [kind, os.path.abspath(path), MEMORY + 10 * size, SECONDS * (1 + size // (50 * 10**6)), str(ROOT)]
        self._process = subprocess.Popen(
            [sys.executable, "-P", str(PROGRAM), json.dumps(limits)], stdin=subprocess.PIPE, stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL, env=os.environ | {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"})
        try:
            found = self._answer()["sheets"]
            if not found:
                raise LogError("the file holds no columns of two or more numbers", where=path,
                               remedy="check what was recorded")
            alone = len(found) == 1
            self.sheets: list[Sheet] = []
            for k, each in enumerate(found):
                check_size(each["rows"] * 8, path)
                where = path if alone else f"{path}, {each['name']}"
                try:
                    sheet = (self._table(k, where, layout) if each["text"] else
                             _ForeignSheet(self, k, where, each, layout.rows if layout else None))
                    sheet.name, sheet.title = "" if alone else each["name"], each["name"]
                    self.sheets.append(sheet)
                except LogError:
                    if alone or (k + 1 == len(found) and not self.sheets):
                        raise  # a worksheet of notes is no table
        except BaseException:
            self.close()
            raise

    def _table(self, index: int, where: str, layout: LogMap | None) -> Sheet:
        """A worksheet, which is a table of text with tabs."""
        return TextFile(self.ask(sheet=index, column=0).tobytes(), where, layout, sheet=True)

    def ask(self, **request: int) -> NDArray[Any]:
        """The answer to a request."""
        assert self._process.stdin is not None
        try:
            self._process.stdin.write(json.dumps(request).encode() + b"\n")
            self._process.stdin.flush()
        except OSError:
            raise self._crashed() from None
        size = self._answer()["size"]
        assert self._process.stdout is not None
        blob = self._process.stdout.read(size)
        if len(blob) < size:
            raise self._crashed()
        return np.asarray(np.load(io.BytesIO(blob), allow_pickle=False))

    def _answer(self) -> dict[str, Any]:
        assert self._process.stdout is not None
        line = self._process.stdout.readline()
        if not line.endswith(b"\n"):
            raise self._crashed()
        said: dict[str, Any] = json.loads(line)
        if "missing" in said:
            raise LogError(f"the library '{said['missing']}' that reads {NAMES[self.kind]} files is not installed",
                           where=self.where, remedy=install(LIBRARIES[self.kind]))
        if "exceeded" in said:
            raise LogError(f"reading takes more than the {said['exceeded'] / 1e9:.1f} GB of memory that it may",
                           where=self.where, remedy="raise the limit (ulimit -v), split the file or record it again")
        if "unreadable" in said:
            raise unreadable(NAMES[self.kind], self.where, ValueError(said["unreadable"]))
        return said

    def _crashed(self) -> LogError:
        return unreadable(NAMES[self.kind], self.where, ValueError("it crashes the reader, or takes too long"))

    def close(self) -> None:
        """End the process."""
        self._process.kill()
        self._process.wait()
        for pipe in (self._process.stdin, self._process.stdout):
            if pipe is not None:
                pipe.close()


class _ForeignSheet(Sheet):
    """A sheet of numbers of such a file."""

    def __init__(self, file: ForeignFile, index: int, where: str, said: dict[str, Any],
                 rows: tuple[int, int] | None) -> None:
        super().__init__(where, said["header"], said["rows"], rows)
        self.shown, self.own_stamps = said["shown"], said["own"]
        self._file, self._index = file, index

    def values(self, index: int, rows: NDArray[np.int64], *, exact: bool = False) -> NDArray[Any]:
        """A column, or the sheet's own stamps."""
        array = self._file.ask(sheet=self._index, column=index)
        if array.dtype.kind not in ("biufmM" if exact else "biuf"):
            raise self.no_numbers(index, "texts or moments", "map another column")
        if array.size != self.count:
            raise unreadable(NAMES[self._file.kind], self.where, ValueError("its columns have different lengths"))
        return array[rows - 1] if exact else array[rows - 1].astype(float)

    def timed(self, index: int, rows: NDArray[np.int64]) -> tuple[NDArray[Any], Stamps | None]:
        """A column of times, or the sheet's own stamps, which are no epoch that anybody has to be told."""
        values, made = super().timed(index, rows)
        return values, made if index >= 0 else Stamps(values)
