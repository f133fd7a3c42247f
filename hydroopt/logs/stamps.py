"""Time stamps at their own resolution: dates, epochs and counters as integers, and seconds from the first of them."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from decimal import Decimal, InvalidOperation
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from hydroopt.errors import LogError
from hydroopt.logs.mapped import by_pieces
from hydroopt.units import factor

if TYPE_CHECKING:
    import pandas as pd

EPOCHS = {"s": 1, "ms": 10**3, "us": 10**6, "ns": 10**9}
"""Ticks per second of the epochs that are in use."""
YEARS_2001_TO_2040 = (978_307_200, 2_208_988_800)
"""Seconds since 1970 (UTC) between which a number counts as a date: no machine runs for so long."""
_DATES = {"%Y-%m-%d": r"\d{4}-\d{1,2}-\d{1,2}", "%Y/%m/%d": r"\d{4}/\d{1,2}/\d{1,2}",
          "%d.%m.%Y": r"\d{1,2}\.\d{1,2}\.\d{4}"}
_MOMENT = re.compile(rf"(?P<date>{'|'.join(_DATES.values())}|\d{{1,2}}[/-]\d{{1,2}}[/-]\d{{4}})?"
                     r"(?:[T ]\s*|(?<=\d),\s*)?(?P<time>\d{1,2}:[0-5]\d(?::[0-5]\d(?:[.,]\d{1,9})?)?)?"
                     r"\s*(?P<half>[AaPp]\.?[Mm]\.?)?\s*(?P<zone>Z|UTC|[+-]\d{2}:?\d{2})?")


class DateOrderError(LogError):
    """Dates of which the day or the month may come first."""


@dataclass(frozen=True)
class Stamps:
    """Times (N,) as integers.

    Attributes:
        moments: (N,) datetime64 in UTC, or timedelta64 of stamps without a date; NaT where there is no stamp.
        shown: what was taken of them, in a sentence; empty where nothing was.
        unit: that of the numbers which were taken for an epoch; empty of dates.
    """

    moments: NDArray[Any]
    shown: str = ""
    unit: str = ""

    @property
    def start(self) -> np.datetime64 | None:
        """The first moment in UTC, as datetime64[ns]; None of stamps without a date."""
        if self.moments.dtype.kind != "M" or np.isnat(self.moments).all():
            return None
        first: np.datetime64 = self.moments[np.argmin(np.isnat(self.moments))].astype("M8[ns]")
        return first

    def seconds(self) -> NDArray[np.float64]:
        """Times (N,) [s], of dates from the first one on, NaN where missing; subtracted as integers.

        >>> Stamps(np.array([1700000000123456789, 1700000000123456790], "M8[ns]")).seconds().tolist()
        [0.0, 1e-09]
        """
        first = self.moments[np.argmin(np.isnat(self.moments))] if self.moments.dtype.kind == "M" else np.timedelta64(0)
        return by_pieces(self.moments.size, lambda span: (self.moments[span] - first) / np.timedelta64(1, "s"))


def dated_as(values: NDArray[Any], unit: str) -> bool:
    """Whether numbers (N,) in a unit of time can only be an epoch.

    >>> dated_as(np.array([1.7e12]), "ms"), dated_as(np.array([1.7e9]), "ms")
    (True, False)
    """
    seconds = np.abs(values.astype(float)) * factor(unit, "s")
    seconds = np.minimum(seconds[np.isfinite(seconds)], 2 * YEARS_2001_TO_2040[1])  # whose sum is finite, too
    return bool(seconds.size and YEARS_2001_TO_2040[0] <= np.median(seconds) <= YEARS_2001_TO_2040[1])


def of_column(values: NDArray[Any]) -> Stamps | None:
    """Stamps of datetime64 in UTC, timedelta64, or numbers (N,) that are an epoch of this age; None of other numbers.
    """
    if values.dtype.kind in "mM":
        return Stamps(values)
    unit = epoch_unit(values)
    if unit is None:
        return None
    if values.dtype.kind in "iu":
        return epoch(values.astype(np.int64).view(f"M8[{unit}]"), unit)
    scale, sound = 10**9 // EPOCHS[unit], np.isfinite(values)
    numbers = np.where(sound, values, 0)
    whole = np.floor(numbers)
    ticks = whole.astype(np.int64) * scale + np.round((numbers - whole) * scale).astype(np.int64)
    resolved = np.spacing(float(np.nanmedian(values))) / EPOCHS[unit]
    return epoch(np.where(sound, ticks.view("M8[ns]"), np.datetime64("NaT")), unit,
                 f"; its numbers resolve {resolved:.2g} s")


def epoch(moments: NDArray[Any], unit: str, more: str = "") -> Stamps:
    """Stamps of an epoch in a unit."""
    sound = np.sort(moments[~np.isnat(moments)])
    about = sound[sound.size // 2].astype("M8[s]")
    return Stamps(moments, f"the time is an epoch in {unit}, about {about} UTC; t = 0 at its first sample{more}", unit)


def epoch_unit(values: NDArray[Any]) -> str | None:
    """The unit in which numbers (N,) are dates of this age; None where they are none.

    >>> epoch_unit(np.array([1700000000000, 1700000000020]))
    'ms'
    """
    if values.size and max(-float(np.fmin.reduce(values)), float(np.fmax.reduce(values))) < YEARS_2001_TO_2040[0]:
        return None  # too few even in seconds, as nearly all are
    return next((unit for unit in EPOCHS if dated_as(values, unit)), None)


def exact_moment(text: str, unit: str) -> np.datetime64:
    """An epoch as a text to nanoseconds, with all of its digits up to those; NaT of one that is empty or absurd.

    >>> exact_moment("1700000000.123456789", "s")
    np.datetime64('2023-11-14T22:13:20.123456789')
    """
    try:
        return np.datetime64(int(Decimal(text.strip()) * (10**9 // EPOCHS[unit])), "ns")
    except (InvalidOperation, ValueError, OverflowError):
        return np.datetime64("NaT", "ns")


def looks_dated(cell: str) -> bool:
    """Whether a cell can be a date or a time of day.

    >>> looks_dated("2026-11-23T04:20:00.123Z"), looks_dated("12.5")
    (True, False)
    """
    match = _MOMENT.fullmatch(cell.strip())
    return bool(match and (match["date"] or match["time"]) and not (match["half"] and not match["time"]))


def of_texts(cells: Sequence[str], order: str | None, where: str,
             place: Callable[[int], str] = "data row {}".format) -> Stamps:
    """Stamps of dates and times as texts: ISO 8601, ``23.11.2026 04:20:00,5``, or with `order` ``11/23/2026 4:20 PM``.

    Args:
        cells: (N,) texts; empty ones are missing.
        order: "day first" or "month first", where dates need it.
        where: the file; `place`: what a sentence calls the place of a cell in it, by its index.

    A time of day alone counts from midnight, and goes on at the next one. A moment without a zone counts as UTC.

    Raises:
        LogError: a cell is no moment, or the order of day and month can be either.

    >>> of_texts(["2026-11-23 04:20:00,000000001", "2026-11-23 04:20:00,000000003"], None, "t").seconds().tolist()
    [0.0, 2e-09]
    """
    import pandas as pd  # noqa: PLC0415 (import cost)

    texts = pd.Series(cells, dtype=object).str.strip()
    full = texts.ne("")
    first = next((text for text in texts if text), "")
    if not looks_dated(first):
        raise LogError(f"'{first:.40}' is neither a number nor a date", where=where,
                       remedy="write it as in 2026-11-23T04:20:00.125, or in seconds")
    parts = texts.str.extract(f"^{_MOMENT.pattern}$")[["date", "time", "half", "zone"]]
    usual = parts[full].notna().mean() >= 0.5
    moments, shown = _since_midnight(parts, dated=usual.date), "the time is a time of day"
    if usual.date:
        dates = parts.date.dropna().to_list()
        form = next((form for form, pattern in _DATES.items() if re.fullmatch(pattern, dates[0])), None)
        form = form or _either_form(dates, order, where)
        days = pd.to_datetime(parts.date, format=form, errors="coerce")
        moments += days.where(days.dt.year.between(1678, 2261)).astype("datetime64[ns]")  # as long as 64 bits reach
        order = {"%d": "day first", "%m": "month first", "%Y": "year first"}[form[:2]]
        shown = f"the time is a date, {order}{'' if usual.zone else ', without a zone: taken as UTC'}"
    wrong = full & (moments.isna() | (parts.notna() != usual).any(axis=1))
    if wrong.any():
        k = int(wrong.idxmax())
        raise LogError(f"'{cells[k]:.40}' is no {'date' if usual.date else 'time of day'} such as '{first:.40}'",
                       where=f"{where}, {place(k)}", remedy="write all of them in one form, or give seconds")
    if not usual.date:
        moments = moments[full]
        moments += pd.Timedelta(days=1) * (moments.diff() < -pd.Timedelta(hours=12)).cumsum() - moments.iloc[0]
    return Stamps(moments.reindex(texts.index).to_numpy(), f"{shown}; t = 0 at its first sample")


def _since_midnight(parts: pd.DataFrame, *, dated: bool) -> pd.Series:
    """Times of day (N,) in UTC by their parts, NaT of what is none; those without a date may count on beyond a day."""
    import pandas as pd  # noqa: PLC0415 (import cost)

    hour = pd.Timedelta(hours=1)
    clock = parts.time.str.replace(",", ".")
    since = pd.to_timedelta(clock.mask(clock.str.count(":") == 1, clock + ":00").fillna("00:00:00"), errors="coerce")
    since = since.where(since < 24 * hour if dated else since.notna())
    afternoon = parts.half.str.upper().str[0].map({"A": 0.0, "P": 12.0})
    since = since.mask(parts.half.notna(), since.where(since.between(hour, 13 * hour, inclusive="left")) % (12 * hour)
                       + afternoon * hour)
    if not dated or parts.zone.isna().all():
        return since
    zone = parts.zone.replace({"Z": "+0000", "UTC": "+0000"}).str.replace(r"(\d\d):?(\d\d)", r"\1:\2:00", regex=True)
    return since - pd.to_timedelta(zone)


def _either_form(cells: Sequence[str], order: str | None, where: str) -> str:
    """The form of dates such as 03/04/2026; the one order that all of them allow, or the stated one."""
    mark = "/" if "/" in cells[0] else "-"
    forms = {"day first": f"%d{mark}%m{mark}%Y", "month first": f"%m{mark}%d{mark}%Y"}
    if order is not None:
        return forms[order]
    pairs = {tuple(map(int, cell.split(mark)[:2])) for cell in cells if cell.count(mark) == 2}
    allowed = [name for name, place in (("day first", 1), ("month first", 0)) if all(p[place] <= 12 for p in pairs)]
    if len(allowed) != 1:
        raise DateOrderError(f"the date '{cells[0]:.30}' may state the day first or the month first", where=where,
                       remedy="state dates = 'day first' or dates = 'month first' in a map")
    return forms[allowed[0]]
