"""Parquet files and Arrow tables; sizes are judged before anything is allocated."""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hydroopt.errors import LogError
from hydroopt.logs import stamps
from hydroopt.logs.column_map import Key, LogMap
from hydroopt.logs.formats.sheet import Sheet
from hydroopt.logs.mapped import empty, release, stored
from hydroopt.logs.table import NoNumbersError, RawKey, Table, check_size, selected, unreadable
from hydroopt.support.packages import needed

BATCH = 2**16
"""Rows decoded at a time, and bytes read at a time."""


class ParquetFile(Sheet):
    """A Parquet file, in memory or on disk; sizes are judged from its metadata before anything is allocated."""

    def __init__(self, source: bytes | Path, where: str, layout: LogMap | None) -> None:
        needed("pyarrow", "Parquet files are read with pyarrow", where=where, error=LogError)
        from pyarrow import ArrowException, BufferReader  # noqa: PLC0415 (an extra)
        from pyarrow.parquet import ParquetFile as Reader  # noqa: PLC0415

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
        super().__init__(where, [f"{field.name} [s]" if field.name == "t" and types.is_timestamp(field.type)
                                 else field.name for field in self._file.schema_arrow], layout.rows if layout else None)

    def _name(self, key: RawKey, *, moment: bool = False) -> str:
        """The name of a column of numbers, or of moments."""
        from pyarrow import types  # noqa: PLC0415 (import cost)

        name = self._names[self.column(key)]
        kind = self._file.schema_arrow.field(name).type
        if moment and (types.is_timestamp(kind) or types.is_duration(kind)):
            return name
        if not (types.is_integer(kind) or types.is_floating(kind) or types.is_decimal(kind)):
            raise NoNumbersError(f"column '{name}' holds {kind}, not numbers", where=self.where,
                           remedy="convert the column to float64")
        return name

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

    def read(self, keys: Sequence[RawKey], texts: Sequence[Key] = (), time: RawKey | None = None) -> Table:
        """The columns `keys` as numbers, where nulls are NaN, and the columns `texts` as texts."""
        from pyarrow import ArrowException  # noqa: PLC0415 (import cost)

        rows, made = selected(self.meta.num_rows, self.rows, self.where), None
        names = {key: self._name(key, moment=key == time) for key in keys}
        columns: dict[RawKey, NDArray[Any]] = {key: empty(rows.size) for key in keys if key != time}
        try:
            if time is not None and time in names:
                stamped = self._stamped(names[time], rows)
                made = stamps.of_column(stamped)
                columns[time] = made.seconds() if made and not made.unit else stored(stamped.astype(float, copy=False))
            for place, batch in self._batches([names[key] for key in keys if key != time], rows):
                for key in columns.keys() - {time}:
                    columns[key][place] = self._numbers(batch.column(names[key]), moment=False)
        except (ArrowException, OSError, ValueError, IndexError) as error:
            raise unreadable("Parquet", self.where, error) from None
        for column in columns.values():
            column.setflags(write=False)
        return Table(columns, rows, stamps=made, texts={
            key: [cells[row - 1] for row in rows] for key, cells in zip(texts, map(self._text, texts), strict=True)})

    def _stamped(self, name: str, rows: NDArray[np.int64]) -> NDArray[Any]:
        """A column of times (N,), in floating point only where a batch needs it."""
        made = np.empty(0)
        for place, batch in self._batches([name], rows):
            part = self._numbers(batch.column(0), moment=True)
            kind = np.result_type(made, part) if place.start else part.dtype
            if kind != made.dtype or not made.size:
                before, made = made, empty(rows.size, kind)
                made[: place.start] = before[: place.start]
            made[place] = part
        return made

    def _batches(self, names: Sequence[str], rows: NDArray[np.int64]) -> Iterator[tuple[slice, Any]]:
        """Arrow record batches of columns in consecutive data rows (N,), with their places among these."""
        end, first, last = 0, int(rows[0]) - 1, int(rows[-1])
        for group in range(self.meta.num_row_groups if names else 0):
            row, end = end, end + self.meta.row_group(group).num_rows
            if end <= first or row >= last:
                continue
            for batch in self._file.iter_batches(BATCH, [group], list(dict.fromkeys(names)), use_threads=False):
                a, b = max(first, row), min(last, row + batch.num_rows)
                if a < b:
                    yield slice(a - first, b - first), batch.slice(a - row, b - a)
                row += batch.num_rows
                release()
            if row != end:
                raise ValueError("fewer rows than declared")

    def _text(self, key: Key) -> list[str]:
        from pyarrow import ArrowException  # noqa: PLC0415 (import cost)

        name = self._names[self.column(key)]
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
