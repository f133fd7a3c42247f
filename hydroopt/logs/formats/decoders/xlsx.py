"""Worksheets of spreadsheets, as tables of text."""

from __future__ import annotations

import re
from datetime import date, datetime, time, timedelta
from functools import partial
from pathlib import Path

import numpy as np
import python_calamine as calamine

from hydroopt.logs.formats.decoders.content import Column, Content

COMMA = re.compile(r"([+-]?\d+),(\d+)")
"""A number as text, with one comma."""


def contents(path: Path) -> list[Content]:
    """The worksheets that hold cells, with tabs between columns."""
    book = calamine.CalamineWorkbook.from_path(str(path))
    found = []
    for name in book.sheet_names:
        rows = book.get_sheet_by_name(name).to_python(skip_empty_area=True)
        if rows:
            lines = ("\t".join(row) for row in _with_points([[_text(cell) for cell in row] for row in rows]))
            text = np.frombuffer("\n".join(lines).encode(), np.uint8)
            found.append(Content(name, [Column("", "", partial(np.asarray, text))], text=True, rows=len(rows)))
    return found


def _with_points(rows: list[list[str]]) -> list[list[str]]:
    """The same cells, where numbers typed as text with a decimal comma have a point.

    A comma before three digits may stand between thousands: it is one for decimals where others of the sheet are.
    """
    typed = [found for row in rows for cell in row if (found := COMMA.fullmatch(cell))]
    if not any(len(found[2]) != 3 or not found[1].strip("+-0") for found in typed):
        return rows
    return [[cell.replace(",", ".") if COMMA.fullmatch(cell) else cell for cell in row] for row in rows]


def _text(cell: object) -> str:
    """A cell as text, numbers with all of their digits."""
    if isinstance(cell, datetime):
        return cell.isoformat(sep=" ", timespec="microseconds")
    if isinstance(cell, timedelta):
        return repr(cell.total_seconds())
    if isinstance(cell, time):
        return cell.isoformat(timespec="microseconds")
    if isinstance(cell, date):
        return cell.isoformat()
    return repr(cell) if isinstance(cell, float) else " ".join(str(cell).split())
