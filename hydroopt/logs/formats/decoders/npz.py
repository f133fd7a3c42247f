"""NumPy archives of arrays; pickled objects are refused."""

from __future__ import annotations

import zipfile
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.lib import format as npy
from numpy.typing import NDArray

from hydroopt.logs.formats.decoders.content import Column, Content, sheets_of_arrays


def contents(path: Path) -> list[Content]:
    """The sheets of an archive: arrays of one length, and each array of named fields."""
    arrays: dict[str, Any] = {}
    tables = []
    with zipfile.ZipFile(path) as archive:
        for member in archive.namelist():
            if not member.endswith(".npy"):
                continue
            with archive.open(member) as file:
                version = npy.read_magic(file)
                header = npy.read_array_header_1_0 if version == (1, 0) else npy.read_array_header_2_0
                shape, _, dtype = header(file)
            name = member.removesuffix(".npy")
            if dtype.names and len(shape) == 1:
                tables.append(Content(name, [Column(part, "", partial(_values, path, name, part))
                                             for part in dtype.names], rows=shape[0]))
            elif dtype.kind in "fiumM":
                arrays[name] = (shape, "", partial(_values, path, name))
    return sheets_of_arrays(arrays) + tables


def _values(path: Path, name: str, part: str = "") -> NDArray[Any]:
    with np.load(path, allow_pickle=False) as archive:
        return np.asarray(archive[name][part] if part else archive[name])
