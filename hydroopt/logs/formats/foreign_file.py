"""Files that a library reads in a process of its own: HDF5, MATLAB, NPZ, XLSX, TDMS, MDF, ROS bags and MCAP."""

from __future__ import annotations

import io
import json
import os
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hydroopt.errors import LogError
from hydroopt.logs import stamps
from hydroopt.logs.column_map import Key, LogMap
from hydroopt.logs.formats.sheet import Sheet
from hydroopt.logs.formats.text_file import TextFile
from hydroopt.logs.stamps import Stamps
from hydroopt.logs.table import Array, NoNumbersError, RawKey, Table, check_size, selected, unreadable
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
            said, _ = self._answer()
            found = said["sheets"]
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
        _, (data,) = self.ask(sheet=index, columns=[], stamps=False)
        return TextFile(data.tobytes(), where, layout, sheet=True)

    def ask(self, **request: Any) -> tuple[dict[str, Any], list[NDArray[Any]]]:
        """The answer to a request, and its arrays."""
        assert self._process.stdin is not None
        try:
            self._process.stdin.write(json.dumps(request).encode() + b"\n")
            self._process.stdin.flush()
        except OSError:
            raise self._crashed() from None
        return self._answer()

    def _answer(self) -> tuple[dict[str, Any], list[NDArray[Any]]]:
        assert self._process.stdout is not None
        line = self._process.stdout.readline()
        if not line.endswith(b"\n"):
            raise self._crashed()
        said = json.loads(line)
        if "missing" in said:
            raise LogError(f"the library '{said['missing']}' that reads {NAMES[self.kind]} files is not installed",
                           where=self.where, remedy=install(LIBRARIES[self.kind]))
        if "exceeded" in said:
            raise LogError(f"reading takes more than the {said['exceeded'] / 1e9:.1f} GB of memory that it may",
                           where=self.where, remedy="raise the limit (ulimit -v), split the file or record it again")
        if "unreadable" in said:
            raise unreadable(NAMES[self.kind], self.where, ValueError(said["unreadable"]))
        blobs = [self._process.stdout.read(size) for size in said["sizes"]]
        if any(len(blob) < size for blob, size in zip(blobs, said["sizes"], strict=True)):
            raise self._crashed()
        return said, [np.load(io.BytesIO(blob), allow_pickle=False) for blob in blobs]

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

    variables = True

    def __init__(self, file: ForeignFile, index: int, where: str, said: dict[str, Any],
                 rows: tuple[int, int] | None) -> None:
        super().__init__(where, said["header"], rows)
        self.shown, self.own_stamps = said["shown"], said["own"]
        self._file, self._index = file, index

    def read(self, keys: Sequence[RawKey], texts: Sequence[Key] = (), time: RawKey | None = None) -> Table:
        """The columns `keys` as numbers; there are no texts."""
        if texts:
            raise LogError("this file has no columns of text", where=self.where, remedy="export it as .csv or .xlsx")
        index = [self.column(key) for key in keys]
        own = self.own_stamps and time is None
        _, arrays = self._file.ask(sheet=self._index, columns=index, stamps=own)
        made = _own(arrays.pop()) if own else None
        columns: dict[RawKey, Array] = {}
        if len({array.size for array in arrays} | ({made.moments.size} if made else set())) > 1:
            raise unreadable(NAMES[self._file.kind], self.where, ValueError("its columns have different lengths"))
        count = made.moments.size if made is not None else arrays[0].size if arrays else 0
        rows = selected(count, self.rows, self.where) if count else np.empty(0, int)
        for key, position, array in zip(keys, index, arrays, strict=True):
            if array.dtype.kind not in "biuf" and not (key == time and array.dtype.kind in "mM"):
                raise NoNumbersError(f"column '{self.header[position]}' holds no numbers", where=self.where,
                               remedy="map another column")
            if key == time:
                made = stamps.of_column(array[rows - 1])
            columns[key] = made.seconds() if array.dtype.kind in "mM" and made else array[rows - 1].astype(float)
        if own and made is not None:
            made = Stamps(made.moments[rows - 1])
        return Table(columns, rows, stamps=made)


def _own(found: NDArray[Any]) -> Stamps:
    """Stamps of a file's own: dates, or seconds."""
    if found.dtype.kind in "mM":
        return Stamps(found)
    ticks = np.round(np.nan_to_num(found) * 1e9).astype(np.int64).view("m8[ns]")
    return Stamps(np.where(np.isfinite(found), ticks, np.timedelta64("NaT")))
