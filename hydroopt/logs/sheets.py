"""Which channels stand in which sheet of a file, or in which of several files, and with which clock."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hydroopt.errors import LogError
from hydroopt.logs.clock import Clock
from hydroopt.logs.column_headers import map_of_header, parts_of
from hydroopt.logs.column_map import ClockMap, ColumnMap, Key, LogMap
from hydroopt.logs.formats.sheet import Sheet
from hydroopt.logs.quality import Finding, out_of_order
from hydroopt.logs.stamps import of_texts
from hydroopt.logs.table import Array, Table, in_si, refuse_damage, stamps_of


class Columns(NamedTuple):
    """Times (N,) [s], channels (N,) and their units in SI, 1-based data rows (N,), the moment of t = 0, what was done.
    """

    t: Array
    values: dict[str, Array]
    units: Mapping[str, str]
    rows: NDArray[np.int64]
    start: np.datetime64 | None
    notes: tuple[Finding, ...]


@dataclass(frozen=True)
class Part:
    """Columns of a sheet that have one clock.

    Attributes:
        name: of the group.
        where: the file, and the sheet if it has several.
        sheet: that holds the columns; `layout`: the map of these columns alone.
        ignored: columns that are no channels.
        clock: what its stamps lack; `start`: moment of t = 0 as a text, or empty.
        padded: whether rows without time and numbers are the end of shorter columns.
    """

    name: str
    where: str
    sheet: Sheet
    layout: LogMap
    ignored: tuple[str, ...] = ()
    clock: Clock = field(default_factory=Clock)
    start: str = ""
    padded: bool = False

    @property
    def time(self) -> Key | None:
        """The raw column of the time; None of a sheet with stamps of its own."""
        column = self.layout.columns.get("t")
        return column.keys[0] if column is not None and column.keys else None

    def read(self) -> Columns:
        """Its channels, in SI.

        Raises:
            LogError: rows are damaged, a unit is of another kind, or there is only one row.
        """
        where, layout = self.where, self.layout
        table = self.sheet.read(layout.keys, time=self.time)
        values, units = in_si(layout, table, where)
        made = stamps_of(layout, table)
        t = values.pop("t") if "t" in values else (
            made.seconds() if made is not None else np.full(table.rows.size, np.nan))
        _refuse_damage(table, t, where)
        if table.rows.size < 2:
            raise LogError("there is only one data row", where=where, remedy="record at least two samples")
        first, last = int(table.rows[0]), int(table.rows[-1])
        notes = [Finding(kind, channel, first, last, count, text) for kind, channel, count, text in (
            ("rows", "t", table.rows.size, layout.rows and f"only data rows {first} to {last} were read"),
            ("ignored", "", 0, self.ignored and f"columns that are not channels left out: {', '.join(self.ignored)}"),
            ("format", "", 0, self.sheet.shown and f"the file was read with {self.sheet.shown}"),
            ("clock", "t", 0, made.shown if made is not None else "")) if text]
        start = of_texts([self.start], None, where).start if self.start else made.start if made is not None else None
        return Columns(t, values, units, table.rows, start, tuple(notes))


def parts_without_map(sheets: Sequence[Sheet], where: str) -> list[Part]:
    """The parts of sheets whose headers are `name [unit]`; those of several without a channel are left out.

    Raises:
        LogError: there is no channel, or no time.
    """
    parts = []
    for sheet in sheets:
        if len(sheets) == 1 or any("." in name and unit for name, unit in map(parts_of, sheet.header)):
            layout, ignored = map_of_header(sheet.header, sheet.where, timed=sheet.own_stamps)
            if layout.columns.keys() - {"t"}:
                parts.append(Part(sheet.name, sheet.where, sheet, layout, ignored))
    if not parts:
        shown = ", ".join(f"'{name}'" for sheet in sheets for name in sheet.header[:4])
        raise LogError(f"no column is a channel with a unit, such as 'boom.q [deg]' (present: {shown[:200]})",
                       where=where, remedy="give a map of the columns with --map, which hydroopt map proposes")
    return parts


def parts_of_map(layout: LogMap, sheets: Sequence[Sheet], where: str) -> list[Part]:
    """The parts of sheets that a map names.

    Raises:
        LogError: a column stands in no sheet or in several, or there is no time.
    """
    mapped = {channel: column for channel, column in layout.columns.items() if channel != "t"}
    if not mapped:
        raise LogError("its map names no channel", where=where, remedy="write in it which column is which channel, in "
                       "which unit, and remove the # before it")
    names = [sheet.name for sheet in sheets]
    found: dict[tuple[int, str], set[str]] = {}
    for channel, column in mapped.items():
        if column.keys:
            k = _sheet_of(column, channel, layout, sheets, where)
            clock = column.group if column.group is not None and column.group not in names else names[k]
            found.setdefault((k, clock), set()).add(channel)
    parts: list[Part] = []
    for (k, name), channels in found.items() or [((0, names[0]), set[str]())]:
        sheet, stated = sheets[k], layout.clocks.get(name, ClockMap())
        ordered = {channel: column for channel, column in mapped.items()  # constants stand in the first part
                   if channel in channels or not (column.keys or parts)}
        if (time := _time_of(sheet, stated, layout, alone=len(sheets) == 1)) is not None:
            ordered = {"t": time} | ordered
        parts.append(Part(name, sheet.where, sheet, layout.model_copy(update={"columns": ordered}), (),
                          Clock.of(stated.delay, stated.drift), stated.start or "", stated.t is not None))
    if unknown := set(layout.clocks) - {part.name for part in parts}:
        raise LogError(f"there is no group '{min(unknown)}' (present: {', '.join(repr(part.name) for part in parts)})",
                       where=where, remedy="correct the name in [clocks]")
    return parts


def _sheet_of(column: ColumnMap, channel: str, layout: LogMap, sheets: Sequence[Sheet], where: str) -> int:
    """Index of the sheet in which a column stands."""
    named = [k for k, sheet in enumerate(sheets) if sheet.name == column.group]
    if column.group is not None and not named and column.group not in layout.clocks:
        present = ", ".join(f"'{sheet.name}'" for sheet in sheets[:20])
        raise LogError(f"there is no group '{column.group}' for '{channel}' (present: {present})", where=where,
                       remedy="correct 'group' in the map, or add the clock")
    holding = named or list(range(len(sheets)))
    if len(holding) > 1:
        holding = [k for k in holding if all(map(sheets[k].holds, column.keys))]
    if len(holding) == 1:
        return holding[0]
    shown = f"column {column.column!r}"
    if not holding:
        present = ", ".join(name for sheet in sheets for name in sheet.header)
        raise LogError(f"there is no {shown} (present are {present[:160]})", where=where,
                       remedy="correct the name in the map")
    raise LogError(f"{shown} of '{channel}' stands in {', '.join(repr(sheets[k].name) for k in holding[:4])}",
                   where=where, remedy=f"state group = '{sheets[holding[0]].name}' or another one of them in the map")


def _time_of(sheet: Sheet, clock: ClockMap, layout: LogMap, *, alone: bool) -> ColumnMap | None:
    """The column of the time of a sheet; None where it has stamps of its own.

    Raises:
        LogError: it has neither.
    """
    if clock.t is not None:
        return clock.t
    common = layout.columns.get("t")
    if common is not None and (alone or not common.keys or all(sheet.holds(key) for key in common.keys)):
        return common
    if sheet.own_stamps:
        return None
    raise LogError("channel 't' is missing" + ("" if alone else f" in '{sheet.name}'"), where=sheet.where,
                   remedy="map the column of the time" + ("" if alone else f", as t in [clocks.\"{sheet.name}\"]"))


def _refuse_damage(table: Table, t: Array, where: str) -> None:
    """Refuse rows that are cut or hold garbage; then also name those whose time is astray.

    Raises:
        LogError: names the rows and the longest sound stretch.
    """
    if not table.damage:
        return
    damage, sound = dict(table.damage), np.isfinite(t)
    for row in table.rows[sound][out_of_order(t[sound])]:
        damage.setdefault(int(row), "time out of order")
    refuse_damage(replace(table, damage=damage), where)
