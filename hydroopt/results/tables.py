"""Numbers and tables as JSON and CSV files have them."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Mapping, Sequence
from typing import Any


def number(value: Any) -> float | None:
    """A number as JSON has it: None for NaN and infinity.

    Example:
        >>> number(float("nan")) is None
        True
    """
    return float(value) if math.isfinite(value) else None


def with_limits(entry: Mapping[str, Any]) -> dict[str, Any]:
    """An entry of a JSON file as a row of a CSV file: the interval `ci95` as `low` and `high`.

    Example:
        >>> with_limits({"name": "a", "ci95": [1.0, 2.0]})
        {'name': 'a', 'low': 1.0, 'high': 2.0}
    """
    flat = dict(entry)
    flat["low"], flat["high"] = flat.pop("ci95") or (None, None)
    return flat


def csv_text(rows: Sequence[Mapping[str, Any]]) -> str:
    """Rows of equal keys as the text of a CSV file."""
    text = io.StringIO()
    writer = csv.DictWriter(text, list(rows[0]) if rows else [], lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    return text.getvalue()
