"""Log files of each format, refused with a reason where damaged: CSV, Parquet and MATLAB."""

import csv
import io
import re
from collections.abc import Sequence
from typing import Any, Protocol

import numpy as np

from hydroopt.errors import LogError
from hydroopt.signals.mapping import LogMap
from hydroopt.signals.matfile import MatFile
from hydroopt.signals.table import Array, RawKey, Table, check_size, find_column, selected, unreadable

_IMPLAUSIBLE = 1e30


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
    if kind == "csv":
        return CsvFile(data, where, layout)
    return ParquetFile(data, where, layout) if kind == "parquet" else MatFile(data, where, layout)


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
        rows = selected(len(self._lines), self._layout.rows, self.where)
        lines = [self._lines[r - 1] for r in rows]
        widths = [self._width(line) for line in lines]
        width = len(self.header) or int(np.bincount(widths).argmax())
        damage = {int(r): f"{w} of {width} columns" for r, w in zip(rows, widths, strict=True) if w != width}
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
                               f"{rows[good[bad]]}, column {position + 1} {name}", remedy=
                               "mend the cell, or select sound rows with 'rows = [first, last]' in a map")
            values[good] = cells
            for row in rows[np.abs(np.where(np.isfinite(values), values, 0)) > _IMPLAUSIBLE]:
                damage.setdefault(int(row), "numbers beyond 1e30")
            columns[key] = values
        return Table(columns, rows, damage)

    def _split(self, line: str) -> list[str]:
        try:
            return next(csv.reader([line], delimiter=self._delimiter), [""])
        except csv.Error:
            raise LogError(f"a line of {len(line)} characters cannot be split into columns", where=self.where,
                           remedy="check the ends of its lines, its quotation marks and the delimiter") from None

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
    from pyarrow import ArrowInvalid, float64, string  # noqa: PLC0415
    from pyarrow import csv as arrow  # noqa: PLC0415

    names = [str(i) for i in range(width)]
    wanted = sorted({names[i] for i in index})

    def table(kind: Any) -> dict[str, Any]:
        result = arrow.read_csv(
            io.BytesIO(text.encode()),
            read_options=arrow.ReadOptions(column_names=names),
            parse_options=arrow.ParseOptions(delimiter=delimiter, ignore_empty_lines=False),
            convert_options=arrow.ConvertOptions(
                column_types=dict.fromkeys(wanted, kind), include_columns=wanted, decimal_point=decimal,
                null_values=["", "nan", "NaN", "NAN", "NA", "null"] if kind == float64() else []))
        return {name: result.column(name) for name in wanted}

    try:
        return {int(n): np.asarray(c.to_numpy(), dtype=np.float64) for n, c in table(float64()).items()}
    except ArrowInvalid:
        out: dict[int, Array | list[str]] = {}
        for name, column in table(string()).items():
            cells: list[str] = column.to_pylist()
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
            raise unreadable("Parquet", where, error) from None
        meta = self._file.metadata
        check_size(meta.num_rows * meta.num_columns * 8, where)
        if meta.num_rows < 1:
            raise LogError("the table has no rows", where=where, remedy="record it again")
        self.header: list[str] = list(self._file.schema_arrow.names)

    def read(self, keys: Sequence[RawKey]) -> Table:
        """The columns `keys` as numbers; nulls are NaN."""
        from pyarrow import ArrowException, types  # noqa: PLC0415 (import cost)

        rows = selected(self._file.metadata.num_rows, self._rows, self.where)
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
                raise unreadable("Parquet", self.where, error) from None
        return Table(columns, rows)
