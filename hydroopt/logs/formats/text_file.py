"""Tables of delimited text, damaged rows of which are named."""

from __future__ import annotations

import csv
import re
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from hydroopt.errors import LogError
from hydroopt.logs import stamps
from hydroopt.logs.column_map import Key, LogMap
from hydroopt.logs.formats.text_dress import decoded, dress_of, lines_of
from hydroopt.logs.stamps import Stamps
from hydroopt.logs.table import Array, RawKey, Table, find_column, refuse_damage, selected


class TextFile:
    """Delimited text; the header is `header` (empty for headerless files), `shown` what was taken of its dress."""

    own_stamps = False

    def __init__(self, data: bytes, where: str, layout: LogMap | None) -> None:
        self.where, self._layout = where, layout or LogMap.model_construct(columns={})
        text, encoding = decoded(data, self._layout.encoding, where)
        lines, comments = lines_of(text, self._layout)
        if not lines:
            raise LogError("there are comments but no data", where=where, remedy="record it again")
        dress = dress_of(lines, self._layout, where)
        self.header, self._decimal, self._thousands = dress.header, dress.decimal, dress.thousands
        dropped = f"{comments} comment line{'s' * (comments > 1)} left out" if comments else ""
        self.shown = ", ".join(part for part in (encoding, dress.shown, dropped) if part)
        self._lines, self._delimiter = lines[dress.first:], dress.delimiter
        if not self._lines and len(lines[-1]) > csv.field_size_limit():
            raise self._no_columns(lines[-1])
        if not self._lines:
            raise LogError("there is a header but no data", where=where, remedy="record it again")
        if dress.delimiter == "whitespace":
            self._lines, self._delimiter = [" ".join(line.split()) for line in self._lines], " "
        self._mark_dates()

    def _mark_dates(self) -> None:
        """Give a time column of dates the unit that its stamps will have."""
        for k, name in enumerate(self.header):
            if name == "t" and stamps.looks_dated((self._split(self._lines[0]) + [""] * (k + 1))[k]):
                self.header[k] = "t [s]"

    def read(self, keys: Sequence[RawKey], texts: Sequence[Key] = (), time: RawKey | None = None) -> Table:
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
        sound = [lines[i] for i in good]
        found = self._parse(sound, index)
        columns: dict[RawKey, Array] = {}
        made: Stamps | None = None
        for key, position in zip(keys, index, strict=True):
            values = np.full(rows.size, np.nan)
            cells = found[position]
            if key == time:
                made = self._stamps(cells, position, sound, np.array(good), rows.size)
                if made is not None and isinstance(cells, list):
                    columns[key] = made.seconds()
                    continue
            if isinstance(cells, list):
                bad = next(i for i, cell in enumerate(cells) if self._number(cell) is None)
                raise LogError(f"'{cells[bad][:40]}' is not a number",
                               where=f"{self.where}, data row {rows[good[bad]]}, {self._named(position)}",
                               remedy="correct the cell, or select sound rows with 'rows = [first, last]' in a map")
            values[good] = cells
            columns[key] = values
        return Table(columns, rows, damage, self._texts(texts, sound, width, np.array(good, int), rows.size), made)

    def _named(self, position: int) -> str:
        return f"column {position + 1} " + (f"'{self.header[position]}'" if self.header else "without name")

    def _stamps(self, cells: Array | list[str], position: int, sound: Sequence[str], good: NDArray[np.int64],
                size: int) -> Stamps | None:
        """The time's dates, or its epoch with all digits; None where it is neither."""
        if isinstance(cells, list):
            if not any(map(stamps.looks_dated, cells[:10])):
                return None
            made = stamps.of_texts(cells, self._layout.dates, f"{self.where}, {self._named(position)}")
        else:
            unit = stamps.epoch_unit(cells)
            if unit is None:
                return None
            texts = self._columns(sound, [position])[position]
            ticks = [stamps.exact_ticks(text.replace(self._decimal, "."), unit) for text in texts]
            made = stamps.epoch(np.array(ticks, np.int64), 10**9, unit)
        ticks_of_all = np.full(size, stamps.MISSING)
        ticks_of_all[good] = made.ticks
        return replace(made, ticks=ticks_of_all)

    def _texts(self, keys: Sequence[Key], sound: Sequence[str], width: int, good: NDArray[np.int64],
               size: int) -> dict[Key, list[str]]:
        """Text columns of length `size`, '' in the rows that are not `good`."""
        if not keys:
            return {}
        index = [find_column(key, self.header, width, self.where) for key in keys]
        cells = self._columns(sound, index)
        out = {}
        for key, position in zip(keys, index, strict=True):
            column = np.full(size, "", dtype=object)
            column[good] = cells[position]
            out[key] = column.tolist()
        return out

    def _split(self, line: str) -> list[str]:
        try:
            return next(csv.reader([line], delimiter=self._delimiter), [""])
        except csv.Error:
            raise self._no_columns(line) from None

    def _no_columns(self, line: str) -> LogError:
        return LogError(f"a line of {len(line)} characters cannot be split into columns", where=self.where,
                        remedy="check the ends of its lines, its quotation marks and the delimiter")

    def _width(self, line: str) -> int:
        """Number of columns; 0 where a quotation mark stays open, which would swallow the rows that follow."""
        if '"' not in line:
            return line.count(self._delimiter) + 1
        try:
            return len(next(csv.reader([line], delimiter=self._delimiter, strict=True)))
        except csv.Error:
            return 0

    def _number(self, cell: str) -> float | None:
        if cell in ("NA", "null"):
            return np.nan
        if self._thousands:
            cell = cell.replace(self._thousands, "")
        try:
            return float(cell.strip().replace(self._decimal, ".") or "nan") if "_" not in cell else None
        except ValueError:
            return None

    def _columns(self, lines: Sequence[str], index: Sequence[int]) -> dict[int, list[str]]:
        """The cells of the columns `index`."""
        rows = list(csv.reader(lines, delimiter=self._delimiter))
        return {i: [row[i] if row else "" for row in rows] for i in set(index)}

    def _parse(self, lines: Sequence[str], index: Sequence[int]) -> dict[int, Array | list[str]]:
        """Columns as numbers; one that holds anything else comes back as its texts."""
        wanted = sorted(set(index))
        try:
            table = np.loadtxt(self._plain(lines), delimiter=self._delimiter, usecols=wanted, comments=None,
                               quotechar='"', ndmin=2)
            return dict(zip(wanted, table.T.copy(), strict=True))
        except ValueError:  # a cell is no plain number
            out: dict[int, Array | list[str]] = {}
            for i, cells in self._columns(lines, wanted).items():
                numbers = [self._number(cell) for cell in cells]
                out[i] = cells if None in numbers else np.array(numbers, dtype=float)
            return out

    def _plain(self, lines: Sequence[str]) -> Sequence[str]:
        """Lines with a decimal point, and nan in empty cells."""
        text = "\n".join(lines)
        if self._decimal not in (".", self._delimiter):
            text = text.replace(self._decimal, ".")
        between = re.escape(self._delimiter)
        filled = re.sub(rf"(^|{between})(?={between}|$)", r"\1nan", text, flags=re.MULTILINE)
        return filled.split("\n")
