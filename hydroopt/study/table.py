"""The outcomes of a study's cells, in their order."""

from __future__ import annotations

import csv
import io
from dataclasses import dataclass

import numpy as np

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

    def column(self, name: str) -> Array:
        """A quantity (M,) of the M cells that succeeded, NaN where there is no number."""
        return np.array([result[name] for result in self.results], dtype=float)

    def where(self, values: Values) -> Table:
        """The cells that have these values."""
        chosen = [k for k, cell in enumerate(self.cells) if all(cell.get(key) == v for key, v in values.items())]
        return Table(tuple(self.cells[k] for k in chosen), tuple(self.outcomes[k] for k in chosen))

    def csv(self) -> str:
        """One line per cell; numbers to their last bit, an empty field where there is none."""
        given = list(dict.fromkeys(key for cell in self.cells for key in cell))
        found = list(dict.fromkeys(key for result in self.results for key in result))
        text = io.StringIO()
        writer = csv.writer(text, lineterminator="\n")
        writer.writerow(["cell", *given, "error", *found])
        for k, (cell, outcome) in enumerate(zip(self.cells, self.outcomes, strict=True)):
            result = outcome.get("result", {})
            writer.writerow([k, *map(cell.get, given), outcome.get("error"), *map(result.get, found)])
        return text.getvalue()
