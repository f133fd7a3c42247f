"""Time stamps at their own resolution: dates, epochs and counters as integers, and seconds from the first of them."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from datetime import date
from decimal import Decimal, InvalidOperation
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hydroopt.errors import LogError
from hydroopt.units import factor

EPOCHS = {"s": 1, "ms": 10**3, "us": 10**6, "ns": 10**9}
"""Ticks per second of the epochs that are in use."""
YEARS_2001_TO_2040 = (978_307_200, 2_208_988_800)
"""Seconds since 1970 (UTC) between which a number counts as a date: no machine runs for so long."""
MISSING = np.iinfo(np.int64).min
"""The tick of a stamp that is missing, numpy's NaT."""

_FIRST_DAY = date(1970, 1, 1).toordinal()
_TIME = r"\d{1,2}:\d{2}(?::\d{2}(?:[.,]\d{1,9})?)?"
_DATES = {"%Y-%m-%d": r"\d{4}-\d{1,2}-\d{1,2}", "%Y/%m/%d": r"\d{4}/\d{1,2}/\d{1,2}",
          "%d.%m.%Y": r"\d{1,2}\.\d{1,2}\.\d{4}"}
_EITHER = r"\d{1,2}([/-])\d{1,2}\1\d{4}"
_MOMENT = re.compile(rf"(?P<date>{'|'.join(_DATES.values())}|\d{{1,2}}[/-]\d{{1,2}}[/-]\d{{4}})?"
                     rf"(?P<gap>[T ]\s*|(?<=\d),\s*)?(?P<time>{_TIME})?\s*(?P<half>[AaPp]\.?[Mm]\.?)?"
                     r"\s*(?P<zone>Z|UTC|[+-]\d{2}:?\d{2})?")


class DateOrderError(LogError):
    """Dates of which the day or the month may come first."""


@dataclass(frozen=True)
class Stamps:
    """Times (N,) as integers.

    Attributes:
        ticks: (N,) counts; `MISSING` where there is no stamp.
        per_second: ticks per second.
        dated: whether they count from 1970-01-01 UTC.
        shown: what was taken of them, in a sentence; empty where nothing was.
        unit: that of the numbers which were taken for an epoch; empty of dates.
    """

    ticks: NDArray[np.int64]
    per_second: int
    dated: bool
    shown: str = ""
    unit: str = ""

    @property
    def start(self) -> np.datetime64 | None:
        """The first moment in UTC, as datetime64[ns]; None of stamps without a date."""
        sound = self.ticks[self.ticks != MISSING]
        if not self.dated or not sound.size:
            return None
        return np.datetime64(int(sound[0]) * (10**9 // self.per_second), "ns")

    def seconds(self) -> NDArray[np.float64]:
        """Times (N,) [s], of dates from the first one on, NaN where missing; subtracted as integers.

        >>> Stamps(np.array([1700000000123456789, 1700000000123456790]), 10**9, True).seconds().tolist()
        [0.0, 1e-09]
        """
        missing = self.ticks == MISSING
        sound = self.ticks[~missing]
        first = sound[0] if self.dated and sound.size else 0
        return np.where(missing, np.nan, (self.ticks - first) / self.per_second)


def dated_as(values: NDArray[Any], unit: str) -> bool:
    """Whether numbers (N,) in a unit of time can only be an epoch.

    >>> dated_as(np.array([1.7e12]), "ms"), dated_as(np.array([1.7e9]), "ms")
    (True, False)
    """
    seconds = np.abs(values.astype(float)) * factor(unit, "s")
    seconds = np.minimum(seconds[np.isfinite(seconds)], 2 * YEARS_2001_TO_2040[1])  # whose sum is finite, too
    return bool(seconds.size and YEARS_2001_TO_2040[0] <= np.median(seconds) <= YEARS_2001_TO_2040[1])


def of_column(values: NDArray[Any]) -> Stamps | None:
    """Stamps of datetime64, timedelta64, or numbers (N,) that are an epoch of this age; None of other numbers."""
    if values.dtype.kind in "mM":
        return of_datetimes(values)
    unit = epoch_unit(values)
    if unit is None:
        return None
    per_second = EPOCHS[unit]
    if values.dtype.kind in "iu":
        return epoch(values.astype(np.int64), per_second, unit)
    missing = ~np.isfinite(values)
    numbers = np.where(missing, 0, values)
    whole, scale = np.floor(numbers), 10**9 // per_second
    ticks = whole.astype(np.int64) * scale + np.round((numbers - whole) * scale).astype(np.int64)
    resolved = np.spacing(float(np.nanmedian(values))) / per_second
    return epoch(np.where(missing, MISSING, ticks), 10**9, unit, f"; its numbers resolve {resolved:.2g} s")


def epoch(ticks: NDArray[np.int64], per_second: int, unit: str, more: str = "") -> Stamps:
    """Stamps of an epoch in a unit."""
    moment = np.datetime64(int(np.median(ticks[ticks != MISSING])) // per_second, "s")
    return Stamps(ticks, per_second, True,
                  f"the time is an epoch in {unit}, about {moment} UTC; t = 0 at its first sample{more}", unit)


def epoch_unit(values: NDArray[Any]) -> str | None:
    """The unit in which numbers (N,) are dates of this age; None where they are none.

    >>> epoch_unit(np.array([1700000000000, 1700000000020]))
    'ms'
    """
    if values.size and max(-float(np.fmin.reduce(values)), float(np.fmax.reduce(values))) < YEARS_2001_TO_2040[0]:
        return None  # too few even in seconds, as nearly all are
    return next((unit for unit in EPOCHS if dated_as(values, unit)), None)


def exact_ticks(text: str, unit: str) -> int:
    """An epoch as a text in nanoseconds, with all of its digits up to those; `MISSING` of one that is empty or absurd.

    >>> exact_ticks("1700000000.123456789", "s")
    1700000000123456789
    """
    try:
        ticks = int(Decimal(text.strip()) * (10**9 // EPOCHS[unit]))
        return ticks if abs(ticks) < -MISSING else int(MISSING)
    except (InvalidOperation, ValueError, OverflowError):
        return int(MISSING)


def of_datetimes(values: NDArray[Any]) -> Stamps:
    """Stamps of datetime64 (N,) in UTC, or of timedelta64."""
    unit, steps = np.datetime_data(values.dtype)
    if unit not in EPOCHS or steps != 1:
        values = values.astype(f"{values.dtype.kind}8[ns]")
        unit = "ns"
    return Stamps(values.astype(np.int64), EPOCHS[unit], values.dtype.kind == "M")


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
    first = next((cell for cell in cells if cell.strip()), "")
    match = _MOMENT.fullmatch(first.strip())
    if match is None or not looks_dated(first):
        raise LogError(f"'{first:.40}' is neither a number nor a date", where=where,
                       remedy="write it as in 2026-11-23T04:20:00.125, or in seconds")
    if not match["date"]:
        return _of_day_times(cells, where, place)
    form = next((form for form, pattern in _DATES.items() if re.fullmatch(pattern, match["date"])), None)
    if form is None:
        form = _either_form(cells, order, where)
    return _of_dates(cells, form, where, place, zoned=bool(match["zone"]))


def _either_form(cells: Sequence[str], order: str | None, where: str) -> str:
    """The form of dates such as 03/04/2026; the one order that all of them allow, or the stated one."""
    mark = "/" if "/" in next(cell for cell in cells if cell.strip()) else "-"
    forms = {"day first": f"%d{mark}%m{mark}%Y", "month first": f"%m{mark}%d{mark}%Y"}
    if order is not None:
        return forms[order]
    pairs = {tuple(map(int, cell.strip().split(mark)[:2])) for cell in cells if re.match(_EITHER, cell.strip())}
    allowed = [name for name, place in (("day first", 1), ("month first", 0)) if all(p[place] <= 12 for p in pairs)]
    if len(allowed) != 1:
        shown = next(cell for cell in cells if cell.strip()).strip()
        raise DateOrderError(f"the date '{shown:.30}' may state the day first or the month first", where=where,
                       remedy="state dates = 'day first' or dates = 'month first' in a map")
    return forms[allowed[0]]


def _of_dates(cells: Sequence[str], form: str, where: str, place: Callable[[int], str], *, zoned: bool) -> Stamps:
    pattern, days = _pattern(cells, form, zoned=zoned), dict[tuple[str, ...], int]()
    ticks = np.full(len(cells), MISSING)
    for k, cell in enumerate(cells):
        if not cell.strip():
            continue
        try:
            ticks[k] = _tick(pattern.fullmatch(cell.strip()), days)
        except (ValueError, OverflowError):
            raise LogError(f"'{cell:.40}' is no date such as '{next(c for c in cells if c.strip()):.40}'",
                           where=f"{where}, {place(k)}",
                           remedy="write all of them in one form, or give seconds") from None
    order = {"%d": "day first", "%m": "month first", "%Y": "year first"}[form[:2]]
    zone = "" if zoned else ", without a zone: taken as UTC"
    return Stamps(ticks, 10**9, True, f"the time is a date, {order}{zone}; t = 0 at its first sample")


def _pattern(cells: Sequence[str], form: str, *, zoned: bool) -> re.Pattern[str]:
    """The one form that all moments must have: that of the first with a time of day."""
    date = re.escape(form).replace("%Y", r"(?P<Y>\d{4})").replace("%m", r"(?P<m>\d{1,2})").replace(
        "%d", r"(?P<d>\d{1,2})")
    found = map(_MOMENT.fullmatch, map(str.strip, cells))
    first = next((match for match in found if match and match["time"]), None)
    if first is None:
        clock = ""
    else:
        seconds = r":(?P<S>\d{2})(?:[.,](?P<f>\d{1,9}))?" if first["time"].count(":") == 2 else ""
        half = r"\s*(?P<p>[AaPp])\.?[Mm]\.?" if first["half"] else ""
        clock = rf"(?:[T ]|,)\s*(?P<H>\d{{1,2}}):(?P<M>\d{{2}}){seconds}{half}"
    return re.compile(f"{date}{clock}" + (r"\s*(?P<z>Z|UTC|[+-]\d{2}:?\d{2})" if zoned else ""), re.IGNORECASE)


def _tick(match: re.Match[str] | None, days: dict[tuple[str, ...], int]) -> int:
    """Nanoseconds since 1970 of a moment; `days` keeps the dates seen.

    Raises:
        ValueError, OverflowError: it is no moment.
    """
    if match is None:
        raise ValueError
    of = match.groupdict()
    key = (of["Y"], of["m"], of["d"])
    if key not in days:
        days[key] = date(*map(int, key)).toordinal() - _FIRST_DAY
    hour, minute, second = (int(of.get(part) or 0) for part in "HMS")
    if of.get("p"):
        if not 1 <= hour <= 12:
            raise ValueError
        hour = hour % 12 + 12 * (of["p"] in "Pp")
    if hour > 23 or minute > 59 or second > 59:
        raise ValueError
    zone = of.get("z") or "Z"
    offset = 0 if zone.upper() in ("Z", "UTC") else int(f"{zone[0]}1") * (60 * int(zone[1:3]) + int(zone[-2:]))
    whole = days[key] * 86_400 + hour * 3600 + (minute - offset) * 60 + second
    ticks = whole * 10**9 + int((of.get("f") or "").ljust(9, "0"))
    if abs(ticks) >= -MISSING:
        raise OverflowError
    return ticks


def _of_day_times(cells: Sequence[str], where: str, place: Callable[[int], str]) -> Stamps:
    """Times of day, which go on after midnight."""
    ticks = np.full(len(cells), MISSING)
    for k, cell in enumerate(cells):
        text = cell.strip().replace(",", ".")
        if not text:
            continue
        match = _MOMENT.fullmatch(text)
        if match is None or match["date"] or not match["time"]:
            raise LogError(f"'{cell:.40}' is no time of day", where=f"{where}, {place(k)}",
                           remedy="write all of them as in 04:20:00.125")
        hours, minutes, seconds = (*match["time"].split(":"), "0")[:3]
        whole, _, part = seconds.partition(".")
        hour = int(hours)
        if match["half"]:
            hour = hour % 12 + 12 * (match["half"][0] in "pP")
        ticks[k] = (hour * 3600 + int(minutes) * 60 + int(whole)) * 10**9 + int(part.ljust(9, "0") or 0)
    sound = np.flatnonzero(ticks != MISSING)
    days = np.cumsum(np.diff(ticks[sound], prepend=ticks[sound][:1]) < -43_200 * 10**9)
    ticks[sound] += days * 86_400 * 10**9 - ticks[sound][0]
    return Stamps(ticks, 10**9, False, "the time is a time of day; t = 0 at its first sample")
