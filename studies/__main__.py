"""Run studies and hold their results against their expected.json.

A quantity with an ``expected_failure`` is checked like the others, but that it falls short, for this reason, fails
nothing.
"""

import json
import runpy
import sys
import time
from pathlib import Path

HERE = Path(__file__).parent


def verdicts(results: dict, expected: dict) -> list[tuple[str, bool, str]]:
    """For every expected quantity: its name, whether it holds, and the comparison in words."""
    found = []
    for name, limits in expected.items():
        value = results.get(name)
        text, holds = f"{value}", value is not None
        for kind, bound in limits.items():
            if kind == "max":
                good, sign = holds and value <= bound, "≤"
            elif kind == "min":
                good, sign = holds and value >= bound, "≥"
            elif kind == "equals":
                good, sign = holds and value == bound, "="
            else:
                continue  # "why" and the like explain
            text, holds = f"{text} {sign} {bound}", good
        found.append((name, holds, text))
    return found


def main(names: list[str]) -> int:
    """Exit code: the number of studies that failed."""
    failed = 0
    for folder in sorted(path.parent for path in HERE.glob("*/run.py")):
        if names and folder.name not in names:
            continue
        began = time.perf_counter()
        results = runpy.run_path(str(folder / "run.py"))["run"]()
        if results is None:
            print(f"{folder.name}: skipped, a data set or a tool that it needs is not at hand")
            continue
        expected = json.loads((folder / "expected.json").read_text())
        table = verdicts(results, expected)
        short = {name: why for name, limits in expected.items() if (why := limits.get("expected_failure"))}
        failed += not all(holds or name in short for name, holds, _ in table)
        print(f"{folder.name} ({time.perf_counter() - began:.0f} s)")
        for name, holds, text in table:
            said = "ok  " if holds else "short" if name in short else "FAIL"
            print(f"  {said} {name}: {text}" + (f" ({short[name]})" if said == "short" else ""))
        for name in sorted(results.keys() - {name for name, _, _ in table}):
            print(f"       {name}: {results[name]}")
    return failed


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
