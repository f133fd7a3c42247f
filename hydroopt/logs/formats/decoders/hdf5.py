"""HDF5 files, MATLAB 7.3 among them, and pandas tables of numbers in them."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Any

import h5py

from hydroopt.logs.formats.decoders.content import Column, Content, sheets_of_arrays

MOST = 5000
"""Datasets of a file that are looked at."""


def contents(path: Path, *, matlab: bool = False) -> list[Content]:
    """The sheets of a file: the numbers of each group, by length, and each table of named fields."""
    file = h5py.File(path, "r")
    arrays: dict[str, Any] = {}
    tables: list[Content] = []

    def visit(name: str, item: object) -> bool | None:
        if not isinstance(item, h5py.Dataset) or (matlab and name.startswith("#")):
            return None
        if item.dtype.names and item.ndim == 1:
            tables.append(Content(name, [Column(part, _unit(item), partial(item.__getitem__, part))
                                         for part in item.dtype.names if item.dtype[part].kind in "fiu"],
                                  rows=item.shape[0]))
        elif item.dtype.kind in "fiu" and item.ndim in (1, 2):
            place = name.replace("/", ".") if matlab else name
            arrays[place] = item.shape, _unit(item), partial(item.__getitem__, ())
        return True if len(arrays) + len(tables) > MOST else None

    file.visititems(visit)
    return sheets_of_arrays(arrays) + tables


def _unit(item: h5py.Dataset) -> str:
    for key in ("units", "unit", "Units", "Unit"):
        value = item.attrs.get(key)
        if isinstance(value, bytes):
            value = value.decode("utf-8", "replace")
        if isinstance(value, str):
            return value.strip()
    return ""
