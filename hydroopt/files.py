"""Files that appear whole or not at all, whatever ends the process; one process at a time writes into a folder.

A folder of results is replaced in two steps. First its files are written and synchronised in ``.unfinished-*``; when
that is renamed ``.complete``, the new result is there. Then the files are moved into place, by this process or, if it
is killed, by the next one that reads or writes the folder.
"""

from __future__ import annotations

import atexit
import errno
import json
import os
import shutil
import tempfile
import threading
import time
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path

from hydroopt.errors import ProblemError
from hydroopt.interrupt import delayed

try:
    import fcntl
except ImportError:  # Windows, where nothing is locked
    fcntl = None  # type: ignore[assignment]

UNFINISHED = ".unfinished-"
"""Prefix of folders that are being written. A living process holds a lock on its own; the others are removed."""
COMPLETE = ".complete"
"""Folder of files that only have to be moved into place: ORDER lists them and what goes, CONTENT holds them."""
ORDER, CONTENT = "order.json", "files"
PATIENCE = 10.0
"""How long a write or a reader waits for another process that is writing [s]."""


class BusyError(ProblemError):
    """Another process writes into the folder."""


class Claim:
    """The right of this process to write into a folder.

    Attributes:
        written: whether this process has written there.
    """

    def __init__(self) -> None:
        self.written = False


_claims: dict[tuple[int, int], Claim] = {}
"""Claims of this process by the folder's device and number."""
_turn = threading.RLock()
"""Held by the thread of this process that writes."""


@contextmanager
def claimed(directory: str | Path, *, patience: float = 0.0) -> Iterator[Claim]:
    """Keep other processes from writing into a folder; it is created if need be, and removed if it stays empty.

    What killed processes left there is completed or removed. The system releases the claim when this process ends. On a
    file system without locks, other processes can write at the same time.

    Args:
        directory: the folder.
        patience: how long to wait for another process [s].

    Raises:
        BusyError: another process writes there.
        ProblemError: the folder cannot be written.
    """
    target = Path(directory)
    if _is_file(target):
        raise ProblemError("this is a file", where=str(directory), remedy="choose another directory with -o")
    own = _claims.get(_identity(target)) if target.is_dir() else None
    if own is not None:
        yield own
        return
    made = [folder for folder in (target, *target.parents) if not folder.exists()]
    lock = identity = None
    try:
        with _reported(target):
            lock, identity = _waited_for(target, time.monotonic() + patience)
            claim = _claims[identity] = Claim()
            if (target / COMPLETE).is_dir():
                _move_into_place(target)
            clean(target)
            with scratch(target):  # so that a folder that cannot be written is refused before anything is computed
                pass
        yield claim
    finally:
        if identity is not None:
            _claims.pop(identity, None)
        with suppress(OSError):
            for folder in made:
                folder.rmdir()
        if lock is not None:
            os.close(lock)


@contextmanager
def scratch(folder: Path, *, mode: int = 0o777) -> Iterator[Path]:
    """A new folder within `folder`, removed at the end; if the process is killed, `clean` removes it.

    Its permissions are `mode`, less what the umask takes.

    Raises:
        OSError: it cannot be created.
    """
    own, lock = folder, None
    try:
        while own is folder:
            own = folder / f"{UNFINISHED}{os.urandom(6).hex()}"
            own.mkdir(mode)
            try:
                lock = _lock(own)
            except (BlockingIOError, FileNotFoundError):  # a process that cleans has just removed it
                own = folder
        yield own
    finally:
        if own is not folder:
            shutil.rmtree(own, ignore_errors=True)
        if lock is not None:
            os.close(lock)


def temporary_files(folder: Path) -> None:
    """Have temporary files in `folder`, until this process ends, where the system has no other place for them."""
    try:
        tempfile.gettempdir()
    except FileNotFoundError:
        stack = ExitStack()
        atexit.register(stack.close)  # after those who put something there
        place = stack.enter_context(scratch(folder.resolve()))
        tempfile.tempdir = os.environ["TMPDIR"] = str(place)  # libraries and other programs read these


def clean(folder: Path) -> None:
    """Remove what killed processes left unfinished in a folder."""
    for left in folder.glob(f"{UNFINISHED}*"):
        with suppress(OSError):  # it belongs to a living process, to another user, or is gone
            lock = _lock(left)
            if lock is not None:
                shutil.rmtree(left, ignore_errors=True)
                os.close(lock)


def write_files(directory: str | Path, files: Mapping[str, str | bytes | None]) -> None:
    """Replace files of a folder, all or none of them, by name; a name may have folders, ``c/crane.h``.

    None removes a file. The last file vouches for the others: it goes before them and comes after them.

    Raises:
        ProblemError: the folder or a file cannot be written, or another process writes there.
    """
    target = Path(directory)
    new = {name: content for name, content in files.items() if content is not None}
    with _turn, claimed(target, patience=PATIENCE) as claim, _reported(target):
        refuse_directory(target, tuple(new))
        with scratch(target) as staged:
            for name, content in new.items():
                (target / name).parent.mkdir(parents=True, exist_ok=True)
                _write(staged / CONTENT / name, content)
            if len(files) == 1 and new:
                os.replace(staged / CONTENT / name, target / name)
                _synchronise((target / name).parent)
                claim.written = True
                return
            _write(staged / ORDER, json.dumps({"new": list(new), "old": [name for name in files if name not in new]}))
            for folder in {each.parent for each in staged.rglob("*")}:
                _synchronise(folder)
            with delayed():
                staged.rename(target / COMPLETE)
                claim.written = True
                _synchronise(target)
                _move_into_place(target)


def encoded(content: str | bytes) -> bytes:
    """What is written of a text: UTF-8, and escapes for bytes of file names that are not."""
    return content if isinstance(content, bytes) else content.encode("utf-8", "backslashreplace")


def write_file(path: str | Path, content: str | bytes) -> None:
    """Write one file, whole or not at all, into a folder that is there and in which others may write, too.

    Raises:
        ProblemError: it cannot be written.
    """
    target = Path(path)
    with _reported(target, "check the directory and its permissions"), scratch(target.parent) as staged:
        _write(staged / target.name, content)
        os.replace(staged / target.name, target)
        _synchronise(target.parent)


def finish(directory: Path) -> None:
    """Before reading a folder: complete what a killed process had written, and wait for one that is writing.

    Raises:
        ProblemError: this user may not complete it.
    """
    end = time.monotonic() + PATIENCE
    while os.path.isdir(directory / COMPLETE):  # unlike a Path's, it is no error for a path that no file can have
        try:
            with claimed(directory):
                pass
        except BusyError:
            if time.monotonic() > end:
                raise
            time.sleep(0.01)
        except ProblemError as error:
            raise ProblemError(f"a run that was killed has left its result in {COMPLETE}, from where it {error.what}",
                               where=str(directory), remedy="run a command that reads it as its owner") from None


def refuse_directory(directory: Path, names: tuple[str, ...]) -> None:
    """Refuse a directory that cannot take files of these names, before they are computed.

    Raises:
        ProblemError: it is a file, or holds a directory where a file must be.
    """
    if _is_file(directory):
        raise ProblemError("this is a file", where=str(directory), remedy="choose another directory with -o")
    for name in names:
        if (directory / name).is_dir():
            raise ProblemError("this is a directory", where=str(directory / name),
                               remedy="choose another directory with -o")


def _is_file(directory: Path) -> bool:
    """Whether the path exists and is not a directory."""
    with _reported(directory):
        return directory.exists() and not directory.is_dir()


def _move_into_place(target: Path) -> None:
    """Move the files of ``.complete``, as often as it takes: those that are no longer there have been moved."""
    complete = target / COMPLETE
    if (complete / ORDER).exists():  # else all have been moved
        order = json.loads((complete / ORDER).read_bytes())
        new = [name for name in order["new"] if (complete / CONTENT / name).exists()]
        for name in [*reversed(new), *order["old"]]:  # old and new files never stand side by side
            (target / name).unlink(missing_ok=True)
        for name in new:
            (target / name).parent.mkdir(parents=True, exist_ok=True)
            os.replace(complete / CONTENT / name, target / name)
        for folder in {(target / name).parent for name in order["new"]}:
            _synchronise(folder)
        (complete / ORDER).unlink()
    shutil.rmtree(complete)


def _waited_for(target: Path, end: float) -> tuple[int | None, tuple[int, int]]:
    """The lock of a folder, which is created if need be, and its identity."""
    while True:
        try:
            target.mkdir(parents=True, exist_ok=True)
            return _lock(target), _identity(target)
        except FileNotFoundError:  # another process has just removed it
            continue
        except BlockingIOError:
            if time.monotonic() > end:
                raise BusyError("another run of hydroopt writes into this folder", where=str(target),
                                remedy="wait until it has ended, or choose another directory with -o") from None
            time.sleep(0.02)


def _lock(folder: Path) -> int | None:
    """Lock a folder until the descriptor is closed or the process ends; None where there are no locks.

    Raises:
        BlockingIOError: another process holds the lock.
        FileNotFoundError: the folder is gone, or another one now.
    """
    if fcntl is None:
        return None
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        if os.path.samestat(os.fstat(descriptor), folder.stat()):
            return descriptor
        raise FileNotFoundError(errno.ENOENT, os.strerror(errno.ENOENT), str(folder))
    except OSError as error:
        os.close(descriptor)
        if isinstance(error, BlockingIOError | FileNotFoundError):
            raise
        return None


def _write(file: Path, content: str | bytes) -> None:
    """Write a file and wait until the disk has it."""
    file.parent.mkdir(parents=True, exist_ok=True)
    with file.open("xb") as out:
        out.write(encoded(content))
        out.flush()
        os.fsync(out.fileno())


def _synchronise(folder: Path) -> None:
    """Wait until the disk has the names in a folder."""
    if os.name == "nt":  # folders cannot be opened there
        return
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    except OSError as error:
        if error.errno not in (errno.EINVAL, errno.ENOTSUP):  # the file system does not know how
            raise
    finally:
        os.close(descriptor)


def _identity(folder: Path) -> tuple[int, int]:
    status = folder.stat()
    return status.st_dev, status.st_ino


@contextmanager
def _reported(where: Path, remedy: str = "choose another directory with -o") -> Iterator[None]:
    try:
        yield
    except OSError as error:
        raise ProblemError(f"cannot be written ({error.strerror or error})", where=str(where), remedy=remedy) from None
