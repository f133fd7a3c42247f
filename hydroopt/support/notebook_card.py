"""What a notebook shows of an object: a card of HTML that takes its colours and fonts from the page around it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from html import escape
from importlib import import_module
from typing import Any, NamedTuple

from hydroopt.errors import visible

_KEPT = "\n\N{NARROW NO-BREAK SPACE}"


class CardTable(NamedTuple):
    """Texts in rows under the names of their columns."""

    columns: Sequence[str]
    rows: Sequence[Sequence[str]]


@dataclass(frozen=True)
class Card:
    """A title, facts by name, tables, and a longer text that folds away.

    >>> print(Card("Log <run>", {"samples": "100"}).html())
    <div style="line-height:1.4"><strong>Log &lt;run&gt;</strong>...<td>samples</td>...<td>100</td>...</div>
    """

    title: str
    facts: Mapping[str, str] = field(default_factory=dict)
    tables: Sequence[CardTable] = ()
    text: str = ""

    def html(self) -> str:
        """The card as a fragment of HTML, without colours, scripts, or anything from outside."""
        parts = [f"<strong>{_text(self.title)}</strong>"]
        if self.facts:
            parts.append(_table((), list(self.facts.items())))
        parts += [_table(*table) for table in self.tables if table.rows]
        if self.text:
            parts.append(f'<details><summary>as text</summary><pre style="overflow-x:auto">{_text(self.text)}</pre>'
                         "</details>")
        return f'<div style="line-height:1.4">{"".join(parts)}</div>'


class Shown:
    """An object that notebooks show as its `card`."""

    def card(self) -> Card:
        """What a notebook shows of it: by default its repr, and its longer text where it has one."""
        title, text = repr(self), str(self)
        return Card(title, text="" if text == title else text)

    def _repr_html_(self) -> str:
        return self.card().html()


class Drawn(Shown):
    """An object that also has figures and a page.

    What draws them stands above everything that can be drawn, and is loaded by its name when it is asked for.
    """

    @property
    def plot(self) -> Any:
        """Its figures, see `hydroopt.plots.Plots`."""
        return import_module("hydroopt.plots").Plots(self)

    def view(self) -> Any:
        """Its page, which notebooks show below the cell, see `hydroopt.view`."""
        return import_module("hydroopt.viewing").view(self)


def figure(value: float, digits: int = 4) -> str:
    """A number in a card to some significant digits, with thousands apart.

    >>> figure(4515600.0, 3), figure(-0.0234891)
    ('4\u202f520\u202f000', '-0.02349')
    """
    return f"{float(f'{value:.{digits}g}'):,.15g}".replace(",", "\N{NARROW NO-BREAK SPACE}")


def _text(text: str) -> str:
    return escape(visible(text, keep=_KEPT))


def _table(columns: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A table without columns that are empty in all its rows, which scrolls where it is long."""
    import pandas as pd  # noqa: PLC0415 (import cost)

    frame = pd.DataFrame([[visible(cell, keep=_KEPT) for cell in row] for row in rows],
                         columns=[visible(name) for name in columns] or None)
    with pd.option_context("display.max_colwidth", None):
        made = frame.loc[:, frame.ne("").any().to_numpy()].to_html(
            header=bool(columns), index=False, border=0, justify="left", max_rows=len(rows))
    return f'<div style="overflow:auto;max-height:24em;text-align:left">{made}</div>'
