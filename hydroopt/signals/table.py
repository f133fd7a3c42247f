"""Raw columns of a file as numbers, and what all file formats have in common."""

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hydroopt.errors import LogError
from hydroopt.signals.mapping import Key

Array = NDArray[np.float64]
RawKey = Key | tuple[str, int | None]
FORMATS = {".csv": "csv", ".txt": "csv", ".dat": "csv", ".parquet": "parquet", ".mat": "mat"}
FILE_LIMIT = 2 * 1024**3
"""Largest file that is read [bytes]."""
EXPANDED_LIMIT = 10 * 1000**3
"""Largest size in memory that a file may declare [bytes]."""


@dataclass(frozen=True)
class Table:
    """Raw columns by key, each (N,); `rows` (N,) 1-based data rows; `damage`: why a row cannot be trusted."""

    columns: dict[RawKey, Array]
    rows: NDArray[np.int64]
    damage: dict[int, str] = field(default_factory=dict)


def load(path: str | Path, declared: str | None) -> tuple[bytes, str, str]:
    """Bytes of a file, their SHA-256 and the format.

    Raises:
        LogError: the file is missing, no file, too large or of an unknown kind.
    """
    file, where = Path(path), str(path)
    kind = declared or FORMATS.get(file.suffix.lower())
    if not file.exists():
        raise LogError("there is no such file", where=where, remedy="check the path")
    if not file.is_file():
        raise LogError("this is a directory or device, not a file", where=where, remedy="name one log file")
    if kind is None:
        raise LogError(f"'{file.suffix}' is not a kind of log that can be read", where=where,
                       remedy=f"use {', '.join(FORMATS)} or state 'format' in a map")
    if (size := file.stat().st_size) > FILE_LIMIT:
        raise LogError(f"the file has {size / 1e9:.1f} GB", where=where,
                       remedy="split it into parts below 2 GiB")
    try:
        data = file.read_bytes()
    except OSError as error:
        raise LogError(f"the file cannot be read ({error.strerror})", where=where,
                       remedy="check its permissions") from None
    if not data.strip():
        raise LogError("the file is empty", where=where, remedy="record it again")
    return data, hashlib.sha256(data).hexdigest(), kind


def runs(rows: Sequence[int] | NDArray[np.int64], most: int = 4) -> str:
    """Row numbers in words, neighbours joined: ``2–10, 6107``."""
    numbers = sorted(int(r) for r in rows)
    parts: list[list[int]] = []
    for number in numbers:
        if parts and number == parts[-1][1] + 1:
            parts[-1][1] = number
        else:
            parts.append([number, number])
    words = [str(a) if a == b else f"{a}–{b}" for a, b in parts[:most]]
    return ", ".join(words) + (f" and {len(parts) - most} more stretches" if len(parts) > most else "")


def find_column(key: Key, header: list[str], width: int, where: str) -> int:
    """Index of a column given by name or 0-based index.

    Raises:
        LogError: there is none, or the name stands there twice.
    """
    if isinstance(key, int):
        if not 0 <= key < width:
            raise LogError(f"there is no column {key} among {width} (counted from 0)", where=where,
                           remedy="correct the index in the map")
        return key
    count = header.count(key)
    if count == 0:
        present = f"those present are {', '.join(header[:40])}" if header else "no header is read"
        raise LogError(f"there is no column '{key}' ({present})", where=where,
                       remedy="correct the name in the map")
    if count > 1:
        raise LogError(f"column '{key}' stands there {count} times", where=where,
                       remedy="rename one or give the column's 0-based index in a map")
    return header.index(key)


def selected(count: int, rows: tuple[int, int] | None, where: str) -> NDArray[np.int64]:
    """1-based data rows that a map selects of `count`."""
    first, last = rows or (1, count)
    if last > count:
        raise LogError(f"rows {first} to {last} are asked for, but there are {count} data rows",
                       where=where,
                       remedy="correct 'rows' in the map")
    return np.arange(first, last + 1)


def check_size(size: float, where: str) -> None:
    """Refuse a file that declares more than EXPANDED_LIMIT bytes."""
    if size > EXPANDED_LIMIT:
        raise LogError(f"the file declares {size / 1e9:.3g} GB of data", where=where,
                       remedy="check that it is undamaged, or split it")


def unreadable(kind: str, where: str, error: BaseException) -> LogError:
    """The error for a file that its library cannot read."""
    reason = (str(error).strip().splitlines() or [type(error).__name__])[0][:120].rstrip(".")
    return LogError(f"this is not a readable {kind} file ({reason})", where=where,
                    remedy="export it again or name the file after its true format")
