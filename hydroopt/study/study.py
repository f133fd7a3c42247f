"""A study: many independent cells of one computation, each with a seed of its own."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from hydroopt.errors import HydrooptError
from hydroopt.support.packages import versions

Value = float | int | str | None
"""An input or output of a cell: a number, a word, or None where there is no number."""
Values = Mapping[str, Value]
Outcome = Mapping[str, Any]
"""Of one cell: ``{"result": {...}}``, or ``{"error": sentence}``."""


@dataclass(frozen=True, eq=False)
class Study:
    """A function and the cells for which it is computed.

    Attributes:
        name: of the kind of study.
        function: takes a cell's values by keyword and returns its result; it must be picklable. The result depends on
            these values alone. The function may cache what all cells of a process share.
        cells: values of each cell.
        settings: everything else that determines the results, as JSON: digests of the machine and of logs, options.
    """

    name: str
    function: Callable[..., Values]
    cells: tuple[Values, ...]
    settings: Mapping[str, Any]

    @cached_property
    def identity(self) -> dict[str, Any]:
        """What two runs must have in common so that one can resume the other."""
        cells = hashlib.sha256(json.dumps([dict(cell) for cell in self.cells]).encode()).hexdigest()
        identity = {"study": self.name, **self.settings, "cells": len(self.cells), "cells_sha256": cells,
                "versions": versions()}
        return dict(json.loads(json.dumps(identity)))


def seeds(seed: int, count: int) -> list[int]:
    """Seeds of independent random streams, one for each cell; below 2^53, so that JSON readers keep them exactly.

    >>> seeds(5, 3) == seeds(5, 10)[:3]
    True
    """
    return [int(np.random.SeedSequence(seed, spawn_key=(k,)).generate_state(1, np.uint64)[0] >> 11)
            for k in range(count)]


def outcome(function: Callable[..., Values], values: Values) -> Outcome:
    """What a study's function returns for a cell's values, or why it returns nothing.

    On one thread, so that it has the same bits wherever it is computed.

    >>> outcome(lambda x: {"half": x / 2}, {"x": 3})
    {'result': {'half': 1.5}}
    """
    os.environ["OMP_NUM_THREADS"] = "1"  # for compiled kernels
    with threadpool_limits(limits=1):
        try:
            return {"result": dict(function(**values))}
        except (HydrooptError, ArithmeticError, np.linalg.LinAlgError) as error:
            return {"error": str(error)}
