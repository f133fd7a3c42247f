"""Log files of each format, refused with a reason where damaged: CSV, Parquet and MATLAB."""

import csv
import io
import re
from collections import deque
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from hydroopt.errors import LogError
from hydroopt.logs.column_map import Key, LogMap
from hydroopt.logs.matlab import MatFile
from hydroopt.logs.table import Array, RawKey, Table, check_size, find_column, refuse_damage, selected, unreadable

BATCH = 2**16
"""Rows decoded at a time, and bytes read at a time, of a Parquet file that is read in pieces."""


class LogFile(Protocol):
    """A file whose header is known and whose columns can be read."""

    header: list[str]

    def read(self, keys: Sequence[RawKey]) -> Table:
        """The columns `keys` as numbers."""


def open_file(kind: str, data: bytes, where: str, layout: LogMap | None) -> LogFile:
    """A file of `kind` "csv", "parquet" or "mat" from its bytes; `layout` is its map, if it has one.

    Raises:
        LogError: the file is damaged or not of that kind, or declares more than can be held.
    """
    return MatFile(data, where, layout) if kind == "mat" else open_table(kind, data, where, layout)


def open_table(kind: str, data: bytes, where: str, layout: LogMap | None) -> "CsvFile | ParquetFile":
    """As `open_file`, of those kinds whose columns may also be texts."""
    if kind == "mat":
        raise LogError("a .mat file has no columns of text", where=where, remedy="export it as .csv or .parquet")
    return CsvFile(data, where, layout) if kind == "csv" else ParquetFile(data, where, layout)


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

    def read(self, keys: Sequence[RawKey], texts: Sequence[Key] = ()) -> Table:
        """The columns `keys` as numbers, where empty cells and 'nan' are NaN, and the columns `texts` as they are."""
        rows = selected(len(self._lines), self._layout.rows, self.where)
        lines = [self._lines[r - 1] for r in rows]
        widths = [self._width(line) for line in lines]
        width = len(self.header) or max(1, int(np.bincount(widths).argmax()))
        damage = {int(r): f"{w} of {width} columns" if w else "a quotation mark out of place"
                  for r, w in zip(rows, widths, strict=True) if w != width}
        index = [find_column(k, self.header, width, self.where) for k in keys if not isinstance(k, tuple)]
        if len(index) < len(keys):
            raise LogError("the map names a 'variable', which only .mat files have", where=self.where,
                           remedy="use 'column'")
        good = [i for i, w in enumerate(widths) if w == width]
        if not good:
            refuse_damage(damage, rows, self.where)
        sound = "\n".join(lines[i] for i in good)
        found = _parse(sound, width, index, self._delimiter, self._layout.decimal)
        columns: dict[RawKey, Array] = {}
        for key, position in zip(keys, index, strict=True):
            values = np.full(rows.size, np.nan)
            cells = found[position]
            if isinstance(cells, list):
                bad = next(i for i, cell in enumerate(cells) if _number(cell, self._layout.decimal) is None)
                name = f"'{self.header[position]}'" if self.header else "without name"
                raise LogError(f"'{cells[bad][:40]}' is not a number", where=f"{self.where}, data row "
                               f"{rows[good[bad]]}, column {position + 1} {name}", remedy=
                               "correct the cell, or select sound rows with 'rows = [first, last]' in a map")
            values[good] = cells
            columns[key] = values
        return Table(columns, rows, damage, self._texts(texts, sound, width, np.array(good, int), rows.size))

    def _texts(self, keys: Sequence[Key], sound: str, width: int, good: NDArray[np.int64],
               size: int) -> dict[Key, list[str]]:
        """Text columns of length `size`, '' in the rows that are not `good`."""
        from pyarrow import string  # noqa: PLC0415

        if not keys:
            return {}
        index = [find_column(key, self.header, width, self.where) for key in keys]
        cells = _columns(sound, width, index, self._delimiter, self._layout.decimal, string())
        out = {}
        for key, position in zip(keys, index, strict=True):
            column = np.full(size, "", dtype=object)
            column[good] = cells[position].to_pylist()
            out[key] = column.tolist()
        return out

    def _split(self, line: str) -> list[str]:
        try:
            return next(csv.reader([line], delimiter=self._delimiter), [""])
        except csv.Error:
            raise LogError(f"a line of {len(line)} characters cannot be split into columns", where=self.where,
                           remedy="check the ends of its lines, its quotation marks and the delimiter") from None

    def _width(self, line: str) -> int:
        """Number of columns; 0 where a quotation mark stays open, which would swallow the rows that follow."""
        if '"' not in line:
            return line.count(self._delimiter) + 1
        try:
            return len(next(csv.reader([line], delimiter=self._delimiter, strict=True)))
        except csv.Error:
            return 0


def _number(cell: str, decimal: str) -> float | None:
    try:
        return float(cell.strip().replace(decimal, ".") or "nan") if "_" not in cell else None
    except ValueError:
        return None


def _columns(text: str, width: int, index: Sequence[int], delimiter: str, decimal: str, kind: Any) -> dict[int, Any]:
    """The columns `index` as Arrow columns of `kind`."""
    from pyarrow import csv as arrow  # noqa: PLC0415
    from pyarrow import float64  # noqa: PLC0415

    names = [str(i) for i in range(width)]
    wanted = sorted({names[i] for i in index})
    result = arrow.read_csv(
        io.BytesIO(text.encode()),
        read_options=arrow.ReadOptions(column_names=names),
        parse_options=arrow.ParseOptions(delimiter=delimiter, ignore_empty_lines=False),
        convert_options=arrow.ConvertOptions(
            column_types=dict.fromkeys(wanted, kind), include_columns=wanted, decimal_point=decimal,
            null_values=["", "nan", "NaN", "NAN", "NA", "null"] if kind == float64() else []))
    return {int(name): result.column(name) for name in wanted}


def _parse(text: str, width: int, index: list[int], delimiter: str,
           decimal: str) -> dict[int, Array | list[str]]:
    """Columns as numbers; one that holds anything else comes back as its texts."""
    from pyarrow import ArrowInvalid, float64, string  # noqa: PLC0415

    try:
        columns = _columns(text, width, index, delimiter, decimal, float64())
        return {i: np.asarray(column.to_numpy(), dtype=np.float64) for i, column in columns.items()}
    except ArrowInvalid:
        out: dict[int, Array | list[str]] = {}
        for i, column in _columns(text, width, index, delimiter, decimal, string()).items():
            cells: list[str] = column.to_pylist()
            numbers = [_number(cell, decimal) for cell in cells]
            out[i] = cells if None in numbers else np.array(numbers, dtype=float)
        return out


class ParquetFile:
    """A Parquet file, in memory or on disk; sizes are judged from its metadata before anything is allocated."""

    def __init__(self, source: bytes | Path, where: str, layout: LogMap | None) -> None:
        from pyarrow import ArrowException, BufferReader  # noqa: PLC0415 (import cost)
        from pyarrow.parquet import ParquetFile as Reader  # noqa: PLC0415

        self.where, self._rows = where, layout.rows if layout else None
        try:
            self._file = (Reader(BufferReader(source)) if isinstance(source, bytes)
                          else Reader(source, buffer_size=BATCH, pre_buffer=False))
        except (ArrowException, OSError, ValueError) as error:
            raise unreadable("Parquet", where, error) from None
        self.meta = self._file.metadata
        if isinstance(source, bytes):
            check_size(self.meta.num_rows * self.meta.num_columns * 8, where)
        if self.meta.num_rows < 1:
            raise LogError("the table has no rows", where=where, remedy="record it again")
        self.header: list[str] = list(self._file.schema_arrow.names)

    @property
    def selected(self) -> tuple[int, int]:
        """First and last 1-based data row that the map selects."""
        rows = selected(self.meta.num_rows, self._rows, self.where)
        return int(rows[0]), int(rows[-1])

    def _column(self, key: RawKey) -> str:
        """The name of a column of numbers."""
        from pyarrow import types  # noqa: PLC0415 (import cost)

        if isinstance(key, tuple):
            raise LogError("the map names a 'variable', which only .mat files have", where=self.where,
                           remedy="use 'column'")
        name = self.header[find_column(key, self.header, len(self.header), self.where)]
        kind = self._file.schema_arrow.field(name).type
        if not (types.is_integer(kind) or types.is_floating(kind) or types.is_decimal(kind)):
            raise LogError(f"column '{name}' holds {kind}, not numbers", where=self.where,
                           remedy="convert the column to float64")
        return name

    def pieces(self, keys: Sequence[RawKey], ranges: Sequence[tuple[int, int]]) -> Iterator[Table]:
        """The columns `keys` as numbers, nulls NaN, of ranges of 1-based data rows (first, last) that may overlap.

        The ranges come in the order of both their ends. No more of the file is held than the widest of them.
        """
        from pyarrow import ArrowException  # noqa: PLC0415 (import cost)

        names = [self._column(key) for key in keys]
        held: list[tuple[int, list[Array]]] = []  # first row, and columns
        waiting = deque(ranges)
        batches = self._batches(names, ranges)
        while waiting:
            first, last = waiting[0]
            held = [(row, columns) for row, columns in held if row + columns[0].size > first]
            while not held or held[-1][0] + held[-1][1][0].size <= last:
                try:
                    row, batch = next(batches)
                    if row + batch.num_rows > first:
                        held.append((row, [np.asarray(batch.column(name).cast("float64"), dtype=float)
                                           for name in names]))
                except (ArrowException, OSError, ValueError) as error:
                    raise unreadable("Parquet", self.where, error) from None
                except StopIteration:
                    raise unreadable("Parquet", self.where, ValueError("fewer rows than declared")) from None
            parts = [[column[max(0, first - row) : last + 1 - row] for column in columns] for row, columns in held]
            yield Table(dict(zip(keys, map(np.concatenate, zip(*parts, strict=True)), strict=True)),
                        np.arange(first, last + 1))
            waiting.popleft()

    def _batches(self, names: list[str], ranges: Sequence[tuple[int, int]]) -> Iterator[tuple[int, Any]]:
        """(first row, Arrow record batch) of the row groups that hold any of the ranges."""
        row = 1
        for group in range(self.meta.num_row_groups):
            stop = row + self.meta.row_group(group).num_rows
            if any(first < stop and last >= row for first, last in ranges):
                for batch in self._file.iter_batches(BATCH, [group], list(dict.fromkeys(names)), use_threads=False):
                    yield row, batch
                    row += batch.num_rows
            row = stop

    def read(self, keys: Sequence[RawKey], texts: Sequence[Key] = ()) -> Table:
        """The columns `keys` as numbers, where nulls are NaN, and the columns `texts` as texts."""
        from pyarrow import ArrowException  # noqa: PLC0415 (import cost)

        rows = selected(self.meta.num_rows, self._rows, self.where)
        columns: dict[RawKey, Array] = {}
        for key in keys:
            name = self._column(key)
            try:
                column = self._file.read(columns=[name]).column(0).cast("float64")
                columns[key] = np.asarray(column.to_numpy(), dtype=float)[rows - 1]
            except (ArrowException, OSError, ValueError, IndexError) as error:
                raise unreadable("Parquet", self.where, error) from None
        return Table(columns, rows, texts={key: [cells[row - 1] for row in rows]
                                           for key, cells in zip(texts, map(self._text, texts), strict=True)})

    def _text(self, key: Key) -> list[str]:
        from pyarrow import ArrowException  # noqa: PLC0415 (import cost)

        name = self.header[find_column(key, self.header, len(self.header), self.where)]
        try:
            cells = self._file.read(columns=[name]).column(0).cast("string").to_pylist()
        except (ArrowException, OSError, ValueError, IndexError):
            raise LogError(f"column '{name}' cannot be read as text", where=self.where,
                           remedy="convert the column to strings") from None
        return ["" if cell is None else cell for cell in cells]
