"""A measurement log in SI units: making it with all findings reported, cutting it, writing it."""

from collections.abc import Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import TYPE_CHECKING, ClassVar

import numpy as np
from numpy.typing import NDArray

from hydroopt.errors import LogError, ProblemError
from hydroopt.logs import quality as find
from hydroopt.logs.channels import channel_table, refuse_other_units, si_unit
from hydroopt.logs.column_map import LogMap, read_map
from hydroopt.logs.frames import FrameSheet, Tabular
from hydroopt.logs.mapped import MAPPED, at, by_pieces, extremes, release
from hydroopt.logs.quality import Finding
from hydroopt.logs.sheets import parts_without_map
from hydroopt.logs.spline import MIN_SAMPLES
from hydroopt.logs.stamps import Stamps
from hydroopt.logs.table import frozen
from hydroopt.logs.treatment import PIECE, Samples, choose, numbered, treat
from hydroopt.machine.quantity import CHANNEL_UNITS
from hydroopt.support.notebook_card import Card

if TYPE_CHECKING:
    import pandas as pd
    import pyarrow as pa


__all__ = ["Finding", "Log", "LogMap", "read_map"]

Array = NDArray[np.float64]
SAMPLE, BLOCK = 2**17, 2**13
"""Samples of a log by which its smoothing is chosen, and those of the blocks that these are taken from."""


@dataclass(frozen=True, repr=False)
class Log(Tabular):
    """Synchronously sampled channels of one recording.

    Attributes:
        name: short name, for tables and figures.
        t: (N,) strictly increasing times [s]; made of datetime64, they count from the first one, at its resolution.
        channels: (N,) values by channel name such as ``boom.q``, in SI.
        sample: (N,) 1-based data row in the file; survives dropping and cutting. Default 1..N.
        segment: (N,) index of the uninterrupted stretch a sample belongs to. Default: cut at gaps.
        findings: what looked wrong and what was done about it.
        path: file it came from; empty for a log that was made.
        sha256: of that file's bytes.
        units: SI unit by channel; defaults to the usual one of the suffix (rad for ``.q``).
        recording: the `Recording` that it was merged from, with all samples of its groups; None of a single group.

    Raises:
        LogError: lengths differ, fewer than two samples, times do not increase, an unknown channel name, or a unit that
            is not SI.

    >>> log = Log("run", np.arange(100) / 50, {"boom.q": np.zeros(100), "boom_cylinder.p_head": np.full(100, 1e7)})
    >>> log
    Log('run': 100 samples, 1.98 s, 2 channels)
    >>> train, held_out = log.split(0.7)
    >>> train.size, held_out.size
    (70, 30)
    >>> log.channel("boom_cylinder.p_head").max(), log.extremes("boom.q"), log.slice(10, -10).rows
    (np.float64(10000000.0), (0.0, 0.0), (11, 90))
    >>> list(log.without(["boom.q"], ()).channels), log.encoded().splitlines()[0]
    (['boom_cylinder.p_head'], b't [s],boom.q [rad],boom_cylinder.p_head [Pa]')
    """

    noun: ClassVar = "log"
    name: str
    t: Array
    channels: Mapping[str, Array]
    sample: NDArray[np.int64] = field(default_factory=lambda: np.empty(0, int))
    segment: NDArray[np.int64] = field(default_factory=lambda: np.empty(0, int))
    findings: tuple[Finding, ...] = ()
    path: str = ""
    sha256: str = ""
    units: Mapping[str, str] = field(default_factory=dict)
    recording: object = field(default=None, repr=False)

    def __post_init__(self) -> None:
        where = self.path or self.name
        given = np.asarray(self.t)
        if given.dtype.kind not in "fiumM":
            raise LogError(f"the time holds {given.dtype}, not seconds", where=where,
                           remedy="give seconds, or datetime64, of which the first one is t = 0")
        t = frozen(Stamps(given).seconds() if given.dtype.kind in "mM" else given, float)
        if t.ndim != 1 or t.size < 2 or find.following(t, lambda steps: ~(steps > 0)).size:
            raise LogError("times do not increase over two or more samples", where=where,
                           remedy="correct the time stamps or choose a longer stretch")
        channels = {name: frozen(x, float) for name, x in self.channels.items()}
        sample = frozen(self.sample if np.size(self.sample) else by_pieces(
            t.size, lambda span: np.arange(span.start + 1, span.stop + 1), int), int)
        segment = frozen(self.segment if np.size(self.segment) else numbered(
            find.gaps(t, find.usual_step(t)), t.size), int)
        for name, x in {"sample": sample, "segment": segment, **channels}.items():
            if x.shape != t.shape:
                raise LogError(f"'{name}' has shape {x.shape}, the time {t.shape}", where=where,
                               remedy="give all channels the same length")
        refuse_other_units(self.units, channels, "log", where)
        units = {name: self.units.get(name) or si_unit(name) for name in channels}
        for name, value in (("t", t), ("channels", channels), ("sample", sample), ("segment", segment),
                            ("units", units)):
            object.__setattr__(self, name, value)
        if t.size >= MAPPED:
            release()

    def __repr__(self) -> str:
        return (f"Log('{self.name}': {self.size} samples, {self.duration:.6g} s, {len(self.channels)} channel"
                f"{'s' * (len(self.channels) != 1)})")

    def card(self) -> Card:
        """What a notebook shows: channels with their ranges, and findings."""
        facts = {"time": f"{self.t[0]:.6g} … {self.t[-1]:.6g} s, {self.size} samples", **(
            {"file": self.path} if self.path else {}), **{each.kind: each.text for each in self.findings}}
        return Card(repr(self), facts, [channel_table(self.channels, self.units)])

    @property
    def size(self) -> int:
        """Number of samples."""
        return int(self.t.size)

    @property
    def rows(self) -> tuple[int, int]:
        """First and last data row in the file."""
        return int(self.sample[0]), int(self.sample[-1])

    @property
    def step(self) -> float:
        """The median step [s]."""
        return find.usual_step(self.t)

    @property
    def duration(self) -> float:
        """From the first to the last sample [s]."""
        return float(self.t[-1] - self.t[0])

    def channel(self, name: str) -> Array:
        """Values (N,) of one channel, in SI.

        Raises:
            LogError: the log has no such channel.
        """
        if name not in self.channels:
            raise missing(name, self.channels, self.path or self.name)
        return self.channels[name]

    def extremes(self, channel: str) -> tuple[float, float]:
        """The smallest and the largest number of a channel; inf and -inf where it holds none."""
        return extremes(self.channels[channel])

    def without(self, channels: Collection[str], findings: tuple[Finding, ...]) -> "Log":
        """The log without some channels, with findings that say why instead of those about them."""
        kept = tuple(finding for finding in self.findings if finding.channel not in channels)
        return replace(self, channels={name: x for name, x in self.channels.items() if name not in channels},
                       findings=(*kept, *findings))

    def pieces(self, margin: float) -> Iterator[tuple["Log", slice, slice]]:
        """The pieces of the log, each with what reaches a `margin` [s] beyond its own samples in their stretches.

        Beside each stand the places of its own samples, in the log and in the piece.
        """
        for own in [slice(0, self.size)] if margin == np.inf else self.spans:
            first = np.maximum(*(np.searchsorted(x, x[own.start] - beyond) for x, beyond in (
                (self.t, margin), (self.segment, 0)))).item()
            end = np.minimum(*(np.searchsorted(x, x[own.stop - 1] + beyond, "right") for x, beyond in (
                (self.t, margin), (self.segment, 0)))).item()
            yield self.slice(first, end), own, slice(own.start - first, own.stop - first)
            release()

    @property
    def spans(self) -> list[slice]:
        """The places of the pieces' own samples: `PIECE` rows of a file at most, or a log that is no longer."""
        borders = np.arange(self.sample[0], self.sample[-1], PIECE)[1:]
        edges = np.unique([0, *np.searchsorted(self.sample, borders), self.size]).tolist()
        return [slice(*each) for each in pairwise(edges)] if self.size > PIECE else [slice(0, self.size)]

    def sampled(self, moving: Collection[str]) -> "Log":
        """All of a log of `SAMPLE` samples at most; of a longer one so many in blocks, between which the channels
        `moving` move the same way.

        Raises:
            LogError: there is no stretch that can be smoothed.
        """
        if self.size <= SAMPLE:
            return self
        starts, ways = np.arange(0, self.size, BLOCK), np.zeros(-(-self.size // BLOCK))
        for name in set(moving) & self.channels.keys():
            low, high = (which.reduceat(self.channels[name], starts) for which in (np.fmin, np.fmax))
            ways += np.nan_to_num((high - low) / (np.nanmax(high) - np.nanmin(low) or 1.0))
            release()
        way = np.cumsum(ways)
        blocks = np.unique(np.searchsorted(way, (np.arange(SAMPLE // BLOCK) + 0.5) * BLOCK / SAMPLE * way[-1]))
        rows = np.concatenate([np.arange(BLOCK * k, min(BLOCK * (k + 1), self.size)) for k in blocks])
        segment = np.cumsum((np.diff(rows // BLOCK, prepend=-1) != 0) | (np.diff(self.segment[rows], prepend=-1) != 0))
        long = np.bincount(segment)[segment] >= MIN_SAMPLES
        if not long.any():
            raise LogError("there is no stretch that is long enough to differentiate", where=self.path or self.name,
                           remedy=f"record at least {MIN_SAMPLES} samples without a gap")
        rows = rows[long]
        return replace(self, t=at(self.t, rows), channels={name: at(x, rows) for name, x in self.channels.items()},
                       sample=at(self.sample, rows), segment=segment[long], recording=None)

    def slice(self, start: int, stop: int) -> "Log":
        """Samples `start` to `stop` (0-based, half open, negative from the end) as a log.

        Raises:
            LogError: fewer than two samples.
        """
        span = np.s_[start:stop]
        sample = self.sample[span]
        if sample.size < 2:
            raise LogError(f"positions {start} to {stop} hold {sample.size} of {self.t.size} samples",
                           where=self.path or self.name, remedy="choose a longer stretch")
        kept = tuple(f for f in self.findings if f.last >= sample[0] and f.first <= sample[-1])
        return replace(self, t=self.t[span], channels={k: x[span] for k, x in self.channels.items()},
                       sample=sample, segment=self.segment[span], findings=kept)

    def split(self, fraction: float) -> tuple["Log", "Log"]:
        """The first `fraction` of the samples, and the rest.

        Raises:
            ProblemError: `fraction` is not between 0 and 1.
            LogError: one part has fewer than two samples.
        """
        if not 0 < fraction < 1:
            raise ProblemError(f"a log cannot be split at {fraction}", where=self.path or self.name,
                               remedy="choose a fraction between 0 and 1")
        cut = round(fraction * self.t.size)
        return self.slice(0, cut), self.slice(cut, self.t.size)

    @classmethod
    def from_frame(cls, frame: "pd.DataFrame | pa.Table", *, units: Mapping[str, str] | None = None,
                   name: str = "frame", treatment: Mapping[str, str] | None = None,
                   limits: Mapping[str, tuple[float, float]] | None = None) -> "Log":
        """A log of a pandas DataFrame or an Arrow table.

        Args:
            frame: columns named ``boom.q [deg]``, or ``boom.q`` with a unit in `units`; columns whose name has no dot
                are not channels and are left out. The time is a column ``t [s]``, or a column ``t`` or the index, of
                datetimes (then t = 0 at the first row) or timedeltas, at their own resolution.
            units: unit by name of the columns that have none in it.
            name: short name of the log.
            treatment, limits: as for `read_log`.

        Raises:
            LogError: a column has no unit, two units or no numbers; the time is missing or stated twice; or the data
                are damaged as `read_log` says.

        >>> import pandas as pd
        >>> t = pd.date_range("2026-01-01", periods=3, freq="20ms")
        >>> log = Log.from_frame(pd.DataFrame({"boom.q": [10.0, 20.0, 30.0]}, index=t), units={"boom.q": "deg"})
        >>> log.t.tolist(), log.units["boom.q"], round(float(log.channels["boom.q"][1]), 6)
        ([0.0, 0.02, 0.04], 'rad', 0.349066)
        """
        (part,) = parts_without_map([FrameSheet(frame, units, name)], name)
        read = part.read()
        samples, segment = treat(Samples(read.t, read.values, read.rows), choose(treatment), limits or {}, name)
        return cls(name, samples.t, samples.channels, samples.sample, segment, samples.findings + read.notes,
                   units=read.units)

    def columns(self) -> dict[str, Array]:
        """Its columns (N,): ``t [s]`` and ``name [SI unit]``.

        >>> log = Log("run", [0.0, 0.02, 0.04], {"boom.q": [0.1, 0.2, 0.3]})
        >>> log.to_frame().columns.tolist()
        ['t [s]', 'boom.q [rad]']
        """
        headers = (f"{name} [{self.units[name]}]" for name in self.channels)
        return {"t [s]": self.t, **dict(zip(headers, self.channels.values(), strict=True))}


def missing(name: str, present: Iterable[str], where: str) -> LogError:
    """The error of a log that has no channel `name`, but those `present`."""
    kinds = CHANNEL_UNITS.get(name.rpartition(".")[2], ("unit",))
    columns = " or ".join(f"'{name} [{({'rad': 'deg', 'Pa': 'bar'}.get(kind, kind))}]'" for kind in kinds)
    return LogError(f"there is no channel '{name}' (present: {', '.join(present) or 'none'})", where=where,
                    remedy=f"record it as a column {columns} or name its column in a map")
