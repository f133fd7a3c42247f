"""What every job must reach, each goal in one place, and whether a run reached it."""

import math
from collections.abc import Sequence
from typing import NamedTuple


class Goal(NamedTuple):
    """A bound on a figure that a part measures.

    `bound` is the largest figure in `unit`, or the smallest if `least`. The figure must also be at least `ratio` times
    as good as its reference in the same run. `unreached` says why no attempt has reached it, which README.md states as
    measured.
    """

    job: str
    part: str
    bound: float
    unit: str
    ratio: float = 0.0
    least: bool = False
    unreached: str = ""

    def __str__(self) -> str:
        beside = f", ≥ {self.ratio:.2g} times the reference" if self.ratio else ""
        return f"{'≥' if self.least else '≤'} {self.bound:g} {self.unit}".rstrip() + beside


COPY = 1 / 1.3
"""Of results that may take 1.3 times as long as a copy of the same bytes."""
GOALS = {
    "help": Goal("`hydroopt --help`", "start", 0.15, "s"),
    "identify": Goal("`identify`, 1664 samples, page included", "identify", 1.2, "s"),
    "warm": Goal("the same in a warm process, without page", "identify", 0.25, "s"),
    "long": Goal("`identify`, 10⁷ samples from Parquet", "streaming", 18.0, "s",
                 unreached="SciPy's medians, transforms and QR take 16 s longer than own C did"),
    "long memory": Goal("the same, memory", "streaming", 600.0, "MB"),
    "long growth": Goal("the same, power of the samples, 10⁶ to 10⁷", "streaming", 1.0, ""),
    "arm": Goal("calibration, UR10, 10⁴ poses, covariance and diagnosis", "calibration", 1.5, "s", ratio=1.0),
    "arm memory": Goal("the same by `calibrate`, memory", "calibration", 500.0, "MB"),
    "arm growth": Goal("the same, power of the poses, 10³ to 10⁴", "calibration", 1.0, ""),
    "chain": Goal("calibration, CAT 215B, 360 poses", "calibration", 0.15, "s"),
    "control": Goal("`control`, 34 s, six runs, page included", "control", 4.0, "s"),
    "control anew": Goal("the same, no kernel cached", "control", 4.0, "s", unreached="gcc takes 1.5 s"),
    "plant": Goal("plant of the CAT 215B, driven", "plant", 300.0, "times real time", least=True),
    "valves": Goal("`identify-valves`, CAT 215B, 7 s at 100 Hz", "valves", 4.0, "s"),
    "excite": Goal("design of a motion, CAT 215B", "excitation", 10.0, "s"),
    "excite criterion": Goal("the same, D beyond that of every start to its end", "excitation", 0.01, "",
                             unreached="following more starts takes more than the goal of the time"),
    "codegen": Goal("`codegen`, CAT 215B, without sizes", "codegen", 2.0, "s"),
    "codegen long": Goal("`codegen`, chain of 24 joints", "growth", 30.0, "s"),
    "cell": Goal("`study montecarlo`, a cell", "montecarlo", 0.4, "s"),
    "kernel": Goal("complete regressor, CAT 215B, batch, results kept", "excavator", 40.0, "ns"),
    "python": Goal("regressor of the UR10 from Python, 1664 samples", "arm", 200.0, "ns", ratio=COPY),
    "python many": Goal("the same, 10⁶ samples", "arm", 200.0, "ns", ratio=COPY),
    "one sample": Goal("one sample in exported C, gcc -O2", "excavator", 110.0, "ns", ratio=1.5,
                       unreached="stated beside 145 ns of code that takes 193 to 205 on the computer of README.md"),
    "intervals": Goal("widths of intervals by many draws, worst change", "intervals", 1.0, "%"),
    "scatter": Goal("widths of intervals by usual draws, worst of eight runs", "intervals", 3.0, "%",
                    unreached="it takes four times as many sweeps, 0.1 s"),
}


class Row(NamedTuple):
    """The figure of a goal beside that of a reference; without one, `beside` is not a number."""

    goal: str
    measured: float
    reference: str = ""
    beside: float = math.nan

    @property
    def ratio(self) -> float:
        """How many times as good as the reference it is."""
        return self.measured / self.beside if GOALS[self.goal].least else self.beside / self.measured

    @property
    def met(self) -> bool:
        """Whether it keeps its bound, and the one beside its reference."""
        goal = GOALS[self.goal]
        kept = self.measured >= goal.bound if goal.least else self.measured <= goal.bound
        return kept and (not goal.ratio or self.ratio >= goal.ratio)


def of_part(part: str) -> set[str]:
    """The goals that a part measures."""
    return {name for name, goal in GOALS.items() if goal.part == part}


def table(rows: Sequence[Row]) -> str:
    """Rows in Markdown, in the order of the goals."""
    lines = ["| job | goal | measured | reference of the same run | ratio | met |", "|---|---|---|---|---|---|"]
    for row in sorted(rows, key=lambda row: [*GOALS].index(row.goal)):
        goal = GOALS[row.goal]
        beside = f"{row.reference} {figure(row.beside, goal.unit)} | {row.ratio:.2f}" if row.reference else " | "
        lines.append(f"| {goal.job} | {goal} | {figure(row.measured, goal.unit)} | {beside} | "
                     f"{'yes' if row.met else f'expected failure: {goal.unreached}' if goal.unreached else 'no'} |")
    return "\n".join(lines)


def figure(value: float, unit: str) -> str:
    """Three significant digits with their unit."""
    return f"{value:#.3g}".rstrip(".") + (f" {unit}" if unit else "")
