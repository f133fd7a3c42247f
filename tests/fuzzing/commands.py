"""Whole commands on spoilt files and with spoilt values of options."""

from __future__ import annotations

import contextlib
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
        "plan-poses": ["ARM", "-n", "2"], "excite": ["ARM", "--log", "LOG", "--seconds", "1", "--duration", "9"],
        "control": ["ARM", "--motion", "PATH", "--truth", "TRUTH"],
        "compare": ["ARM", "ANSWER", "ANSWER", "ANSWER"],
        "identify-payload": ["ARM", "--unloaded", "ANSWER", "--loaded", "LOG"], "identify-valves": ["ARM", "LOG"],
        "weigh": ["ARM", "LOG", "--calibration", "ANSWER", "--full-scale", "90 kg", "--tare", "1 s"],
        "check": ["ARM", "LOG"], "what-next": ["ARM", "ANSWER", "--force-std", "1 %"],
        "design-calibrator": ["ARM", "-n", "4", "--links", "3", "--starts", "1", "--effort", "0.02"]}
"""Good arguments by command; words in capitals stand for files."""
OPTIONS = ("--map", "--treat", "--smoothing", "--bandwidth", "--method", "--loss", "--tolerance", "--ridge", "--seed",
           "--duration", "--rate", "--set", "--friction", "--holdout", "--fix", "--criterion", "--focus", "--rest",
           "--gain", "--gain-error", "--level", "--link", "--truth", "--prefix", "--functions", "--json", "--nonsense",
           "--constraint", "--prior",
           "--motion")
MAKERS: dict[str, Callable[[random.Random, Path], Callable[[], object]]] = {
    "LOG": kinds.KINDS["CSV log"][0], "POSES": kinds.KINDS["pose table"][0], "PATH": kinds.KINDS["trajectory"][0],
    "TRUTH": kinds.KINDS["truth"][0], "ANSWER": kinds.KINDS["estimate folder"][0]}
NAMES = {"LOG": "log.csv", "POSES": "poses.csv", "PATH": "path.csv", "TRUTH": "truth.json", "ANSWER": "."}


@cache
def options(command: str) -> list[str]:
    """The options that a command has, but for -o."""
    key = command.replace("-", "_")
    group = typer.Typer()
    group.command()(getattr(import_module(f"hydroopt.cli.{key}"), key))
    names = [max(option.opts, key=len) for option in typer.main.get_command(group).params]
    return [name for name in names if name.startswith("--") and name != "--output"]


def arguments(rng: random.Random, folder: Path) -> list[str]:
    """A command whose files, of which at least one is spoilt, lie in the folder."""
    command = rng.choice(list(GOOD))
    made = [command]
    for word in GOOD[command]:
        given = word
        if word == "ARM":
            given = kinds.ARM
        elif word == "MACHINE":
            file = folder / ("arm.urdf" if rng.random() < 0.3 else "machine.toml")
            kinds.KINDS["URDF" if file.suffix == ".urdf" else "machine file"][0](rng, folder)
            given = str(file)
        elif word == "LOG" and rng.random() < 0.3:
            kinds.KINDS["Parquet log"][0](rng, folder)
            given = str(folder / "log.parquet")
        elif word in MAKERS:
            if not (folder / NAMES[word]).exists() or word == "ANSWER":
                MAKERS[word](rng, folder)
            given = str(folder / NAMES[word])
        made.append(given)
    if command != "show":
        made += ["-o", str(folder / "out")]
    if rng.random() < 0.4 or command in ("simulate", "plan-poses"):
        value = rng.choice((*mutation.NUMBERS, *mutation.WORDS)).replace("\0", "")
        name = rng.choice(options(command) if rng.random() < 0.8 else OPTIONS)
        made += [name, value.encode("utf-8", "replace").decode()]
    return made


def run(seed: int) -> str:
    """How a command ended: "done", "refused" or "no answer"; what is none of these is raised."""
    rng = random.Random(f"command {seed}")
    with tempfile.TemporaryDirectory(prefix="fuzz-") as name:
        folder = Path(name)
        (folder / "w").mkdir()
        sys.argv = ["hydroopt", *arguments(rng, folder)]
        os.chdir(folder / "w")
        streams = [os.open(folder / "w" / stream, os.O_RDWR | os.O_CREAT) for stream in ("out", "err")]
        for stream, number in zip(streams, (1, 2), strict=True):
            os.dup2(stream, number)
        code: object = 0
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
        if "Traceback" in err or code not in (0, 2, 3):
            raise AssertionError(shown)
        if re.search("[\x00-\x08\x0b-\x1f\x7f\u202a-\u202e\u2066-\u2069]", out + err):
            raise AssertionError(f"prints control characters: {shown}")
        if code:
            sentence = err.rstrip("\n").rpartition("\n")[2].removeprefix("hydroopt: ")
            if len(sentence) > LONGEST or not sentence.endswith((".", "'")):
                raise AssertionError(f"is not a sentence ({len(sentence)} characters): {shown}")
        return {0: "done", 2: "refused", 3: "no answer"}[code]  # type: ignore[index]
