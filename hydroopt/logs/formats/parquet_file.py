"""Parquet files and Arrow tables; sizes are judged before anything is allocated."""

from collections import deque
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hydroopt.errors import LogError
from hydroopt.logs import stamps
from hydroopt.logs.column_map import Key, LogMap
from hydroopt.logs.table import (
    Array,
    NoNumbersError,
    RawKey,
    Table,
    check_size,
    ends,
    find_column,
    selected,
    unreadable,
)
from hydroopt.packages import needed

BATCH = 2**16
"""Rows decoded at a time, and bytes read at a time, of a Parquet file that is read in pieces."""


class ParquetFile:
    """A Parquet file, in memory or on disk; sizes are judged from its metadata before anything is allocated."""

    own_stamps, shown, layout, unnamed = False, "", None, 0

    def __init__(self, source: bytes | Path, where: str, layout: LogMap | None) -> None:
        needed("pyarrow", "Parquet files are read with pyarrow", where=where, error=LogError)
        from pyarrow import ArrowException, BufferReader  # noqa: PLC0415 (an extra)
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
        from pyarrow import types  # noqa: PLC0415 (import cost)

        # dates have the unit that their stamps will have
        self._names: list[str] = list(self._file.schema_arrow.names)
        self.header: list[str] = [f"{field.name} [s]" if field.name == "t" and types.is_timestamp(field.type)
                                  else field.name for field in self._file.schema_arrow]

    @property
    def selected(self) -> tuple[int, int]:
        """First and last 1-based data row that the map selects."""
        return ends(self.meta.num_rows, self._rows, self.where)

    def _column(self, key: RawKey, *, moment: bool = False) -> str:
        """The name of a column of numbers, or of moments."""
        from pyarrow import types  # noqa: PLC0415 (import cost)

        if isinstance(key, tuple):
            raise LogError("the map names a 'variable', which only .mat files have", where=self.where,
                           remedy="use 'column'")
        name = self._names[find_column(key, self.header, len(self.header), self.where)]
        kind = self._file.schema_arrow.field(name).type
        if moment and (types.is_timestamp(kind) or types.is_duration(kind)):
            return name
        if not (types.is_integer(kind) or types.is_floating(kind) or types.is_decimal(kind)):
            raise NoNumbersError(f"column '{name}' holds {kind}, not numbers", where=self.where,
                           remedy="convert the column to float64")
        return name

    def pieces(self, keys: Sequence[RawKey], ranges: Sequence[tuple[int, int]],
               time: RawKey | None = None) -> Iterator[Table]:
        """The columns `keys` as numbers, nulls NaN, of ranges of 1-based data rows (first, last) that may overlap.

        The ranges come in the order of both their ends. No more of the file is held than the widest of them. A `time`
        of dates or of an epoch comes as stamps, too.
        """
        from pyarrow import ArrowException  # noqa: PLC0415 (import cost)

        names = [self._column(key, moment=key == time) for key in keys]
        held: list[tuple[int, list[NDArray[Any]]]] = []  # first row, and columns
        waiting = deque(ranges)
        batches = self._batches(names, ranges)
        while waiting:
            first, last = waiting[0]
            held = [(row, columns) for row, columns in held if row + columns[0].size > first]
            while not held or held[-1][0] + held[-1][1][0].size <= last:
                try:
                    row, batch = next(batches)
                    if row + batch.num_rows > first:
                        held.append((row, [self._numbers(batch.column(name), moment=key == time)
                                           for key, name in zip(keys, names, strict=True)]))
                except (ArrowException, OSError, ValueError) as error:
                    raise unreadable("Parquet", self.where, error) from None
                except StopIteration:
                    raise unreadable("Parquet", self.where, ValueError("fewer rows than declared")) from None
            parts = [[column[max(0, first - row) : last + 1 - row] for column in columns] for row, columns in held]
            columns = dict(zip(keys, map(np.concatenate, zip(*parts, strict=True)), strict=True))
            made = stamps.of_column(columns[time]) if time in columns else None
            yield Table({key: x.astype(float, copy=False) for key, x in columns.items()}, np.arange(first, last + 1),
                        stamps=made)
            waiting.popleft()

    @staticmethod
    def _numbers(column: Any, *, moment: bool) -> NDArray[Any]:
        """An Arrow array as floating point; of a time as dates or whole numbers where it holds these."""
        if (plain := _plain(column)) is not None:
            return plain if moment and plain.dtype.kind in "iu" else plain.astype(float, copy=False)
        if moment:
            values = column.to_numpy(zero_copy_only=False)
            if values.dtype.kind in "mMiu":
                return np.asarray(values)
        return np.asarray(column.cast("float64", safe=False), dtype=float)

    def extremes(self, key: RawKey, rows: tuple[int, int]) -> tuple[float, float] | None:
        """The least and the greatest number of a column in data rows (first, last), as the file states them; None where
        it does not, or only together with other rows."""
        column, begin = self._names.index(self._column(key)), 1
        found: list[tuple[float, float]] = []
        for k in range(self.meta.num_row_groups):
            group = self.meta.row_group(k)
            end = begin + group.num_rows - 1
            if begin <= rows[1] and end >= rows[0]:
                stated = group.column(column).statistics if group.num_columns == len(self._names) else None
                if begin < rows[0] or end > rows[1] or stated is None or not stated.has_min_max:
                    return None
                if not isinstance(stated.min, int | float):  # of a damaged file
                    return None
                found.append((float(stated.min), float(stated.max)))
            begin = end + 1
        least, most = zip(*found, strict=True)
        return min(least), max(most)

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

    def read(self, keys: Sequence[RawKey], texts: Sequence[Key] = (), time: RawKey | None = None) -> Table:
        """The columns `keys` as numbers, where nulls are NaN, and the columns `texts` as texts."""
        from pyarrow import ArrowException  # noqa: PLC0415 (import cost)

        rows = selected(self.meta.num_rows, self._rows, self.where)
        columns: dict[RawKey, Array] = {}
        made = None
        for key in keys:
            name = self._column(key, moment=key == time)
            try:
                values = self._numbers(self._file.read(columns=[name]).column(0).combine_chunks(), moment=key == time)
                if key == time and (made := stamps.of_column(values[rows - 1])) and not made.unit:
                    columns[key] = made.seconds()
                    continue
                columns[key] = values.astype(float)[rows - 1]
            except (ArrowException, OSError, ValueError, IndexError) as error:
                raise unreadable("Parquet", self.where, error) from None
        return Table(columns, rows, stamps=made, texts={
            key: [cells[row - 1] for row in rows] for key, cells in zip(texts, map(self._text, texts), strict=True)})

    def _text(self, key: Key) -> list[str]:
        from pyarrow import ArrowException  # noqa: PLC0415 (import cost)

        name = self._names[find_column(key, self.header, len(self.header), self.where)]
        try:
            cells = self._file.read(columns=[name]).column(0).cast("string").to_pylist()
        except (ArrowException, OSError, ValueError, IndexError):
            raise LogError(f"column '{name}' cannot be read as text", where=self.where,
                           remedy="convert the column to strings") from None
        return ["" if cell is None else cell for cell in cells]


def _plain(column: Any) -> NDArray[Any] | None:
    """An Arrow array of whole or floating-point numbers without nulls, in the memory of that array; None of others.

    What Arrow itself offers for this imports pandas, where it is installed.
    """
    from pyarrow import types  # noqa: PLC0415 (import cost)

    sound = (types.is_integer(column.type) or types.is_floating(column.type)) and not column.null_count
    return np.from_dlpack(column) if sound and len(column) else None
