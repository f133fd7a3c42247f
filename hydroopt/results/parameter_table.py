"""The parameters of an answer as a table by name."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

from hydroopt.errors import ProblemError
from hydroopt.results.tables import csv_text, number, with_limits
from hydroopt.support.input_file import similar
from hydroopt.support.notebook_card import Card, CardTable, Shown, figure
from hydroopt.units import in_print

if TYPE_CHECKING:
    import pandas as pd


CATEGORIES = {"combination": "only in combination with others", "not excited": "not excited by the motion",
              "none": "without effect on the data", "fixed": "fixed",
              "stated": "from a constraint or prior that was added"}
"""What it means where a parameter has no value of its own."""


@dataclass(frozen=True, repr=False)
class ParameterRow:
    """One parameter of an answer, in SI; None where a number does not exist. `float` gives the value, or NaN.

    >>> row("boom.m", "mass", "kg", nominal=1830.0, value=1790.04, std=12.3, ci95=(1766.0, 1814.0))
    boom.m = 1790 ± 12 kg (95 %: 1766 … 1814)
    >>> row("boom.mc_z", "first moment", "kg*m", nominal=0.0, identifiability="combination")
    boom.mc_z: only in combination with others; the machine file states 0 kg*m

    Attributes:
        name: its address, e.g. ``boom.m``.
        kind: what it is, e.g. ``mass``.
        unit: SI.
        nominal: value in the machine file; `prior_std` its standard deviation there.
        value: the estimate, `std` its standard deviation and `ci95` its 95 % interval; None where the parameter is not
            identifiable.
        bound: name of the bound or constraint that holds it.
        identifiability: ``full``, ``combination``, ``not excited``, ``none``, ``stated`` or ``fixed``.
    """

    name: str
    kind: str
    unit: str
    nominal: float | None = None
    prior_std: float | None = None
    value: float | None = None
    std: float | None = None
    ci95: tuple[float, float] | None = None
    bound: str | None = None
    identifiability: str = "full"

    def __float__(self) -> float:
        return math.nan if self.value is None else self.value

    def __repr__(self) -> str:
        if self.value is None:
            stated = "" if self.nominal is None else f"; the machine file states {self.nominal:.6g} {self.unit}"
            return f"{self.name}: {CATEGORIES.get(self.identifiability, self.identifiability)}{stated}"
        at_bound = f", at {self.bound}" if self.bound else ""
        return f"{self.name} = {self.shown[0]}{self.spread} {self.unit}{self.interval}{at_bound}"

    @property
    def shown(self) -> tuple[str, ...]:
        """Value, std, low and high as texts, to the second digit of the standard deviation; "" of what is None."""
        numbers = (self.value, self.std, *(self.ci95 or (None, None)))
        if not self.std or self.value is None:
            return tuple("" if number is None else f"{number:.6g}" for number in numbers)
        decimals = 1 - math.floor(math.log10(self.std))
        if abs(decimals) > 9 or abs(self.value) >= 1e9:
            return tuple("" if number is None else f"{number:.4g}" for number in numbers)
        return tuple("" if number is None else f"{round(number, decimals):.{max(decimals, 0)}f}" for number in numbers)

    @property
    def spread(self) -> str:
        """`` ± std``; empty where there is none."""
        return f" ± {self.shown[1]}" if self.shown[1] else ""

    @property
    def interval(self) -> str:
        """`` (95 %: low … high)``; empty where there is none."""
        return f" (95 %: {self.shown[2]} … {self.shown[3]})" if self.ci95 else ""

    @property
    def information_from_data(self) -> float | None:
        """Part of the information that is from data, 1 − (std/prior_std)²: 0 where the prior alone speaks."""
        if self.std is None:
            return None
        if self.prior_std is None:
            return 1.0
        if not self.prior_std:
            return 0.0
        ratio = self.std / self.prior_std
        return max(0.0, 1.0 - ratio * ratio)  # a power would overflow

    def as_dict(self) -> dict[str, Any]:
        """The entry of a JSON file."""
        entry = asdict(self)
        entry["ci95"] = list(self.ci95) if self.ci95 else None
        return entry | {"information_from_data": self.information_from_data}


def row(name: str, kind: str, unit: str, *, nominal: float = math.nan, prior_std: float = math.nan,
        value: float = math.nan, std: float = math.nan, ci95: Sequence[float] = (math.nan, math.nan),
        bound: str = "", identifiability: str = "full") -> ParameterRow:
    """A row from numbers as estimators have them: NaN and "" become None."""
    low, high = (float(limit) for limit in ci95)
    return ParameterRow(name, str(kind), unit, number(nominal), number(prior_std), number(value), number(std),
                        (low, high) if math.isfinite(low) and math.isfinite(high) else None, bound or None,
                        identifiability)


class ParameterTable(Shown, Mapping[str, ParameterRow]):
    """Parameters by name, in their order.

    Example:
        >>> table = ParameterTable([row("boom.m", "mass", "kg", nominal=1830.0, value=1790.0, std=12.0)])
        >>> table["boom.m"].value
        1790.0
        >>> table
        ParameterTable of 1 parameter, 1 estimated
        >>> table.to_csv().splitlines()[1].split(",")[:3]
        ['boom.m', 'mass', 'kg']
    """

    def __init__(self, rows: Sequence[ParameterRow]) -> None:
        self.rows = tuple(rows)

    @cached_property
    def _by_name(self) -> dict[str, ParameterRow]:
        return {each.name: each for each in self.rows}

    def __getitem__(self, name: str) -> ParameterRow:
        try:
            return self._by_name[name]
        except KeyError:
            close = similar(name, self._by_name)
            raise ProblemError("no parameter has this name", where=f"parameter '{name}'",
                               remedy=f"did you mean {' or '.join(close)}") from None

    def __contains__(self, name: object) -> bool:
        return name in self._by_name

    def __iter__(self) -> Iterator[str]:
        return iter(self._by_name)

    def __len__(self) -> int:
        return len(self.rows)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, ParameterTable) and self.rows == other.rows

    def __hash__(self) -> int:
        return hash(self.rows)

    def __repr__(self) -> str:
        estimated = sum(each.value is not None for each in self.rows)
        return f"ParameterTable of {len(self)} parameter{'s' * (len(self) != 1)}, {estimated} estimated"

    def card(self) -> Card:
        """What a notebook shows: the estimated parameters, then those that are not."""
        return Card(repr(self), tables=self.card_tables())

    def card_tables(self) -> list[CardTable]:
        """The estimated parameters, and those that the data do not determine one by one, for a notebook."""
        known = [each for each in self.rows if each.value is not None]
        rows = [(each.name, *each.shown[:2], in_print(each.unit), " … ".join(each.shown[2:]) if each.ci95 else "",
                 "" if each.nominal is None else figure(each.nominal, 6), each.bound or "") for each in known]
        others = [(each.name, "" if each.nominal is None else figure(each.nominal, 6), in_print(each.unit),
                   CATEGORIES.get(each.identifiability, each.identifiability))
                  for each in self.rows if each.value is None]
        return [table for table in (
            CardTable(("parameter", "value", "±", "unit", "95 %", "machine file", "bound"), rows),
            CardTable(("parameter", "machine file", "unit", "identifiability"), others)) if table.rows]

    def to_csv(self) -> str:
        """Text of a CSV file: one row a parameter, the interval as `low` and `high`."""
        return csv_text([with_limits(each.as_dict()) for each in self.rows])

    def to_frame(self) -> pd.DataFrame:
        """A pandas DataFrame indexed by name, with the columns of the CSV file; NaN where a number does not exist."""
        import pandas as pd  # noqa: PLC0415 (import cost)

        columns = list(with_limits(ParameterRow("", "", "").as_dict()))
        return pd.DataFrame([with_limits(each.as_dict()) for each in self.rows], columns=columns).set_index("name")

