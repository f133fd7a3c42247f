"""Which reader a file has, and the sheets of one file, of several, or of a directory."""

from __future__ import annotations

import gzip
import hashlib
import os
import zlib
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path

from hydroopt.errors import LogError
from hydroopt.logs.column_map import FORMATS, LogMap
from hydroopt.logs.formats.foreign_file import NAMES, ForeignFile
from hydroopt.logs.formats.parquet_file import ParquetFile
from hydroopt.logs.formats.sheet import Sheet
from hydroopt.logs.formats.text_file import TextFile
from hydroopt.logs.table import EXPANDED_LIMIT, unreadable
from hydroopt.support import memory

MAGIC = {b"MDF     ": "mdf", b"\x89HDF\r\n\x1a\n": "hdf5", b"#ROSBAG V2.0": "bags"}
"""First bytes of files whose name may say something else."""
EXPANSION = 10
"""Bytes of memory that a byte of text takes until an identification is done with it."""


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
            kind, packed = true_kind(file, layout), file.lower().endswith(".gz")
            if kind is None and os.path.isfile(file):
                raise LogError(f"'{Path(file).suffix}' is not a kind of log that can be read", where=file,
                               remedy=f"use {', '.join(FORMATS)} or state 'format' in a map")
            digests.append(_digest(file))
            found: Sequence[Sheet]
            if kind in NAMES:
                foreign = ForeignFile(str(kind), file, _size(file), layout)
                stack.callback(foreign.close)
                found = foreign.sheets
            elif kind == "parquet":
                found = [ParquetFile(_content(file) if packed else Path(file), file, layout)]
            else:
                found = [TextFile(_content(file), file, layout)]
            front = stem(file) if len(files) > 1 else ""
            for sheet in found:
                sheet.name = f"{front}:{sheet.name}" if front and sheet.name else front or sheet.name
            sheets += found
        yield sheets, digests[0] if len(digests) == 1 else hashlib.sha256("".join(digests).encode()).hexdigest()


def kind_of(path: str | Path) -> str | None:
    """The kind of a file by its name, without .gz."""
    file = Path(path)
    return FORMATS.get((file.with_suffix("") if file.suffix.lower() == ".gz" else file).suffix.lower())


def true_kind(path: str | Path, layout: LogMap | None) -> str | None:
    """The kind of a file by its map, its first bytes or its name; None where none of them says."""
    declared = layout.format if layout else None
    if os.path.isdir(path):
        return declared or "bags"
    kind = declared or kind_of(path)
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
        kind_of(entry.path) is not None if entry.is_file() else _is_bag(entry.path)))
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


def _digest(path: str) -> str:
    """SHA-256 of a file, or of those of a directory's files, by name.

    Raises:
        LogError: it cannot be read or is empty, as pipes and devices are.
    """
    try:
        if _size(path) == 0:
            raise LogError("the file is empty", where=path, remedy="record it again")
        if not os.path.isdir(path):
            with open(path, "rb") as file:
                return hashlib.file_digest(file, "sha256").hexdigest()
        parts = sorted(entry.path for entry in os.scandir(path) if entry.is_file())
        return hashlib.sha256("".join(map(_digest, parts)).encode()).hexdigest()
    except (FileNotFoundError, ValueError):  # ValueError: a NUL in the path
        raise LogError("there is no such file", where=path, remedy="check the path") from None
    except OSError as error:
        raise LogError(f"the file cannot be read ({error.strerror})", where=path,
                       remedy="check the path and its permissions") from None


def _content(path: str) -> bytes:
    """The bytes of a file, unpacked if it ends in .gz: little may be packed there from much.

    Raises:
        LogError: an identification with it would not have enough memory, it is damaged, or it is empty.
    """
    most = int(min(memory.available() / EXPANSION, EXPANDED_LIMIT))
    packed = path.lower().endswith(".gz")
    try:
        with gzip.open(path) if packed else open(path, "rb") as file:
            content = file.read((most if packed else min(most, os.path.getsize(path))) + 1)
    except (OSError, EOFError, zlib.error) as error:
        raise unreadable("gzip" if packed else "log", path, error) from None
    if len(content) > most:
        raise LogError(f"a table of more than {most / 1e9:.1f} GB takes more memory than there is", where=path,
                       remedy="convert it to Parquet, which is read in pieces, or split it")
    if not content.strip():
        raise LogError("the file is empty", where=path, remedy="record it again")
    return content


def stem(path: str | Path) -> str:
    """The name of a file without its ending, `.csv.gz` being one.

    >>> stem("logs/run1.csv.gz")
    'run1'
    """
    name = Path(path)
    return (name.with_suffix("") if name.suffix.lower() == ".gz" else name).stem
