"""What a decoder finds in a file: sheets of columns of one length."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

from numpy.typing import NDArray

WIDEST = 64
"""Columns of an array that are read as channels; an array with more of them is an image or a cloud of points."""


@dataclass(frozen=True)
class Column:
    """A column: its `name`, `unit` (empty where the file states none), and how its values (N,) are read."""

    name: str
    unit: str
    values: Callable[[], NDArray[Any]]

    @property
    def header(self) -> str:
        """`name [unit]`, or the name where there is no unit or the name states it."""
        stated = self.name.rpartition(" ")[2].startswith("[")
        return f"{self.name} [{self.unit}]" if self.unit and not stated else self.name


@dataclass(frozen=True)
class Content:
    """A sheet: its `name`, `columns`, and how its own stamps (N,) are read, datetime64 in UTC or timedelta64.

    `shown` is what was taken of the file that it does not state. Of a table of `text` the one column
    is its bytes. `rows` is how many there are.
    """

    name: str
    columns: Sequence[Column] = ()
    stamps: Callable[[], NDArray[Any]] | None = None
    shown: str = ""
    text: bool = False
    rows: int = 0


def _part(read: Callable[[], NDArray[Any]], index: int | None = None, axis: int = 0) -> NDArray[Any]:
    """A vector, or that of an index along an axis of a matrix."""
    return read().ravel() if index is None else read().take(index, axis)


def sheets_of_arrays(arrays: Mapping[str, tuple[tuple[int, ...], str, Callable[[], NDArray[Any]]]]) -> list[Content]:
    """Sheets of arrays (shape, unit, reader) by path, those of one folder and length together.

    Args:
        arrays: vectors, or matrices whose columns become ``name[0]``, ``name[1]``, …, or whose rows do where these are
            fewer; a path has its folders before the last slash.
    """
    found: dict[tuple[str, int], list[Column]] = {}
    for path, (shape, unit, read) in arrays.items():
        folder, _, name = path.rpartition("/")
        if len(shape) == 1 or (len(shape) == 2 and 1 in shape):
            found.setdefault((folder, max(shape)), []).append(Column(name, unit, partial(_part, read)))
        elif len(shape) == 2 and min(shape) <= WIDEST:
            axis = int(shape[1] <= shape[0])
            for k in range(shape[axis]):
                found.setdefault((folder, shape[1 - axis]), []).append(
                    Column(f"{name}[{k}]", unit, partial(_part, read, k, axis)))
    found = {key: columns for key, columns in found.items() if key[1] > 1}
    most = {folder: Counter({n: len(columns) for (f, n), columns in found.items() if f == folder}).most_common(1)[0][0]
            for folder, _ in found}
    return [Content(folder if n == most[folder] else f"{folder} of {n} rows".strip(), columns, rows=n)
            for (folder, n), columns in found.items()]
