"""What a file of any format offers, and a frame: sheets of columns."""

from __future__ import annotations

import re
from abc import ABC, abstractmethod
from collections.abc import Sequence

from hydroopt.errors import LogError
from hydroopt.logs.column_map import Key, Layout
from hydroopt.logs.table import RawKey, Table


class Sheet(ABC):
    """A table of columns of one length: a file, or a sheet, topic or group of one.

    Attributes:
        where: the file, and the sheet if it has several.
        header: names of the columns, `name [unit]` where the file states units; empty where there is none.
        rows: first and last data row that are read; None of all.
        name: that maps call it by; empty of a file's only one, unless there are several files.
        title: the name that the file itself has for it, such as a topic.
        unnamed: number of columns of a table without header, else 0.
        layout: of a table of text, or of a worksheet, as far as it has one; None of other files.
        shown: what was taken of the file that it does not state, in a sentence; empty where nothing was.
        own_stamps: whether its rows have stamps of their own, which no column states.
        variables: whether a map may name its columns by variable and row, as those of a MATLAB file.
    """

    name = title = shown = ""
    own_stamps, variables, unnamed = False, False, 0
    layout: Layout | None = None

    def __init__(self, where: str, header: list[str], rows: tuple[int, int] | None = None) -> None:
        self.where, self.header, self.rows = where, header, rows

    @abstractmethod
    def read(self, keys: Sequence[RawKey], texts: Sequence[Key] = (), time: RawKey | None = None) -> Table:
        """The columns `keys` as numbers, missing ones NaN, and the columns `texts` as texts.

        Args:
            keys: names, 0-based indices, or (variable, row).
            texts: names or indices.
            time: that of the keys which is the time; a date or an epoch comes as the table's `stamps`.

        Raises:
            LogError: there is no such column, or it holds no numbers.
        """

    def column(self, key: RawKey) -> int:
        """Index of a column given by name, without its unit where that says enough, 0-based index, or (variable, row).

        Raises:
            LogError: there is none, or the name occurs twice.
        """
        width = len(self.header) or self.unnamed
        if isinstance(key, int):
            if not 0 <= key < width:
                raise LogError(f"there is no column {key} among {width} (counted from 0)", where=self.where,
                               remedy="correct the index in the map")
            return key
        if isinstance(key, tuple):
            if not self.variables:
                raise LogError("the map names a 'variable', which only .mat files have", where=self.where,
                               remedy="use 'column'")
            key = key[0] if key[1] is None else f"{key[0]}[{key[1]}]"
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

    def holds(self, key: RawKey) -> bool:
        """Whether there is such a column."""
        try:
            self.column(key)
        except LogError:
            return False
        return True
