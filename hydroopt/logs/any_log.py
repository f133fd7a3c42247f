"""What a log in memory and a log that is read in pieces have in common."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from dataclasses import replace
from typing import Any, Protocol, Self, TypeVar

import numpy as np

from hydroopt.logs.log import Log
from hydroopt.logs.quality import Finding

Loaded_co = TypeVar("Loaded_co", covariant=True)


class AnyLog(Protocol):
    """A log, in memory (`Log`) or read in pieces (`hydroopt.logs.stream.LogStream`)."""

    @property
    def name(self) -> str:
        """Short name, for tables and figures."""

    @property
    def path(self) -> str:
        """File it came from; empty for a log that was made."""

    @property
    def sha256(self) -> str:
        """Of that file's bytes."""

    @property
    def channels(self) -> Mapping[str, Any]:
        """By name."""

    @property
    def units(self) -> Mapping[str, str]:
        """SI unit by channel."""

    @property
    def findings(self) -> tuple[Finding, ...]:
        """Data defects and what was done about them."""

    @property
    def size(self) -> int:
        """Number of samples."""

    @property
    def rows(self) -> tuple[int, int]:
        """First and last data row in the file."""

    @property
    def duration(self) -> float:
        """From the first to the last sample [s]."""

    def extremes(self, channel: str) -> tuple[float, float]:
        """The smallest and the largest number of a channel; inf and -inf where it holds none."""

    def without(self, channels: Collection[str], findings: tuple[Finding, ...]) -> Self:
        """The log without some channels, with findings that say why instead of those about them."""

    def slice(self, start: int, stop: int) -> Self:
        """Samples `start` to `stop` (0-based, half open) as a log."""

    def split(self, fraction: float) -> tuple[Self, Self]:
        """The first `fraction` of the samples, and the rest."""

    def loaded(self, purpose: str) -> Log:
        """The log with all samples in memory, which `purpose` needs.

        Raises:
            ProblemError: it is read in pieces.
        """


class Loadable(Protocol[Loaded_co]):
    """What can be asked for all of its samples at once: a log, or an experiment made of one."""

    def loaded(self, purpose: str) -> Loaded_co:
        """The same with all samples in memory.

        Raises:
            ProblemError: the log is read in pieces.
        """


def in_memory(items: Iterable[Loadable[Loaded_co]], purpose: str) -> tuple[Loaded_co, ...]:
    """Logs or experiments for a purpose that needs all samples at once.

    Raises:
        ProblemError: one of them is read in pieces.

    >>> log = Log("ramp", t=[0.0, 0.1, 0.2], channels={"boom.q": [0.0, 0.1, 0.2]})
    >>> in_memory([log], "a robust loss") == (log,)
    True
    """
    return tuple(item.loaded(purpose) for item in items)


def both_parts(first: AnyLog, second: AnyLog) -> AnyLog:
    """A log of two parts of one file as it was before the split, with the channels of both; the first one alone where
    samples are read in pieces, or do not follow.

    >>> log = Log("ramp", t=np.arange(6) / 10, channels={"boom.q": np.arange(6) / 10})
    >>> both_parts(*log.split(0.5)).channel("boom.q").tolist() == log.channel("boom.q").tolist()
    True
    """
    if not (isinstance(first, Log) and isinstance(second, Log)) or second.sample[0] <= first.sample[-1]:
        return first
    return replace(first, t=np.concatenate([first.t, second.t]), recording=None,
                   channels={name: np.concatenate([values, second.channels[name]])
                             for name, values in first.channels.items() if name in second.channels},
                   sample=np.concatenate([first.sample, second.sample]),
                   segment=np.concatenate([first.segment, second.segment]))
