"""The command's process: Ctrl-C at any moment, streams that cannot be written, users without a home, two at once."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from fixtures.tiers import tiered
from hydroopt.support.files import claimed

pytestmark = pytest.mark.skipif(os.name == "nt", reason="signals and users of POSIX")
COMMAND = (sys.executable, "-m", "hydroopt")
INTERRUPTED = "hydroopt: interrupted; no result was written\n"


def shell(script: str, **environment: str) -> subprocess.CompletedProcess[str]:
    """What a shell made of a script, in which $H is the command."""
    return subprocess.run(["bash", "-c", script], capture_output=True, text=True, check=False, timeout=100,
                          env=os.environ | {"H": " ".join(COMMAND)} | environment)


@pytest.mark.slow
def test_output_that_cannot_be_written_is_said_or_not_needed() -> None:
    script = "$H study --help {}; echo $? >&2"
    assert shell("set -o pipefail; $H study --help | head -1; echo $? >&2").stderr == "0\n"
    assert shell(script.format(">&- <&-")).stderr == "0\n"
    full = shell(script.format("> /dev/full")).stderr
    assert full == "hydroopt: standard output: cannot be written (No space left on device); send it elsewhere.\n2\n"
    assert shell("$H nonsense 2>&-; echo $?").stdout == "2\n"


def test_no_file_takes_the_place_of_a_closed_stream(tmp_path: Path) -> None:
    """What is printed would stand in the first file that is opened."""
    code = ("from hydroopt.cli.streams import open_streams; open_streams(); f = open('file', 'w'); "
            "print('printed', flush=True); print(f.fileno(), file=f)")
    shell(f"cd {tmp_path}; {sys.executable} -c \"{code}\" <&- >&- 2>&-")
    assert int((tmp_path / "file").read_text()) > 2


@pytest.mark.parametrize("environment", [
    {"PYTHONIOENCODING": "ascii"}, {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"}])
def test_any_encoding_can_print_everything(environment: dict[str, str]) -> None:
    program = "from hydroopt.cli.streams import open_streams; open_streams(); print('\\u03c3 \\udcff')"
    done = shell(f"{sys.executable} -c \"{program}\"", **environment)
    assert (done.stdout, done.stderr) == ("\\u03c3 \\udcff\n", "")


@pytest.mark.parametrize("moment", tiered(
    ["hydroopt.cli", "typer", "hydroopt.machine.machine_file", "numpy", "casadi"], lambda moment: moment == "casadi"))
def test_ctrl_c_while_modules_are_imported_ends_in_a_sentence(tmp_path: Path, moment: str) -> None:
    """The signal comes when a module begins to be imported."""
    program = (f"import runpy, signal, sys\\n"
               f"def hook(event, arguments):\\n"
               f"    if event == 'import' and arguments[0] == {moment!r} and not done:\\n"
               f"        done.append(1)\\n"
               f"        signal.raise_signal(signal.SIGINT)\\n"
               f"done = []\\n"
               f"sys.addaudithook(hook)\\n"
               f"sys.argv = ['hydroopt', 'simulate', 'cat215b', '-o', {str(tmp_path / 'out')!r}]\\n"
               f"runpy.run_module('hydroopt', run_name='__main__')\\n").replace("\\n", "\n")
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False, timeout=100)
    assert (done.returncode, done.stdout, done.stderr) == (130, "", INTERRUPTED)
    assert not list(tmp_path.iterdir())


def test_ctrl_c_that_a_finaliser_swallows_or_a_library_replaces_still_ends_the_run() -> None:
    program = """
import signal, sys, time
from hydroopt import cli
from hydroopt.support import interrupt

class Finaliser:
    def __del__(self):
        signal.raise_signal(signal.SIGINT)

def swallowed(*_, **__):
    Finaliser()
    time.sleep(100)

def replaced(*_, **__):
    try:
        signal.raise_signal(signal.SIGINT)
    except KeyboardInterrupt:
        raise ImportError("a library could not be imported") from None

interrupt.remember()
cli.app = {"swallowed": swallowed, "replaced": replaced}[sys.argv[1]]
cli.main()
"""
    for kind in ("swallowed", "replaced"):
        done = subprocess.run([sys.executable, "-c", program, kind], capture_output=True, text=True, check=False)
        assert (done.returncode, done.stderr) == (130, INTERRUPTED), kind


def test_a_second_run_into_the_same_folder_is_refused(tmp_path: Path) -> None:
    with claimed(tmp_path / "out"):
        done = shell(f"$H simulate cat215b -o {tmp_path}/out")
    assert done.returncode == 2
    assert done.stderr == (f"hydroopt: {tmp_path}/out: another run of hydroopt writes into this folder; wait until it "
                           "has ended, or choose another directory.\n")
    assert not list(tmp_path.iterdir())


@pytest.mark.slow
@pytest.mark.needs("setpriv")
@pytest.mark.skipif(os.geteuid() != 0, reason="only root can become another user")
@pytest.mark.parametrize("arguments", [
    ["show", "kr300"], ["simulate", "kr300", "-o", "out"], ["plan-poses", "cat215b", "-n", "4", "-o", "out"],
    ["identify", "kr300", "out/log.csv", "-o", "answer"], ["codegen", "kr300", "-o", "out"]], ids=lambda each: each[0])
def test_a_user_without_home_and_password_entry_who_can_write_to_one_folder_only(place: Path, arguments: list[str],
                                                                                ) -> None:
    done = subprocess.run(
        ["setpriv", "--reuid=54321", "--regid=54321", "--clear-groups", "--inh-caps=-all,+dac_read_search",
         "--ambient-caps=+dac_read_search", *COMMAND, *arguments], capture_output=True, text=True, check=False,
        cwd=place, env={key: value for key, value in os.environ.items() if key in ("PYTHONPATH", "PATH")})
    assert done.returncode == 0, done.stderr
    assert all(line.startswith("hydroopt: kernels cannot be kept") for line in done.stderr.splitlines())


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder that belongs to a user who has nothing else."""
    folder = tmp_path_factory.mktemp("place")
    os.chown(folder, 54321, 54321)
    return folder


@pytest.mark.slow
def test_a_worker_ends_when_its_parent_is_killed(tmp_path: Path) -> None:
    program = """
from hydroopt.support.processes import pool

class ImportedForLong:
    def __reduce__(self):
        return eval, ("print(__import__('os').getpid(), flush=True) or __import__('time').sleep(100)",)

if __name__ == "__main__":
    with pool(1, print, ImportedForLong()) as crew:
        crew.submit(bool).result()
"""
    (tmp_path / "program.py").write_text(program)
    with subprocess.Popen([sys.executable, str(tmp_path / "program.py")], stdout=subprocess.PIPE) as parent:
        assert parent.stdout is not None
        worker = int(parent.stdout.readline())
        parent.send_signal(signal.SIGKILL)
    assert ends(worker)


@pytest.mark.slow
def test_a_compiler_and_what_it_starts_end_when_the_command_is_killed(tmp_path: Path) -> None:
    started = tmp_path / "started"
    slow = tmp_path / "cc"
    slow.write_text(f"#!/bin/sh\nsleep 100 & echo $! $$ > {started}.part; mv {started}.part {started}; wait\n")
    slow.chmod(0o755)
    environment = {**os.environ, "CC": str(slow), "HYDROOPT_CACHE": str(tmp_path / "cache")}
    with subprocess.Popen([sys.executable, "-c", "from hydroopt.kernels.compiler import compiler; compiler()"],
                          env=environment) as parent:
        end = time.monotonic() + 20
        while not started.exists() and time.monotonic() < end:
            time.sleep(0.02)
        parent.send_signal(signal.SIGKILL)
    assert all(ends(int(process)) for process in started.read_text().split())


def ends(process: int) -> bool:
    """Whether a process ends soon."""
    end = time.monotonic() + 20
    while (running := Path(f"/proc/{process}").exists()) and time.monotonic() < end:
        time.sleep(0.05)
    return not running
