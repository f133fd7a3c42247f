"""Whole commands on spoilt files and with spoilt values of options."""

from __future__ import annotations

import contextlib
import io
import json
import os
import random
import re
import sys
import tempfile
from collections.abc import Callable
from functools import cache
from importlib import import_module
from pathlib import Path

import typer

from fuzzing import kinds, mutation
from hydroopt import cli
from hydroopt.errors import LONGEST

GOOD = {"show": ["MACHINE"], "codegen": ["MACHINE"], "simulate": ["ARM", "--duration", "2", "--rate", "20"],
        "identify": ["ARM", "LOG", "--method", "wls"], "calibrate": ["ARM", "POSES"],
        "plan-poses": ["ARM", "-n", "2"], "excite": ["ARM", "--log", "LOG", "--search-seconds", "1", "--duration", "9"],
        "control": ["ARM", "--motion", "PATH", "--truth", "TRUTH"],
        "compare": ["ARM", "ANSWER", "ANSWER", "ANSWER"],
        "identify-payload": ["ARM", "--unloaded", "ANSWER", "--loaded", "LOG"], "identify-valves": ["ARM", "LOG"],
        "weigh": ["ARM", "LOG", "--calibration", "ANSWER", "--full-scale", "90 kg", "--tare", "1 s"],
        "check": ["ARM", "LOG"], "what-next": ["ARM", "ANSWER", "--force-std", "1 %"],
        "design-calibrator": ["panda_mukca", "-n", "4", "--links", "3", "--starts", "1", "--effort", "0.02",
                              "--sensor", "0.1 deg=120"],
        "check MOTION": ["ARM", "PATH"], "calibrate SHEET": ["RIG", "SHEET"], "calibrate FILE": ["RIG FILE", "SHEET"],
        "weigh KNOWN": ["ARM", "LOG", "--calibration", "ANSWER", "--full-scale", "90 kg", "--known", "60 kg:LOG",
                        "--gain-error", "0.02"],
        "what-next TIP": ["RIG FILE", "--tip-std", "10 mm", "--budget", "20"],
        "measure-up": ["RIG FILE", "--tip-std", "10 mm"], "measure-up FILE": ["MACHINE", "--tip-std", "10 mm"],
        "plan-poses FILE": ["MACHINE", "-n", "2"], "plan-valve-test": ["ARM"], "plan-valve-test FILE": ["MACHINE"],
        "view": ["MACHINE"], "view ANSWER": ["ANSWER"], "view RIG": ["RIG FILE"], "map": ["LOG", "ARM"],
        "map FILE": ["LOG", "MACHINE"], "new": ["NEW", "--answers", "ANSWERS"], "new ASKED": ["NEW"],
        "convert": ["MACHINE", "OUT"], "calibrate-sensors": ["ARM", "LOG"], "compare TWO": ["ARM", "ANSWER", "LOG"],
        "study montecarlo": ["ARM", "--cells", "2", "--duration", "2", "--rate", "20", "--method", "wls",
                             "--processes", "1"],
        "models": []}
"""Good arguments by command, and a word in capitals where there are several; words in capitals stand for files."""
FILELESS = ("show", "map", "new", "convert", "models")
"""Commands without a directory for results."""
OPTIONS = ("--map", "--treat", "--smoothing", "--bandwidth", "--method", "--loss", "--tolerance", "--ridge", "--seed",
           "--duration", "--rate", "--set", "--friction", "--holdout", "--fix", "--criterion", "--focus", "--rest",
           "--gain", "--gain-error", "--level", "--link", "--truth", "--prefix", "--functions", "--json", "--nonsense",
           "--constraint", "--prior",
           "--motion")
MAKERS: dict[str, Callable[[random.Random, Path], Callable[[], object]]] = {
    "LOG": kinds.KINDS["CSV log"][0], "POSES": kinds.KINDS["pose table"][0], "PATH": kinds.KINDS["trajectory"][0],
    "TRUTH": kinds.KINDS["truth"][0], "ANSWER": kinds.KINDS["estimate folder"][0],
    "SHEET": kinds.KINDS["filled sheet"][0], "ANSWERS": kinds.KINDS["answers"][0], "RIG FILE": kinds.KINDS["rig"][0]}
NAMES = {"LOG": "log.csv", "POSES": "poses.csv", "PATH": "path.csv", "TRUTH": "truth.json", "ANSWER": ".",
         "SHEET": "sheet.csv", "ANSWERS": "answers.toml", "RIG FILE": "rig.toml"}
SPOILT = 0.7
"""Part of the files that are spoilt; of a command with several, some pass the first check, then."""


@cache
def options(command: str) -> list[str]:
    """The options that a command has, but for -o."""
    key, _, job = command.replace("-", "_").partition(" ")
    module = import_module(f"hydroopt.cli.{key}")
    if job.islower():
        found = typer.main.get_command(module.app).commands[job]  # type: ignore[attr-defined]
    else:
        group = typer.Typer()
        group.command()(getattr(module, key))
        found = typer.main.get_command(group)
    names = [max(option.opts, key=len) for option in found.params]
    return [name for name in names if name.startswith("--") and name != "--output"]


def arguments(rng: random.Random, folder: Path, kind: str = "") -> list[str]:
    """A command, of a kind or of any, whose files lie in the folder: most are spoilt, and all are good of a kind."""
    spoilt = 0.0 if kind else SPOILT
    kind = kind or rng.choice(list(GOOD))
    command = " ".join(word for word in kind.split() if not word.isupper())
    made = command.split()
    for word in GOOD[kind]:
        given = word
        if word == "ARM":
            given = kinds.ARM
        elif word == "RIG":
            given = kinds.RIG
        elif word == "MACHINE":
            file = folder / ("arm.urdf" if rng.random() < 0.3 else "machine.toml")
            with mutation.sparing(not spoilt):
                kinds.KINDS["URDF" if file.suffix == ".urdf" else "machine file"][0](rng, folder)
            given = str(file)
        elif word == "LOG" and rng.random() < 0.4 * spoilt:
            kinds.KINDS["Parquet log"][0](rng, folder)
            given = str(folder / "log.parquet")
        elif word == "60 kg:LOG":
            given = f"60 kg:{made[2]}"
        elif word == "NEW":
            given = str(folder / "out" / "new.toml")
        elif word == "OUT":
            given = str(folder / "out" / rng.choice(("m.toml", "m.urdf", "m.xml", "m.sdf", "m.txt", "m")))
        elif word in MAKERS:
            if not (folder / NAMES[word]).exists() or word == "ANSWER":
                with mutation.sparing(rng.random() >= spoilt):
                    MAKERS[word](rng, folder)
            given = str(folder / NAMES[word])
        made.append(given)
    if command not in FILELESS:
        made += ["-o", str(folder / "out")]
    elif command == "map":
        made += rng.choice(([], ["--to", str(folder / "map.toml")]))
    elif command in ("new", "convert"):
        (folder / "out").mkdir()
    if not spoilt:
        return made
    if rng.random() < 0.4 or command in ("simulate", "plan-poses", "models", "plan-valve-test"):
        value = rng.choice((*mutation.NUMBERS, *mutation.WORDS)).replace("\0", "")
        name = rng.choice(options(command) if rng.random() < 0.8 and options(command) else OPTIONS)
        made += [name, value.encode("utf-8", "replace").decode()]
    if rng.random() < 0.2 and "--json" in options(command):
        made.append("--json")
    return made


def typed(rng: random.Random) -> list[str]:
    """Answers to whatever is asked: most are empty, which takes what is typical."""
    said = ("", "", "", "", "", "", "crane", "excavator", "loader", "arm", "back", "?", "y", "2 m", "1,5 m", "3")
    return [rng.choice(said) if rng.random() < 0.9 else
            re.sub(r"[\0\n\r\ud800-\udfff]", "", rng.choice((*mutation.NUMBERS, *mutation.WORDS)))
            for _ in range(rng.choice((0, 3, 30, 200)))]


def _refused(name: str) -> object:
    raise AssertionError(f"writes {name} in JSON")


def run(seed: int, kind: str = "") -> str:
    """How a command ended: "done", "refused", "no answer" or "stopped"; what is none of these is raised.

    Args:
        seed: of the command, its files and options.
        kind: a key of `GOOD`, whose files are good then.
    """
    rng = random.Random(f"command {seed}")
    with tempfile.TemporaryDirectory(prefix="fuzz-") as name:
        folder = Path(name)
        (folder / "w").mkdir()
        sys.argv = ["hydroopt", *arguments(rng, folder, kind)]
        os.chdir(folder / "w")
        streams = [os.open(folder / "w" / stream, os.O_RDWR | os.O_CREAT) for stream in ("out", "err")]
        for stream, number in zip(streams, (1, 2), strict=True):
            os.dup2(stream, number)
        code: object = 0
        sys.stdin = io.StringIO("".join(answer + "\n" for answer in typed(rng)))
        with open(1, "w", closefd=False) as sys.stdout, open(2, "w", closefd=False) as sys.stderr:
            try:
                cli.main()
            except SystemExit as ended:
                code = ended.code
        out, err = ((folder / "w" / stream).read_text("utf-8", "replace") for stream in ("out", "err"))
        os.chdir("/")
        with contextlib.suppress(OSError):
            for stream in streams:
                os.close(stream)
        shown = f"{' '.join(sys.argv)[:200]!r}: exit {code}, {err[-300:]!r}"
        if code == 130 and sys.argv[1] == "new":  # the answers ended before the questions
            return "stopped"
        if "Traceback" in err or code not in (0, 2, 3):
            raise AssertionError(shown)
        if re.search("[\x00-\x08\x0b-\x1f\x7f\u202a-\u202e\u2066-\u2069]", out + err):
            raise AssertionError(f"prints control characters: {shown}")
        if code:
            sentence = err.rstrip("\n").rpartition("\n")[2].removeprefix("hydroopt: ")
            if len(sentence) > LONGEST or not sentence.endswith((".", "'")):
                raise AssertionError(f"is not a sentence ({len(sentence)} characters): {shown}")
        left = folder / "out"
        files = [] if Path(sys.argv[1]).name == "new" else [str(file.relative_to(left)) for file in left.rglob("*")]
        if (code == 2 and files) or any(Path(file).name.startswith(".") for file in files):
            raise AssertionError(f"leaves {files[:5]}: {shown}")
        for text in [*(left.rglob("*.json") if code != 2 else ())]:
            json.loads(text.read_text("utf-8"), parse_constant=_refused)
        if code == 0 and "--json" in sys.argv:
            json.loads(out, parse_constant=_refused)
        return {0: "done", 2: "refused", 3: "no answer"}[code]  # type: ignore[index]
