"""A folder holds an old or a new result, whatever kills a process that writes; one process writes at a time."""

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

import filelock  # noqa: F401 (whose files would be opened in a child that counts)
import pytest

from hydroopt.errors import ProblemError
from hydroopt.support import files
from hydroopt.support.files import BusyError, claimed, write_file, write_files

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
def test_killed_at_any_change_a_folder_holds_no_mixture(
    tmp_path: Path, before: dict[str, str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(files.os, "fsync", lambda _: None)  # which matters to a disk alone
    after = {name: text for name, text in NEW.items() if text is not None}
    theirs, states = THEIRS if before else {}, []
    for step in range(1, 200):
        folder = tmp_path / str(step)
        if before:
            write_files(folder, before | THEIRS)
        status = killed_at(step, lambda folder=folder: write_files(folder, NEW))
        if folder.exists():
            now = content(folder)
            assert theirs.items() <= now.items()
            whole = now in (before | theirs, after | theirs)
            assert now.items() <= (before | theirs).items() or now.items() <= (after | theirs).items()
            assert whole or "estimate.json" not in now  # which vouches for the others
            states.append("old" if now == before | theirs else "new" if whole else "refused")
        write_files(folder, {"next.txt": "next"})
        assert not list(folder.glob(".*"))
        if status == 0:
            break
        assert status == -signal.SIGKILL
    assert states == sorted(states, key=["old", "refused", "new"].index)
    assert states.count("refused") < states.count("old")
    assert states[-1] == "new"


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
    with pytest.raises(ProblemError, match=r"No space left on device.*another directory"):
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


@pytest.mark.parametrize("mask", [0o022, 0o077, 0o002])
def test_modes_follow_the_mask(tmp_path: Path, mask: int) -> None:
    def work() -> None:
        os.umask(mask)
        write_files(tmp_path / "new/out", OLD)
        write_file(tmp_path / "new/log.csv", "1")

    assert child(work) == 0
    for path in tmp_path.rglob("*"):
        assert stat.S_IMODE(path.stat().st_mode) == (0o777 if path.is_dir() else 0o666) & ~mask, path


@pytest.mark.parametrize(("path", "why"), [
    ("file", "this is a file"), ("file/out", "a file|Not a directory"), ("/dev/full", "this is a file"),
    ("/proc/x", "cannot be written"), ("/proc/1/x/y", "cannot be written"), ("x" * 300, "too long"),
    ("/".join(["x" * 200] * 30), "too long"), ("a\0b", "null"), ("dangling", "cannot be written"),
    ("loop/out", "cannot be written")])
def test_a_path_that_cannot_be_written_is_refused_at_once(tmp_path: Path, path: str, why: str) -> None:
    (tmp_path / "file").write_text("")
    (tmp_path / "dangling").symlink_to(tmp_path / "file/none")
    (tmp_path / "loop").symlink_to(tmp_path / "loop")
    before = sorted(tmp_path.rglob("*"))
    with pytest.raises(ProblemError, match=rf"({why}).*; choose another directory"), claimed(tmp_path / path):
        pass
    with pytest.raises(ProblemError, match=rf"({why}).*; choose another directory"):
        write_files(tmp_path / path, NEW)
    assert sorted(tmp_path.rglob("*")) == before


@pytest.mark.parametrize(("names", "why"), [
    (("../out.txt",), "leads out"), (("/tmp/hydroopt-x",), "leads out"), (("c/../../x",), "leads out"),
    (("link/x",), "leads out"), (("fit.csv",), "is a directory"), ((".",), "leads out")])
def test_a_name_that_leads_out_of_the_folder_is_refused_and_nothing_is_written(
    tmp_path: Path, names: tuple[str, ...], why: str
) -> None:
    out, elsewhere = tmp_path / "out", tmp_path / "elsewhere"
    elsewhere.mkdir()
    write_files(out, OLD)
    (out / "link").symlink_to(elsewhere)
    (out / "fit.csv").mkdir()
    before = sorted(tmp_path.rglob("*"))
    with pytest.raises(ProblemError, match=why):
        write_files(out, {**dict.fromkeys(names, "new"), "estimate.json": "new"})
    assert sorted(tmp_path.rglob("*")) == before
    (elsewhere / "x").write_text("theirs")
    write_files(out, {"link/x": None, "../elsewhere/x": None, "estimate.json": "new"})
    assert (elsewhere / "x").read_text() == "theirs"


def test_links_in_place_of_the_own_files_lead_to_no_change_elsewhere(tmp_path: Path) -> None:
    out, theirs = tmp_path / "out", tmp_path / "theirs"
    out.mkdir()
    theirs.mkdir()
    (theirs / "notes.txt").write_text("theirs")
    (out / files.LOCK).symlink_to(theirs / "notes.txt")
    with pytest.raises(ProblemError, match="cannot be written"):
        write_files(out, NEW)
    (out / files.LOCK).unlink()
    (out / f"{files.HIDDEN}x").symlink_to(theirs)
    (out / "report.html").symlink_to(theirs / "notes.txt")
    write_files(out, NEW)
    assert content(theirs) == {"notes.txt": "theirs"}
    assert (out / "report.html").read_text() == "new"


def test_a_deleted_working_directory_is_refused_at_once(tmp_path: Path) -> None:
    script = f"mkdir {tmp_path}/gone; cd {tmp_path}/gone; rmdir {tmp_path}/gone; {sys.executable} -c '{{}}'"
    program = "from hydroopt.support.files import claimed; claimed(\"out\").__enter__()"
    done = subprocess.run(["bash", "-c", script.format(program)], capture_output=True, text=True, check=False,
                          timeout=60)
    assert done.stderr.endswith("out: cannot be written (No such file or directory); choose another "
                                "directory.\n")
    assert not list(tmp_path.iterdir())


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
from hydroopt.support.files import temporary_files
temporary_files(Path({str(tmp_path)!r}))
place = Path(tempfile.mkdtemp())
print(os.environ["TMPDIR"] == str(place.parent), place.parent.parent)
"""
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False)
    assert (done.stdout, done.stderr) == (f"True {tmp_path}\n", "")
    assert not list(tmp_path.iterdir())
