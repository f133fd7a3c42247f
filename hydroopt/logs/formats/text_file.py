"""Tables of delimited text, damaged rows of which are named."""

from __future__ import annotations

import csv
import io
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from hydroopt.errors import LogError
from hydroopt.logs import stamps
from hydroopt.logs.column_map import Layout, LogMap
from hydroopt.logs.formats.sheet import Sheet
from hydroopt.logs.formats.text_layout import NO_NUMBER, TextTable, cells_of, decoded
from hydroopt.logs.stamps import Stamps
from hydroopt.logs.table import Array, NoNumbersError, Table

if TYPE_CHECKING:
    import pandas as pd

SHEET = {"delimiter": "\t", "quote": "", "decimal": ".", "thousands": "", "encoding": "utf-8"}
"""What is certain of a worksheet as text."""


class TextFile(Sheet):
    """Delimited text, parsed by pandas in the `layout` that a map states or, as far as it does not, the lines show.

    `shown` is what was decided.
    """

    def __init__(self, data: bytes, where: str, mapping: LogMap | None, *, sheet: bool = False) -> None:
        stated = Layout() if mapping is None else Layout(**mapping.model_dump(include=set(Layout.model_fields)))
        if sheet:
            stated = stated.model_copy(update=SHEET)
        text, encoding = decoded(data, stated.encoding, where)
        lines = text.replace("\r\n", "\n").replace("\r", "\n").split("\n")
        table = TextTable(lines, stated, encoding, where)
        self._layout, self._places = table.layout, np.array(table.rows, int) + 1
        self._lines = [lines[k] for k in table.rows]
        self.layout = table.layout.model_copy(update=dict.fromkeys(SHEET)) if sheet else table.layout
        super().__init__(where, table.names, len(self._lines), mapping.rows if mapping else None)
        self.shown = table.shown
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

    @cached_property
    def _frame(self) -> pd.DataFrame:
        """All rows that have as many cells as usual by 0-based data row, columns of numbers as such."""
        return self._parsed(na_values=NO_NUMBER, decimal=self._layout.decimal, low_memory=False,
                            thousands=self._layout.thousands or None)

    def _cells(self, index: int, rows: NDArray[np.int64]) -> pd.Series:
        """The cells of a column in 1-based data rows as texts, by 0-based row."""
        return self._parsed(dtype=str, usecols=[index])[index].reindex(rows - 1, fill_value="")

    def texts(self, index: int, rows: NDArray[np.int64]) -> list[str]:
        """The cells of a column."""
        return list(map(str, self._cells(index, rows)))

    def _parsed(self, **how: Any) -> pd.DataFrame:
        """These rows, as pandas reads them.

        Raises:
            LogError: the lines cannot be split.
        """
        import pandas as pd  # noqa: PLC0415 (import cost)

        layout, sound = self._layout, np.flatnonzero(self._widths == self._width)
        try:
            return pd.read_csv(
                io.BytesIO("\n".join(self._lines[k] for k in sound).encode()), header=None, index_col=False,
                names=range(int(self._counts[sound].max())), keep_default_na=False, skip_blank_lines=False,
                sep=r"\s+" if layout.delimiter == "whitespace" else layout.delimiter, quotechar=layout.quote or '"',
                quoting=csv.QUOTE_MINIMAL if layout.quote else csv.QUOTE_NONE, skipinitialspace=True, **how,
            ).set_axis(sound)
        except ValueError as error:
            raise LogError(f"its lines cannot be split into columns ({error})", where=self.where,
                           remedy="check the ends of its lines, its quotation marks and the delimiter") from None

    def damage(self, rows: NDArray[np.int64]) -> Table:
        """The rows (N,) that have too few or too many cells, or an open quotation mark."""
        widths, width = self._widths[rows - 1], self._width
        return Table({}, rows, {int(r): f"{w} of {width} columns" if w else "a quotation mark out of place"
                                for r, w in zip(rows[widths != width], widths[widths != width], strict=True)},
                     lines=self._places[rows - 1])

    def _place(self, row: int, index: int) -> str:
        """What a sentence calls a cell of a 0-based data row."""
        name = f"'{self.header[index]}'" if self.header else "without name"
        return f"line {self._places[row]}, data row {row + 1}, column {index + 1} {name}"

    def timed(self, index: int, rows: NDArray[np.int64]) -> tuple[NDArray[Any], Stamps | None]:
        """A column of times, and its dates, or its epoch with all digits."""
        if self._frame[index].dtype.kind not in "iuf":
            cells = self._cells(index, rows)
            if any(map(stamps.looks_dated, cells[cells.ne("")].head(10))):
                made = stamps.of_texts(cells.to_list(), self._layout.dates, self.where,
                                       lambda k: self._place(int(cells.index[k]), index))
                return made.moments, made
        values = self.values(index, rows)
        unit = stamps.epoch_unit(values)
        return values, None if unit is None else stamps.epoch(np.array(
            [stamps.exact_moment(text, unit) for text in self._plain(self._cells(index, rows))], "M8[ns]"), unit)

    def _plain(self, cells: pd.Series) -> pd.Series:
        """Texts (N,) of numbers as Python writes them."""
        plain = cells.str.strip().str.replace(self._layout.thousands or " ", "", regex=False)
        return plain.str.replace(",", ".", regex=False) if self._layout.decimal == "," else plain

    def values(self, index: int, rows: NDArray[np.int64], *, exact: bool = False) -> Array:
        """A column as numbers, where empty cells and 'nan' are NaN.

        Raises:
            LogError: a cell holds anything else; of kind NoNumbersError, if most of them do.
        """
        if self._frame[index].dtype.kind in "iuf":
            return np.asarray(self._frame[index].reindex(rows - 1), float)
        cells = self._cells(index, rows)
        plain = self._plain(cells)
        numbers = [_number(text) for text in plain]
        wrong = [k for k, number in enumerate(numbers) if number is None]
        if not wrong:
            return np.array(numbers, float)
        kind = NoNumbersError if 2 * len(wrong) > np.count_nonzero(plain.ne("")) else LogError
        raise kind(f"'{cells.iloc[wrong[0]]:.40}' is not a number",
                   where=f"{self.where}, {self._place(int(cells.index[wrong[0]]), index)}",
                   remedy="correct the cell, or select sound rows with 'rows = [first, last]' in a map")


def _number(text: str) -> float | None:
    """A text as a number, NaN of one that stands for none; None of any other."""
    try:
        return np.nan if text in NO_NUMBER else None if "_" in text else float(text)
    except ValueError:
        return None
