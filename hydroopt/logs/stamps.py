"""Time stamps at their own resolution: dates, epochs and counters as integers, and seconds from the first of them."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
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

_TIME = r"\d{1,2}:\d{2}(?::\d{2}(?:[.,]\d{1,9})?)?"
_DATES = {"%Y-%m-%d": r"\d{4}-\d{1,2}-\d{1,2}", "%Y/%m/%d": r"\d{4}/\d{1,2}/\d{1,2}",
          "%d.%m.%Y": r"\d{1,2}\.\d{1,2}\.\d{4}"}
_EITHER = r"\d{1,2}([/-])\d{1,2}\1\d{4}"
_MOMENT = re.compile(rf"(?P<date>{'|'.join(_DATES.values())}|\d{{1,2}}[/-]\d{{1,2}}[/-]\d{{4}})?"
                     rf"(?P<gap>[T ]\s*|(?<=\d),\s*)?(?P<time>{_TIME})?\s*(?P<half>[AaPp]\.?[Mm]\.?)?"
                     r"\s*(?P<zone>Z|UTC|[+-]\d{2}:?\d{2})?")


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
    seconds = seconds[np.isfinite(seconds)]
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


def of_texts(cells: Sequence[str], order: str | None, where: str) -> Stamps:
    """Stamps of dates and times as texts: ISO 8601, ``23.11.2026 04:20:00,5``, or with `order` ``11/23/2026 4:20 PM``.

    Args:
        cells: (N,) texts; empty ones are missing.
        order: "day first" or "month first", where dates need it.
        where: the file and column.

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
        return _of_day_times(cells, where)
    form = next((form for form, pattern in _DATES.items() if re.fullmatch(pattern, match["date"])), None)
    if form is None:
        form = _either_form(cells, order, where)
    return _of_dates(cells, form, where, zoned=bool(match["zone"]))


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
        raise LogError(f"the date '{shown:.30}' may state the day first or the month first", where=where,
                       remedy="state dates = 'day first' or dates = 'month first' in a map")
    return forms[allowed[0]]


def _of_dates(cells: Sequence[str], form: str, where: str, *, zoned: bool) -> Stamps:
    import pandas as pd  # noqa: PLC0415 (import cost)

    texts = [" ".join(cell.replace("T", " ", 1).split()) for cell in cells]
    times = [text.partition(" ")[2] for text in texts]
    shape = next((time for time in times if time), "")
    clock = "" if not shape else " %I:%M" if re.search("[AaPp]\\.?[Mm]", shape) else " %H:%M"
    texts = [text.replace(",", ".") for text in texts]
    if shape.count(":") - len(re.findall(r"[+-]\d{2}:\d{2}$", shape)) >= 2:
        clock += ":%S"
    if any("." in time or "," in time for time in times):
        clock += ".%f"
        texts = [re.sub(r"(:\d{2}:\d{2})(?!\.\d)(?=\D|$)", r"\1.0", text, count=1) for text in texts]
    half = " %p" if "%I" in clock else ""
    if half:
        texts = [re.sub(r"\s*([AaPp])\.?[Mm]\.?", r" \1M", text).upper() for text in texts]
    zone = "%z" if zoned else ""
    if zoned:
        texts = [re.sub(r"\s*(Z|UTC)$", "+0000", text, flags=re.IGNORECASE) for text in texts]
        texts = [re.sub(r"\s+([+-]\d{2}:?\d{2})$", r"\1", text) for text in texts]
    try:
        moments = pd.to_datetime(pd.Series([text or None for text in texts], dtype=object),
                                 format=f"{form}{clock}{half}{zone}", utc=True)
    except (ValueError, TypeError, OverflowError):
        bad = next((k for k, cell in enumerate(cells) if cell.strip() and not looks_dated(cell)), 0)
        raise LogError(f"'{cells[bad]:.40}' in data row {bad + 1}, or a cell after it, is no date such as "
                       f"'{next(c for c in cells if c.strip()):.40}'", where=where,
                       remedy="write all of them in one form, or give seconds") from None
    values = moments.dt.tz_localize(None).to_numpy().astype("M8[ns]")
    order = {"%d": "day first", "%m": "month first", "%Y": "year first"}[form[:2]]
    zone = "" if zoned else ", without a zone: taken as UTC"
    return Stamps(values.astype(np.int64), 10**9, True, f"the time is a date, {order}{zone}; t = 0 at its first sample")


def _of_day_times(cells: Sequence[str], where: str) -> Stamps:
    """Times of day, which go on after midnight."""
    ticks = np.full(len(cells), MISSING)
    for k, cell in enumerate(cells):
        text = cell.strip().replace(",", ".")
        if not text:
            continue
        match = _MOMENT.fullmatch(text)
        if match is None or match["date"] or not match["time"]:
            raise LogError(f"'{cell:.40}' in data row {k + 1} is no time of day", where=where,
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
