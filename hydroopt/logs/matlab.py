"""MATLAB files up to version 7 as tables."""

import io
import struct
import zlib
from collections.abc import Sequence

import numpy as np
from scipy.io import loadmat
from scipy.io.matlab import MatReadError

from hydroopt.errors import LogError
from hydroopt.logs.column_map import LogMap
from hydroopt.logs.table import Array, RawKey, Table, check_size, selected, unreadable


class MatFile:
    """A MATLAB file up to version 7; keys are (variable, row), with dots for fields of a struct."""

    def __init__(self, data: bytes, where: str, layout: LogMap | None) -> None:
        if layout is None:
            raise LogError("a .mat file says nothing about units", where=where,
                           remedy="give a map with --map")
        if data[:128].startswith(b"MATLAB 7.3") or data[:4] == b"\x89HDF":
            raise LogError("this is a MATLAB 7.3 file", where=where, remedy="save it with save(..., '-v7')")
        self.header: list[str] = []
        self.where, self._data, self._rows = where, data, layout.rows
        self._check_declared()

    def read(self, keys: Sequence[RawKey]) -> Table:
        """The variables `keys` as numbers, all of one length."""
        if not all(isinstance(key, tuple) for key in keys):
            raise LogError("the map names a 'column'", where=self.where,
                           remedy="use 'variable' for a .mat file")
        names = sorted({key[0].partition(".")[0] for key in keys if isinstance(key, tuple)})
        try:
            content = loadmat(io.BytesIO(self._data), variable_names=names)  # type: ignore[arg-type]
        except (MatReadError, ValueError, TypeError, OSError, EOFError, zlib.error, MemoryError, KeyError,
                IndexError, NotImplementedError) as error:
            raise unreadable("MATLAB", self.where, error) from None
        columns = {key: self._pick(content, *key) for key in keys if isinstance(key, tuple)}
        sizes = {values.size for values in columns.values()}
        if len(sizes) > 1:
            raise LogError(f"the mapped variables have different lengths {sorted(sizes)}", where=self.where,
                           remedy="map variables of one recording")
        rows = selected(sizes.pop(), self._rows, self.where)
        return Table({key: values[rows - 1] for key, values in columns.items()}, rows)

    def _pick(self, content: object, variable: str, row: int | None) -> Array:
        value, here = content, f"{self.where}, variable '{variable}'"
        for part in variable.split("."):
            if isinstance(value, np.ndarray) and value.dtype.names and value.size == 1:
                value = dict(zip(value.dtype.names, value.item(), strict=True))
            if not isinstance(value, dict) or part not in value:
                present = [k for k in value if not str(k).startswith("__")] if isinstance(value, dict) else []
                raise LogError(f"there is no '{part}' (present: {', '.join(present[:40]) or 'nothing'})",
                               where=here, remedy="correct the map")
            value = value[part]
        array = np.asarray(value)
        if array.dtype.kind not in "fiu" or array.ndim != 2:
            raise LogError("this is not a real matrix", where=here, remedy="map a numeric vector or matrix")
        if (1 not in array.shape) if row is None else row >= array.shape[0]:
            raise LogError(f"it has {array.shape[0]} rows and {array.shape[1]} columns", where=here,
                           remedy=f"state row = 0 to {array.shape[0] - 1} in the map")
        return np.asarray(array.ravel() if row is None else array[row], dtype=float)

    def _check_declared(self) -> None:
        """Judge the sizes that the variables declare (version 5 to 7), unpacking only their first bytes."""
        data, total, at = self._data, 0, 128
        order = ">" if data[126:128] == b"MI" else "<"
        while data[126:128] in (b"IM", b"MI") and at + 8 <= len(data):
            kind, size = struct.unpack(order + "II", data[at:at + 8])
            body = data[at + 8:at + 8 + size]
            at += 8 + size
            try:
                packed = kind == 15
                head = zlib.decompressobj().decompress(body, 512) if packed else data[at - size - 8:][:512]
            except zlib.error as error:
                raise unreadable("MATLAB", self.where, error) from None
            if len(head) < 48:
                continue
            (declared,), (rank,) = (struct.unpack(order + "I", head[i:i + 4]) for i in (4, 28))
            dims = struct.unpack(order + f"{min(rank // 4, 8)}i", head[32:32 + 4 * min(rank // 4, 8)])
            opaque = head[16] == 17
            total += max(declared, 0 if opaque else 8 * int(np.prod([float(abs(d)) for d in dims])))
        check_size(total, self.where)
