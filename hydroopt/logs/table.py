"""Raw columns of a file as numbers or texts, their writing, and what all file formats have in common."""

import io
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hydroopt.errors import LogError, ProblemError
from hydroopt.logs.channels import si_unit
from hydroopt.logs.column_map import Key, LogMap
from hydroopt.logs.mapped import by_pieces, release
from hydroopt.logs.stamps import Stamps
from hydroopt.support.files import write_file
from hydroopt.support.packages import needed
from hydroopt.units import factor, largest

Array = NDArray[np.float64]
EXPANDED_LIMIT = 10 * 1000**3
"""Largest size in memory that a file may declare [bytes]."""


class NoNumbersError(LogError):
    """A column that holds something else than numbers."""


@dataclass(frozen=True)
class Table:
    """Raw columns by key, each (N,); `rows` (N,) 1-based data rows; `damage`: why a row cannot be trusted.

    `texts` are the columns (N,) that were asked for as texts, '' where a cell is empty; `stamps` the time, where it is
    a date, an epoch or the file's own; `lines` (N,) the 1-based lines of a file of text.
    """

    columns: dict[Key, Array]
    rows: NDArray[np.int64]
    damage: dict[int, str] = field(default_factory=dict)
    texts: dict[Key, list[str]] = field(default_factory=dict)
    stamps: Stamps | None = None
    lines: NDArray[np.int64] | None = None


def in_si(layout: LogMap, table: Table, where: str) -> tuple[dict[str, Array], dict[str, str]]:
    """Channels (N,) of a map in SI, the time `t` among them, and the SI unit of each but the time.

    Rows with numbers beyond any machine become part of the table's damage.
    """
    values: dict[str, Array] = {}
    units: dict[str, str] = {}
    made = stamps_of(layout, table)
    for name, column in layout.columns.items():
        if name == "t" and made is not None:
            values["t"] = made.seconds()
            continue
        if name == "t" and not column.unit:
            raise LogError("the time is neither dates nor has a unit", where=where,
                           remedy="name its column 't [s]' or state its 'unit' in the map")
        si = si_unit(name, column.unit)
        raw = [table.columns[key] for key in column.keys]
        scale, shift = column.factor * factor(column.unit, si), column.shift(si, where)
        with np.errstate(over="ignore", invalid="ignore"):
            values[name] = raw[0] if (len(raw), scale, shift) == (1, 1, 0) else by_pieces(
                len(table.rows), partial(_scaled, raw, scale, shift))
        most = largest(si)
        if not (-most <= values[name].min(initial=0.0) and values[name].max(initial=0.0) <= most):  # or one is NaN
            beyond = ~(np.abs(values[name]) <= most) & np.all(np.isfinite(raw), axis=0)
            if name == "t" and table.stamps is not None and np.count_nonzero(beyond) > beyond.size // 2:
                raise LogError(f"the time is stated in {column.unit}, but its numbers are an epoch in "
                               f"{table.stamps.unit}", where=where, remedy=f"state its unit as {table.stamps.unit}")
            for row in table.rows[beyond]:
                table.damage.setdefault(int(row), f"{name} beyond {most:g} {si}")
        units[name] = si
        release()
    return values, {name: unit for name, unit in units.items() if name != "t"}


def _scaled(raw: Sequence[Array], scale: float, shift: float, span: slice) -> Array:
    """A part of a channel: factor × (column − minus) + offset, or the offset alone."""
    if not raw:
        return np.full(span.stop - span.start, shift)
    return scale * (raw[0][span] if len(raw) == 1 else raw[0][span] - raw[1][span]) + shift


def stamps_of(layout: LogMap, table: Table) -> Stamps | None:
    """The stamps of a table's time; None where it is numbers, in the unit that the map states, that are no epoch."""
    made, column = table.stamps, layout.columns.get("t")
    if made is None or column is None or not made.unit:
        return made
    plain = column.factor == 1 and column.minus is column.offset is None
    return made if plain and factor(column.unit, "s") == factor(made.unit, "s") else None


def refuse_damage(table: Table, where: str) -> None:
    """Raise a LogError if there is damage, naming its first line and the longest sound segment of all rows."""
    damage, every = table.damage, table.rows
    if not damage:
        return
    rows = np.array(sorted(damage))
    if table.lines is not None:
        where = f"{where}, line {table.lines[np.searchsorted(every, rows[0])]}"
    fences = np.concatenate([[every[0] - 1], rows, [every[-1] + 1]])
    longest = int(np.argmax(np.diff(fences)))
    start, stop = int(fences[longest]) + 1, int(fences[longest + 1]) - 1
    reasons: dict[str, list[int]] = {}
    for row in rows:
        reasons.setdefault(damage[int(row)], []).append(int(row))
    shown = "; ".join(f"{runs(which)}: {reason}" for reason, which in list(reasons.items())[:4])
    noun = "row" if rows.size == 1 else "rows"
    trim = f"trim it with 'rows = [{start}, {stop}]' in a map, or " if stop > start else ""
    raise LogError(f"data {noun} {runs(rows)} {'is' if rows.size == 1 else 'are'} damaged ({shown})",
                   where=where,
                   remedy=f"{trim}correct the file")


def frozen(values: ArrayLike, kind: type) -> NDArray[Any]:
    """A copy of `values` as an array of `kind` that cannot be written to; they themselves, if they are one."""
    if type(values) is np.ndarray and values.dtype == kind and not values.flags.writeable and not (
            isinstance(values.base, np.ndarray) and values.base.flags.writeable):
        return values
    array: NDArray[Any] = np.array(values, dtype=kind)
    array.setflags(write=False)
    return array


def write_columns(path: str | Path, columns: Mapping[str, NDArray[Any]], what: str) -> None:
    """Write columns (N,) by header as CSV or Parquet, by extension; complete or not at all, NaN as an empty cell.

    Raises:
        LogError: another extension, or the file cannot be written; the sentence calls it `what`.
    """
    target = Path(path)
    if target.suffix.lower() not in (".csv", ".parquet"):
        raise LogError(f"'{target.suffix}' is not a kind of {what} that can be written", where=str(path),
                       remedy="use .csv or .parquet")
    try:
        write_file(target, encoded_columns(columns, parquet=target.suffix.lower() == ".parquet"))
    except ProblemError as error:
        raise LogError(f"the {what} {error.what}", where=str(path), remedy=error.remedy) from None


def encoded_columns(columns: Mapping[str, NDArray[Any]], *, parquet: bool = False) -> bytes:
    """Content of a CSV or Parquet file of columns (N,) by header, NaN as an empty cell."""
    if parquet:
        arrow = needed("pyarrow", "Parquet files are written with pyarrow", where="output", error=LogError)
        table = arrow.table({name: arrow.array(column, from_pandas=True) for name, column in columns.items()})
        file = io.BytesIO()
        needed("pyarrow.parquet", "Parquet files are written with pyarrow", where="output").write_table(table, file)
        return file.getvalue()
    rows = zip(*map(_cells, columns.values()), strict=True)
    return "".join(f"{','.join(row)}\n" for row in (columns, *rows)).encode()


def _cells(column: NDArray[Any]) -> list[str]:
    """Cells of a CSV file: numbers with all of their digits, NaN empty, texts in quotation marks."""
    if column.dtype.kind not in "fiu":
        return ['"{}"'.format(str(cell).replace('"', '""')) for cell in column.tolist()]
    return ["" if math.isnan(value) else repr(value).removesuffix(".0") for value in column.tolist()]


def runs(rows: Sequence[int] | NDArray[np.int64], most: int = 4) -> str:
    """Row numbers in words, neighbours joined: ``2–10, 6107``.

    >>> runs([6107, *range(2, 11)]), runs(range(0, 40, 2), 1)
    ('2–10, 6107', '0 and 19 more stretches')
    """
    numbers = np.unique(np.asarray(rows))
    ends = np.flatnonzero(np.diff(numbers, append=np.inf) > 1)
    firsts = numbers[np.concatenate([[0], ends[:-1] + 1])]
    words = [str(a) if a == b else f"{a}–{b}" for a, b in zip(firsts[:most], numbers[ends[:most]], strict=True)]
    return ", ".join(words) + (f" and {len(ends) - most} more stretches" if len(ends) > most else "")


def selected(count: int, rows: tuple[int, int] | None, where: str) -> NDArray[np.int64]:
    """1-based data rows that a map selects of `count`."""
    first, last = rows or (1, count)
    if last > count:
        raise LogError(f"rows {first} to {last} are asked for, but there are {count} data rows",
                       where=where,
                       remedy="correct 'rows' in the map")
    return by_pieces(last - first + 1, lambda span: np.arange(first + span.start, first + span.stop), int)


def check_size(size: float, where: str) -> None:
    """Refuse a file that declares more than EXPANDED_LIMIT bytes."""
    if size > EXPANDED_LIMIT:
        raise LogError(f"the file declares {size / 1e9:.3g} GB of data", where=where,
                       remedy="check that it is undamaged, or split it")


def unreadable(kind: str, where: str, error: BaseException) -> LogError:
    """The error for a file that its library cannot read."""
    reason = (str(error).strip().splitlines() or [type(error).__name__])[0][:120].rstrip(".")
    return LogError(f"this is not a readable {kind} file ({reason})", where=where,
                    remedy="export it again or name the file after its true format")
