"""The folder of compiled kernels.

Whoever can write there runs code as this user. The folder is used only if no other user can: it belongs to this user,
and only this user and root can write to it and to the folders above it, as ssh requires of its keys.
"""

from __future__ import annotations

import hashlib
import os
import re
import shutil
import stat
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TypeVar

import platformdirs

T = TypeVar("T")

UNUSED = 90 * 24 * 3600.0
"""For how long [s] nothing has read what is removed once something new is kept."""
OWN = re.compile(r"[0-9a-f]{32}[-.]")
"""Beginning of the names of what is kept, and of scratch folders: ``$HYDROOPT_CACHE`` may hold other files, too."""


def folder(part: str = "") -> Path:
    """The cache: ``$HYDROOPT_CACHE`` or the user's folder for such, or a folder in it; made if it is missing.

    What is looked for by the beginning of its name is kept in parts: to list thousands of files takes longer than to
    load a kernel.

    Raises:
        PermissionError: others than this user can write there; the message names the folder.
        OSError: the folder cannot be made or read, or the user has no home.
    """
    stated = os.environ.get("HYDROOPT_CACHE")
    try:
        path = Path(os.path.realpath(stated or platformdirs.user_cache_path("hydroopt"))) / part
    except RuntimeError:
        raise FileNotFoundError("this user has no home") from None
    for missing in reversed([each for each in (path, *path.parents) if not each.exists()]):
        missing.mkdir(mode=0o700, exist_ok=True)
    if not path.is_dir():
        raise NotADirectoryError(f"'{path}' is a file")
    _refuse_foreign(path)
    return path


@contextmanager
def scratch(inside: Path | None = None) -> Iterator[Path]:
    """A new folder for this user alone, in the cache or among the system's temporary files; removed at the end.

    What has long been unused in the cache is removed first.

    Raises:
        PermissionError: others could put something else in its place.
        OSError: there is no folder that can be written.
    """
    if inside is not None:
        _remove_unused(inside)
    prefix = f"{os.urandom(16).hex()}-"
    with tempfile.TemporaryDirectory(prefix=prefix, dir=inside, ignore_cleanup_errors=True) as temporary:
        path = Path(os.path.realpath(temporary))
        _refuse_foreign(path)
        yield path


def read(file: Path) -> bytes:
    """Content of a regular file that belongs to this user and that no other user can write.

    Raises:
        PermissionError: it is another kind of file.
        OSError: it cannot be read.
    """
    with open(os.open(file, os.O_RDONLY | getattr(os, "O_NOFOLLOW", 0)), "rb") as opened:
        state = os.fstat(opened.fileno())
        if not stat.S_ISREG(state.st_mode) or _foreign(state):
            raise PermissionError(f"others than this user can write to '{file}'")
        return opened.read()


def kept(part: str, key: str, suffix: str, make: Callable[[Path], Path], use: Callable[[Path], T]) -> T:
    """What the file of a key in a part of the cache is used for; one that is not there, or cannot be used, is made.

    Its name holds a hash of its content: a file is whole or is not used, however many processes make it at once.

    Args:
        part: see `folder`.
        key: of 32 hexadecimal digits.
        suffix: of the file's name.
        make: writes it into a folder, and says where.
        use: reads or loads it.

    Raises:
        OSError: the cache cannot be used.
    """
    place = folder(part)
    names = [name for name in os.listdir(place) if name.startswith(f"{key}-") and name.endswith(suffix)]
    for entry in sorted(place / name for name in names):  # pathlib's glob takes ten times as long
        with suppress(OSError):
            if _digest(read(entry)) == entry.stem.partition("-")[2]:
                return use(entry)
        with suppress(FileNotFoundError):  # another process found it first
            entry.unlink()
    with scratch(place) as empty:
        made = make(empty)
        made.chmod(0o700)  # whatever the umask: only this user may write it
        return use(made.rename(place / f"{key}-{_digest(made.read_bytes())}{suffix}"))


def _digest(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()[:32]


def _remove_unused(place: Path) -> None:
    """Remove what is kept directly in a folder, or was left by killed processes, and has not been read for `UNUSED`."""
    with os.scandir(place) as entries:
        for entry in entries:
            with suppress(OSError):
                state = entry.stat(follow_symlinks=False)
                if OWN.match(entry.name) and time.time() - max(state.st_atime, state.st_mtime) > UNUSED:
                    shutil.rmtree(entry.path) if stat.S_ISDIR(state.st_mode) else os.unlink(entry.path)


def _refuse_foreign(path: Path) -> None:
    """Refuse a folder without symbolic links in its path, in which others could put or replace a file."""
    for place in (path, *path.parents):
        state = place.lstat()
        sticky = place != path and state.st_mode & stat.S_ISVTX  # there others cannot rename what is not theirs
        owner = place != path and state.st_uid == 0
        if _foreign(state, ignore_mode=bool(sticky), ignore_owner=owner):
            raise PermissionError(f"others than this user can write to '{place}'")


def _foreign(state: os.stat_result, *, ignore_mode: bool = False, ignore_owner: bool = False) -> bool:
    if not hasattr(os, "geteuid"):  # Windows, where a user's folders are closed to others
        return False
    writable = bool(state.st_mode & (stat.S_IWGRP | stat.S_IWOTH))
    return (writable and not ignore_mode) or (state.st_uid != os.geteuid() and not ignore_owner)
