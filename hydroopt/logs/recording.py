"""A recording as its instruments made it: groups of channels, each with stamps of its own, and their merging."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from hydroopt.errors import LogError
from hydroopt.logs import quality
from hydroopt.logs.clock import Clock
from hydroopt.logs.log import Log, missing
from hydroopt.logs.quality import Finding
from hydroopt.support.notebook_card import Shown

Array = NDArray[np.float64]

NEEDED = ("q", "length", "tau", "force", "p_head", "p_rod", "p_a", "p_b")
"""Suffixes of the channels without which no force of an actuator is known or explained: position, force, pressure."""


@dataclass(frozen=True)
class Recording(Shown):
    """What was recorded at one time, in groups of channels that each have their own stamps.

    Attributes:
        name: short name, for tables and figures.
        start: moment of t = 0 in UTC, as datetime64[ns]; None where the stamps state no date.
        groups: channels that are sampled together, as logs by the name of their topic, sheet or file, empty where a
            file has but one group; in the order of the file, no channel stands in two of them.
        findings: what looked wrong and what was done about it.
        path: file it came from; several are joined by ", "; empty for a recording that was made.
        sha256: of that file's bytes, or of the digests of several files.
        clocks: what the stamps of groups lack, by name; `log` corrects them by delay and drift.

    Raises:
        LogError: there is no group, or a channel or group stands twice.

    >>> fast = Log("/joints", np.arange(5) / 100, {"boom.q": np.zeros(5)})
    >>> slow = Log("/can", np.array([0.0, 0.05]), {"boom_cylinder.p_head": np.array([1e6, 2e6])})
    >>> recording = Recording("run", (fast, slow))
    >>> recording
    Recording('run': 0.05 s, groups '/joints' (5 samples), '/can' (2 samples))
    >>> recording.log().channels["boom_cylinder.p_head"].tolist()
    [1000000.0, 1200000.0, 1400000.0, 1600000.0, 1800000.0]
    >>> recording.group("boom.q").size
    5
    """

    name: str
    groups: tuple[Log, ...]
    start: np.datetime64 | None = None
    findings: tuple[Finding, ...] = ()
    path: str = ""
    sha256: str = ""
    clocks: Mapping[str, Clock] = field(default_factory=dict)

    def __post_init__(self) -> None:
        where = self.path or self.name
        if not self.groups:
            raise LogError("there is no group of channels", where=where, remedy="give at least one")
        seen: dict[str, str] = {}
        for group in self.groups:
            for channel in group.channels:
                if channel in seen:
                    raise LogError(f"channel '{channel}' stands in '{seen[channel]}' and in '{group.name}'",
                                   where=where, remedy="remove one of them, or leave it out of the map")
                seen[channel] = group.name
        if len({group.name for group in self.groups}) < len(self.groups):
            raise LogError("two groups have one name", where=where, remedy="rename one")

    def __repr__(self) -> str:
        groups = ", ".join(f"'{group.name}' ({group.size} samples)" for group in self.groups)
        return (f"Recording('{self.name}': {self.duration:.6g} s, group{'s' * (len(self.groups) > 1)} {groups})")

    @classmethod
    def of(cls, log: Log, group: str = "") -> Recording:
        """The recording that a log was merged from, with all samples; else one of the one group of channels that it is.

        >>> Recording.of(Log("run", [0.0, 0.1], {"boom.q": [0.0, 0.1]})).groups[0].channels["boom.q"].tolist()
        [0.0, 0.1]
        """
        if isinstance(log.recording, Recording):
            return log.recording
        return cls(log.name, (replace(log, name=group, findings=()),), None, log.findings, log.path, log.sha256)

    @property
    def duration(self) -> float:
        """From the first to the last sample of any group [s]."""
        return max(float(group.t[-1]) for group in self.groups) - min(float(group.t[0]) for group in self.groups)

    @property
    def channels(self) -> dict[str, Array]:
        """Values by channel name, in SI; those of different groups have different lengths."""
        return {name: x for group in self.groups for name, x in group.channels.items()}

    def group(self, channel: str) -> Log:
        """The group that holds a channel.

        Raises:
            LogError: no group does.
        """
        for group in self.groups:
            if channel in group.channels:
                return group
        raise missing(channel, self.channels, self.path or self.name)

    def log(self, grid: str | None = None) -> Log:
        """All channels at the stamps of one group, the others interpolated linearly in time.

        Args:
            grid: name of that group. By default the fastest that holds a position, a force or a pressure; of a
                recording without those the fastest.

        Samples of the grid outside of another group's time, or in one of its gaps, are left out; a faster group
        than the grid loses samples. A finding states each of these.

        Raises:
            LogError: there is no such group, or two groups have no time in common.
        """
        where = self.path or self.name
        groups = [self._corrected(group) for group in self.groups]
        base = groups[self._grid(grid, where)]
        others = [group for group in groups if group is not base]
        if not others:
            return replace(base, name=self.name, findings=self.findings, path=self.path, sha256=self.sha256)
        keep, findings, lost = np.ones(base.size, bool), self.findings, list[Finding]()
        for alike in _sampled_alike(others):
            group, shown = alike[0], ", ".join(map(_shown, alike))
            _refuse_apart(base, group, where)
            outside = (base.t < group.t[0]) | (base.t > group.t[-1])
            inside = ~outside & _in_gap(base, group)
            for mask, text in ((outside, f"stand outside of the time of {shown}; left out"),
                               (inside, f"stand in a gap of {shown}; left out")):
                if mask.any():
                    lost.append(quality.finding("unpaired", "t", base.sample[mask], text))
            keep &= ~(outside | inside)
            if not np.array_equal(group.t, base.t):
                count, verb = _lost(base, group), "is" if len(alike) == 1 else "are"
                lost.append(Finding("resampled", next(iter(group.channels)), int(base.sample[0]), int(base.sample[-1]),
                                    count, f"{shown} of {1 / group.step:.4g} Hz {verb} interpolated at the "
                                    f"{1 / base.step:.4g} Hz of {_shown(base)}; {count or 'none'} of "
                                    f"{'its' if len(alike) == 1 else 'their'} {group.size} samples do not count"))
        if np.count_nonzero(keep) < 2:
            raise LogError("fewer than two samples have values of all groups", where=where,
                           remedy="record the groups at the same time, or map the channels of one group only")
        t = base.t[keep]
        channels = {name: x[keep] for name, x in base.channels.items()}
        for group in others:
            channels |= {name: np.interp(t, group.t, x) for name, x in group.channels.items()}
        channels = {name: channels[name] for name in self.channels}
        rows = base.sample[keep]
        findings += tuple(replace(each, first=min(each.first, int(rows[-1])), last=max(each.last, int(rows[0])))
                          for each in lost)  # part of what is left, however it is cut
        cut = np.diff(base.segment[keep], prepend=base.segment[keep][:1]) != 0
        units = {name: unit for group in self.groups for name, unit in group.units.items()}
        segment = np.cumsum(cut | _behind_a_loss(keep))
        return Log(self.name, t, channels, base.sample[keep], segment, findings, self.path, self.sha256, units, self)

    def hidden_noise(self, channel: str, t: Array) -> float:
        """White noise of a channel over what second differences show of it once it is interpolated at the times t (N,).

        Interpolation takes fast noise away and leaves slow noise, which is what estimates feel.

        >>> group = Log("/can", np.arange(6) * 0.1, {"boom_cylinder.p_head": np.zeros(6)})
        >>> recording = Recording("run", (group,))
        >>> [round(recording.hidden_noise("boom_cylinder.p_head", group.t[:-1] + late), 3) for late in (0.0, 0.05)]
        [1.0, 2.449]
        """
        group = self._corrected(self.group(channel))
        behind, weight = _neighbours(t, group)
        # second differences of the interpolation's rows: six weights each, some of which belong to one sample
        weights, places = np.stack([1 - weight, weight]), np.stack([behind - 1, behind])
        size = np.concatenate([weights[:, :-2], -2 * weights[:, 1:-1], weights[:, 2:]])
        place = np.concatenate([places[:, :-2], places[:, 1:-1], places[:, 2:]])
        shown = sum(float(np.sum(size[i] * size[j] * (place[i] == place[j]))) for i in range(6) for j in range(6))
        shown /= max(len(t) - 2, 1)
        return float(np.sqrt(6 / shown * group.step / np.median(np.diff(t)))) if shown > 0 else 1.0

    def _corrected(self, group: Log) -> Log:
        """A group with its stamps corrected for the delay and the drift of its clock."""
        clock = self.clocks.get(group.name, Clock())
        return replace(group, t=clock.corrected(group.t)) if clock.delay or clock.drift else group

    @property
    def grid(self) -> Log:
        """The group whose stamps `log` takes by default."""
        return self.groups[self._grid(None, self.path or self.name)]

    def _grid(self, name: str | None, where: str) -> int:
        """Index of the group whose stamps a log of the recording has."""
        names = [group.name for group in self.groups]
        if name is not None:
            if name not in names:
                raise LogError(f"there is no group '{name}'", where=where,
                               remedy=f"use one of {', '.join(map(repr, names))}")
            return names.index(name)
        needed = [k for k, group in enumerate(self.groups)
                  if any(channel.rpartition(".")[2] in NEEDED for channel in group.channels)]
        return min(needed or range(len(names)), key=lambda k: self.groups[k].step)


def _sampled_alike(groups: Sequence[Log]) -> list[list[Log]]:
    """The groups, those with the same stamps and stretches together."""
    found: dict[tuple[bytes, bytes], list[Log]] = {}
    for group in groups:
        found.setdefault((group.t.tobytes(), group.segment.tobytes()), []).append(group)
    return list(found.values())


def _shown(group: Log) -> str:
    """What a sentence calls a group."""
    return f"'{group.name or next(iter(group.channels))}'"


def _refuse_apart(base: Log, group: Log, where: str) -> None:
    """Refuse two groups that have no time in common.

    Raises:
        LogError: states how far they are apart.
    """
    apart = max(float(group.t[0] - base.t[-1]), float(base.t[0] - group.t[-1]))
    if apart <= 0:
        return
    offset = float(group.t[0] - base.t[0])
    hours = round(offset / 3600)
    zone = f", about {abs(hours)} h: a time zone?" if hours and abs(offset - 3600 * hours) < 600 else ""
    raise LogError(f"{_shown(group)} begins {abs(offset):.6g} s {'after' if offset > 0 else 'before'} {_shown(base)}, "
                   f"and they have no time in common{zone}", where=where,
                   remedy=f"correct the clocks, or state delay = '{offset:.6g} s' in "
                           f"[clocks.\"{group.name}\"] of a map")


def _in_gap(base: Log, group: Log) -> NDArray[np.bool_]:
    """Stamps (N,) of `base` strictly within a gap of `group`."""
    step = np.diff(group.t)
    behind = np.clip(np.searchsorted(group.t, base.t, side="left"), 1, group.size - 1)
    wide = (step > quality.GAP * max(group.step, base.step)) | (np.diff(group.segment) > 0)
    on_stamp = base.t == group.t[np.clip(np.searchsorted(group.t, base.t), 0, group.size - 1)]
    return np.asarray(wide[behind - 1] & ~on_stamp)


def _neighbours(t: Array, group: Log) -> tuple[NDArray[np.intp], Array]:
    """Which sample of a group follows each time (N,), and its weight beside the one before in interpolation."""
    behind = np.clip(np.searchsorted(group.t, t), 1, group.size - 1)
    return behind, (t - group.t[behind - 1]) / (group.t[behind] - group.t[behind - 1])


def _lost(base: Log, group: Log) -> int:
    """How many samples of `group` have no weight at any stamp of `base`."""
    behind, weight = _neighbours(base.t, group)
    within = (weight > -1e-6) & (weight < 1 + 1e-6)
    used = np.zeros(group.size, bool)
    used[behind[within & (weight > 1e-6)]] = True
    used[behind[within & (weight < 1 - 1e-6)] - 1] = True
    return int(np.count_nonzero(~used))


def _behind_a_loss(keep: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Which of the samples kept follow a sample that was not."""
    index = np.flatnonzero(keep)
    return np.diff(index, prepend=index[:1] - 1) > 1
