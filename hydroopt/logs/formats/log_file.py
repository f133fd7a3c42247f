"""What a file of any format offers: sheets of columns."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

from hydroopt.logs.column_map import Key, Layout
from hydroopt.logs.table import RawKey, Table


class LogFile(Protocol):
    """A sheet of columns of one length, that of a file which has but one or one of several.

    Attributes:
        header: names of the columns, `name [unit]` where the file states units; empty where there is none.
        unnamed: number of columns of a table without header, else 0.
        layout: of a table of text, or of a worksheet, as far as it has one; None of other files.
        shown: what was taken of the file that it does not state, in a sentence; empty where nothing was.
        own_stamps: whether its rows have stamps of their own, which no column states.
    """

    header: list[str]
    shown: str
    own_stamps: bool
    unnamed: int

    @property
    def layout(self) -> Layout | None:
        """That of a table of text."""

    def read(self, keys: Sequence[RawKey], texts: Sequence[Key] = (), time: RawKey | None = None) -> Table:
        """The columns `keys` as numbers and the columns `texts` as texts.

        Args:
            keys: names, 0-based indices, or (variable, row).
            texts: names or indices.
            time: that of the keys which is the time; a date or an epoch comes as the table's `stamps`.

        Raises:
            LogError: there is no such column, or it holds no numbers.
        """
