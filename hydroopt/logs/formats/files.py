"""Which reader a file has, and the sheets of one file, of several, or of a directory."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path

from hydroopt.errors import LogError
from hydroopt.logs.column_map import LogMap
from hydroopt.logs.formats.foreign_file import NAMES, ForeignFile
from hydroopt.logs.formats.parquet_file import ParquetFile
from hydroopt.logs.formats.sheet import Sheet
from hydroopt.logs.formats.text_file import TextFile
from hydroopt.logs.table import EXPANDED_LIMIT, FORMATS, kind_of, load

MAGIC = {b"MDF     ": "mdf", b"\x89HDF\r\n\x1a\n": "hdf5", b"#ROSBAG V2.0": "bags"}
"""First bytes of files whose name may say something else."""


@contextmanager
def open_files(paths: Sequence[str], layout: LogMap | None) -> Iterator[tuple[list[Sheet], str]]:
    """The sheets of files, open as long as they are read, and the SHA-256 of the file, or of those of several; a
    directory that is no bag stands for its files.

    Raises:
        LogError: a file is damaged or of an unknown kind, or declares more than can be held.
    """
    files = [file for path in paths for file in _files_of(path)]
    sheets, digests = list[Sheet](), list[str]()
    with ExitStack() as stack:
        for file in files:
            kind, front = true_kind(file, layout), stem(file) if len(files) > 1 else ""
            if kind in NAMES:
                digests.append(_digest(file))
                foreign = ForeignFile(str(kind), file, _size(file), layout)
                stack.callback(foreign.close)
                found = foreign.sheets
            elif kind == "parquet" and not file.lower().endswith(".gz"):
                digests.append(_digest(file, float("inf")))
                found = [ParquetFile(Path(file), file, layout)]
            else:
                data, digest, kind = load(file, kind)
                digests.append(digest)
                found = [TextFile(data, file, layout) if kind == "csv" else ParquetFile(data, file, layout)]
            for sheet in found:
                sheet.name = f"{front}:{sheet.name}" if front and sheet.name else front or sheet.name
            sheets += found
        yield sheets, digests[0] if len(digests) == 1 else hashlib.sha256("".join(digests).encode()).hexdigest()


def true_kind(path: str | Path, layout: LogMap | None) -> str | None:
    """The kind of a file by its map, its first bytes or its name; None where none of them says."""
    declared = layout.format if layout else None
    if os.path.isdir(path):
        return declared or "bags"
    kind = kind_of(path, declared)
    if declared not in (None, "mat") or not os.path.isfile(path):
        return kind
    with open(path, "rb") as file:
        start = file.read(128)
    found = next((each for magic, each in MAGIC.items() if start.startswith(magic)), None)
    if kind == "mat":
        return "mat73" if start.startswith(b"MATLAB 7.3") or found == "hdf5" else "mat"
    return found or kind


def _files_of(path: str) -> list[str]:
    """The file, or the files and bags of a directory that are logs.

    Raises:
        LogError: the directory holds no log.
    """
    if not os.path.isdir(path) or _is_bag(path):
        return [path]
    files = sorted(entry.path for entry in os.scandir(path) if not entry.name.startswith(".") and (
        kind_of(entry.path, None) is not None if entry.is_file() else _is_bag(entry.path)))
    if not files:
        raise LogError("this is a directory without logs, not a file", where=path,
                       remedy=f"name a file of {', '.join(FORMATS)}, or a directory of such files")
    return files


def _is_bag(path: str) -> bool:
    """Whether this is the directory of a ROS 2 bag."""
    return os.path.isfile(os.path.join(path, "metadata.yaml"))


def _size(path: str) -> int:
    if os.path.isdir(path):
        return sum(entry.stat().st_size for entry in os.scandir(path) if entry.is_file())
    return os.path.getsize(path)


def _digest(path: str, most: float = EXPANDED_LIMIT) -> str:
    """SHA-256 of a file of at most so many bytes, or of those of a directory's files, by name.

    Raises:
        LogError: it cannot be read, is empty or too large.
    """
    try:
        size = _size(path)
        if size > most:
            raise LogError(f"it has {size / 1e9:.1f} GB", where=path, remedy="split it")
        if size == 0:
            raise LogError("the file is empty", where=path, remedy="record it again")
        if not os.path.isdir(path):
            with open(path, "rb") as file:
                return hashlib.file_digest(file, "sha256").hexdigest()
        parts = sorted(entry.path for entry in os.scandir(path) if entry.is_file())
        return hashlib.sha256("".join(map(_digest, parts)).encode()).hexdigest()
    except (OSError, ValueError) as error:  # ValueError: a NUL in the path
        raise LogError(f"the file cannot be read ({getattr(error, 'strerror', error)})", where=path,
                       remedy="check the path and its permissions") from None


def stem(path: str | Path) -> str:
    """The name of a file without its ending, `.csv.gz` being one.

    >>> stem("logs/run1.csv.gz")
    'run1'
    """
    name = Path(path)
    return (name.with_suffix("") if name.suffix.lower() == ".gz" else name).stem
