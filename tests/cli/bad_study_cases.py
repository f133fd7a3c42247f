"""What can be wrong with a study that is asked for, in the form of `bad_input_cases`."""

from __future__ import annotations

from pathlib import Path

from cli.bad_input_cases import GOOD_LOG, Case, constant, written

from hydroopt import load_machine
from hydroopt.files import write_files
from hydroopt.study.directory import IDENTITY
from hydroopt.study.montecarlo import montecarlo


def study(*more: str, place: str, kind: str = "montecarlo") -> Case:
    return Case(lambda d: ["study", kind, "patu655_lift", "-o", str(d / "out"), *more], place)


def with_log(lines: list[str], place: str, *more: str, kind: str = "bootstrap") -> Case:
    return Case(lambda d: ["study", kind, "patu655_lift", str(written(d, "\n".join(lines) + "\n", "log.csv")), "-o",
                           str(d / "out"), *more], place)


def kept(identity: str, place: str) -> Case:
    """A directory in which something else is kept; it is not called `out`, which may hold no file."""
    def spoil(folder: Path) -> list[str]:
        write_files(folder / "kept", {IDENTITY: identity} if identity else {})
        write_files(folder / "kept/cells", {})
        return ["study", "montecarlo", "patu655_lift", "-o", str(folder / "kept"), "--cells", "3"]
    return Case(spoil, place)


def _in_the_way(folder: Path) -> list[str]:
    written(folder, "a file", "out")
    return ["study", "montecarlo", "patu655_lift", "-o", str(folder / "out")]


def other() -> str:
    import json

    return json.dumps(montecarlo(load_machine("patu655_lift"), cells=3, seed=7).identity)


def elsewhere(address: str) -> Case:
    """A scheduler that is not there; what was begun may stay, as it says what the study is."""
    return Case(lambda d: ["study", "montecarlo", "patu655_lift", "-o", str(d / "begun"), "--cells", "2", "--scheduler",
                           address], f"--scheduler {address}: .*scheduler")


ALL = {
    "unknown kind": study(kind="jackknife", place="study: 'jackknife' .*; .*montecarlo"),
    "no cells": study("--cells", "0", place="study: .*'--cells'"),
    "negative seed": study("--seed", "-1", place="study: .*'--seed'"),
    "no workers": study("--workers", "0", place="study: .*'--workers'"),
    "unknown method": study("--method", "magic", place="--method: 'magic'"),
    "negative duration": study("--duration", "-5", place="-5"),
    "rate not a number": study("--rate", "nan", place="nan"),
    "motion and its duration": study("--motion", "m.csv", "--duration", "5", place="--duration: .*; .*--motion"),
    "motion that is not there": study("--motion", "none.csv", place=r"none\.csv: "),
    "log of a Monte Carlo": with_log(GOOD_LOG, "montecarlo", kind="montecarlo"),
    "vary of a Monte Carlo": study("--vary", "rate=1,2", place="--vary: .*montecarlo"),
    "map without a motion": study("--map", "map.toml", place="--map: "),
    "sweep of nothing": study(kind="sweep", place="--vary: "),
    "sweep of the unknown": study("--vary", "mass=1,2", kind="sweep", place="--vary: 'mass' .*; .*accuracy"),
    "sweep of words": study("--vary", "rate=slow,fast", kind="sweep", place="--vary: 'rate=slow,fast'"),
    "sweep without values": study("--vary", "rate", kind="sweep", place="--vary: 'rate'"),
    "sweep of negative values": study("--vary", "accuracy=1,-1", kind="sweep", place="--vary: 1, -1 "),
    "sweep of one twice": study("--vary", "rate=50", "--vary", "rate=60", kind="sweep", place="--vary: 'rate=60'"),
    "sweep of the same value": study("--vary", "rate=50,50", kind="sweep", place="--vary: 50, 50 "),
    "bootstrap of nothing": study(kind="bootstrap", place="LOG: .*; .*file"),
    "bootstrap with a duration": with_log(GOOD_LOG, "--duration: .*bootstrap", "--duration", "3"),
    "bootstrap of a log in which nothing moves": with_log(constant(list(GOOD_LOG)), r"log\.csv: no joint moves"),
    "bootstrap of a log that is not there": study("none.csv", kind="bootstrap", place=r"none\.csv: "),
    "multistart of nothing": study(kind="multistart", place="LOG: "),
    "multistart of a log": with_log(GOOD_LOG, r"log\.csv|machine", kind="multistart"),
    "output is a file": Case(_in_the_way, "out: this is a file"),
    "directory of another study": kept(other(), "kept: .*seed is 7 there and 0 here"),
    "directory of nobody's cells": kept("", r"kept: .*study\.json"),
    "directory with a damaged identity": kept('{"study"', r"kept/study\.json: "),
    "scheduler that is not there": elsewhere("tcp://127.0.0.1:1"),
    "scheduler without a port": elsewhere("nonsense"),
    "scheduler of another protocol": elsewhere("magic://127.0.0.1:8786"),
    "scheduler and workers": study("--scheduler", "tcp://127.0.0.1:1", "--workers", "2", place="--workers: "),
}
CASES = {f"study: {name}": case for name, case in ALL.items()}
