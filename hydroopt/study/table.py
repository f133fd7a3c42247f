"""The outcomes of a study's cells, in their order, and the statistics that all kinds of studies share."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from hydroopt.results.tables import csv_text
from hydroopt.spatial.inertia import Array
from hydroopt.study.study import Outcome, Values


@dataclass(frozen=True, eq=False)
class Table:
    """Cells (N) with their outcomes (N).

    >>> table = Table(({"seed": 1}, {"seed": 2}), ({"result": {"x": 0.5}}, {"error": "not identifiable"}))
    >>> table.column("x"), table.failures
    (array([0.5]), {'not identifiable': [1]})
    >>> print(table.csv())
    cell,seed,error,x
    0,1,,0.5
    1,2,not identifiable,
    <BLANKLINE>
    """

    cells: tuple[Values, ...]
    outcomes: tuple[Outcome, ...]

    def __len__(self) -> int:
        return len(self.cells)

    @property
    def results(self) -> list[Values]:
        """Results of the cells that succeeded."""
        return [outcome["result"] for outcome in self.outcomes if "result" in outcome]

    @property
    def failures(self) -> dict[str, list[int]]:
        """Indices of the cells that failed, by the message of the error."""
        found: dict[str, list[int]] = {}
        for k, outcome in enumerate(self.outcomes):
            if "error" in outcome:
                found.setdefault(outcome["error"], []).append(k)
        return found

    @property
    def failed(self) -> dict[str, Any]:
        """The number of cells that failed, and each error with the indices of its cells, as JSON."""
        return {"failed": len(self) - len(self.results),
                "failures": [{"error": error, "cells": cells} for error, cells in self.failures.items()]}

    def column(self, name: str) -> Array:
        """A quantity (M,) of the M cells that succeeded, NaN where there is no number."""
        return np.array([result[name] for result in self.results], dtype=float)

    def where(self, values: Values) -> Table:
        """The cells that have these values."""
        chosen = [k for k, cell in enumerate(self.cells) if all(cell.get(key) == v for key, v in values.items())]
        return Table(tuple(self.cells[k] for k in chosen), tuple(self.outcomes[k] for k in chosen))

    def csv(self) -> str:
        """One line per cell; numbers to their last bit, an empty field where there is none."""
        keys = dict.fromkeys(key for some in (["cell"], *self.cells, ["error"], *self.results) for key in some)
        return csv_text([dict.fromkeys(keys) | {"cell": k} | dict(cell) | outcome.get("result", {})
                         | {"error": outcome.get("error")}
                         for k, (cell, outcome) in enumerate(zip(self.cells, self.outcomes, strict=True))])


def spread(error: Array, std: Array) -> dict[str, float | None]:
    """Bias and scatter of an error (N,), and the ratio of the scatter to the stated σ (N,).

    The scatter is the standard deviation of the errors, the stated σ their root mean square.

    >>> spread(np.array([1.0, 3.0]), np.array([2.0, 2.0]))["bias"]
    2.0
    """
    scatter = float(np.std(error, ddof=1)) if len(error) > 1 else None
    stated = float(np.sqrt(np.mean(std**2))) if np.all(np.isfinite(std)) else None
    return {"bias": float(np.mean(error)), "scatter": scatter, "stated_std": stated,
            "scatter_over_stated": scatter / stated if scatter is not None and stated else None}


def quantiles(values: Array) -> dict[str, float | None]:
    """Median, the quantiles that hold 90 %, and the largest."""
    values = values[np.isfinite(values)]
    found = np.quantile(values, [0.5, 0.05, 0.95, 1.0]).tolist() if values.size else [None] * 4
    return dict(zip(("median", "q05", "q95", "max"), found, strict=True))
