"""Studies end with the same bits whoever computes them, and whatever kills whom in between."""

from __future__ import annotations

import json
import math
import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import psutil
import pytest
from threadpoolctl import threadpool_limits

from fixtures import quick
from hydroopt.errors import ProblemError, SolverError
from hydroopt.study.run import Directory, run
from hydroopt.study.study import Study, seeds
from hydroopt.study.table import Table

PATIENCE = 60.0
"""Time [s] that nothing here takes."""
HERE = {**os.environ, "PYTHONPATH": os.pathsep.join(map(str, Path(__file__).parents[1:3]))}


def alone(study: Study) -> str:
    """The table of a study whose cells need nobody else, computed one by one in this process."""
    with threadpool_limits(limits=1):
        results = [study.function(**cell) for cell in study.cells]
    outcomes = [{"result": {key: None if isinstance(value, float) and math.isnan(value) else value
                            for key, value in result.items()}} for result in results]
    return Table(study.cells, tuple(outcomes)).csv()


def until(happened: Callable[[], object]) -> None:
    began = time.monotonic()
    while not happened():
        assert time.monotonic() - began < PATIENCE, "nothing happens"
        time.sleep(0.02)


def kept(directory: Path) -> dict[str, int]:
    return {file.name: file.stat().st_mtime_ns for file in (directory / "cells").glob("*.json")}


def workers(of: int | None = None) -> list[psutil.Process]:
    found = []
    for child in psutil.Process(of).children(recursive=True):
        with suppress(psutil.Error):
            if "spawn_main" in " ".join(child.cmdline()):
                found.append(child)
    return found


def reachable() -> list[object]:
    """Sockets by which others could send work to this process or to one that it started."""
    here = psutil.Process()
    own = [socket for socket in here.net_connections("inet") if socket.status == psutil.CONN_LISTEN]
    return own + [socket for child in here.children(recursive=True) for socket in child.net_connections("all")
                  if socket.laddr]  # a pair of sockets without names belongs to the two processes that hold it


@contextmanager
def process(*arguments: str, **options: object) -> Iterator[subprocess.Popen[bytes]]:
    running = subprocess.Popen([sys.executable, *arguments], env=HERE, stdout=subprocess.DEVNULL,
                               stderr=subprocess.DEVNULL, **options)  # type: ignore[call-overload]
    try:
        yield running
    finally:
        running.kill()
        running.wait()


@pytest.mark.slow
def test_a_study_killed_at_half_goes_on_and_a_worker_killed_costs_nothing(tmp_path: Path) -> None:
    out, study, told, killed = tmp_path / "out", quick.study(40, pause=0.05), [], []
    with process(quick.__file__, str(out), "40", "0.05") as running:
        until(lambda: len(kept(out)) >= 20)
        begun = workers(running.pid)
        running.send_signal(signal.SIGKILL)
        running.wait()
        assert len(begun) == 2
    before = kept(out)
    assert 20 <= len(before) < 40
    assert not (out / "results.csv").exists()
    until(lambda: not any(worker.is_running() and worker.status() != psutil.STATUS_ZOMBIE for worker in begun))

    def say(text: str, part: float | None = None) -> None:
        told.append(text)
        if len(told) == 4:
            killed.extend(workers()[:1])
            killed[0].kill()

    table = run(study, out, workers=2, say=say)
    after = kept(out)
    assert {name: after[name] for name in before} == before  # none was computed again
    assert len(killed) == 1
    assert not table.failures
    assert (out / "results.csv").read_text("utf-8") == alone(study)
    assert told[-1] == "40 of 40 cells"


@pytest.mark.slow
@pytest.mark.needs("openssl")
def test_workers_of_a_scheduler_elsewhere_give_the_same_bits(tmp_path: Path) -> None:
    """They share no directory with the study, and one of them is killed; nobody takes part without the certificate."""
    import dask
    from distributed import Client

    study, away = quick.study(30, pause=0.05), tmp_path / "away"
    away.mkdir()
    address, key, certificate = (tmp_path / name for name in ("scheduler.json", "key.pem", "certificate.pem"))
    subprocess.run(["openssl", "req", "-x509", "-newkey", "rsa:2048", "-nodes", "-keyout", key, "-out", certificate,
                    "-days", "2", "-subj", "/CN=study"], check=True, capture_output=True)
    arguments = ("--scheduler-file", str(address), "--protocol", "tls", "--tls-ca-file", str(certificate),
                 "--tls-cert", str(certificate), "--tls-key", str(key))
    options = ("--nthreads", "1", "--no-nanny", "--no-dashboard")
    with process("-m", "distributed.cli.dask_scheduler", "--port", "0", "--no-dashboard", *arguments,
                 cwd=away) as scheduler:
        until(address.exists)
        at = json.loads(address.read_text("utf-8"))["address"]
        with pytest.raises(ProblemError, match="the certificates in Dask's configuration cannot be used"):
            run(study, tmp_path / "out", scheduler=at)
        with pytest.raises(OSError, match="closed"):
            Client(at.replace("tls", "tcp"), timeout=5)
        given = {f"DASK_DISTRIBUTED__COMM__TLS__{name}": str(file) for name, file in
                 (("CA_FILE", certificate), ("CLIENT__CERT", certificate), ("CLIENT__KEY", key))}
        with (dask.config.set(dask.config.merge(dask.config.config, dask.config.collect_env(given))),
              process("-m", "distributed.cli.dask_worker", *arguments, *options, cwd=away),
              process("-m", "distributed.cli.dask_worker", *arguments, *options, cwd=away) as second):
            def say(text: str, part: float | None = None) -> None:
                if text.startswith("10 of 30 cells"):
                    second.kill()

            table = run(study, tmp_path / "out", scheduler=at, say=say)
            assert not table.failures
            assert (tmp_path / "out/results.csv").read_text("utf-8") == alone(study)

            def end(text: str, part: float | None = None) -> None:
                if text.startswith("5 of 30 cells"):
                    scheduler.kill()

            with pytest.raises(SolverError, match="the connection to the scheduler was lost"):
                run(study, tmp_path / "lost", scheduler=at, say=end)
    assert 5 <= len(kept(tmp_path / "lost")) < 30


def test_what_is_no_scheduler_is_refused_soon(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A server that takes the call and never says a word."""
    monkeypatch.setattr("hydroopt.study.scheduler.PATIENCE", 0.5)
    with socket.socket() as server:
        server.bind(("127.0.0.1", 0))
        server.listen()
        at, began = f"tcp://127.0.0.1:{server.getsockname()[1]}", time.monotonic()
        with pytest.raises(ProblemError, match=rf"--scheduler {at}: no Dask scheduler answers"):
            run(quick.study(3), tmp_path, scheduler=at)
    assert time.monotonic() - began < 20  # a busy machine takes its time, but not for ever


def test_an_address_that_asks_for_certificates_is_refused_without(tmp_path: Path) -> None:
    with pytest.raises(ProblemError, match=r"--scheduler tls://127.0.0.1:1: the certificates in Dask's configuration "
                       r"cannot be used \(it states none\); set DASK_DISTRIBUTED__COMM__TLS__CA_FILE"):
        run(quick.study(3), tmp_path, scheduler="tls://127.0.0.1:1")


class Unloadable:
    """Ends the process that unpickles it, as a script does that starts a study without asking whether it is main."""

    def __reduce__(self) -> tuple[object, tuple[int]]:
        return os._exit, (3,)


def test_processes_that_cannot_start_are_an_error(tmp_path: Path) -> None:
    work: Any = Unloadable()
    with pytest.raises(ProblemError, match="a process for its cells ended before it could start; in a script"):
        run(replace(quick.study(3), function=work), tmp_path, workers=2)
    assert not list((tmp_path / "cells").glob("*.json"))
    assert not workers()


def test_the_command_starts_without_distributed() -> None:
    code = "import hydroopt.cli, sys; sys.exit(bool({'distributed', 'tornado'} & sys.modules.keys()))"
    assert subprocess.run([sys.executable, "-c", code], env=HERE, check=False).returncode == 0


@pytest.mark.slow
def test_cells_that_fail_or_kill_are_recorded_and_do_no_harm(tmp_path: Path) -> None:
    sockets: list[object] = []
    table = run(quick.study(8, bad=2, deadly=5), tmp_path, workers=1, say=lambda *_: sockets.extend(reachable()))
    assert not sockets
    assert [k for k, outcome in enumerate(table.outcomes) if "error" in outcome] == [2, 5]
    assert table.outcomes[2]["error"] == "cell 2: the data show nothing; measure more."
    assert "cell 5: the process that computed it died repeatedly" in table.outcomes[5]["error"]
    good = quick.study(8)
    for k in (0, 1, 3, 4, 6, 7):
        expected = good.function(**good.cells[k])
        assert {**table.outcomes[k]["result"], "nothing": None} == {**expected, "nothing": None}
    lines = (tmp_path / "results.csv").read_text("utf-8").splitlines()
    assert len(lines) == 9
    assert '"a,b"' in lines[1]
    # and what is recorded is not tried again: nobody would be there to do it
    assert run(quick.study(8, bad=2, deadly=5), tmp_path, scheduler="tcp://127.0.0.1:1").csv() == table.csv()


def test_cells_that_cannot_be_read_are_not_finished(tmp_path: Path) -> None:
    study = quick.study(6)
    place = Directory(tmp_path, study)
    for k in range(6):
        place.write(k, {"result": {"x": 0.1 + k, "nothing": float("nan")}})
    for k, text in {0: "", 1: '{"cell"', 2: "[]", 3: json.dumps({"cell": {"seed": 1}, "result": {}}),
                    4: json.dumps({"cell": study.cells[4], "result": 3})}.items():
        (tmp_path / f"cells/{k}.json").write_text(text)
    (tmp_path / ".hydroopt-x").mkdir()
    assert Directory(tmp_path, study).read() == {5: {"result": {"x": 5.1, "nothing": None}}}
    assert not (tmp_path / ".hydroopt-x").exists()


@pytest.mark.parametrize(("other", "what"), [
    (quick.study(6, seed=4), "seed is 3 there and 4 here"), (quick.study(7), "cells is 6 there and 7 here"),
    (quick.study(6, bad=1), "cells_sha256 is"),
    (Study("slow", quick.cell, quick.study(6).cells, {"seed": 3}), "study")])
def test_the_directory_of_another_study_is_refused(other: Study, what: str, tmp_path: Path) -> None:
    Directory(tmp_path, quick.study(6))
    Directory(tmp_path, quick.study(6))
    with pytest.raises(ProblemError, match=f"another study: .*{what}"):
        run(other, tmp_path)


def test_another_version_is_another_study(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    Directory(tmp_path, quick.study(6))
    monkeypatch.setattr("hydroopt.support.packages.metadata.version", lambda name: "0.0")
    with pytest.raises(ProblemError, match=r'versions hydroopt is ".*" there and "0.0" here'):
        run(quick.study(6), tmp_path)


def test_a_study_without_any_result_is_no_success(tmp_path: Path) -> None:
    place = Directory(tmp_path, quick.study(2))
    for k in range(2):
        place.write(k, {"error": f"cell {k}: the data show nothing; measure more."})
    with pytest.raises(SolverError, match="no cell succeeded: cell 0"):
        run(quick.study(2), tmp_path)


def test_seeds_are_many_and_stay_when_cells_are_added() -> None:
    assert seeds(5, 10) == seeds(5, 20)[:10]
    assert len({*seeds(0, 2000), *seeds(1, 2000)}) == 4000
    assert max(seeds(0, 2000)) < 2**53
