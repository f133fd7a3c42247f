"""Logs and recordings from files: which channels they hold, in SI, with all findings reported."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hydroopt.errors import LogError
from hydroopt.logs.column_map import LogMap, for_log, read_map
from hydroopt.logs.formats.files import open_files, stem
from hydroopt.logs.log import Log
from hydroopt.logs.mapped import release
from hydroopt.logs.quality import Finding
from hydroopt.logs.recording import Recording
from hydroopt.logs.sheets import Part, parts_of_map, parts_without_map
from hydroopt.logs.table import Array
from hydroopt.logs.treatment import Samples, choose, treat

SPARSE = 0.9
"""Share of the rows with a number below which a column may count as sampled more slowly."""
EVEN = 4.0
"""Largest distance between rows with a number, in median distances, of such a column."""


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
    (Log('joints': 3 samples, 0.04 s, 1 channel), Log('can': 2 samples, 0.04 s, 1 channel))
    >>> recording.log().channels["boom_cylinder.p_head"].tolist()
    [10000000.0, 10050000.0, 10100000.0]
    """
    files = [str(path) for path in ([paths] if isinstance(paths, str | Path) else paths)]
    if not files:
        raise LogError("there is no file", where="recording", remedy="give at least one")
    where, chosen = ", ".join(files), choose(treatment)
    stated = (None if mapping is None else for_log(mapping, where) if isinstance(mapping, LogMap)
              else read_map(mapping))
    groups: list[tuple[Log, np.datetime64 | None]] = []
    findings: list[Finding] = []
    with open_files(files, stated) as (sheets, digest):
        parts = parts_without_map(sheets, where) if stated is None else parts_of_map(stated, sheets, where)
        for part in parts:
            for group, start, found in _groups(part, chosen, limits or {}):
                groups.append((group, start))
                findings += found
    aligned, start = _aligned(groups, where)
    if start is None and len({part.where for part in parts}) > 1:
        rows = (int(aligned[0].sample[0]), int(aligned[0].sample[-1]))
        findings.append(Finding("clock", "t", *rows, 0, "the times of the groups have no date: one zero is assumed"))
    return Recording(stem(files[0]), aligned, start, tuple(dict.fromkeys(findings)), where, digest,
                     {part.name: part.clock for part in parts})


def _groups(part: Part, chosen: Mapping[str, str],
            limits: Mapping[str, tuple[float, float]]) -> list[tuple[Log, np.datetime64 | None, tuple[Finding, ...]]]:
    """The group of channels of a part of a file, or the groups of its columns that hold numbers in some rows."""
    read, where = part.read(), part.where
    t, values, rows, notes = read.t, read.values, read.rows, list(read.notes)
    used = np.isfinite(t) | np.logical_or.reduce([np.isfinite(x) for x in values.values()]) if part.padded else None
    pieces, empty = _by_rows(values) if chosen["nan"] == "use" else ([(None, [*values])], [])
    if empty:
        text = f"{', '.join(empty)}: no number in any row; left out"
        notes.append(Finding("empty", empty[0], int(rows[0]), int(rows[-1]), rows.size, text))
    out = []
    for k, (mask, names) in enumerate(pieces):
        keep = mask if used is None else used if mask is None else mask & used
        found = Samples(t, {name: values[name] for name in names}, rows)
        found = found if keep is None else found.keep(keep)
        sample = found.sample
        samples, segment = treat(found, chosen, limits, where)
        said = [*samples.findings, *(notes if k == 0 else ())]
        if mask is not None:
            said.append(Finding("sparse", names[0], int(sample[0]), int(sample[-1]), int(sample.size),
                                f"{', '.join(names)} hold{'s' * (len(names) == 1)} numbers in {sample.size} of "
                                f"{rows.size} rows: a group of channels with stamps of its own"))
        name = part.name if k == 0 else f"{part.name} {names[0]}".strip()
        log = Log(name, samples.t, samples.channels, samples.sample, segment, (), where,
                  units={name: read.units[name] for name in names})
        out.append((log, read.start, tuple(said)))
    return out


def _by_rows(channels: Mapping[str, Array]) -> tuple[list[tuple[NDArray[np.bool_] | None, list[str]]], list[str]]:
    """The names of channels (N,) by the rows in which they hold numbers, None of nearly all or of uneven ones, which
    are defects; and the names of those without a number. Where none has one, all are as if they had.

    >>> nan = np.nan
    >>> found, empty = _by_rows({"a.q": np.arange(8.0), "a.u": np.array([1, nan] * 4), "b.q": np.full(8, nan)})
    >>> [names for _, names in found], empty
    ([['a.q'], ['a.u']], ['b.q'])
    """
    full, empty = list[str](), list[str]()
    sparse: dict[bytes, tuple[NDArray[np.bool_] | None, list[str]]] = {}
    for name, x in channels.items():
        rows = np.isfinite(x)
        release()
        if not rows.any():
            empty.append(name)
        elif np.any(np.isinf(x)) or not _even(rows):
            full.append(name)
        else:
            sparse.setdefault(np.packbits(rows).tobytes(), (rows, []))[1].append(name)
    if not full and not sparse:
        return [(None, empty)], []
    return [*([(None, full)] if full else []), *sparse.values()], empty


def _even(rows: NDArray[np.bool_]) -> bool:
    """Whether the rows are few and evenly spread over all."""
    if not 2 <= np.count_nonzero(rows) < SPARSE * rows.size:
        return False
    index = np.flatnonzero(rows)
    steps = np.diff(index)
    widest = EVEN * np.median(steps)
    return bool(max(steps.max(), index[0], rows.size - 1 - index[-1]) <= max(widest, 2))


def _aligned(groups: Sequence[tuple[Log, np.datetime64 | None]],
             where: str) -> tuple[tuple[Log, ...], np.datetime64 | None]:
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
