"""`make fuzz`: reads spoilt inputs, runs spoilt commands, and writes the figures to out/fuzz/table.md."""

from __future__ import annotations

import argparse
import gc
import multiprocessing
import os
import pkgutil
import random
import sys
import time
import warnings
from collections import Counter
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import Any

import hydroopt
from fuzzing import commands, kinds
from fuzzing.isolation import HANG, MEMORY, Done, each

BATCH = 250
LANE: list[Callable[[int], tuple[str, list[Done]]]] = []
"""What the forked lanes do with a piece of work; it is known to them, as no pickle could make it."""


def main() -> int:
    """Nothing found: 0."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--inputs", type=int, default=200_000)
    parser.add_argument("--commands", type=int, default=2_000)
    parser.add_argument("--first", type=int, default=0, help="seed of the first input and command")
    parser.add_argument("--minutes", type=float, default=30.0, help="after which no further batch begins")
    parser.add_argument("-o", "--output", type=Path, default=Path("out/fuzz"))
    asked = parser.parse_args()
    warnings.simplefilter("error")
    prepare()
    began, found = time.monotonic(), 0
    work: list[tuple[str, Callable[[int], Any], list[int]]] = []
    for kind, count in kinds.shares(asked.inputs).items():
        seeds = range(asked.first, asked.first + count)
        work += [(kind, lambda seed, kind=kind: kinds.parse(kind, seed), list(seeds[k:k + BATCH]))  # type: ignore[misc]
                 for k in range(0, count, BATCH)]
    work += [("whole command", commands.run, [seed]) for seed in range(asked.first, asked.first + asked.commands)]
    random.Random(0).shuffle(work)  # all kinds from the start on
    results: dict[str, list[Done]] = {kind: [] for kind in [*kinds.KINDS, "whole command"]}

    LANE.append(lambda k: (work[k][0], list(each(work[k][1], work[k][2]))
                           if time.monotonic() - began < 60 * asked.minutes else []))
    with multiprocessing.get_context("fork").Pool(os.cpu_count()) as pool:
        for kind, done in pool.imap_unordered(_lane, range(len(work))):
            results[kind] += done
    text, found = table(results, time.monotonic() - began)
    asked.output.mkdir(parents=True, exist_ok=True)
    (asked.output / "table.md").write_text(text, "utf-8")
    print(text)
    return min(found, 1)


def _lane(k: int) -> tuple[str, list[Done]]:
    return LANE[0](k)


def prepare() -> None:
    """Import and compute once what all children share."""
    for module in ("pandas", "pyarrow.csv", "pyarrow.parquet"):
        import_module(module)
    for found in pkgutil.walk_packages(hydroopt.__path__, "hydroopt."):
        if not found.name.endswith("__main__"):
            import_module(found.name)
    kinds.prepare()
    gc.freeze()


def table(results: dict[str, list[Done]], seconds: float) -> tuple[str, int]:
    """The figures as a table with all faults below, and how many faults count."""
    lines = ["| input | read | values | refused | contained | faults | slowest [s] | memory [MB] | longest sentence |",
             "|---|---|---|---|---|---|---|---|---|"]
    faults: list[str] = []
    total: Counter[str] = Counter()
    for kind, done in results.items():
        if not done:
            continue
        contained = [one for one in done if one.fault.startswith("crash") and kind == kinds.CONTAINED]
        bad = [one for one in done if one.fault and one not in contained]
        values = sum(one.result in ("value", "done") for one in done if not one.fault)
        counts = {"read": len(done), "values": values, "refused": len(done) - values - len(bad) - len(contained),
                  "contained": len(contained), "faults": len(bad)}
        total.update({"commands" if kind == "whole command" else key: count for key, count in counts.items()
                      if kind != "whole command" or key == "read"})
        total["all faults"] += len(bad)
        longest = max((len(one.result) for one in done if one.result), default=0)
        cells = [kind, *counts.values(), f"{max(one.seconds for one in done):.1f}",
                 f"{max(one.memory for one in done) / 1e6:.0f}", "" if kind == "whole command" else longest]
        lines.append("| " + " | ".join(map(str, cells)) + " |")
        faults += [f"- {kind}, seed {one.index}: {one.fault}" for one in bad]
    head = (f"{total['read']} inputs read, {total['commands']} whole commands, {total['all faults']} faults "
            f"(tracebacks, crashes, over {HANG:.0f} s, over {MEMORY / 1e9:.0f} GB, bad sentences) in {seconds:.0f} s; "
            "the crashes of SciPy's reader that its process contains are counted apart.\n\n")
    return head + "\n".join(lines) + "\n" + "".join(f"\n{fault}" for fault in faults), total["all faults"]


if __name__ == "__main__":
    sys.exit(main())
