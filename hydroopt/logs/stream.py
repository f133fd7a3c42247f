"""A log that is too long for memory: a Parquet file that is read piece by piece as often as need be."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from copy import copy
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hydroopt.errors import LogError, ProblemError
from hydroopt.logs.column_map import LogMap
from hydroopt.logs.formats.parquet_file import ParquetFile
from hydroopt.logs.log import Log, full_layout, given_layout, left_out
from hydroopt.logs.log_files import read_log
from hydroopt.logs.quality import Finding
from hydroopt.logs.spline import MIN_SAMPLES, Grid
from hydroopt.logs.table import Table, in_si, kind_of, refuse_damage, stamps_of
from hydroopt.logs.treatment import Samples, choose, treat

Array = NDArray[np.float64]

STREAMED = 500_000
"""Data rows of a Parquet file above which it is read in pieces."""

PIECE = 2**17
"""Rows of a piece."""

BLOCKS, BLOCK = 16, 4096
"""A sample of the log: so many blocks of so many rows, or all of it where it is no longer than that."""


@dataclass(frozen=True)
class Survey:
    """Summary of all rows: first and last time [s], the usual step [s], how many there are of them and the
    time they take [s], gaps not counted; extremes of every channel.
    """

    first: float
    last: float
    step: float
    steps: int
    moved: float
    extremes: Mapping[str, tuple[float, float]]


@dataclass(frozen=True)
class LogStream:
    """Rows of a Parquet file as a log, of which no more than a piece is ever in memory.

    Attributes:
        path: of the file; `sha256` of its bytes.
        layout: which column is what; `units`: SI unit by channel.
        treatment: action by kind of finding; `limits`: of the sensors' ranges, as for `read_log`.
        rows: first and last 1-based data row.
        findings: those known before the samples are read.
        piece: rows read at a time.
        origin: moment of t = 0 in UTC; None where the stamps state no date.
    """

    path: str
    sha256: str
    layout: LogMap
    units: Mapping[str, str]
    treatment: Mapping[str, str]
    limits: Mapping[str, tuple[float, float]]
    rows: tuple[int, int]
    findings: tuple[Finding, ...] = ()
    piece: int = PIECE
    origin: np.datetime64 | None = None

    @property
    def name(self) -> str:
        """Short name, for tables and figures."""
        return Path(self.path).stem

    @property
    def channels(self) -> Mapping[str, str]:
        """The channels' names, with their units."""
        return self.units

    @property
    def size(self) -> int:
        """Number of rows, those that a treatment drops among them."""
        return self.rows[1] - self.rows[0] + 1

    @property
    def duration(self) -> float:
        """From the first to the last sample [s]."""
        return self.survey.last - self.survey.first

    def loaded(self, purpose: str) -> Log:
        """Refuse what needs all samples at once.

        Raises:
            ProblemError: always.
        """
        raise ProblemError(f"the log is read in pieces, but {purpose} needs all of it at once", where=self.path,
                           remedy=f"leave that out, or give {STREAMED} rows at most with 'rows = [first, last]' "
                                  "in a map")

    def slice(self, start: int, stop: int) -> LogStream:
        """Rows `start` to `stop` (0-based, half open).

        Raises:
            LogError: fewer than two rows.
        """
        if not 0 <= start < stop - 1 < self.size:
            raise LogError(f"positions {start} to {stop} hold fewer than two of {self.size} samples", where=self.path,
                           remedy="choose a longer stretch")
        return replace(self, rows=(self.rows[0] + start, self.rows[0] + stop - 1))

    def with_findings(self, more: Iterable[Finding]) -> LogStream:
        """The same log with further findings."""
        made = copy(self)  # with its survey
        object.__setattr__(made, "findings", (*self.findings, *more))
        return made

    def extremes(self, channel: str) -> tuple[float, float]:
        """The smallest and the largest number of a channel; inf and -inf where it holds none."""
        return self.survey.extremes[channel]

    def without(self, channels: Collection[str], findings: tuple[Finding, ...]) -> LogStream:
        """The same rows without some channels, with findings that say why."""
        columns = {name: column for name, column in self.layout.columns.items() if name not in channels}
        return replace(self, layout=self.layout.model_copy(update={"columns": columns}),
                       units={name: unit for name, unit in self.units.items() if name not in channels},
                       findings=(*self.findings, *findings))

    def split(self, fraction: float) -> tuple[LogStream, LogStream]:
        """The first `fraction` of the rows, and the rest.

        Raises:
            ProblemError: `fraction` is not between 0 and 1.
            LogError: one part has fewer than two rows.
        """
        if not 0 < fraction < 1:
            raise ProblemError(f"a log cannot be split at {fraction}", where=self.path,
                               remedy="choose a fraction between 0 and 1")
        cut = round(fraction * self.size)
        return self.slice(0, cut), self.slice(cut, self.size)

    def read(self, ranges: Sequence[tuple[int, int]], channels: Iterable[str] | None = None) -> Iterator[Samples]:
        """Time and channels, all of them if not stated, of ranges of data rows in SI; nothing is treated."""
        wanted = {"t", *(self.units if channels is None else channels)}
        layout = self.layout.model_copy(update={
            "columns": {name: column for name, column in self.layout.columns.items() if name in wanted}})
        file, (time,) = ParquetFile(Path(self.path), self.path, self.layout), layout.columns["t"].keys
        for table in file.pieces(layout.keys, ranges, time):
            values, _ = in_si(layout, table, self.path)
            refuse_damage(table, self.path)
            t, made = values.pop("t"), stamps_of(layout, table)
            yield Samples(t if made is None else made.seconds(self.origin), values, table.rows)

    @cached_property
    def survey(self) -> Survey:
        """One look at all rows; the extremes of a channel without a number are inf and -inf.

        Where the file states the extremes of a channel its numbers are not read for them.

        Raises:
            LogError: there are not two times.
        """
        extremes = {**dict.fromkeys(self.units, (np.inf, -np.inf)), **self._stated}
        first, last, step, steps, moved = np.nan, np.nan, np.nan, 0, 0.0
        for samples in self.read(_ranges(self.rows, self.piece), self.units.keys() - self._stated.keys()):
            t = samples.t[np.isfinite(samples.t)]
            if np.isnan(last) and t.size > 1:
                first, last, step = float(t[0]), float(t[0]), float(np.median(np.diff(t)))
            long = np.diff(t, prepend=last)
            usual = long[(long > 0) & (long <= 3.0 * step)]
            steps, moved, last = steps + usual.size, moved + float(usual.sum()), float(t[-1]) if t.size else last
            for name, x in samples.channels.items():
                low, high = extremes[name]
                extremes[name] = (min(low, float(np.fmin.reduce(x))), max(high, float(np.fmax.reduce(x))))
        if not steps:
            raise LogError("times do not increase", where=self.path, remedy="select other rows")
        return Survey(first, last, step, steps, moved, extremes)

    @cached_property
    def _stated(self) -> Mapping[str, tuple[float, float]]:
        """Extremes of channels as the file states them for its parts; `treated` checks them against the numbers."""
        file = ParquetFile(Path(self.path), self.path, self.layout)
        found: dict[str, tuple[float, float]] = {}
        for name, column in self.layout.columns.items():
            if name == "t" or len(column.keys) != 1 or (stated := file.extremes(column.keys[0], self.rows)) is None:
                continue
            layout = self.layout.model_copy(update={"columns": {name: column}})
            ends = Table({column.keys[0]: np.array(stated)}, np.array(self.rows))
            (values, _) = in_si(layout, ends, self.path)
            if not ends.damage and np.all(np.isfinite(values[name])):  # otherwise rows have to be named
                found[name] = float(values[name].min()), float(values[name].max())
        return found

    def _moves(self, channel: Sequence[str]) -> list[Array]:
        """How far each of some channels moves in each block of rows."""
        moves: dict[str, list[Array]] = {name: [] for name in channel if name not in self._moved}
        ranges = _ranges(self.rows, self.piece // BLOCK * BLOCK or BLOCK)
        for samples in self.read(ranges, moves) if moves else ():
            for name, some in moves.items():
                starts = np.arange(0, samples.t.size, BLOCK)
                with np.errstate(invalid="ignore"):  # of infinities
                    some.append(np.fmax.reduceat(samples.channels[name], starts)
                                - np.fmin.reduceat(samples.channels[name], starts))
        self._moved.update({name: np.nan_to_num(np.concatenate(parts)) for name, parts in moves.items()})
        return [self._moved[name] for name in channel]

    @cached_property
    def _moved(self) -> dict[str, Array]:
        """What `_moves` has found."""
        return {}

    @property
    def grid(self) -> Grid:
        """Knots for splines, the same whatever the pieces."""
        return Grid(self.survey.first, self.survey.moved, self.survey.steps)

    def sample(self, moving: Sequence[str]) -> Log:
        """All of a short log; of a long one the blocks between which the channels `moving` move the same way.

        Raises:
            LogError: there is no stretch that can be smoothed.
        """
        if self.size <= BLOCKS * BLOCK:
            ranges = [self.rows]
        else:
            spans = {name: high - low for name, (low, high) in self.survey.extremes.items()}
            moving = [name for name in moving if spans[name] > 0]
            way = np.cumsum(sum(move / spans[name] for name, move in zip(moving, self._moves(moving), strict=True)))
            blocks = np.searchsorted(way, (np.arange(BLOCKS) + 0.5) / BLOCKS * way[-1])
            starts = self.rows[0] + BLOCK * np.unique(blocks)
            ranges = [(int(row), min(int(row) + BLOCK - 1, self.rows[1])) for row in starts]
        parts = [self.treated(samples, (1, 0)) for samples in self.read(ranges)]
        begins = np.cumsum([0, *(part.segment[-1] + 1 for part in parts)])
        segment = np.concatenate([part.segment + begin for part, begin in zip(parts, begins, strict=False)])
        long = np.bincount(segment)[segment] >= MIN_SAMPLES
        if not long.any():
            raise LogError("there is no stretch that is long enough to differentiate", where=self.path,
                           remedy=f"record at least {MIN_SAMPLES} samples without a gap")
        return Log(self.name, np.concatenate([part.t for part in parts])[long],
                   {name: np.concatenate([part.channels[name] for part in parts])[long] for name in self.units},
                   np.concatenate([part.sample for part in parts])[long], segment[long], (), self.path, self.sha256,
                   self.units)

    def windows(self, margins: tuple[int, int], channels: Iterable[str] | None = None
                ) -> Iterator[tuple[Samples, tuple[int, int]]]:
        """Samples of every piece with so many rows more before and behind it, and the piece's first and last row."""
        pieces = _ranges(self.rows, self.piece)
        wide = [(max(first - margins[0], self.rows[0]), min(last + margins[1], self.rows[1])) for first, last in pieces]
        yield from zip(self.read(wide, channels), pieces, strict=True)

    def treated(self, samples: Samples, reported: tuple[int, int]) -> Log:
        """Samples as a log after checks and treatments; only findings in the rows `reported` (first, last) are kept.

        Raises:
            LogError: a kind of finding whose action is "error", or numbers beyond what the file states of them.
        """
        extremes = {name: self.survey.extremes[name] for name in samples.channels}
        for name in samples.channels.keys() & self._stated.keys():
            x, (low, high) = samples.channels[name], extremes[name]
            if np.fmin.reduce(x) < low or np.fmax.reduce(x) > high:
                raise LogError(f"{name} has numbers beyond the least and the greatest that the file states of it",
                               where=self.path, remedy="write the file again")
        piece = replace(samples, reported=reported, whole=extremes)
        kept, segment = treat(piece, self.treatment, self.limits, self.path)
        for own in (kept.t, kept.sample, segment, *kept.channels.values()):
            own.setflags(write=False)  # nobody else has them: no need for copies
        return Log(self.name, kept.t, kept.channels, kept.sample, segment, kept.findings, self.path, self.sha256,
                   {name: self.units[name] for name in kept.channels})


def open_log(path: str | Path, *, mapping: LogMap | str | Path | None = None,
             treatment: Mapping[str, str] | None = None,
             limits: Mapping[str, tuple[float, float]] | None = None) -> Log | LogStream:
    """As `read_log`, but a Parquet file of more than `STREAMED` rows is not read now, and later in pieces.

    Raises:
        LogError: the file is missing, damaged or not understood.
        ProblemError: unknown treatment, or one that a log in pieces does not know.

    >>> from tempfile import TemporaryDirectory
    >>> with TemporaryDirectory() as directory:
    ...     file = Path(directory) / "run.parquet"
    ...     Log("run", np.arange(100) / 50, {"boom.q": np.zeros(100)}).write(file)
    ...     open_log(file)
    Log('run': 100 samples, 1.98 s, 1 channel)
    """
    layout = given_layout(mapping, str(path))
    packed = Path(path).suffix.lower() == ".gz"
    if (kind_of(path, layout.format if layout else None) == "parquet" and not packed and os.path.isfile(path)
            and os.path.getsize(path)):
        file = ParquetFile(Path(path), str(path), layout)
        if file.meta.num_rows > STREAMED and (rows := file.selected)[1] - rows[0] >= STREAMED:
            return stream(path, mapping=layout, treatment=treatment, limits=limits)
    return read_log(path, mapping=layout, treatment=treatment, limits=limits)


def stream(path: str | Path, *, mapping: LogMap | str | Path | None = None,
           treatment: Mapping[str, str] | None = None, limits: Mapping[str, tuple[float, float]] | None = None,
           piece: int = PIECE) -> LogStream:
    """A Parquet file as a log that is read in pieces of so many rows.

    Raises:
        LogError: the file is damaged or not understood.
        ProblemError: unknown treatment, or one that needs the log as a whole.
    """
    where, chosen = str(path), choose(treatment)
    for kind, action in chosen.items():
        if action == "interpolate" or (kind, action) == ("non-monotonic", "drop"):
            raise ProblemError(f"the log is read in pieces, between which '{kind}' cannot be treated by '{action}'",
                               where=where, remedy="choose another treatment, correct the file, or give a part of "
                                                   f"fewer than {STREAMED} rows with 'rows = [first, last]' in a map")
    given = given_layout(mapping, where)
    file = ParquetFile(Path(path), where, given)
    layout, ignored = full_layout(given, file.header, where)
    rows = file.selected
    # units and dates as they are found for whole logs
    first = next(file.pieces(layout.keys, [(rows[0], min(rows[0] + BLOCK - 1, rows[1]))], layout.columns["t"].keys[0]))
    (_, units), made = in_si(layout, first, where), stamps_of(layout, first)
    notes = left_out(layout, ignored, *rows)
    if made is not None and made.shown:
        notes += (Finding("clock", "t", *rows, 0, made.shown),)
    with Path(path).open("rb") as data:
        digest = hashlib.file_digest(data, "sha256").hexdigest()
    return LogStream(where, digest, layout, units, chosen, limits or {}, rows, notes, piece,
                     None if made is None else made.start)


def _ranges(rows: tuple[int, int], size: int) -> list[tuple[int, int]]:
    """Data rows (first, last) of pieces of so many rows."""
    return [(first, min(first + size - 1, rows[1])) for first in range(rows[0], rows[1] + 1, size)]
