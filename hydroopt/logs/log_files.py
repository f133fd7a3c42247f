"""Logs and recordings from files: which channels they hold, in SI, with all findings reported."""

from collections.abc import Mapping, Sequence
from hashlib import sha256
from pathlib import Path

from hydroopt.errors import LogError
from hydroopt.logs.column_map import LogMap
from hydroopt.logs.log import Log, full_layout, given_layout, log_of_table
from hydroopt.logs.quality import Finding
from hydroopt.logs.readers import open_file
from hydroopt.logs.recording import ChannelGroup, Recording
from hydroopt.logs.table import in_si, load
from hydroopt.logs.treatment import choose


def read_log(
    path: str | Path,
    *,
    mapping: LogMap | str | Path | None = None,
    treatment: Mapping[str, str] | None = None,
    limits: Mapping[str, tuple[float, float]] | None = None,
) -> Log:
    """Read a log from CSV, Parquet or, with a map, a MATLAB file.

    Args:
        path: file with headers `name [unit]`; columns whose name has no dot are not channels and are left out (a
            finding of kind "ignored" says so).
        mapping: for files with other headers, the map of their columns (`read_map`); it needs the time `t` and has no
            labels.
        treatment: action by kind of finding, see `treatment.ACTIONS`. By default NaN and bad time stamps are
            errors, gaps split the log into segments and everything else is reported only.
        limits: (lowest, highest) value of a sensor's range by channel, in SI; samples there are saturated. Limits of
            channels that the log lacks mean nothing.

    Raises:
        LogError: the file is missing, damaged or not understood; the sentence names row and column.
        ProblemError: unknown treatment.

    >>> from pathlib import Path
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
    """Read a recording, one group of channels from each file; nothing is resampled.

    Args:
        paths: the file, or the files that were recorded at one time; their times have one zero.
        mapping, treatment, limits: as for `read_log`, for all files; the treatment of each group sees that group alone.

    Raises:
        LogError: a file is missing, damaged or not understood, or two files hold the same channel.
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
    files = [Path(path) for path in ([paths] if isinstance(paths, str | Path) else paths)]
    if not files:
        raise LogError("there is no file", where="recording", remedy="give at least one")
    where = ", ".join(str(path) for path in (paths if not isinstance(paths, str | Path) else [paths]))
    chosen, stated = choose(treatment), given_layout(mapping, where)
    digest, groups = sha256(), []
    findings: list[Finding] = []
    for file in files:
        data, _, kind = load(file, stated.format if stated else None)
        digest.update(data)
        opened = open_file(kind, data, str(file), stated)
        layout, ignored = full_layout(stated, opened.header, str(file))
        table = opened.read(layout.keys)
        log = log_of_table(str(file), table, layout, ignored, in_si(layout, table, str(file)), chosen, limits or {})
        groups.append(ChannelGroup(file.stem if len(files) > 1 else "", log.t, log.channels, log.units, log.sample,
                                   log.segment))
        findings += log.findings
    return Recording(files[0].stem, tuple(groups), None, tuple(findings), where, digest.hexdigest())
