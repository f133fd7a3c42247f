"""One kill: a command in a process of its own, a signal at a moment, and what is left."""

from __future__ import annotations

import contextlib
import json
import os
import shutil
import signal
import sys
import time
from collections.abc import Callable
from hashlib import sha256
from pathlib import Path
from typing import NamedTuple

import hydroopt as ho
from hydroopt.__main__ import main
from hydroopt.errors import HydrooptError
from hydroopt.support.files import claimed
from studies.kills.jobs import Job

MARK = "HYDROOPT_KILLS"
"""Stands in the environment of all processes that a trial begins."""
PATIENCE = 5.0
"""How long processes may outlive the command [s]."""
LONGEST = 900.0
"""Time [s] from which a command hangs."""
OWN = ("created", "wall_s", "files")
"""Keys of a JSON file that differ between two runs that find the same."""


class Moment(NamedTuple):
    """When and how to kill.

    Attributes:
        clock: "events": before the event number `when`, of files, imports and processes, that Python audits; "time":
            after the part `when` of the command's duration; "never".
        when: the number of the event, or the part.
        number: the signal.
        group: whether all processes of the command get it, as from a terminal.
        fresh: whether the process begins with a new interpreter, so that events of its imports count.
    """

    clock: str
    when: float
    number: int = signal.SIGKILL
    group: bool = False
    fresh: bool = False


class Ended(NamedTuple):
    """How a command ended: exit code, what it said, seconds, events, and seconds from signal to end (or NaN)."""

    code: int
    said: str
    seconds: float
    events: int
    latency: float


def run(arguments: list[str], folder: Path, name: str, moment: Moment, duration: float, cache: Path) -> Ended:
    """Run a command in a folder and kill it."""
    errors, events = folder / f"{name}.err", folder / f"{name}.events"
    began, sent = time.monotonic(), float("nan")
    number = os.fork()
    if not number:
        os.setsid()
        os.chdir(folder)
        stream = os.open(errors, os.O_CREAT | os.O_WRONLY | os.O_TRUNC)
        os.dup2(stream, 2)
        os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
        os.environ |= {MARK: name, "HYDROOPT_CACHE": str(cache), "OMP_NUM_THREADS": "1"}
        # a shell lets what it begins in the background ignore Ctrl-C
        signal.signal(signal.SIGINT, signal.SIG_DFL if moment.fresh else signal.default_int_handler)
        if moment.fresh:
            os.execv(sys.executable, [sys.executable, "-m", "studies.kills.trial", json.dumps(moment), str(events),
                                      *arguments])
        command(moment, events, arguments)
    if moment.clock == "time":
        while time.monotonic() - began < moment.when * duration and not ended(number):
            time.sleep(0.005)
        sent = time.monotonic()
        with contextlib.suppress(ProcessLookupError):
            (os.killpg if moment.group else os.kill)(number, moment.number)
    while not ended(number):
        if time.monotonic() - began > LONGEST:
            os.killpg(number, signal.SIGKILL)
        time.sleep(0.005)
    code = os.waitstatus_to_exitcode(os.waitpid(number, 0)[1])
    over = time.monotonic()
    return Ended(code, errors.read_text(errors="replace"), over - began,
                 int(events.read_text()) if events.exists() else 0, over - sent)


def ended(number: int) -> bool:
    """Whether a child has ended; it stays a zombie."""
    return os.waitid(os.P_PID, number, os.WEXITED | os.WNOHANG | os.WNOWAIT) is not None


def command(moment: Moment, events: Path, arguments: list[str]) -> None:
    """Become the command, and kill it at an event."""
    count, here = 0, os.getpid()

    def audited(_: str, __: object) -> None:
        nonlocal count
        if os.getpid() == here:
            count += 1
            if moment.clock == "events" and count == moment.when:
                (os.killpg if moment.group else os.kill)(here, moment.number)

    sys.argv = ["hydroopt", *arguments]
    sys.modules["__main__"] = sys.modules[main.__module__]  # which processes of the command import
    sys.addaudithook(audited)
    code = 1
    try:
        main()
    except SystemExit as stopped:
        code = int(stopped.code or 0)
    except BaseException:
        sys.excepthook(*sys.exc_info())
    sys.stderr.flush()
    if moment.clock == "never":
        events.write_text(str(count))
    os._exit(code)


def orphans(name: str) -> int:
    """How many processes of a trial still run after a while."""
    end = time.monotonic() + PATIENCE
    while (found := _marked(name)) and time.monotonic() < end:
        time.sleep(0.05)
    for process in found:
        with contextlib.suppress(ProcessLookupError):
            os.kill(process, signal.SIGKILL)
    return len(found)


def _marked(name: str) -> list[int]:
    found = []
    for process in Path("/proc").glob("[0-9]*"):
        with contextlib.suppress(OSError):
            if f"{MARK}={name}".encode() in (process / "environ").read_bytes().split(b"\0"):
                found.append(int(process.name))
    return found


def content(folder: Path) -> dict[str, str]:
    """Digests of the visible files by name; of a JSON file without what differs between two runs."""
    found = {}
    for file in sorted(folder.rglob("*")):
        name = str(file.relative_to(folder))
        if file.is_file() and not name.startswith("."):
            data = file.read_bytes()
            if file.suffix == ".json":
                data = json.dumps({key: value for key, value in json.loads(data).items() if key not in OWN}).encode()
            elif file.suffix == ".html":
                data = b""  # its digest stands in the JSON file, where there is one
            found[name] = sha256(data).hexdigest()
    return found


def whole(folder: Path) -> bool:
    """Whether a saved answer loads and its files are those that it lists."""
    try:
        answer = ho.load(folder)
        return dict(answer.files()).keys() == answer.content()["files"].keys()
    except (HydrooptError, OSError):
        return False


def state(folder: Path, job: Job, old: dict[str, str], new: dict[str, str]) -> str:
    """What a folder holds: nothing, old, new, refused (a part of one of them, which no command reads), or mixed."""
    found = content(folder) if folder.exists() else {}
    if not found:
        return "nothing"
    if job.saved and not readable(folder):
        part = found.items() <= old.items() or found.keys() <= new.keys()
        return "refused" if part else "mixed"
    if job.saved and not whole(folder):
        return "mixed"
    if old and found == old:
        return "old"
    if found == new if job.exact else found.keys() == new.keys():
        return "new"
    part = found.items() <= old.items() or (found.items() <= new.items() if job.exact else found.keys() <= new.keys())
    return "refused" if part and not job.saved else "mixed"


def readable(folder: Path) -> bool:
    """Whether a folder is read as an answer."""
    try:
        ho.load(folder)
    except HydrooptError:
        return False
    return True


def cells_of(folder: Path, complete: dict[str, str]) -> str:
    """What the folder of a study holds: nothing, whole cells of it, everything, or mixed."""
    found = content(folder) if folder.exists() else {}
    if any(complete.get(name) != digest for name, digest in found.items()):
        return "mixed"
    if found.keys() & {"summary.json", "report.html"} and found != complete:
        return "mixed"
    return "new" if found == complete else "old" if "study.json" in found else "nothing" if not found else "mixed"


def left_over(folder: Path) -> int:
    """How many unfinished things are left in a folder after the next run."""
    if folder.exists():
        with claimed(folder):
            pass
    return sum(1 for _ in folder.rglob(".*"))


def fresh_copy(source: Path | None, target: Path) -> None:
    """Make a folder a copy of another, or nothing."""
    shutil.rmtree(target, ignore_errors=True)
    if source is not None:
        shutil.copytree(source, target)


Run = Callable[[Moment, str], Ended]

if __name__ == "__main__":
    command(Moment(*json.loads(sys.argv[1])), Path(sys.argv[2]), sys.argv[3:])
