"""Tables of delimited text, damaged rows of which are named."""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from hydroopt.errors import LogError
from hydroopt.logs import stamps
from hydroopt.logs.column_map import Key, Layout, LogMap
from hydroopt.logs.formats.text_layout import NO_NUMBER, cells_of, decoded, table_of
from hydroopt.logs.stamps import Stamps
from hydroopt.logs.table import Array, NoNumbersError, RawKey, Table, find_column, refuse_damage, selected

if TYPE_CHECKING:
    import pandas as pd

SHEET = {"delimiter": "\t", "quote": "", "decimal": ".", "thousands": "", "encoding": "utf-8"}
"""What is certain of a worksheet as text."""


class TextFile:
    """Delimited text, parsed by pandas in the `layout` that a map states or, as far as it does not, the lines show.

    `header` has the names of the columns; a table without it has `unnamed` columns. `shown` is what was decided.
    """

    own_stamps = False

    def __init__(self, data: bytes, where: str, mapping: LogMap | None, *, sheet: bool = False) -> None:
        self.where, self._rows = where, mapping.rows if mapping else None
        stated = Layout() if mapping is None else Layout(**mapping.model_dump(include=set(Layout.model_fields)))
        if sheet:
            stated = stated.model_copy(update=SHEET)
        text, encoding = decoded(data, stated.encoding, where)
        lines = text.replace("\r\n", "\n").replace("\r", "\n").split("\n")
        table = table_of(lines, stated.model_copy(update={"encoding": encoding}), where)
        self._layout, self._places = table.layout, np.array(table.rows, int) + 1
        self._lines = [lines[k] for k in table.rows]
        self.layout = table.layout.model_copy(update=dict.fromkeys(SHEET)) if sheet else table.layout
        self.header, self.shown = table.names, table.shown(stated)
        if not self._lines and (longest := max(map(len, lines))) > csv.field_size_limit():
            raise LogError(f"a line of {longest} characters cannot be split into columns", where=where,
                           remedy="check the ends of its lines, its quotation marks and the delimiter")
        if not self._lines:
            raise LogError("there is a header but no data", where=where, remedy="record it again")
        self.unnamed = 0 if self.header else self._width

    @cached_property
    def _counts(self) -> NDArray[np.int64]:
        """Cells of each row; 0 where a quotation mark stays open, which would swallow the rows that follow."""
        mark, quote = str(self._layout.delimiter), self._layout.quote or "\n"
        blank = mark == "whitespace"
        counts = np.array([len(line.split()) if blank else line.count(mark) + 1 for line in self._lines])
        for k, line in enumerate(self._lines):
            if quote in line:
                counts[k] = 0 if line.count(quote) % 2 else len(cells_of(line, self._layout))
        return counts

    @cached_property
    def _widths(self) -> NDArray[np.int64]:
        """Columns of each row: its cells, but empty ones behind the last name."""
        widths = self._counts.copy()
        for k in np.flatnonzero(widths > len(self.header)) if self.header else ():
            if not any(map(str.strip, cells_of(self._lines[k], self._layout)[len(self.header):])):
                widths[k] = len(self.header)
        return widths

    @cached_property
    def _width(self) -> int:
        return len(self.header) or int(np.bincount(self._widths).argmax()) or 1

    def read(self, keys: Sequence[RawKey], texts: Sequence[Key] = (), time: RawKey | None = None) -> Table:
        """The columns `keys` as numbers, where empty cells and 'nan' are NaN, and the columns `texts` as they are."""
        rows = selected(len(self._lines), self._rows, self.where)
        widths, width = self._widths[rows - 1], self._width
        damage = {int(r): f"{w} of {width} columns" if w else "a quotation mark out of place"
                  for r, w in zip(rows[widths != width], widths[widths != width], strict=True)}
        good = np.flatnonzero(widths == width)
        table = Table({}, rows, damage, lines=self._places[rows - 1])
        if any(isinstance(key, tuple) for key in keys):
            raise LogError("the map names a 'variable', which only .mat files have", where=self.where,
                           remedy="use 'column'")
        if not good.size:
            refuse_damage(table, self.where)
        index: dict[RawKey, int] = {key: find_column(key, self.header, width, self.where) for key in (*keys, *texts)
                                    if not isinstance(key, tuple)}
        sound = _Rows([self._lines[r - 1] for r in rows[good]], int(self._counts[rows[good] - 1].max()),
                      self._places[rows[good] - 1], rows[good])
        at = None if time is None else index[time]
        dated = at is not None and any(
            stamps.looks_dated(cells_of(line, self._layout)[at]) for line in sound.lines[:10])
        words = {index[key] for key in texts} | ({at} if at is not None and dated else set())
        frame = self._parsed(sound, {index[key] for key in keys if not isinstance(key, tuple)} - words, words)
        made = None if at is None else self._stamps(frame[at], at, sound, dated=dated)
        columns: dict[RawKey, Array] = {}
        for key in keys:
            values = np.full(rows.size, np.nan)
            if key != time or not dated:
                values[good] = self._numbers(frame[index[key]], index[key], sound)
            columns[key] = values
        if made is not None:
            ticks = np.full(rows.size, stamps.MISSING)
            ticks[good] = made.ticks
            made = replace(made, ticks=ticks)
            if time is not None and dated:
                columns[time] = made.seconds()
        found: dict[Key, list[str]] = {}
        for key in texts:
            column = np.full(rows.size, "", dtype=object)
            column[good] = frame[index[key]]
            found[key] = column.tolist()
        return replace(table, columns=columns, texts=found, stamps=made)

    def _place(self, k: int, position: int, sound: _Rows) -> str:
        """What a sentence calls a cell of the row k."""
        name = f"'{self.header[position]}'" if self.header else "without name"
        return f"line {sound.places[k]}, data row {sound.rows[k]}, column {position + 1} {name}"

    def _stamps(self, cells: pd.Series, position: int, sound: _Rows, *, dated: bool) -> Stamps | None:
        """The time's dates, or its epoch with all digits; None where it is neither."""
        if dated:
            return stamps.of_texts(cells.tolist(), self._layout.dates, self.where,
                                   lambda k: self._place(k, position, sound))
        unit = stamps.epoch_unit(self._numbers(cells, position, sound))
        if unit is None:
            return None
        texts = self._parsed(sound, set(), {position})[position].str.replace(str(self._layout.decimal), ".")
        return stamps.epoch(np.array([stamps.exact_ticks(text, unit) for text in texts], np.int64), 10**9, unit)

    def _parsed(self, sound: _Rows, numbers: set[int], texts: set[int]) -> pd.DataFrame:
        """Columns as numbers, all as texts where one of them holds anything else, and columns of texts.

        Raises:
            LogError: the lines cannot be split.
        """
        import pandas as pd  # noqa: PLC0415 (import cost)

        layout = self._layout
        kinds = dict.fromkeys(numbers, float) | dict.fromkeys(texts, str)
        try:
            return pd.read_csv(
                io.BytesIO("\n".join(sound.lines).encode()), header=None, names=range(sound.width), index_col=False,
                sep=r"\s+" if layout.delimiter == "whitespace" else layout.delimiter, usecols=sorted(kinds),
                dtype=kinds, decimal=layout.decimal, thousands=layout.thousands or None, quotechar=layout.quote or '"',
                quoting=csv.QUOTE_MINIMAL if layout.quote else csv.QUOTE_NONE, keep_default_na=False,
                na_values=dict.fromkeys(numbers, NO_NUMBER), skipinitialspace=True, skip_blank_lines=False,
                low_memory=False)
        except ValueError as error:
            if numbers:
                return self._parsed(sound, set(), numbers | texts)
            raise LogError(f"its lines cannot be split into columns ({error})", where=self.where,
                           remedy="check the ends of its lines, its quotation marks and the delimiter") from None

    def _numbers(self, cells: pd.Series, position: int, sound: _Rows) -> Array:
        """A column as numbers.

        Raises:
            LogError: a cell holds anything else; of kind NoNumbersError, if most of them do.
        """
        if cells.dtype == float:
            return np.asarray(cells)
        values = [self._number(cell) for cell in cells]
        if None not in values:
            return np.array(values, dtype=float)
        k, kind = values.index(None), LogError
        if 2 * values.count(None) > cells.str.strip().ne("").sum():
            kind = NoNumbersError
        raise kind(f"'{cells[k]:.40}' is not a number", where=f"{self.where}, {self._place(k, position, sound)}",
                   remedy="correct the cell, or select sound rows with 'rows = [first, last]' in a map")

    def _number(self, cell: str) -> float | None:
        text = cell.strip()
        if text in NO_NUMBER:
            return np.nan
        try:
            plain = text.replace(self._layout.thousands or " ", "").replace(str(self._layout.decimal), ".")
            return None if "_" in text else float(plain)
        except ValueError:
            return None


@dataclass(frozen=True)
class _Rows:
    """Sound rows: their `lines` of up to `width` cells, the `places` (N,) of these in the file, data `rows` (N,)."""

    lines: Sequence[str]
    width: int
    places: NDArray[np.int64]
    rows: NDArray[np.int64]
