"""Little memory, and compilers that write no whole library: commands answer, or end in one sentence."""

from __future__ import annotations

import json
import os
import resource
import subprocess
import sys
import tempfile
from collections import Counter
from collections.abc import Sequence
from functools import partial
from pathlib import Path

from hydroopt.logs.column_map import LogMap
from studies.first_contact.compilers import WRONG, script
from studies.first_contact.log_formats import FORMATS

LIMITS = 1, 2, 3, 4, 6
"""GB of memory that a command may use."""
SENTENCE = "hydroopt: "


def run() -> dict[str, float]:
    """Tried: `check` of a log of 4 s in each format under each of `LIMITS`, set as by ``ulimit -v``; and `identify` of
    one of them with an empty cache and each of the compilers of `WRONG`.

    A command that ends in another way than with an answer, or one sentence and exit code 2, has crashed.
    """
    with tempfile.TemporaryDirectory() as folder:
        place = Path(folder)
        logs = {kind: written(kind, place / str(k)) for k, kind in enumerate(FORMATS)}
        ends = {gb: Counter(limited(gb, ["check", "patu655_lift", *log, "--quiet"]) for log in logs.values())
                for gb in LIMITS}
        compilers = Counter(compiled(wrong, place / f"compiler{k}", logs["csv"]) for k, wrong in enumerate(WRONG))
    figures = {"memory_formats": len(logs), "memory_limits": len(LIMITS)}
    for gb, ended in ends.items():
        figures |= {f"memory_{gb}_gb_{end}": ended[end] for end in ("answer", "sentence", "crash")}
    return figures | {"compilers_tried": len(WRONG), "compilers_crash": len(WRONG) - compilers["answer"]}


def written(kind: str, folder: Path) -> list[str]:
    """A log in a format, with its map, as arguments of a command."""
    folder.mkdir()
    path, layout = FORMATS[kind](folder)
    return [str(path), *([] if layout is None else ["--map", str(_map(layout, folder / "map.toml"))])]


def _map(layout: LogMap, file: Path) -> Path:
    columns = layout.model_dump(mode="json", exclude_none=True, exclude_defaults=True)["columns"]
    file.write_text("[columns]\n" + "".join(
        f'"{name}" = {{ {", ".join(f"{key} = {json.dumps(value)}" for key, value in column.items())} }}\n'
        for name, column in columns.items()), "utf-8")
    return file


def limited(gb: float, arguments: Sequence[str]) -> str:
    """How a command ends under a limit of memory [GB]: "answer", "sentence" or "crash"."""
    most = int(gb * 1e9)
    return _ended(arguments, dict(os.environ), most)


def compiled(wrong: str, folder: Path, log: Sequence[str]) -> str:
    """How an identification ends whose compiler writes no whole library."""
    folder.mkdir()
    (folder / "cc").write_text(script(WRONG[wrong]))
    (folder / "cc").chmod(0o755)
    return _ended(["identify", "patu655_lift", *log, "--quiet", "-o", str(folder / "out")], os.environ | {
        "CC": str(folder / "cc"), "HYDROOPT_CACHE": str(folder / "cache")})


def _ended(arguments: Sequence[str], environment: dict[str, str], most: int = resource.RLIM_INFINITY) -> str:
    done = subprocess.run([sys.executable, "-m", "hydroopt", *arguments], capture_output=True, text=True, check=False,
                          env=environment, preexec_fn=partial(resource.setrlimit, resource.RLIMIT_AS, (most, most)))
    said = [line for line in done.stderr.splitlines() if line.startswith(SENTENCE)]
    if done.returncode in (0, 3):
        return "answer"
    return "sentence" if done.returncode == 2 and done.stderr.splitlines() == said[-1:] else "crash"
