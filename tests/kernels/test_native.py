"""Kernels: where they come from, and that nobody else's code is loaded in their place."""

from __future__ import annotations

import ctypes
import hashlib
import itertools
import logging
import os
import platform
import subprocess
import sys
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from types import SimpleNamespace

import casadi as ca
import numpy as np
import pytest

from hydroopt.kernels import compiler as system
from hydroopt.kernels import native
from hydroopt.kernels.expression_graph import program
from hydroopt.kernels.native import FEW, Kernel, Runner, source
from hydroopt.support import cache
from studies.first_contact import compilers

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="commands and modes of POSIX")

X = np.linspace(0, 1, 2 * FEW)[:, None]


def evaluated() -> list[float]:
    """x² + 1 at all X, by a runner that remembers nothing."""
    x = ca.SX.sym("x")
    (result,) = Runner().over(ca.Function("square", [x], [x * x + 1]), X)
    return list(result.ravel())


RIGHT = pytest.approx(list((X * X + 1).ravel()))
EVIL = "void over(long n, void *x, void *s, double **y) { for (long k = 0; k < n; ++k) y[0][k] = 666; }"


@pytest.fixture(autouse=True)
def _fresh() -> Iterator[None]:
    for kept in (system.compiler, system.notice):
        kept.cache_clear()
    yield
    for kept in (system.compiler, system.notice):
        kept.cache_clear()


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("HYDROOPT_CACHE", str(tmp_path / "home" / "cache"))
    monkeypatch.delenv("CC", raising=False)
    (tmp_path / "tmp").mkdir()
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path / "tmp"))
    return tmp_path / "home" / "cache"


@pytest.fixture
def compiled(monkeypatch: pytest.MonkeyPatch) -> list[Path]:
    """The folders in which kernels were compiled."""
    places: list[Path] = []
    honest = system.Compiler.compile

    def compile_(by: system.Compiler, source: str, place: Path) -> Path:
        places.append(place)
        return honest(by, source, place)

    monkeypatch.setattr(system.Compiler, "compile", compile_)
    return places


def planted(folder: Path, content: bytes | None = None) -> Path:
    """In place of the kernel that was kept: another library, or garbage, under the name that its content asks for."""
    (kept,) = folder.glob("*/*.so")
    if content is None:
        subprocess.run(["cc", "-shared", "-fPIC", "-x", "c", "-", "-o", "evil.so"], input=EVIL.encode(), check=True,
                       cwd=folder)
        content = (folder / "evil.so").read_bytes()
        (folder / "evil.so").unlink()
    kept.unlink()
    evil = kept.parent / f"{kept.name.partition('-')[0]}-{hashlib.sha256(content).hexdigest()[:32]}.so"
    evil.write_bytes(content)
    evil.chmod(0o700)
    return evil


def test_a_kernel_is_compiled_once_and_nothing_else_is_left(folder: Path, compiled: list[Path]) -> None:
    assert evaluated() == RIGHT
    assert evaluated() == RIGHT
    assert len(compiled) == 1
    ((kept,),) = (part.iterdir() for part in folder.iterdir())
    assert kept.stat().st_mode & 0o777 == 0o700
    assert not list((folder.parents[1] / "tmp").iterdir())


@pytest.mark.parametrize("count", [FEW, 8 * FEW, 8 * FEW + 3])
@pytest.mark.parametrize("wide", [3, 400])  # within the caches, and past them
def test_results_do_not_depend_on_the_memory_that_takes_them(folder: Path, count: int, wide: int) -> None:
    x = ca.SX.sym("x", 2)
    entries = [(k + 1) * x[k % 2] + 1 if k % 3 else ca.SX(0) for k in range(2 * wide)]
    function = ca.Function("two", [x], [ca.densify(ca.reshape(ca.vertcat(*entries), 2, wide)), x[1] * x[0]])
    given, runner = np.random.default_rng(count).normal(size=(count, 2)), Runner()
    expected = [np.array([np.array(function(row)[i]) for row in given]) for i in range(2)]
    first = runner.over(function, given)
    dirty = runner.over(function, 2 * given)
    rows = [np.full(values.shape, np.nan) for values in first]
    for out in (None, dirty, rows):
        made = runner.over(function, given, out=out)
        for i in range(2):
            np.testing.assert_allclose(made[i], expected[i], rtol=1e-13, atol=1e-13)
            assert out is None or made[i] is out[i]


def test_what_this_user_put_there_is_loaded(folder: Path, compiled: list[Path]) -> None:
    """The other tests would pass with a library that cannot be loaded at all."""
    evaluated()
    planted(folder)
    assert evaluated() == [666] * len(X)


@pytest.mark.parametrize("attack", ["open folder", "open part", "open parent", "open file", "link", "owner"])
def test_no_library_is_loaded_that_others_could_have_written(attack: str, folder: Path, compiled: list[Path],
                                                             monkeypatch: pytest.MonkeyPatch) -> None:
    evaluated()
    evil = planted(folder)
    match attack:
        case "open folder":
            folder.chmod(0o777)
        case "open part":
            evil.parent.chmod(0o777)
        case "open parent":
            folder.parent.chmod(0o770)
        case "open file":
            evil.chmod(0o722)
        case "link":
            evil.symlink_to(evil.rename(folder.parents[1] / "evil.so"))
        case "owner":
            number, honest = evil.stat().st_ino, os.fstat
            monkeypatch.setattr(os, "fstat", lambda handle: os.stat_result(  # another user's
                (*(state := honest(handle))[:4], state.st_uid + (state.st_ino == number), *state[5:])))
    assert evaluated() == RIGHT
    assert len(compiled) == 2
    assert not list((folder.parents[1] / "tmp").iterdir())


@pytest.mark.parametrize("content", [b"", b"no library", b"\x7fELF\x02\x01\x01" + bytes(100)])
def test_garbage_is_compiled_again(content: bytes, folder: Path, compiled: list[Path]) -> None:
    evaluated()
    garbage = planted(folder, content)
    assert evaluated() == RIGHT
    assert len(compiled) == 2
    assert not garbage.exists()
    cut = next(folder.glob("*/*.so"))
    cut.write_bytes(cut.read_bytes()[:-1])
    assert evaluated() == RIGHT
    assert len(compiled) == 3
    assert len(list(folder.glob("*/*"))) == 1


def test_without_a_cache_kernels_are_compiled_in_a_private_place(folder: Path, compiled: list[Path],
                                                                 caplog: pytest.LogCaptureFixture) -> None:
    folder.parent.mkdir()
    folder.write_text("a file")
    assert evaluated() == RIGHT
    assert evaluated() == RIGHT
    assert all(place.parent == folder.parents[1] / "tmp" for place in compiled)
    assert len(compiled) == 2
    assert not list((folder.parents[1] / "tmp").iterdir())
    assert [record.levelno for record in caplog.records] == [logging.WARNING]  # once
    assert "kernels cannot be kept" in caplog.text
    assert "set HYDROOPT_CACHE to a folder" in caplog.text


def test_one_empty_cache_is_filled_by_many_at_once(folder: Path, compiled: list[Path]) -> None:
    x = ca.SX.sym("x")
    square, by = ca.Function("square", [x], [x * x + 1]), system.compiler()
    assert by is not None

    def compiled_there(scratch: Path) -> Path:
        return by.compile(source(program(square)), scratch)

    with ThreadPoolExecutor(4) as pool:
        libraries = list(pool.map(lambda _: cache.kept(
            "", 32 * "a", ".so", compiled_there, lambda library: ctypes.CDLL(str(library))), range(4)))
    kernels = [Kernel(library, square) for library in libraries]
    assert [list(kernel([X], len(X))[0].ravel()) for kernel in kernels] == [RIGHT] * 4
    assert {file.suffix for file in folder.iterdir()} == {".so"}


@pytest.mark.slow
def test_processes_that_start_at_once_with_an_empty_cache_agree(folder: Path) -> None:
    code = "import sys; sys.path.insert(0, sys.argv[1]); import test_native as t; assert t.evaluated() == t.RIGHT"
    running = [subprocess.Popen([sys.executable, "-c", code, str(Path(__file__).parent)]) for _ in range(3)]
    assert [process.wait() for process in running] == [0] * 3
    assert {file.suffix for file in folder.glob("*/*")} == {".so"}


@pytest.mark.parametrize(("command", "why"), [
    ('gcc "', "No closing quotation"), ("no-such-compiler", "No such file"), ("false", "non-zero exit status"),
    ("   ", "No such file"), ("/", "denied")])
def test_a_misspelt_compiler_is_named_and_the_usual_one_serves(command: str, why: str, folder: Path,
                                                               compiled: list[Path], monkeypatch: pytest.MonkeyPatch,
                                                               caplog: pytest.LogCaptureFixture) -> None:
    monkeypatch.setenv("CC", command)
    assert evaluated() == RIGHT
    assert len(compiled) == 1
    assert f"CC={command!r} cannot be used" in caplog.text
    assert why in caplog.text


@pytest.mark.parametrize(("system", "remedy"), [("Linux", "install gcc or clang"), ("Darwin", "xcode-select --install"),
                                                ("Windows", "clang of LLVM")])
def test_without_a_compiler_casadi_does_the_work(system: str, remedy: str, folder: Path,
                                                 monkeypatch: pytest.MonkeyPatch,
                                                 caplog: pytest.LogCaptureFixture) -> None:
    monkeypatch.setenv("PATH", str(folder))
    monkeypatch.setattr(platform, "system", lambda: system)
    assert evaluated() == RIGHT
    assert "no C compiler found" in caplog.text
    assert remedy in caplog.text


def script(folder: Path, compiling: str) -> str:
    """The file of a compiler that compiles as a line of a shell says."""
    folder.mkdir(parents=True)
    command = folder.parents[1] / "mycc"
    command.write_text(compilers.script(compiling))
    command.chmod(0o755)
    return str(command)


@pytest.mark.parametrize(("named", "processor", "given", "not_given"), [
    ("Windows", "AMD64", ["-march=native"], ["-fPIC", "-lm", "-lmvec"]),
    ("Darwin", "arm64", ["-mcpu=native", "-fPIC", "-lm"], ["-march=native", "-lmvec"]),
    ("Darwin", "x86_64", ["-march=native", "-fPIC", "-lm"], ["-lmvec"])])
@pytest.mark.parametrize("refuses", [False, True])
def test_other_systems_as_far_as_they_can_be_faked(
        named: str, processor: str, given: list[str], not_given: list[str], refuses: bool, folder: Path,
        compiled: list[Path], monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture) -> None:
    """A stub stands for the compiler of that system: it notes its options and builds with those of this system.

    Neither the linker of that system nor the loading of its libraries is tried.
    """
    told = folder.parents[1] / "options"
    macros = "#define _MSC_VER 1930" if named == "Windows" else "#define __APPLE__ 1"
    folder.mkdir(parents=True)
    command = folder.parents[1] / "theircc"
    command.write_text(f'#!/bin/sh\ncase "$*" in *-dM*) echo "{macros}"; exit;; esac\necho "$*" >{told}\n'
                       f'{"exit 1" if refuses else "exec cc -O2 -fPIC -shared -w -x c - -o kernel.so -lm"}\n')
    command.chmod(0o755)
    monkeypatch.setenv("CC", str(command))
    monkeypatch.setattr(system, "FLAGS", system.flags(named, processor))
    if named == "Windows":  # processes without groups, and no shell to end them
        monkeypatch.setattr(system, "os", SimpleNamespace(**{**vars(os), "name": "nt"}))
    assert evaluated() == RIGHT
    assert len(compiled) == 1
    options = told.read_text().split()
    assert set(given) <= set(options)
    assert not set(not_given) & set(options)
    assert ("kernels cannot be" in caplog.text or "slowly" in caplog.text) == refuses


@pytest.mark.slow
def test_a_compiler_that_hangs_is_ended_with_all_that_it_started(folder: Path, compiled: list[Path],
                                                                 monkeypatch: pytest.MonkeyPatch,
                                                                 caplog: pytest.LogCaptureFixture) -> None:
    told = folder.parents[1] / "pid"
    monkeypatch.setenv("CC", script(folder, f"sleep 1000 & echo $! >{told}; wait"))
    monkeypatch.setattr(system, "COMPILING", 1.0)
    began = time.monotonic()
    assert evaluated() == RIGHT
    assert evaluated() == RIGHT
    assert time.monotonic() - began < 30
    assert len(compiled) == 1  # it is not tried again
    assert "no answer within 1 s" in caplog.text
    pid = int(told.read_text())
    assert _ends(pid, within=10.0)
    assert not list(folder.glob("*/*"))


def _ends(pid: int, within: float) -> bool:
    """Whether a process has ended or ends within a time [s]: one that is killed needs a turn of a busy machine to."""
    until, status = time.monotonic() + within, Path(f"/proc/{pid}/stat")
    while time.monotonic() < until:
        try:
            if status.read_text().rpartition(")")[2].split()[0] in "ZX":
                return True
        except OSError:
            return True
        time.sleep(0.05)
    return False


def test_a_compiler_finds_nothing_in_the_working_directory(folder: Path, compiled: list[Path],
                                                           monkeypatch: pytest.MonkeyPatch) -> None:
    """GNU's linker would look for libgcc_s.so.1 there; a compiler's own path may be relative to it."""
    where = folder.parents[1] / "where"
    command = Path(script(folder, f'pwd >{where}; exec cc "$@"'))
    monkeypatch.chdir(command.parent)
    monkeypatch.setenv("CC", f"./{command.name}")
    assert evaluated() == RIGHT
    assert [Path(line) for line in where.read_text().splitlines()] == compiled


def test_a_compiler_that_fails_says_why_without_control_characters(folder: Path, monkeypatch: pytest.MonkeyPatch,
                                                                   caplog: pytest.LogCaptureFixture) -> None:
    monkeypatch.setenv("CC", script(folder, r"printf 'out of\n\033[2Jmemory' >&2; exit 1"))
    assert evaluated() == RIGHT
    assert "the kernel 'square' cannot be compiled (out of ?[2Jmemory)" in caplog.text


@pytest.mark.parametrize("wrong", compilers.WRONG)
def test_what_a_compiler_did_not_write_whole_is_not_loaded(wrong: str, folder: Path, monkeypatch: pytest.MonkeyPatch,
                                                           caplog: pytest.LogCaptureFixture) -> None:
    """To load half a library ends the process by SIGBUS, at once or at its first use."""
    monkeypatch.setenv("CC", script(folder, compilers.WRONG[wrong]))
    assert evaluated() == RIGHT
    assert "the kernel 'square' cannot be compiled" in caplog.text


def test_long_code_in_pieces_computes_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    """Values that pass between the pieces, and outputs that each of them writes."""
    x = ca.SX.sym("x", 3)
    terms = [ca.sin(x[k % 3] + k) * ca.cos(x[(k + 1) % 3] * k) for k in range(12)]
    made = ca.Function("long", [x], [ca.vertcat(*(a * b + terms[0] for a, b in itertools.pairwise(terms)))])
    at = np.random.default_rng(0).uniform(-1, 1, (2 * FEW + 3, 3))
    (whole,) = Runner().over(made, at)
    monkeypatch.setattr(native, "LONG", 100)
    monkeypatch.setattr(native, "PIECE", 5)
    assert "passed[1]" in source(program(made))
    monkeypatch.setattr(system.cache, "folder", lambda _: (_ for _ in ()).throw(OSError("not kept")))
    (pieces,) = Runner().over(made, at)
    np.testing.assert_allclose(pieces, whole, rtol=0, atol=1e-14)
