"""HDF5 files, MATLAB 7.3 among them, and pandas tables of numbers in them."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from hydroopt.logs.formats.decoders.content import Column, Content, UnreadableError, sheets_of_arrays

MOST = 5000
"""Datasets of a file that are looked at."""


def contents(path: Path, *, matlab: bool = False) -> list[Content]:
    """The sheets of a file: the numbers of each group, by length, and each table of named fields.

    Raises:
        UnreadableError: it is damaged.
    """
    try:
        file = h5py.File(path, "r")
        arrays: dict[str, Any] = {}
        tables: list[Content] = []

        def visit(name: str, item: object) -> bool | None:
            if not isinstance(item, h5py.Dataset) or (matlab and name.startswith("#")):
                return None
            if item.dtype.names and item.ndim == 1:
                tables.append(Content(name, [Column(part, _unit(item), partial(_values, item, part))
                                             for part in item.dtype.names if item.dtype[part].kind in "fiu"],
                                      rows=item.shape[0]))
            elif item.dtype.kind in "fiu" and item.ndim in (1, 2):
                arrays[name.replace("/", ".") if matlab else name] = (
                    item.shape, _unit(item), partial(_values, item))
            return True if len(arrays) + len(tables) > MOST else None

        file.visititems(visit)
    except (OSError, RuntimeError, ValueError, KeyError, TypeError) as error:
        raise UnreadableError(str(error) or type(error).__name__) from None
    return sheets_of_arrays(arrays) + tables


def _values(item: h5py.Dataset, part: str = "") -> NDArray[Any]:
    try:
        return np.asarray(item[part] if part else item[()])
    except (OSError, RuntimeError, ValueError, KeyError) as error:
        raise UnreadableError(str(error)) from None


def _unit(item: h5py.Dataset) -> str:
    for key in ("units", "unit", "Units", "Unit"):
        value = item.attrs.get(key)
        if isinstance(value, bytes):
            value = value.decode("utf-8", "replace")
        if isinstance(value, str):
            return value.strip()
    return ""
