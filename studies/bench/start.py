"""CPU time of starting: the interpreter, the package, help."""

import statistics
import sys

from hydroopt.cli import COMMANDS
from studies.bench.goals import Row
from studies.bench.process import measured

RUNS = 5
PYTHON, HELP = "python -c pass", "hydroopt --help"
CASES = {PYTHON: ["-c", "pass"], "import hydroopt": ["-c", "import hydroopt"],
         HELP: ["-m", "hydroopt", "--help"]} | {
         f"hydroopt {name} --help": ["-m", "hydroopt", name, "--help"] for name in COMMANDS}


def start() -> list[Row]:
    """CPU seconds, user and system, median of five processes each."""
    print(f"{'':32} {'CPU s':>6}")
    taken = {}
    for name, arguments in CASES.items():
        taken[name] = statistics.median(measured([sys.executable, *arguments]).cpu for _ in range(RUNS))
        print(f"{name:32} {taken[name]:6.3f}")
    return [Row("help", taken[HELP], PYTHON, taken[PYTHON])]
