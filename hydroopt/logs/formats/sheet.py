"""What a file of any format offers, and a frame: sheets of columns."""

from __future__ import annotations

import re
from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hydroopt.errors import LogError
from hydroopt.logs.column_map import Key, Layout
from hydroopt.logs.mapped import stored
from hydroopt.logs.stamps import Stamps, of_column
from hydroopt.logs.table import Array, NoNumbersError, Table, refuse_damage, selected


class Sheet(ABC):
    """A table of columns of one length: a file, or a sheet, topic or group of one.

    Attributes:
        where: the file, and the sheet if it has several.
        header: names of the columns, `name [unit]` where the file states units; empty where there is none.
        count: how many data rows it has; `rows`: first and last of those that are read, None of all.
        name: that maps call it by; empty of a file's only one, unless there are several files.
        title: the name that the file itself has for it, such as a topic.
        unnamed: number of columns of a table without header, else 0.
        layout: of a table of text, or of a worksheet, as far as it has one; None of other files.
        shown: what was taken of the file that it does not state, in a sentence; empty where nothing was.
        own_stamps: whether its rows have stamps of their own, which no column states.
    """

    name = title = shown = ""
    own_stamps, unnamed = False, 0
    layout: Layout | None = None

    def __init__(self, where: str, header: list[str], count: int, rows: tuple[int, int] | None = None) -> None:
        self.where, self.header, self.count, self.rows = where, header, count, rows

    @abstractmethod
    def values(self, index: int, rows: NDArray[np.int64], *, exact: bool = False) -> NDArray[Any]:
        """A column in 1-based data rows (N,) as floating-point numbers, missing ones NaN; where it is to be `exact`
        also as whole numbers or moments, datetime64 in UTC or timedelta64. Of index -1 the file's own stamps.

        Raises:
            LogError: it cannot be read; of kind NoNumbersError, if it holds something else.
        """

    def texts(self, index: int, rows: NDArray[np.int64]) -> list[str]:
        """A column in 1-based data rows (N,) as texts, empty ones ''.

        Raises:
            LogError: it has none.
        """
        raise LogError("this file has no columns of text", where=self.where, remedy="export it as .csv or .xlsx")

    def timed(self, index: int, rows: NDArray[np.int64]) -> tuple[NDArray[Any], Stamps | None]:
        """A column of times in 1-based data rows (N,), and their stamps where they are dates or an epoch."""
        values = self.values(index, rows, exact=True)
        return values, of_column(values)

    def damage(self, rows: NDArray[np.int64]) -> Table:
        """A table of 1-based data rows (N,) without columns yet, with what is wrong with some of the rows."""
        return Table({}, rows)

    def read(self, keys: Sequence[Key], texts: Sequence[Key] = (), time: Key | None = None) -> Table:
        """The columns `keys` as numbers, missing ones NaN, and the columns `texts` as texts.

        Args:
            keys: names or 0-based indices, as `texts`.
            time: that of the keys which is the time; a date or an epoch comes as the table's `stamps`.

        Raises:
            LogError: there is no such column, or it holds no numbers; or all rows are damaged.
        """
        table = self.damage(selected(self.count, self.rows, self.where))
        if len(table.damage) == table.rows.size:
            refuse_damage(table, self.where)
        rows, raw, made = table.rows, np.empty(0), None
        if time is not None or self.own_stamps:
            raw, made = self.timed(-1 if time is None else self.column(time), rows)
        columns: dict[Key, Array] = {key: self.values(self.column(key), rows) for key in keys if key != time}
        if time is not None:
            columns[time] = made.seconds() if made is not None and not made.unit else stored(
                raw.astype(float, copy=False))
        found = {key: self.texts(self.column(key), rows) for key in texts}
        return replace(table, columns=columns, texts=found, stamps=made)

    def no_numbers(self, index: int, kind: object, remedy: str) -> NoNumbersError:
        """The error of a column that holds a `kind` of something else."""
        return NoNumbersError(f"column '{self.header[index]}' holds {kind}, not numbers", where=self.where,
                              remedy=remedy)

    def column(self, key: Key) -> int:
        """Index of a column given by name, without its unit where that says enough, or by 0-based index.

        Raises:
            LogError: there is none, or the name occurs twice.
        """
        width = len(self.header) or self.unnamed
        if isinstance(key, int):
            if not 0 <= key < width:
                raise LogError(f"there is no column {key} among {width} (counted from 0)", where=self.where,
                               remedy="correct the index in the map")
            return key
        count = self.header.count(key)
        if count == 0:
            bare = [re.sub(r"\s*\[[^\[\]]*\]$", "", name) for name in self.header]
            if bare.count(key) == 1:
                return bare.index(key)
            present = f"those present are {', '.join(self.header[:40])}" if self.header else "no header is read"
            raise LogError(f"there is no column '{key}' ({present})", where=self.where,
                           remedy="correct the name in the map")
        if count > 1:
            raise LogError(f"column '{key}' occurs {count} times", where=self.where,
                           remedy="rename one or give the column's 0-based index in a map")
        return self.header.index(key)

    def holds(self, key: Key) -> bool:
        """Whether there is such a column."""
        try:
            self.column(key)
        except LogError:
            return False
        return True
