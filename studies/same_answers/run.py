"""Compare the answers of some sixty jobs with those that were stored before the engines were rebuilt.

``python -m studies same_answers`` compares. ``python -m studies.same_answers.run --store [NAME...]`` stores anew, which
is done only where README.md says which answer changed and why.
"""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from studies.same_answers.jobs import LOWER_IS_BETTER, jobs

STORED = Path(__file__).with_name("stored.json")
SAME_POINT = 1e-4
"""[σ] how far an optimum may move: the solvers' tolerance."""
SAME_WIDTH = 0.03
"""How far the mean width of intervals may move, as a part of it: the scatter of the sampler's usual number of draws."""
SAME_DESIGN = 0.01
"""How much worse a design's criterion, a mean of logarithms, may become."""


def numbers(values: object) -> list[float | None]:
    """As JSON has them: nine digits, null for what is not known."""
    return [None if value is None or not np.isfinite(value) else float(f"{float(value):.9g}") for value in values]


def answers(chosen: Sequence[str] = ()) -> dict[str, dict]:
    """What each job, or each chosen one, answers now; an exception is an answer, too."""
    found: dict[str, dict] = {}
    for name, job in jobs():
        if chosen and name not in chosen:
            continue
        began = time.perf_counter()
        try:
            found[name] = {key: numbers(value) if key in ("value", "std") else value for key, value in job().items()}
        except Exception as error:
            found[name] = {"status": f"{type(error).__name__}: {error}"}
        print(f"{time.perf_counter() - began:6.1f} s  {name}: {found[name]['status']}", flush=True)
    return found


def difference(old: dict, new: dict) -> str:
    """How an answer differs beyond what is allowed, in a few words; empty if it does not."""
    if old["status"] != new["status"]:
        return f"status {old['status']} -> {new['status']}"
    if LOWER_IS_BETTER in old:
        worse = new[LOWER_IS_BETTER] - old[LOWER_IS_BETTER]
        return f"criterion {worse:+.3g}" if worse > SAME_DESIGN * max(1.0, abs(old[LOWER_IS_BETTER])) else ""
    if "value" not in old:
        return ""
    before, after, wide, now = (np.array(each, float) for each in (old["value"], new["value"], old["std"], new["std"]))
    if before.shape != after.shape or np.any(np.isfinite(before) != np.isfinite(after)):
        return "other parameters are determined"
    known = np.isfinite(before) & (wide > 0)
    moved = np.max(np.abs(after - before)[known] / wide[known], initial=0.0)
    both = known & (now > 0)
    width = np.mean(now[both] / wide[both]) - 1 if np.any(both) else 0.0
    return ", ".join([f"optimum {moved:.2g} sigma"] * bool(moved > SAME_POINT) +
                     [f"widths {width:+.1%}"] * bool(abs(width) > SAME_WIDTH))


def run() -> dict:
    """Number of jobs, and how many answers differ."""
    stored, found = json.loads(STORED.read_text("utf-8")), answers()
    differences = {name: difference(old, found.get(name, {"status": "gone"})) for name, old in stored.items()}
    differ = {name: words for name, words in differences.items() if words}
    for name, words in differ.items():
        print(f"{name}: {words}")
    return {"jobs": len(stored), "differ": len(differ)}


if __name__ == "__main__" and "--store" in sys.argv:
    chosen = sys.argv[sys.argv.index("--store") + 1:]
    kept = json.loads(STORED.read_text("utf-8")) if chosen else {}
    lines = (f"{json.dumps(name)}:{json.dumps(answer, separators=(',', ':'))}"
             for name, answer in (kept | answers(chosen)).items())
    STORED.write_text("{" + ",\n".join(lines) + "}\n", "utf-8")
