"""A study: many independent cells of one computation, each with a seed of its own."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from hydroopt.versions import versions

Value = float | int | str | None
"""What a cell takes and gives: a number, a word, or nothing where there is no number."""
Values = Mapping[str, Value]
Outcome = Mapping[str, Any]
"""Of one cell: ``{"result": {...}}``, or ``{"error": sentence}``."""


@dataclass(frozen=True, eq=False)
class Study:
    """What is computed in which cells.

    Attributes:
        name: of the kind of study.
        function: takes a cell's values by keyword and returns its result; it and what it holds can be pickled. The
            result depends on nothing but these values. What all cells of a process share it may keep to itself.
        cells: values of each cell.
        settings: all else that decides the results, as JSON would have it: digests of the machine and of logs, options.
    """

    name: str
    function: Callable[..., Values]
    cells: tuple[Values, ...]
    settings: Mapping[str, Any]

    @cached_property
    def identity(self) -> dict[str, Any]:
        """What two runs must have in common for one to go on where the other ended."""
        cells = hashlib.sha256(json.dumps([dict(cell) for cell in self.cells]).encode()).hexdigest()
        said = {"study": self.name, **self.settings, "cells": len(self.cells), "cells_sha256": cells,
                "versions": versions()}
        return dict(json.loads(json.dumps(said)))

    @cached_property
    def digest(self) -> str:
        """Of the identity."""
        return hashlib.sha256(json.dumps(self.identity, sort_keys=True).encode()).hexdigest()


def seeds(seed: int, count: int) -> list[int]:
    """Seeds of independent random streams, such as one for each cell; below 2^53, so that any reader keeps them."""
    return [int(np.random.SeedSequence(seed, spawn_key=(k,)).generate_state(1, np.uint64)[0] >> 11)
            for k in range(count)]
