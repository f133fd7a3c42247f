"""Numbers and tables as JSON and CSV files have them; covariance.csv, that of all numbers estimated together."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from hydroopt.errors import ProblemError
from hydroopt.spatial.inertia import Array

COVARIANCE = "covariance.csv"
"""The file beside the JSON file of an answer."""


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


def covariance_csv(names: Sequence[str], covariance: Array) -> str:
    """The content of the file: a row and a column for each number, with the covariance (k, k) in SI.

    >>> print(covariance_csv(["boom.a", "stick.a"], np.array([[4e-6, 1e-6], [1e-6, 9e-6]])), end="")
    name,boom.a,stick.a
    boom.a,4e-06,1e-06
    stick.a,1e-06,9e-06
    """
    return csv_text([{"name": name, **dict(zip(names, values, strict=True))}
                     for name, values in zip(names, covariance.tolist(), strict=True)])


def read_covariance(text: str, where: str) -> tuple[tuple[str, ...], Array]:
    """Names (k,) and covariance (k, k) of such a file.

    Raises:
        ProblemError: it is damaged.

    >>> names, covariance = read_covariance("name,boom.a\\nboom.a,4e-06\\n", "covariance.csv")
    >>> names, covariance.tolist()
    (('boom.a',), [[4e-06]])
    """
    rows = list(csv.reader(io.StringIO(text)))
    try:
        names = tuple(rows[0][1:])
        covariance = np.array([[float(cell) for cell in row[1:]] for row in rows[1:]]).reshape(len(names), len(names))
        if tuple(row[0] for row in rows[1:]) != names or not np.all(np.isfinite(covariance)):
            raise ValueError
    except (ValueError, IndexError):
        raise ProblemError("it is damaged", where=where, remedy="calibrate or identify again") from None
    return names, covariance
