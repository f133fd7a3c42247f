"""NumPy archives of arrays; pickled objects are refused."""

from __future__ import annotations

from functools import partial
from pathlib import Path

import numpy as np

from hydroopt.logs.formats.decoders.content import Column, Content, sheets_of_arrays


def contents(path: Path) -> list[Content]:
    """The sheets of an archive: arrays of one length, and each array of named fields."""
    arrays, tables = {}, []
    with np.load(path, allow_pickle=False) as archive:
        for name in archive.files:
            try:
                found = archive[name]
            except ValueError as error:
                if "pickle" in str(error):
                    continue
                raise
            if found.dtype.names and found.ndim == 1:
                tables.append(Content(name, [Column(part, "", partial(np.asarray, found[part]))
                                             for part in found.dtype.names], rows=len(found)))
            elif found.dtype.kind in "fiumM":
                arrays[name] = (found.shape, "", partial(np.asarray, found))
    return sheets_of_arrays(arrays) + tables
