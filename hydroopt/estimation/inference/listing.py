"""Lists and tables in plain text, by which problems print themselves; long ones are shortened."""

from __future__ import annotations

from collections.abc import Sequence

MOST = 40
"""Rows of a table at most."""


def table(header: Sequence[str], rows: Sequence[Sequence[str]], *, most: int = MOST) -> list[str]:
    """Lines of a table whose columns are aligned; beyond `most` rows the last line states how many are left out.

    >>> print("\\n".join(table(("name", "unit"), [("boom.m", "kg"), ("boom.mc_x", "kg*m"), ("boom.mc_y", "kg*m")],
    ...                        most=2)))
      name    unit
      boom.m  kg
      … 2 more
    """
    if not rows:
        return ["  none"]
    shown = list(rows) if len(rows) <= most else list(rows[: most - 1])
    widths = [max(len(row[k]) for row in (header, *shown)) for k in range(len(header))]
    lines = ["  " + "  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip()
             for row in (header, *shown)]
    return [*lines, *([f"  … {len(rows) - len(shown)} more"] if len(shown) < len(rows) else [])]


def named_row(*cells: str | float) -> tuple[str, ...]:
    """Cells of a row as text: numbers to six digits, infinite ones as a dash.

    >>> named_row("boom.m", "kg", 1560.0, 0.0, float("inf"))
    ('boom.m', 'kg', '1560', '0', '–')
    """
    return tuple(cell if isinstance(cell, str) else number(cell) for cell in cells)


def number(value: float) -> str:
    """Six digits, or a dash for a number that is infinite or unknown."""
    return f"{value:.6g}" if abs(value) < float("inf") else "–"
