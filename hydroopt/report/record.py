"""What all results have in common as JSON and CSV."""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from typing import Any

import numpy as np

from hydroopt.machine.machine import Machine

SCHEMA = 1
"""Version of estimate.json and its like; it changes when a key changes its meaning or goes."""


def machine_entry(machine: Machine) -> dict[str, Any]:
    """What a result says of the machine it is about."""
    return {"name": machine.name, "parameter_set": machine.parameter_set, "sha256": machine.sha256}


def now() -> str:
    """The time, in UTC."""
    return datetime.now(UTC).isoformat(timespec="seconds")


def flat(row: Mapping[str, Any]) -> dict[str, Any]:
    """A parameter without nested values."""
    flat = dict(row)
    flat |= dict(zip(("low", "high"), flat.pop("ci95") or (None, None), strict=True))
    if "correlated_with" in flat:
        partner = flat.pop("correlated_with") or {"name": None, "correlation": None}
        flat |= {"correlated_with": partner["name"], "correlation": partner["correlation"]}
    return flat


def table(rows: Sequence[Mapping[str, Any]]) -> str:
    """Rows of equal keys as CSV."""
    text = io.StringIO()
    writer = csv.DictWriter(text, list(rows[0]) if rows else [], lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    return text.getvalue()


def number(value: Any) -> float | None:
    """A number as JSON has it: None for NaN and infinity."""
    return float(value) if np.isfinite(value) else None
