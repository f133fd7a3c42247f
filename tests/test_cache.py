"""What hydroopt keeps and later runs lies where nobody else can write."""

from __future__ import annotations

import os
import stat
import sys
from pathlib import Path

import pytest

from hydroopt.support import cache

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="owners and modes of POSIX")


@pytest.fixture
def home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("HYDROOPT_CACHE", str(tmp_path / "a" / "cache"))
    return tmp_path / "a"


def mode(path: Path) -> int:
    return stat.S_IMODE(path.stat().st_mode)


def test_what_is_missing_is_made_for_this_user_alone(home: Path) -> None:
    before = os.umask(0)
    try:
        made = cache.folder()
    finally:
        os.umask(before)
    assert made == home / "cache"
    assert [mode(made), mode(home)] == [0o700] * 2


@pytest.mark.parametrize("bits", [0o020, 0o002])
@pytest.mark.parametrize("place", [".", "cache"])
def test_a_folder_that_others_can_write_is_refused(bits: int, place: str, home: Path) -> None:
    cache.folder()
    (home / place).chmod(0o700 | bits)
    with pytest.raises(PermissionError, match=f"others than this user can write to '{home / place}'"):
        cache.folder()


def test_others_may_write_to_a_folder_above_in_which_they_can_rename_only_their_own(home: Path) -> None:
    cache.folder()
    home.chmod(0o1777)
    assert cache.folder() == home / "cache"
    (home / "cache").chmod(0o1777)
    with pytest.raises(PermissionError, match="cache"):
        cache.folder()


def test_the_folder_of_another_user_is_refused(home: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    cache.folder()
    me = os.geteuid()
    monkeypatch.setattr(os, "geteuid", lambda: me + 1)
    with pytest.raises(PermissionError, match="cache"):
        cache.folder()


def test_a_link_counts_as_what_it_leads_to(home: Path) -> None:
    (home / "open").mkdir(parents=True)
    (home / "open").chmod(0o777)
    (home / "cache").symlink_to(home / "open")
    with pytest.raises(PermissionError, match=f"'{home / 'open'}'"):
        cache.folder()


def test_files_of_others_are_not_read(home: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file, link = cache.folder() / "x.so", cache.folder() / "y.so"
    file.write_bytes(b"own")
    file.chmod(0o644)
    link.symlink_to(file)
    assert cache.read(file) == b"own"
    with pytest.raises(OSError, match="symbolic link"):
        cache.read(link)
    file.chmod(0o664)
    with pytest.raises(PermissionError):
        cache.read(file)
    file.chmod(0o600)
    me = os.geteuid()
    monkeypatch.setattr(os, "geteuid", lambda: me + 1)
    with pytest.raises(PermissionError):
        cache.read(file)


def test_a_temporary_folder_that_others_can_replace_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    with cache.scratch() as made:
        assert made.parent == tmp_path
    tmp_path.chmod(0o777)
    with pytest.raises(PermissionError, match="others"), cache.scratch():
        pass
    assert not list(tmp_path.iterdir())


def test_without_a_home_nothing_is_kept_in_the_working_directory(tmp_path: Path,
                                                                 monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("HYDROOPT_CACHE", raising=False)
    def homeless(name: str) -> Path:
        raise RuntimeError(name)

    monkeypatch.setattr("platformdirs.user_cache_path", homeless)  # as for a user without a home
    monkeypatch.chdir(tmp_path)
    with pytest.raises(OSError, match="no home"):
        cache.folder()
    assert not list(tmp_path.iterdir())


def test_what_is_kept_or_left_by_killed_processes_and_long_unused_is_removed_and_nothing_else(home: Path) -> None:
    old, young, other = f"{'a' * 32}.function", f"{'b' * 32}.function", "notes.txt"
    for name in (old, young, other):
        (cache.folder() / name).write_bytes(b"content")
    with cache.scratch(cache.folder()) as left:
        living = left.name
    (cache.folder() / living / "sub").mkdir(parents=True)
    (cache.folder() / "users").mkdir()
    for name in (old, other, living, "users"):
        os.utime(cache.folder() / name, (0, 0))
    made = cache.kept("", "c" * 32, ".function", written, Path)
    assert made.read_bytes() == b"content"
    assert sorted(os.listdir(cache.folder())) == [young, made.name, other, "users"]


def written(place: Path) -> Path:
    (place / "made").write_bytes(b"content")
    return place / "made"


def test_what_is_not_whole_is_made_again(home: Path) -> None:
    first = cache.kept("ab", "d" * 32, ".so", written, Path)
    assert cache.kept("ab", "d" * 32, ".so", lambda _: first, Path) == first
    first.write_bytes(b"cont")
    assert cache.kept("ab", "d" * 32, ".so", written, Path.read_bytes) == b"content"
