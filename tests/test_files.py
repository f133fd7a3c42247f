"""A folder holds the old result or the new one, whatever kills a process that writes; one process writes at a time."""

from __future__ import annotations

import errno
import os
import resource
import signal
import stat
import subprocess
import sys
import threading
from collections.abc import Callable
from pathlib import Path

import pytest

from hydroopt import files
from hydroopt.errors import ProblemError
from hydroopt.files import BusyError, claimed, clean, finish, scratch, write_file, write_files

pytestmark = [pytest.mark.skipif(os.name == "nt", reason="kills and locks of POSIX"),
              pytest.mark.filterwarnings("ignore:.*fork:DeprecationWarning")]
OLD = {"report.html": "old", "gone.csv": "old", "c/crane.h": "old", "estimate.json": "old"}
NEW = {"report.html": "new", "gone.csv": None, "fit.csv": "new", "c/crane.h": "new", "estimate.json": "new"}
THEIRS = {"notes.txt": "the user's"}
CHANGES = ("os.mkdir", "os.rename", "os.remove", "os.rmdir", "open")
"""Audit events of all that changes a folder; `open` comes before a file is made and written."""


def child(work: Callable[[], None]) -> int:
    """Exit status of a process that does some work, and nothing else of this one's."""
    number = os.fork()
    if not number:
        try:
            work()
            os._exit(0)
        except ProblemError:
            os._exit(2)
        except BaseException:
            os._exit(1)
    return os.waitstatus_to_exitcode(os.waitpid(number, 0)[1])


def killed_at(step: int, work: Callable[[], None]) -> int:
    """Exit status of a process that is killed before its change number `step` to the file system."""
    left = [step]

    def count(event: str, _: object) -> None:
        if event in CHANGES:
            left[0] -= 1
            if not left[0]:
                os.kill(os.getpid(), signal.SIGKILL)

    def hooked() -> None:
        sys.addaudithook(count)
        work()

    return child(hooked)


def content(folder: Path) -> dict[str, str]:
    """Visible files by name."""
    return {str(file.relative_to(folder)): file.read_text() for file in sorted(folder.rglob("*"))
            if file.is_file() and not str(file.relative_to(folder)).startswith(".")}


@pytest.mark.parametrize("before", [
    pytest.param(OLD, id="over an old result"), pytest.param({}, id="into nothing", marks=pytest.mark.slow)])
def test_killed_at_any_change_a_folder_holds_the_old_result_or_the_new_one(
    tmp_path: Path, before: dict[str, str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(files.os, "fsync", lambda _: None)  # which matters to a disk alone
    after = {name: text for name, text in NEW.items() if text is not None}
    found, partial = [], 0
    for step in range(1, 200):
        folder = tmp_path / str(step)
        if before:
            write_files(folder, before | THEIRS)
        theirs = THEIRS if before else {}
        status = killed_at(step, lambda folder=folder: write_files(folder, NEW))
        if folder.exists():
            now = content(folder)
            # old and new files never stand side by side, and the last file stands there only with all others
            assert len({text for name, text in now.items() if name not in theirs}) <= 1
            assert "estimate.json" not in now or now in (before | theirs, after | theirs)
            partial += now not in (before | theirs, after | theirs)
            finish(folder)
        found.append(content(folder) == after | theirs)
        assert found[-1] or not folder.exists() or content(folder) == before | theirs
        write_files(folder, {"next.txt": "next"})
        assert not list(folder.glob(".*"))
        if status == 0:
            break
        assert status == -signal.SIGKILL
    assert found == sorted(found)
    assert len(found) > 20
    assert 0 < found.index(True) < len(found) - 5  # the result counts before its files are moved into place
    assert partial > 5


def test_a_full_disk_leaves_the_old_result(tmp_path: Path) -> None:
    write_files(tmp_path, OLD)

    def work() -> None:
        resource.setrlimit(resource.RLIMIT_FSIZE, (2000, 2000))
        write_files(tmp_path, NEW | {"residuals.csv": "1" * 3000})

    assert child(work) == 2
    assert content(tmp_path) == OLD
    assert not list(tmp_path.glob(".*"))


def test_a_disk_that_fails_in_between_leaves_the_old_result(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_files(tmp_path, OLD)
    written: list[int] = []

    def fail(descriptor: int) -> None:
        written.append(descriptor)
        if len(written) == 3:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(files.os, "fsync", fail)
    with pytest.raises(ProblemError, match=r"No space left on device.*-o"):
        write_files(tmp_path, NEW)
    assert content(tmp_path) == OLD
    assert not list(tmp_path.glob(".*"))


def test_a_second_process_is_refused_until_the_first_one_is_dead(tmp_path: Path) -> None:
    ours, theirs = os.pipe()
    number = os.fork()
    if not number:
        with claimed(tmp_path / "out"):
            os.write(theirs, b"1")
            threading.Event().wait(60)
        os._exit(0)
    try:
        os.read(ours, 1)
        with pytest.raises(BusyError, match=r"another run of hydroopt writes into this folder; wait"), \
                claimed(tmp_path / "out"):
            pass
        assert (tmp_path / "out").is_dir()
        with claimed(tmp_path / "other"):
            pass
    finally:
        os.kill(number, signal.SIGKILL)
        os.waitpid(number, 0)
    write_files(tmp_path / "out", OLD)
    assert content(tmp_path / "out") == OLD
    assert not list(tmp_path.rglob(".*"))


def test_a_claim_is_the_process_s_own_and_leaves_no_folder_that_it_made(tmp_path: Path) -> None:
    with claimed(tmp_path / "a/b") as claim:
        with claimed(tmp_path / "a/b") as again:
            assert again is claim
        assert (tmp_path / "a/b").is_dir()
        assert not claim.written
    assert not list(tmp_path.iterdir())
    with claimed(tmp_path / "a/b") as claim:
        write_files(tmp_path / "a/b", OLD)
        assert claim.written
    assert content(tmp_path / "a/b") == OLD


def test_what_is_unfinished_goes_unless_its_process_lives(tmp_path: Path) -> None:
    def work() -> None:
        with scratch(tmp_path) as place:
            (place / "half").write_text("half")
            os.kill(os.getpid(), signal.SIGKILL)

    assert child(work) == -signal.SIGKILL
    (left,) = tmp_path.iterdir()
    with scratch(tmp_path) as own:
        assert child(lambda: clean(tmp_path)) == 0
        assert list(tmp_path.iterdir()) == [own]
    assert not left.exists()


@pytest.mark.parametrize("mask", [0o022, 0o077, 0o002])
def test_modes_follow_the_mask(tmp_path: Path, mask: int) -> None:
    def work() -> None:
        os.umask(mask)
        write_files(tmp_path / "new/out", OLD)
        write_file(tmp_path / "new/log.csv", "1")

    assert child(work) == 0
    for path in tmp_path.rglob("*"):
        assert stat.S_IMODE(path.stat().st_mode) == (0o777 if path.is_dir() else 0o666) & ~mask, path


def test_a_folder_that_cannot_be_written_is_refused_at_once(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    for bad in (tmp_path / "file", tmp_path / "file/out"):
        with pytest.raises(ProblemError, match=r"(a file|cannot be written).* choose another directory"), claimed(bad):
            pass
    (tmp_path / "out/fit.csv").mkdir(parents=True)
    with pytest.raises(ProblemError, match="this is a directory"):
        write_files(tmp_path / "out", NEW)
    assert content(tmp_path / "out") == {}


def test_ctrl_c_while_files_are_moved_comes_when_all_are(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    moved = os.replace

    def pressed(*names: Path) -> None:
        signal.raise_signal(signal.SIGINT)
        moved(*names)

    write_files(tmp_path, OLD)
    monkeypatch.setattr(files.os, "replace", pressed)
    with pytest.raises(KeyboardInterrupt):
        write_files(tmp_path, NEW)
    assert content(tmp_path) == {name: text for name, text in NEW.items() if text is not None}
    assert not list(tmp_path.glob(".*"))


def test_where_no_other_folder_can_be_written_temporary_files_lie_in_it_until_the_process_ends(tmp_path: Path) -> None:
    program = f"""
import os, tempfile
from pathlib import Path
tempfile._candidate_tempdir_list = list  # as on a system that is read-only but for one folder
from hydroopt.files import temporary_files
temporary_files(Path({str(tmp_path)!r}))
place = Path(tempfile.mkdtemp())
print(os.environ["TMPDIR"] == str(place.parent), place.parent.parent)
"""
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False)
    assert (done.stdout, done.stderr) == (f"True {tmp_path}\n", "")
    assert not list(tmp_path.iterdir())


def test_a_path_that_no_file_can_have_is_no_error_to_read() -> None:
    finish(Path("x" * 5000))
