"""Parquet files and Arrow tables; sizes are judged before anything is allocated."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hydroopt.errors import LogError
from hydroopt.logs.column_map import LogMap
from hydroopt.logs.formats.sheet import Sheet
from hydroopt.logs.mapped import empty, release
from hydroopt.logs.table import check_size, unreadable
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
                                 else field.name for field in self._file.schema_arrow], self.meta.num_rows,
                         layout.rows if layout else None)

    def values(self, index: int, rows: NDArray[np.int64], *, exact: bool = False) -> NDArray[Any]:
        """A column as numbers, where nulls are NaN."""
        from pyarrow import ArrowException, types  # noqa: PLC0415 (import cost)

        kind = self._file.schema_arrow.field(self._names[index]).type
        if not (types.is_integer(kind) or types.is_floating(kind) or types.is_decimal(kind)
                or (exact and (types.is_timestamp(kind) or types.is_duration(kind)))):
            raise self.no_numbers(index, kind, "convert the column to float64")
        made = None
        try:
            for place, column in self._batches(self._names[index], rows):
                part = _numbers(column, exact=exact)
                made = empty(rows.size, part.dtype) if made is None else made
                if part.dtype != made.dtype:  # of whole numbers some are missing
                    return self.values(index, rows)
                made[place] = part
        except (ArrowException, OSError, ValueError, IndexError) as error:
            raise unreadable("Parquet", self.where, error) from None
        assert made is not None
        made.setflags(write=False)
        return made

    def texts(self, index: int, rows: NDArray[np.int64]) -> list[str]:
        """A column as texts, where nulls are ''."""
        from pyarrow import ArrowException  # noqa: PLC0415 (import cost)

        name = self._names[index]
        try:
            cells = self._file.read(columns=[name]).column(0).cast("string").to_pylist()
        except (ArrowException, OSError, ValueError, IndexError):
            raise LogError(f"column '{name}' cannot be read as text", where=self.where,
                           remedy="convert the column to strings") from None
        return [cells[row - 1] or "" for row in rows]

    def _batches(self, name: str, rows: NDArray[np.int64]) -> Iterator[tuple[slice, Any]]:
        """Arrow arrays of a column in consecutive data rows (N,), with their places among these."""
        end, first, last = 0, int(rows[0]) - 1, int(rows[-1])
        for group in range(self.meta.num_row_groups):
            row, end = end, end + self.meta.row_group(group).num_rows
            if end <= first or row >= last:
                continue
            for batch in self._file.iter_batches(BATCH, [group], [name], use_threads=False):
                a, b = max(first, row), min(last, row + batch.num_rows)
                if a < b:
                    yield slice(a - first, b - first), batch.column(0).slice(a - row, b - a)
                row += batch.num_rows
                release()
            if row != end:
                raise ValueError("fewer rows than declared")


def _numbers(column: Any, *, exact: bool) -> NDArray[Any]:
    """An Arrow array as floating point; if `exact` as dates or whole numbers where it holds these."""
    if (plain := _plain(column)) is not None:
        return plain if exact and plain.dtype.kind in "iu" else plain.astype(float, copy=False)
    if exact:
        values = column.to_numpy(zero_copy_only=False)
        if values.dtype.kind in "mMiu":
            return np.asarray(values)
    return np.asarray(column.cast("float64", safe=False), dtype=float)


def _plain(column: Any) -> NDArray[Any] | None:
    """An Arrow array of whole or floating-point numbers without nulls, in the memory of that array; None of others.

    What Arrow itself offers for this imports pandas, where it is installed.
    """
    from pyarrow import types  # noqa: PLC0415 (import cost)

    sound = (types.is_integer(column.type) or types.is_floating(column.type)) and not column.null_count
    return np.from_dlpack(column) if sound and len(column) else None
