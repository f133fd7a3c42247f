"""The audit of the thesis: every section, equation, table and figure has a row, and every path in it exists."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
SECTIONS = re.findall(r"[\d.]+", """
    1.1 1.2 1.2.1 1.2.2 1.3 1.4 1.5 2.1 2.2 2.3 2.3.1 2.3.2 2.4 2.4.1 2.4.2 2.5 3.1 3.2 3.3 3.3.1 3.3.2 3.3.3 3.4 3.4.1
    3.4.2 3.4.3 3.4.4 3.5 3.5.1 3.5.2 3.6 3.6.1 3.6.2 3.6.3 3.6.4 3.7 3.7.1 3.7.2 3.7.3 3.8 3.8.1 3.8.2 3.8.3 4.1 4.2
    4.3 4.3.1 4.3.2 4.3.3 4.3.4 4.3.5 4.4 4.4.1 4.4.2 4.4.3 4.5 4.6 5.1 5.2 5.3""")
THESIS = ([f"Section {number}" for number in SECTIONS]
          + [f"Eq. {chapter}.{k}" for chapter, last in ((3, 46), (4, 61)) for k in range(1, last + 1)]
          + [f"Table {k}" for k in range(1, 18)] + [f"Figure {k}" for k in range(1, 38)])
VERDICTS = {"same", "better", "different", "partial", "missing", "background"}


def rows() -> list[list[str]]:
    text = (ROOT / "docs/thesis.md").read_text("utf-8")
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in text.splitlines()
            if re.match(r"\| (Section|Eqs?\.|Table|Figures?) ", line)]


def items(cell: str) -> list[str]:
    """What a first cell names: ``Eqs. 3.2 to 3.4``, ``Figures 9, 10``, ``Table 1``."""
    kind, _, rest = cell.partition(" ")
    kind = {"Eqs.": "Eq.", "Figures": "Figure"}.get(kind, kind)
    found = []
    for part in rest.split(", "):
        first, _, last = part.partition(" to ")
        head, _, low = first.rpartition(".")
        high = (last or first).rpartition(".")[2]
        found += [f"{kind} {head}.{k}".replace(" .", " ") for k in range(int(low), int(high) + 1)]
    return found


def test_every_item_of_the_thesis_has_one_row() -> None:
    found = [item for row in rows() for item in items(row[0])]
    assert sorted(found) == sorted(THESIS)


@pytest.mark.parametrize("row", rows(), ids=lambda row: row[0])
def test_a_row_names_what_exists_and_says_why_it_differs(row: list[str]) -> None:
    _, subject, here, verdict, why = row
    assert subject
    assert verdict in VERDICTS
    assert why or verdict in ("same", "background", "better")
    paths = re.findall(r"`([^`]+)`", here)
    assert paths or verdict == "missing"
    assert [path for path in paths if not (ROOT / path).exists()] == []
    for path in re.findall(r"`((?:hydroopt|studies|models|docs|tests)/[^`]+)`", why):
        assert (ROOT / path).exists()


def test_items_that_the_studies_show_are_named_there() -> None:
    """A study that a table's row names speaks of that table."""
    for row in rows():
        number = re.fullmatch(r"Table (\d+)", row[0])
        for study in re.findall(r"`(studies/\w+)`", row[2]) if number else ():
            text = " ".join((ROOT / study / name).read_text("utf-8") for name in ("README.md", "run.py"))
            named = {int(k) for part in re.findall(r"Tables? ([\d, toand]+)", text) for k in expanded(part)}
            assert int(number[1]) in named, (row[0], study)


def expanded(text: str) -> list[int]:
    """Numbers of ``4 to 6, 11 and 12``."""
    text = re.sub(r"(\d+) to (\d+)", lambda m: " ".join(map(str, range(int(m[1]), int(m[2]) + 1))), text)
    return [int(k) for k in re.findall(r"\d+", text)]
