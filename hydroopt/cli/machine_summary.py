"""A machine on one page: its tables summed up part by part, so that they fit on a screen."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from hydroopt.results.readable import readable

ROWS = 12
"""Rows of a table, or lines of a list, that are shown; what is left out is counted."""

def sensors(rows: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """One row for all channels of a kind with the same accuracy and rate.

    >>> sensors([{"channel": f"{joint}.q", "unit": "rad", "std": 0.001, "rate_hz": None} for joint in ("boom", "arm")])
    [{'channels': 'boom.q, arm.q', 'std': '0.057 deg', 'rate': 'any'}]
    """
    alike: dict[tuple[str, str], list[str]] = {}
    for row in rows:
        rate = "any" if row["rate_hz"] is None else f"{row['rate_hz']:g} Hz"
        alike.setdefault((readable(row["std"], row["unit"]), rate), []).append(row["channel"])
    return [{"channels": _listed(channels, 3), "std": std, "rate": rate} for (std, rate), channels in alike.items()]


def parts(rows: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """One row for all parameters of a part: its mass, and how many of its parameters motion identifies.

    >>> row = {"name": "boom.m", "unit": "kg", "nominal": 90.0, "prior_std": 9.0, "identifiability": "none"}
    >>> parts([row, row | {"name": "boom.mc_x", "identifiability": "full"}])
    [{'part': 'boom', 'mass [kg]': '90 ± 9', 'alone': 'mc_x', 'combined': '', 'none': 1}]
    """
    owners: dict[str, list[Mapping[str, Any]]] = {}
    for row in rows:
        owners.setdefault(row["name"].rpartition(".")[0], []).append(row)
    found = []
    for owner, own in owners.items():
        of = {kind: [row["name"].rpartition(".")[2] for row in own if row["identifiability"] == kind]
              for kind in ("full", "combination", "none")}
        mass = next((row for row in own if row["name"] == f"{owner}.m"), None)
        found.append({"part": owner, "mass [kg]": "" if mass is None else f"{mass['nominal']:.5g}" + (
            "" if mass["prior_std"] is None else f" ± {mass['prior_std']:.4g}"), "alone": _listed(of["full"], 3),
            "combined": len(of["combination"]) or "", "none": len(of["none"]) or ""})
    return found


def hydraulics(rows: Sequence[Mapping[str, Any]]) -> str:
    """How many hydraulic parameters the machine states, and of what."""
    owners = list(dict.fromkeys(row["name"].rpartition(".")[0] for row in rows))
    return f"{len(rows)} hydraulic parameters are stated, of {_listed(owners, 6)}." if rows else ""


def calibration(lines: Sequence[str]) -> str:
    """What kinematic calibration there is, without what each stage identifies."""
    heads = [line.partition(":")[0] for line in lines if not line.startswith(" ")]
    return f"Kinematic calibration: {_listed(heads, 4)}." if heads else ""


def shortened(items: Sequence[Any], most: int = ROWS) -> tuple[Sequence[Any], str]:
    """The first of some rows or lines, and how many more there are, in words; one more than `most` is shown as well."""
    if len(items) <= most + 1:
        return items, ""
    return items[:most], f"… and {len(items) - most} more"


def _listed(names: Sequence[str], most: int) -> str:
    shown, more = shortened(names, most)
    return ", ".join(shown) + f" {more}" * bool(more)
