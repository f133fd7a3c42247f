"""MATLAB files up to version 7: numeric matrices, and those of structs by names with dots."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from scipy.io import loadmat

from hydroopt.logs.formats.decoders.content import Content, sheets_of_arrays


def contents(path: Path) -> list[Content]:
    """The sheets of a file: vectors, and rows or columns of matrices, by length."""
    return sheets_of_arrays({name: (value.shape, "", partial(np.asarray, value))
                             for variable, each in loadmat(path).items() if not variable.startswith("__")
                             for name, value in _matrices(variable, each)})


def _matrices(name: str, value: Any) -> Iterator[tuple[str, Any]]:
    """The numeric matrices of a variable: itself, or those of its fields."""
    if not isinstance(value, np.ndarray) or value.ndim != 2:
        return
    if value.dtype.names:
        for field, part in zip(value.dtype.names, value.item(), strict=True) if value.size == 1 else ():
            yield from _matrices(f"{name}.{field}", part)
    elif value.dtype.kind in "fiu":
        yield name, value
