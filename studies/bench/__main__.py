"""Run all parts, or those that are named; ``montecarlo=60`` takes 60 cells instead of 1000."""

import os
import sys

from studies.bench import goals, jobs, kernels
from studies.bench.calibration import calibration
from studies.bench.closed_loop import control
from studies.bench.excitation import excitation
from studies.bench.growth import growth
from studies.bench.intervals import intervals
from studies.bench.linkage import linkage
from studies.bench.montecarlo import montecarlo
from studies.bench.plant import plant
from studies.bench.start import start
from studies.bench.streaming import streaming
from studies.bench.valves import valves

# memory first: the most that this process has ever held counts as the peak of those that it starts
PARTS = {"streaming": streaming, "identify": jobs.identify, "codegen": jobs.codegen, "calibration": calibration,
         "control": control,
         "excavator": kernels.excavator, "arm": kernels.arm, "linkage": linkage, "growth": growth,
         "batch": kernels.batch, "first": kernels.first, "intervals": intervals,
         "excitation": excitation, "plant": plant, "start": start,
         "valves": valves,
         "montecarlo": montecarlo}


def main(names: list[str]) -> None:
    sizes = {name: int(size) for name, _, size in (text.partition("=") for text in names) if size}
    names = [text.partition("=")[0] for text in names]
    unknown = set(names) - PARTS.keys()
    if unknown:
        raise SystemExit(f"there is no part {', '.join(sorted(unknown))}; use {', '.join(PARTS)}")
    rows: list[goals.Row] = []
    for name, part in PARTS.items():
        if not names or name in names:
            print(f"{name}: {part.__doc__}")
            found = part(*([sizes[name]] if name in sizes else [])) or []
            if {row.goal for row in found} != goals.of_part(name):
                raise SystemExit(f"{name} must measure {', '.join(sorted(goals.of_part(name)))}")
            rows += found
            print(f"\nload {os.getloadavg()[0]:.1f} on {len(os.sched_getaffinity(0))} cores\n", flush=True)
    if rows:
        print(goals.table(rows))


if __name__ == "__main__":
    main(sys.argv[1:])
