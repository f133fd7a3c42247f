"""Headers `name [unit]`: every channel is found whatever the spaces, and any other header is refused or left out."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from hydroopt.errors import LogError
from hydroopt.logs.column_headers import map_of_header
from hydroopt.machine.quantity import CHANNEL_UNITS

SPACES = st.text(" \t", max_size=3)
NAMES = st.from_regex(r"[A-Za-z][A-Za-z0-9_]{0,8}", fullmatch=True)
CHANNELS = st.tuples(NAMES, st.sampled_from(sorted(CHANNEL_UNITS)))


@st.composite
def headers(draw: st.DrawFn) -> tuple[list[str], dict[str, str]]:
    """Cells of a header in any order, and the unit of each channel."""
    units = {"t": draw(st.sampled_from(["s", "ms"]))}
    for part, kind in draw(st.lists(CHANNELS, max_size=5, unique=True)):
        units[f"{part}.{kind}"] = draw(st.sampled_from(CHANNEL_UNITS[kind]))
    cells = [f"{draw(SPACES)}{name}{draw(SPACES)}[{draw(SPACES)}{unit}{draw(SPACES)}]{draw(SPACES)}"
             for name, unit in units.items()]
    return list(draw(st.permutations(cells))), units


@given(headers())
def test_channels_and_units_are_those_of_the_header(made: tuple[list[str], dict[str, str]]) -> None:
    cells, units = made
    layout, ignored = map_of_header(cells, "log.csv")
    assert not ignored
    assert {name: column.unit for name, column in layout.columns.items()} == units
    assert all(cells[column.column].strip().startswith(name) for name, column in layout.columns.items())


@given(st.lists(st.text(max_size=20), max_size=4), st.booleans())
def test_any_header_is_read_or_refused_with_its_place(cells: list[str], poses: bool) -> None:
    refused = None
    try:
        layout, ignored = map_of_header(["t [s]", *cells], "log.csv", poses=poses)
    except LogError as error:
        refused = error
    if refused is not None:
        assert refused.where.startswith("log.csv")
        assert refused.remedy
    elif not poses:
        assert len(layout.columns) + len(ignored) == 1 + len(cells)
