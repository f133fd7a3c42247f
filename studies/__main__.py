"""Run studies, hold their results against their expected.json, and write one table of them all.

A quantity with an ``expected_failure`` is checked like the others, but that it falls short, for this reason, fails
nothing. STUDY/PART runs a part of a study whose ``run`` takes names of parts; only what it returns is then checked.
"""

import argparse
import inspect
import json
import operator
import runpy
import sys
import time
import traceback
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

from studies.show import OUT

HERE = Path(__file__).parent
QUICK = ("kr300", "identifiability", "complete_against_reduced", "mukca_panda_2", "patu_lift", "panda_gaz2019")
"""Studies that ``--quick`` runs: the main claims on real data, in a few minutes."""
SIGNS = {"max": "≤", "min": "≥", "equals": "="}
WITHIN = {"max": operator.le, "min": operator.ge, "equals": operator.eq}
HOLDS, FAILS = "holds", "**fails**"


class Row(NamedTuple):
    """One line of the table."""

    study: str
    quantity: str
    value: object
    bound: str
    verdict: str
    seconds: float


def checked(value: object, limits: dict) -> tuple[str, str]:
    """The bounds of a quantity in words, and the verdict on its value; None is within no bound."""
    bounds = {kind: limits[kind] for kind in SIGNS if kind in limits}
    good = value is not None and all(WITHIN[kind](value, bound) for kind, bound in bounds.items())
    text = ", ".join(f"{SIGNS[kind]} {bound}" for kind, bound in bounds.items())
    if good:
        return text, HOLDS
    return text, f"expected failure: {limits['expected_failure']}" if "expected_failure" in limits else FAILS


def rows(folder: Path, parts: Sequence[str] = ()) -> Iterator[Row]:
    """Run one study, or some parts of it: its quantities with bounds first, then those without."""
    began = time.perf_counter()
    try:
        results = _run(folder)(*parts)
    except Exception as error:  # a study that breaks does not keep the others from running
        traceback.print_exc()
        yield Row(folder.name, "all", None, "", f"{FAILS}: {type(error).__name__}", time.perf_counter() - began)
        return
    seconds = time.perf_counter() - began
    if results is None:
        yield Row(folder.name, "all", None, "", "skipped: a data set or a tool that it needs is missing", seconds)
        return
    expected = json.loads((folder / "expected.json").read_text("utf-8"))
    for name, limits in expected.items():
        if name in results or not parts:
            yield Row(folder.name, name, results.get(name), *checked(results.get(name), limits), seconds)
    for name in sorted(results.keys() - expected.keys()):
        yield Row(folder.name, name, results[name], "", "", seconds)


def _run(folder: Path) -> Callable[..., dict | None]:
    run: Callable[..., dict | None] = runpy.run_path(str(folder / "run.py"))["run"]
    return run


def _has_parts(folder: Path) -> bool:
    kinds = [each.kind for each in inspect.signature(_run(folder)).parameters.values()]
    return inspect.Parameter.VAR_POSITIONAL in kinds


def markdown(found: list[Row]) -> str:
    """The table; the seconds of a study stand in its first line."""
    lines = ["| study | quantity | value | bound | verdict | seconds |", "|---|---|---|---|---|---|"]
    for k, row in enumerate(found):
        seconds = f"{row.seconds:.0f}" if k == 0 or found[k - 1].study != row.study else ""
        value = "" if row.value is None else row.value
        lines.append(f"| {row.study} | {row.quantity} | {value} | {row.bound} | {row.verdict} | {seconds} |")
    return "\n".join(lines) + "\n"


def main() -> int:
    """Exit code: the number of studies that failed."""
    parser = argparse.ArgumentParser(prog="python -m studies", description=__doc__.partition("\n")[0])
    there = [path.parent.name for path in sorted(HERE.glob("*/run.py"))]
    parser.add_argument("names", nargs="*", metavar="STUDY[/PART]",
                        help=f"studies to run, all by default: {', '.join(there)}")
    parser.add_argument("--quick", action="store_true", help=f"run only {', '.join(QUICK)}")
    options = parser.parse_args()
    chosen: dict[str, list[str]] = {}
    for name, _, part in (each.partition("/") for each in options.names or (QUICK if options.quick else there)):
        chosen.setdefault(name, []).extend([part] if part else [])
    if unknown := set(chosen) - set(there):
        parser.error(f"there is no study {', '.join(sorted(unknown))}")
    for name in (name for name, parts in chosen.items() if parts and not _has_parts(HERE / name)):
        parser.error(f"the study {name} has no parts")
    found: list[Row] = []
    OUT.mkdir(parents=True, exist_ok=True)
    for name, parts in chosen.items():
        print(f"== {name}", flush=True)
        found += rows(HERE / name, parts)
        (OUT / "table.md").write_text(markdown(found), "utf-8")  # so that an interrupted run leaves what it found
    print(f"\n{markdown(found)}\n{OUT / 'table.md'}")
    return len({row.study for row in found if row.verdict.startswith(FAILS)})


if __name__ == "__main__":
    sys.exit(main())
