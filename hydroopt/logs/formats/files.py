"""Which reader a file has, and the sheets of one file or of several."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from hydroopt.logs.column_map import LogMap
from hydroopt.logs.formats.log_file import LogFile
from hydroopt.logs.formats.mat_file import MatFile
from hydroopt.logs.formats.parquet_file import ParquetFile
from hydroopt.logs.formats.text_file import TextFile
from hydroopt.logs.sheets import Sheet
from hydroopt.logs.table import load


@dataclass(frozen=True)
class Source:
    """The sheets of one file or several, and the SHA-256 of each file."""

    sheets: tuple[Sheet, ...]
    digests: tuple[str, ...]


@contextmanager
def open_files(paths: Sequence[str], layout: LogMap | None) -> Iterator[Source]:
    """The sheets of files, open as long as they are read.

    Raises:
        LogError: a file is damaged or of an unknown kind, or declares more than can be held.
    """
    sheets, digests = [], []
    for path in paths:
        data, digest, kind = load(path, layout.format if layout else None)
        sheets.append(Sheet(stem(path) if len(paths) > 1 else "", path, open_file(kind, data, path, layout)))
        digests.append(digest)
    yield Source(tuple(sheets), tuple(digests))


def open_file(kind: str, data: bytes, where: str, layout: LogMap | None) -> LogFile:
    """A file of `kind` "csv", "parquet" or "mat" from its bytes; `layout` is its map, if it has one.

    Raises:
        LogError: the file is damaged or not of that kind, or declares more than can be held.
    """
    if kind == "mat":
        return MatFile(data, where, layout)
    return TextFile(data, where, layout) if kind == "csv" else ParquetFile(data, where, layout)


def stem(path: str | Path) -> str:
    """The name of a file without its ending, `.csv.gz` being one.

    >>> stem("logs/run1.csv.gz")
    'run1'
    """
    name = Path(path)
    return (name.with_suffix("") if name.suffix.lower() == ".gz" else name).stem
