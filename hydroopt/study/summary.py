"""Statistics that the summaries of all kinds of studies share."""

from __future__ import annotations

from typing import Any

import numpy as np

from hydroopt.spatial.inertia import Array
from hydroopt.study.table import Table


def failed(table: Table) -> dict[str, Any]:
    """The number of cells that failed, and each error with the indices of its cells."""
    return {"failed": len(table) - len(table.results),
            "failures": [{"error": error, "cells": cells} for error, cells in table.failures.items()]}


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
