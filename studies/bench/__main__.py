"""Run all parts, or those that are named."""

import sys

from studies.bench import jobs, kernels
from studies.bench.excitation import excitation

# memory first: the most that this process has ever held counts as the peak of those that it starts
PARTS = {"identify": jobs.identify, "calibration": jobs.calibration, "excavator": kernels.excavator,
         "arm": kernels.arm, "batch": kernels.batch, "first": kernels.first,
         "excitation": excitation}


def main(names: list[str]) -> None:
    unknown = set(names) - PARTS.keys()
    if unknown:
        raise SystemExit(f"there is no part {', '.join(sorted(unknown))}; use {', '.join(PARTS)}")
    for name, part in PARTS.items():
        if not names or name in names:
            print(f"{name}: {part.__doc__}")
            part()
            print()


if __name__ == "__main__":
    main(sys.argv[1:])
