"""Logs and recordings from files: which channels they hold, in SI, with all findings reported."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from hashlib import sha256
from pathlib import Path

import numpy as np

from hydroopt.errors import LogError
from hydroopt.logs.column_map import LogMap
from hydroopt.logs.formats.files import Source, open_files, stem
from hydroopt.logs.log import Log, given_layout, left_out, refuse_damage_of, treated_log
from hydroopt.logs.partial_columns import Partial, partial_columns
from hydroopt.logs.quality import Finding
from hydroopt.logs.recording import ChannelGroup, Recording
from hydroopt.logs.sheets import Part, parts_of_map, parts_without_map
from hydroopt.logs.stamps import of_texts
from hydroopt.logs.table import in_si, stamps_of
from hydroopt.logs.treatment import choose


def read_log(
    path: str | Path,
    *,
    mapping: LogMap | str | Path | None = None,
    treatment: Mapping[str, str] | None = None,
    limits: Mapping[str, tuple[float, float]] | None = None,
) -> Log:
    """Read a log; several groups of channels are merged as `Recording.log` does.

    Args:
        path: file with headers `name [unit]`; columns whose name has no dot are not channels and are left out (a
            finding of kind "ignored" says so). Or a directory of files that were recorded at one time.
        mapping: for files with other headers, the map of their columns (`read_map`); it has no labels, and needs the
            time `t` unless the file has stamps of its own.
        treatment: action by kind of finding, see `treatment.ACTIONS`. By default NaN and bad time stamps are
            errors, gaps split the log into segments and everything else is reported only.
        limits: (lowest, highest) value of a sensor's range by channel, in SI; samples there are saturated. Limits of
            channels that the log lacks mean nothing.

    Raises:
        LogError: the file is missing, damaged or not understood; the sentence names row and column.
        ProblemError: unknown treatment.

    >>> from tempfile import TemporaryDirectory
    >>> with TemporaryDirectory() as directory:
    ...     file = Path(directory) / "run.csv"
    ...     _ = file.write_text("t [s],boom.q [deg],boom_cylinder.p_head [bar]\\n0,10,100\\n0.02,10.1,101\\n")
    ...     log = read_log(file)
    >>> log.channels["boom_cylinder.p_head"].tolist(), log.units["boom.q"]
    ([10000000.0, 10100000.0], 'rad')
    """
    return read_recording(path, mapping=mapping, treatment=treatment, limits=limits).log()


def read_recording(
    paths: str | Path | Sequence[str | Path],
    *,
    mapping: LogMap | str | Path | None = None,
    treatment: Mapping[str, str] | None = None,
    limits: Mapping[str, tuple[float, float]] | None = None,
) -> Recording:
    """Read a recording, one group of channels for each clock; nothing is resampled.

    A sheet, topic or group of a file that has several is a group of channels, and so is each of several files. Columns
    that hold numbers in few rows, evenly spread, are a group too.

    Args:
        paths: the file or directory, or the files that were recorded at one time. Times without a date have one zero;
            dates are aligned.
        mapping, treatment, limits: as for `read_log`, for all files; the treatment of each group sees that group alone.

    Raises:
        LogError: a file is missing, damaged or not understood, two groups hold the same channel, or only some of the
            groups have dates.
        ProblemError: unknown treatment.

    >>> from tempfile import TemporaryDirectory
    >>> with TemporaryDirectory() as directory:
    ...     joints, can = Path(directory) / "joints.csv", Path(directory) / "can.csv"
    ...     _ = joints.write_text("t [s],boom.q [deg]\\n0,10\\n0.02,10.1\\n0.04,10.3\\n")
    ...     _ = can.write_text("t [s],boom_cylinder.p_head [bar]\\n0,100\\n0.04,101\\n")
    ...     recording = read_recording([joints, can])
    >>> recording.groups
    (ChannelGroup('joints': 3 samples, 50 Hz, 1 channel), ChannelGroup('can': 2 samples, 25 Hz, 1 channel))
    >>> recording.log().channels["boom_cylinder.p_head"].tolist()
    [10000000.0, 10050000.0, 10100000.0]
    """
    files = [str(path) for path in ([paths] if isinstance(paths, str | Path) else paths)]
    if not files:
        raise LogError("there is no file", where="recording", remedy="give at least one")
    where, chosen = ", ".join(files), choose(treatment)
    stated = given_layout(mapping, where)
    with open_files(files, stated) as source:
        parts = (parts_without_map(source.sheets, where) if stated is None
                 else parts_of_map(stated, source.sheets, where))
        groups: list[tuple[ChannelGroup, np.datetime64 | None]] = []
        findings: list[Finding] = []
        for part in parts:
            for group, start, found in _groups(part, chosen, limits or {}, split=chosen["nan"] == "use"):
                groups.append((group, start))
                findings += found
        digest = _digest(source)
    aligned, start = _aligned(groups, where)
    if start is None and len({part.where for part in parts}) > 1:
        rows = (int(aligned[0].sample[0]), int(aligned[0].sample[-1]))
        findings.append(Finding("clock", "t", *rows, 0, "the times of the groups have no date: one zero is assumed"))
    clocks = {part.name: part.clock for part in parts}
    return Recording(stem(files[0]), aligned, start, tuple(dict.fromkeys(findings)), where, digest, clocks)


def _digest(source: Source) -> str:
    if len(source.digests) == 1:
        return source.digests[0]
    return sha256("".join(source.digests).encode()).hexdigest()


def _groups(part: Part, chosen: Mapping[str, str], limits: Mapping[str, tuple[float, float]], *,
            split: bool) -> list[tuple[ChannelGroup, np.datetime64 | None, tuple[Finding, ...]]]:
    """The group of channels of a part of a file, or the groups of its columns that hold numbers in some rows."""
    where, layout = part.where, part.layout
    table = part.sheet.read(layout.keys, time=part.time)
    values, units = in_si(layout, table, where)
    made = stamps_of(layout, table)
    t = values.pop("t") if "t" in values else made.seconds() if made is not None else np.full(table.rows.size, np.nan)
    refuse_damage_of(table, t, where)
    if table.rows.size < 2:
        raise LogError("there is only one data row", where=where, remedy="record at least two samples")
    rows = (int(table.rows[0]), int(table.rows[-1]))
    notes = left_out(layout, part.ignored, *rows)
    notes += tuple(Finding(kind, "t" if kind == "clock" else "", *rows, 0, text) for kind, text in (
        ("format", part.sheet.shown and f"the file was read with {part.sheet.shown}"),
        ("clock", made.shown if made is not None else "")) if text)
    start = made.start if made is not None else None
    if part.start:
        start = of_texts([part.start], None, where).start
    used = np.isfinite(t) | np.logical_or.reduce([np.isfinite(x) for x in values.values()]) if part.padded else None
    found = partial_columns(values) if split else Partial(tuple(values), (), ())
    if not found.full and not found.sparse:
        found = Partial(tuple(values), (), ())
    pieces = [*([(None, found.full)] if found.full else []), *found.sparse]
    out = []
    for k, (mask, names) in enumerate(pieces):
        keep = mask if used is None else used if mask is None else mask & used
        name = part.name if k == 0 else f"{part.name} {names[0]}".strip()
        sample = table.rows if keep is None else table.rows[keep]
        log = treated_log(where, t if keep is None else t[keep],
                          {n: values[n] if keep is None else values[n][keep] for n in names}, sample, chosen, limits,
                          {n: units[n] for n in names})
        said = log.findings + (notes if k == 0 else ())
        if mask is not None:
            said += (Finding("sparse", names[0], int(sample[0]), int(sample[-1]), int(sample.size),
                             f"{', '.join(names)} hold{'s' * (len(names) == 1)} numbers in {sample.size} of "
                             f"{table.rows.size} rows: a group of channels with stamps of its own"),)
        group = ChannelGroup(name, log.t, log.channels, log.units, log.sample, log.segment)
        out.append((group, start, said))
    if found.empty:
        text = f"{', '.join(found.empty)}: no number in any row; left out"
        group, start, said = out[0]
        out[0] = group, start, (*said, Finding("empty", found.empty[0], *rows, table.rows.size, text))
    return out


def _aligned(groups: Sequence[tuple[ChannelGroup, np.datetime64 | None]],
             where: str) -> tuple[tuple[ChannelGroup, ...], np.datetime64 | None]:
    """Groups with one zero of time, and its moment, if they have dates.

    Raises:
        LogError: only some of them have.
    """
    starts = [start for _, start in groups if start is not None]
    if not starts:
        return tuple(group for group, _ in groups), None
    if len(starts) < len(groups):
        name = next(group.name for group, start in groups if start is None)
        raise LogError(f"the times of '{name}' have no date, those of other groups have", where=where,
                       remedy=f"state start = '2026-01-31T12:00:00' in [clocks.\"{name}\"] of a map")
    first = min(starts)
    late = [0.0 if start is None else float((start - first) / np.timedelta64(1, "s")) for _, start in groups]
    return tuple(replace(group, t=group.t + seconds) if seconds else group
                 for (group, _), seconds in zip(groups, late, strict=True)), first
