"""Raw columns of a file as numbers: CSV, Parquet and MATLAB, refused with a reason where damaged."""

import csv
import hashlib
import io
import re
import struct
import zlib
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hydroopt.errors import LogError
from hydroopt.signals.mapping import Key, LogMap

Array = NDArray[np.float64]
RawKey = Key | tuple[str, int | None]
FORMATS = {".csv": "csv", ".txt": "csv", ".dat": "csv", ".parquet": "parquet", ".mat": "mat"}
FILE_LIMIT = 2 * 1024**3
"""Largest file that is read [bytes]."""
EXPANDED_LIMIT = 10 * 1000**3
"""Largest size in memory that a file may declare [bytes]."""
_IMPLAUSIBLE = 1e30


@dataclass(frozen=True)
class Table:
    """Raw columns by key, each (N,); `rows` (N,) 1-based data rows; `damage`: why a row cannot be trusted."""

    columns: dict[RawKey, Array]
    rows: NDArray[np.int64]
    damage: dict[int, str] = field(default_factory=dict)


def load(path: str | Path, declared: str | None) -> tuple[bytes, str, str]:
    """Bytes of a file, their SHA-256 and the format.

    Raises:
        LogError: the file is missing, no file, too large or of an unknown kind.
    """
    file, where = Path(path), str(path)
    kind = declared or FORMATS.get(file.suffix.lower())
    if not file.exists():
        raise LogError("there is no such file", where=where, remedy="check the path")
    if not file.is_file():
        raise LogError("this is a directory or device, not a file", where=where, remedy="name one log file")
    if kind is None:
        raise LogError(f"'{file.suffix}' is not a kind of log that can be read", where=where,
                       remedy=f"use {', '.join(FORMATS)} or state 'format' in a map")
    if (size := file.stat().st_size) > FILE_LIMIT:
        raise LogError(f"the file has {size / 1e9:.1f} GB", where=where, remedy="split it into parts below 2 GiB")
    try:
        data = file.read_bytes()
    except OSError as error:
        raise LogError(f"the file cannot be read ({error.strerror})", where=where,
                       remedy="check its permissions") from None
    if not data.strip():
        raise LogError("the file is empty", where=where, remedy="record it again")
    return data, hashlib.sha256(data).hexdigest(), kind


def runs(rows: Sequence[int] | NDArray[np.int64], most: int = 4) -> str:
    """Row numbers in words, neighbours joined: ``2–10, 6107``."""
    numbers = sorted(int(r) for r in rows)
    parts: list[list[int]] = []
    for number in numbers:
        if parts and number == parts[-1][1] + 1:
            parts[-1][1] = number
        else:
            parts.append([number, number])
    words = [str(a) if a == b else f"{a}–{b}" for a, b in parts[:most]]
    return ", ".join(words) + (f" and {len(parts) - most} more stretches" if len(parts) > most else "")


def find_column(key: Key, header: list[str], width: int, where: str) -> int:
    """Index of a column given by name or 0-based index.

    Raises:
        LogError: there is none, or the name stands there twice.
    """
    if isinstance(key, int):
        if not 0 <= key < width:
            raise LogError(f"there is no column {key} among {width} (counted from 0)", where=where,
                           remedy="correct the index in the map")
        return key
    count = header.count(key)
    if count == 0:
        present = f"those present are {', '.join(header[:40])}" if header else "the file is read without header"
        raise LogError(f"there is no column '{key}' ({present})", where=where,
                       remedy="correct the name in the map")
    if count > 1:
        raise LogError(f"column '{key}' stands there {count} times", where=where,
                       remedy="rename one or give the column's 0-based index in a map")
    return header.index(key)


class CsvFile:
    """Delimited text; the header is `header` (empty for headerless files)."""

    def __init__(self, data: bytes, where: str, layout: LogMap | None) -> None:
        self.where, self._layout = where, layout or LogMap.model_construct(columns={})
        binary = LogError("this is not a text file (binary data inside)", where=where,
                          remedy="export it as CSV or name the file after its true format")
        if b"\0" in data:
            raise binary
        try:
            text = data.decode("utf-8-sig")
        except UnicodeDecodeError as error:
            text = data.decode("latin-1")
            if error.start > 4096 or re.search(r"[\x00-\x08\x0e-\x1f\x7f-\x9f]", text[:4096]):
                raise binary from None
        lines = text.replace("\r\n", "\n").replace("\r", "\n").rstrip("\n ").split("\n")
        if self._layout.delimiter == "whitespace":
            lines, self._delimiter = [" ".join(line.split()) for line in lines], " "
        else:
            self._delimiter = self._layout.delimiter
        self.header = [cell.strip() for cell in self._split(lines[0])] if self._layout.header else []
        self._lines = lines[1:] if self._layout.header else lines
        if not self._lines:
            raise LogError("there is a header but no data", where=where, remedy="record it again")

    def read(self, keys: Sequence[RawKey]) -> Table:
        """The columns `keys` as numbers; empty cells and 'nan' are NaN."""
        rows = _selected(len(self._lines), self._layout.rows, self.where)
        lines = [self._lines[r - 1] for r in rows]
        widths = [self._width(line) for line in lines]
        width = len(self.header) or int(np.bincount(widths).argmax())
        damage = {int(r): f"has {w} of {width} columns" for r, w in zip(rows, widths, strict=True) if w != width}
        index = [find_column(k, self.header, width, self.where) for k in keys if not isinstance(k, tuple)]
        if len(index) < len(keys):
            raise LogError("the map names a 'variable', which only .mat files have", where=self.where,
                           remedy="use 'column'")
        good = [i for i, w in enumerate(widths) if w == width]
        found = _parse("\n".join(lines[i] for i in good), width, index, self._delimiter, self._layout.decimal)
        columns: dict[RawKey, Array] = {}
        for key, position in zip(keys, index, strict=True):
            values = np.full(rows.size, np.nan)
            cells = found[position]
            if isinstance(cells, list):
                bad = next(i for i, cell in enumerate(cells) if _number(cell, self._layout.decimal) is None)
                name = f"'{self.header[position]}'" if self.header else "without name"
                raise LogError(f"'{cells[bad][:40]}' is not a number", where=f"{self.where}, data row "
                               f"{rows[good[bad]]}, column {position + 1} {name}",
                               remedy="mend the cell, or select undamaged rows with 'rows = [first, last]' in a map")
            values[good] = cells
            for row in rows[np.abs(np.where(np.isfinite(values), values, 0)) > _IMPLAUSIBLE]:
                damage.setdefault(int(row), "holds numbers beyond 1e30")
            columns[key] = values
        return Table(columns, rows, damage)

    def _split(self, line: str) -> list[str]:
        return next(csv.reader([line], delimiter=self._delimiter), [""])

    def _width(self, line: str) -> int:
        return len(self._split(line)) if '"' in line else line.count(self._delimiter) + 1


def _number(cell: str, decimal: str) -> float | None:
    try:
        return float(cell.strip().replace(decimal, ".") or "nan") if "_" not in cell else None
    except ValueError:
        return None


def _parse(text: str, width: int, index: list[int], delimiter: str,
           decimal: str) -> dict[int, Array | list[str]]:
    """Columns as numbers; one that holds anything else comes back as its texts."""
    from pyarrow import ArrowInvalid, csv as arrow, float64, string  # noqa: PLC0415 (import cost)

    names = [str(i) for i in range(width)]
    wanted = sorted({names[i] for i in index})

    def table(kind: object) -> dict[str, object]:
        result = arrow.read_csv(
            io.BytesIO(text.encode()),
            read_options=arrow.ReadOptions(column_names=names),
            parse_options=arrow.ParseOptions(delimiter=delimiter, ignore_empty_lines=False),
            convert_options=arrow.ConvertOptions(
                column_types={n: kind for n in wanted}, include_columns=wanted, decimal_point=decimal,
                null_values=["", "nan", "NaN", "NAN", "NA", "null"] if kind == float64() else []))
        return {name: result.column(name) for name in wanted}

    try:
        return {int(n): np.asarray(c.to_numpy(), dtype=float) for n, c in table(float64()).items()}  # type: ignore[attr-defined]
    except ArrowInvalid:
        out: dict[int, Array | list[str]] = {}
        for name, column in table(string()).items():
            cells: list[str] = column.to_pylist()  # type: ignore[attr-defined]
            numbers = [_number(cell, decimal) for cell in cells]
            out[int(name)] = cells if None in numbers else np.array(numbers, dtype=float)
        return out


class ParquetFile:
    """A Parquet file; sizes are judged from its metadata before anything is allocated."""

    def __init__(self, data: bytes, where: str, layout: LogMap | None) -> None:
        from pyarrow import ArrowException, BufferReader  # noqa: PLC0415 (import cost)
        from pyarrow.parquet import ParquetFile as Reader  # noqa: PLC0415

        self.where, self._rows = where, layout.rows if layout else None
        try:
            self._file = Reader(BufferReader(data))
        except (ArrowException, OSError, ValueError) as error:
            raise _unreadable("Parquet", where, error) from None
        meta = self._file.metadata
        _check_size(meta.num_rows * meta.num_columns * 8, where)
        if meta.num_rows < 1:
            raise LogError("the table has no rows", where=where, remedy="record it again")
        self.header: list[str] = list(self._file.schema_arrow.names)

    def read(self, keys: Sequence[RawKey]) -> Table:
        """The columns `keys` as numbers; nulls are NaN."""
        from pyarrow import ArrowException, types  # noqa: PLC0415 (import cost)

        rows = _selected(self._file.metadata.num_rows, self._rows, self.where)
        columns: dict[RawKey, Array] = {}
        for key in keys:
            if isinstance(key, tuple):
                raise LogError("the map names a 'variable', which only .mat files have", where=self.where,
                               remedy="use 'column'")
            name = self.header[find_column(key, self.header, len(self.header), self.where)]
            kind = self._file.schema_arrow.field(name).type
            if not (types.is_integer(kind) or types.is_floating(kind) or types.is_decimal(kind)):
                raise LogError(f"column '{name}' holds {kind}, not numbers", where=self.where,
                               remedy="convert the column to float64")
            try:
                column = self._file.read(columns=[name]).column(0).cast("float64")
                columns[key] = np.asarray(column.to_numpy(), dtype=float)[rows - 1]
            except (ArrowException, OSError, ValueError, IndexError) as error:
                raise _unreadable("Parquet", self.where, error) from None
        return Table(columns, rows)


class MatFile:
    """A MATLAB file up to version 7; keys are (variable, row), with dots for fields of a struct."""

    header: tuple[str, ...] = ()

    def __init__(self, data: bytes, where: str, layout: LogMap | None) -> None:
        if layout is None:
            raise LogError("a .mat file says nothing about units", where=where, remedy="give a map with --map")
        if data[:128].startswith(b"MATLAB 7.3") or data[:4] == b"\x89HDF":
            raise LogError("this is a MATLAB 7.3 file", where=where, remedy="save it with save(..., '-v7')")
        self.where, self._data, self._rows = where, data, layout.rows
        self._check_declared()

    def read(self, keys: Sequence[RawKey]) -> Table:
        """The variables `keys` as numbers, all of one length."""
        from scipy.io import loadmat  # noqa: PLC0415 (import cost)
        from scipy.io.matlab import MatReadError  # noqa: PLC0415

        if not all(isinstance(key, tuple) for key in keys):
            raise LogError("the map names a 'column'", where=self.where, remedy="use 'variable' for a .mat file")
        names = sorted({key[0].partition(".")[0] for key in keys if isinstance(key, tuple)})
        try:
            content = loadmat(io.BytesIO(self._data), variable_names=names)
        except (MatReadError, ValueError, TypeError, OSError, EOFError, zlib.error, MemoryError, KeyError,
                IndexError, NotImplementedError) as error:
            raise _unreadable("MATLAB", self.where, error) from None
        columns = {key: self._pick(content, *key) for key in keys if isinstance(key, tuple)}
        sizes = {values.size for values in columns.values()}
        if len(sizes) > 1:
            raise LogError(f"the mapped variables have different lengths {sorted(sizes)}", where=self.where,
                           remedy="map variables of one recording")
        rows = _selected(sizes.pop(), self._rows, self.where)
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
        if row is not None and row >= array.shape[0] or row is None and 1 not in array.shape:
            raise LogError(f"it has {array.shape[0]} rows and {array.shape[1]} columns", where=here,
                           remedy=f"state row = 0 to {array.shape[0] - 1} in the map")
        return np.asarray(array.ravel() if row is None else array[row], dtype=float)

    def _check_declared(self) -> None:
        """Sum the sizes that the variables of a version 5 to 7 file declare, unpacking only their first bytes."""
        data, total, at = self._data, 0, 128
        order = ">" if data[126:128] == b"MI" else "<"
        while data[126:128] in (b"IM", b"MI") and at + 8 <= len(data):
            kind, size = struct.unpack(order + "II", data[at:at + 8])
            body = data[at + 8:at + 8 + size]
            at += 8 + size
            try:
                head = zlib.decompressobj().decompress(body, 512) if kind == 15 else data[at - size - 8:at][:512]
            except zlib.error as error:
                raise _unreadable("MATLAB", self.where, error) from None
            if len(head) < 48:
                continue
            declared, rank = struct.unpack(order + "I", head[4:8])[0], struct.unpack(order + "I", head[28:32])[0]
            dims = struct.unpack(order + f"{min(rank // 4, 8)}i", head[32:32 + 4 * min(rank // 4, 8)])
            opaque = head[16] == 17
            total += max(declared, 0 if opaque else 8 * int(np.prod([float(abs(d)) for d in dims])))
        _check_size(total, self.where)


def _selected(count: int, rows: tuple[int, int] | None, where: str) -> NDArray[np.int64]:
    first, last = rows or (1, count)
    if last > count:
        raise LogError(f"rows {first} to {last} are asked for, but there are {count} data rows", where=where,
                       remedy="correct 'rows' in the map")
    return np.arange(first, last + 1)


def _check_size(size: float, where: str) -> None:
    if size > EXPANDED_LIMIT:
        raise LogError(f"the file declares {size / 1e9:.3g} GB of data", where=where,
                       remedy="check that it is undamaged, or split it")


def _unreadable(kind: str, where: str, error: BaseException) -> LogError:
    reason = (str(error).strip().splitlines() or [type(error).__name__])[0][:120].rstrip(".")
    return LogError(f"this is not a readable {kind} file ({reason})", where=where,
                    remedy="export it again or name the file after its true format")
