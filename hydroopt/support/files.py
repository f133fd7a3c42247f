"""Files that appear whole or not at all; one process at a time writes into a folder, and reading changes nothing.

A folder of results is replaced under a lock. All new files are written beside the old ones first, in a hidden folder,
so that a full disk costs nothing. Then the old files go, the one that vouches for the others first, and the new ones
are moved into their place, that one last. A process that is killed in between leaves a folder without that file, which
every reader refuses; the next writer removes what is hidden. Other files in the folder stay.
"""

from __future__ import annotations

import atexit
import os
import shutil
import tempfile
import threading
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path, PurePath

from hydroopt.errors import ProblemError
from hydroopt.support.interrupt import delayed

LOCK = ".hydroopt.lock"
"""File that is locked, and is there, while a process writes into its folder."""
HIDDEN = ".hydroopt-"
"""Prefix of folders of files that are not in their place yet."""
PATIENCE = 10.0
"""How long a write waits for another process that is writing [s]."""
REMEDY = "choose another directory"


class BusyError(ProblemError):
    """Another process writes into the folder."""


class Claim:
    """The right of this process to write into a folder.

    Attributes:
        written: whether this process has written there.
    """

    def __init__(self) -> None:
        self.written = False


_claims: dict[str, Claim] = {}
"""Claims of this process by the folder's path."""
_turn = threading.RLock()
"""Held by the thread of this process that writes."""


@contextmanager
def claimed(directory: str | Path, *, patience: float = 0.0) -> Iterator[Claim]:
    """Keep other processes from writing into a folder; it is created if need be, and removed if it stays empty.

    What killed processes left there unfinished is removed. The system releases the claim when this process ends.

    Args:
        directory: the folder.
        patience: how long to wait for another process [s].

    Raises:
        BusyError: another process writes there.
        ProblemError: the folder cannot be written.
    """
    from filelock import FileLock, Timeout  # noqa: PLC0415 (import cost)

    with _reported(directory):
        target = Path(os.path.realpath(directory))
        if target.exists() and not target.is_dir():
            raise ProblemError("this is a file", where=str(directory), remedy=REMEDY)
        made = [folder for folder in (target, *target.parents) if not folder.exists()]
    if str(target) in _claims:
        yield _claims[str(target)]
        return
    lock = FileLock(target / LOCK, timeout=patience, thread_local=False)
    try:
        with _reported(directory):
            target.mkdir(parents=True, exist_ok=True)
            try:
                lock.acquire()
            except Timeout:
                if not (target / LOCK).exists():  # the system refuses, as if it were held
                    raise ProblemError("this folder cannot be written", where=str(directory), remedy=REMEDY) from None
                raise BusyError("another run of hydroopt writes into this folder", where=str(directory),
                                remedy=f"wait until it has ended, or {REMEDY}") from None
            for left in target.glob(f"{HIDDEN}*"):
                shutil.rmtree(left, ignore_errors=True)  # which leaves files and symbolic links alone
        claim = _claims[str(target)] = Claim()
        yield claim
    finally:
        if lock.is_locked:
            _claims.pop(str(target), None)
            with suppress(OSError):
                (target / LOCK).unlink()  # who waits for it notices
            lock.release()
        with suppress(OSError):
            for folder in made:
                folder.rmdir()


def temporary_files(folder: Path) -> None:
    """Have temporary files in `folder`, until this process ends, where the system has no other place for them."""
    try:
        tempfile.gettempdir()
    except FileNotFoundError:
        place = tempfile.mkdtemp(prefix=HIDDEN, dir=folder.resolve())
        atexit.register(shutil.rmtree, place, ignore_errors=True)  # after those who put something there
        tempfile.tempdir = os.environ["TMPDIR"] = place  # libraries and other programs read these


def write_files(directory: str | Path, files: Mapping[str, str | bytes | None]) -> None:
    """Replace files of a folder, all or none of them, by name; a name may have folders, ``c/crane.h``.

    None removes a file. The last file vouches for the others: it goes before them and comes after them.

    Raises:
        ProblemError: the folder or a file cannot be written, a name leads out of the folder, or another process writes
            there.
    """
    target = Path(directory)
    new = {name: content for name, content in files.items() if content is not None}
    with _turn, claimed(target, patience=PATIENCE) as claim, _reported(target):
        refuse_places(target, new)
        with tempfile.TemporaryDirectory(prefix=HIDDEN, dir=target, ignore_cleanup_errors=True) as hidden:
            for name, content in new.items():
                (target / name).parent.mkdir(parents=True, exist_ok=True)
                _write(Path(hidden, name), encoded(content))
            with delayed():
                claim.written = True
                if len(files) > 1:  # old and new files never stand side by side
                    for name in reversed([*files]):
                        if lies_within(target, name):
                            (target / name).unlink(missing_ok=True)
                for name in new:
                    os.replace(Path(hidden, name), target / name)


def write_file(path: str | Path, content: str | bytes) -> None:
    """Write one file, whole or not at all, into a folder that is there.

    Raises:
        ProblemError: it cannot be written, or another process writes into the folder.
    """
    target = Path(path)
    with _reported(path):
        os.stat(target.parent)
    try:
        write_files(target.parent, {target.name: content})
    except ProblemError as error:
        raise ProblemError(error.what, where=str(path), remedy="check the directory and its permissions") from None


def lies_within(folder: Path, name: str) -> bool:
    """Whether a file's name, which may have folders, is a plain one that no symbolic link leads out of the folder.

    >>> [lies_within(Path(), name) for name in ("c/crane.h", "../crane.h", "/crane.h", "")]
    [True, False, False, False]
    """
    path = PurePath(name)
    return bool(path.parts) and "\0" not in name and not path.is_absolute() and ".." not in path.parts and not any(
        os.path.islink(folder / parent) for parent in path.parents if parent.parts)


def refuse_places(directory: Path, names: Iterable[str]) -> None:
    """Refuse a directory that cannot take files of these names, before they are computed.

    Raises:
        ProblemError: a name leads out of it, or it holds a directory where a file must be.
    """
    for name in names:
        if not lies_within(directory, name):
            raise ProblemError("this leads out of the directory", where=str(directory / name), remedy=REMEDY)
        if os.path.isdir(directory / name):
            raise ProblemError("this is a directory", where=str(directory / name), remedy=REMEDY)


def encoded(content: str | bytes) -> bytes:
    """What is written of a text: UTF-8, and escapes for bytes of file names that are not."""
    return content if isinstance(content, bytes) else content.encode("utf-8", "backslashreplace")


def _write(file: Path, content: bytes) -> None:
    """Write a file and wait until the disk has it."""
    file.parent.mkdir(parents=True, exist_ok=True)
    with file.open("xb") as out:
        out.write(content)
        out.flush()
        os.fsync(out.fileno())


@contextmanager
def _reported(where: str | Path) -> Iterator[None]:
    try:
        yield
    except (OSError, ValueError) as error:  # a ValueError of a path with NUL
        why = error.strerror if isinstance(error, OSError) and error.strerror else error
        raise ProblemError(f"cannot be written ({why})", where=str(where), remedy=REMEDY) from None
