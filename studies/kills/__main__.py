"""Kill every command at random moments by SIGINT, SIGTERM and SIGKILL; print and store a table of what was left.

    python -m studies.kills [KILLS] [--seed SEED] [--jobs NAME,NAME] [-o FILE]

The figures stand in FILE, by default out/kills.json.
"""

from __future__ import annotations

import argparse
import json
import signal
import tempfile
from collections import Counter
from importlib import import_module
from pathlib import Path

import numpy as np

from hydroopt.cli import COMMANDS
from studies.kills.jobs import JOBS, PREPARED, prepare
from studies.kills.trial import (
    LONGEST,
    Ended,
    Moment,
    cells_of,
    content,
    fresh_copy,
    left_over,
    orphans,
    run,
    state,
)
from studies.show import OUT, table

SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGKILL)
CLOCKS = (("events", False), ("events", True), ("time", False))
COUNTED = ("mixed", "tracebacks", "wrong exits", "orphans", "left over", "hangs")
"""Figures that must be 0."""
FIGURES = ("kills", "nothing", "old", "new", "refused", *COUNTED)


def wrong(ended: Ended, number: int) -> bool:
    """Whether a command that got a signal ended in another way than it should."""
    if number != signal.SIGINT:
        return ended.code not in (-number, 0)
    last = ended.said.strip().rpartition("\n")[2]
    return ended.code not in (0, 130) or (ended.code == 130 and "hydroopt: " not in last)


class Kills:
    """The folder in which commands are killed, with what they give if nobody kills them."""

    def __init__(self, folder: Path, names: list[str]) -> None:
        self.folder, self.cache, self.count = folder, folder / "cache", 0
        self.duration: dict[str, float] = {}
        self.events: dict[tuple[str, bool], int] = {}
        prepare(folder)
        for line in PREPARED:
            self.unkilled(line.split())
        for name in names:
            for fresh, what in ((False, "old"), (True, "new")):
                # into the folder of all trials, which answers name, and from there to one of its own
                ended = self.unkilled([*self.arguments(name, what), "-o", "out"], fresh=fresh)
                (folder / name).mkdir(exist_ok=True)
                (folder / "out").rename(folder / name / what)
                self.duration[name], self.events[name, fresh] = ended.seconds, ended.events
        self.content = {(name, what): content(folder / name / what) for name in names for what in ("old", "new")}

    def arguments(self, name: str, what: str) -> list[str]:
        """Of a command, for one of its two results."""
        return JOBS[name].line.format(what=what, seed=["old", "new"].index(what)).split()

    def unkilled(self, arguments: list[str], *, fresh: bool = False) -> Ended:
        """Run a command to its end."""
        ended = run(arguments, self.folder, "unkilled", Moment("never", 0, fresh=fresh), 0.0, self.cache)
        if ended.code:
            raise SystemExit(f"{' '.join(arguments)} ends with {ended.code}: {ended.said}")
        return ended

    def kill(self, name: str, moment: Moment, rng: np.random.Generator) -> Counter[str]:
        """Kill a command once: what that adds to the figures."""
        self.count += 1
        out = self.folder / "out"
        there = name != "study" and rng.random() < 0.5
        fresh_copy(self.folder / name / "old" if there else None, out)
        cache = self.cache if rng.random() < 0.8 else self.folder / f"cold-{self.count}"
        ended = run([*self.arguments(name, "new"), "-o", "out"], self.folder, f"trial-{self.count}", moment,
                    self.duration[name], cache)
        found: Counter[str] = Counter(kills=1)
        found["orphans"] = orphans(f"trial-{self.count}")
        new = self.content[name, "new"]
        kind = (cells_of(out, new) if name == "study"
                else state(out, JOBS[name], self.content[name, "old"] if there else {}, new))
        found[kind] = 1
        found["left over"] = left_over(out)
        found["tracebacks"] = "Traceback" in ended.said and moment.number == signal.SIGINT
        found["wrong exits"] = wrong(ended, moment.number)
        found["hangs"] = ended.seconds > LONGEST
        if any(found[key] for key in COUNTED):
            print(f"kill {self.count}: {name}, {moment}, {'old' if there else 'nothing'} before: "
                  f"{dict(found)}, exit {ended.code}, {ended.seconds:.1f} s\n{ended.said[-3000:]}", flush=True)
            print(sorted(content(out).items() ^ new.items()) if out.exists() else "no folder", flush=True)
        if kind == "old" and name == "study" and self.count % 3 == 0:
            self.unkilled([*self.arguments(name, "new"), "-o", "out"])
            found["mixed"] += content(out) != new
        return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("kills", nargs="?", type=int, default=500)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--jobs", default=",".join(JOBS))
    parser.add_argument("-o", "--output", type=Path, default=OUT.parent / "kills.json")
    options = parser.parse_args()
    names = options.jobs.split(",")
    for name in COMMANDS:  # so that the processes that are forked need not
        import_module(f"hydroopt.cli.{name.replace('-', '_')}")
    for module in ("hydroopt.solving", "hydroopt.codegen.folder", "hydroopt.report.page", "hydroopt.report.study",
                   "hydroopt.estimation.dynamic.session_comparison", "hydroopt.control.comparison"):
        import_module(module)
    rng = np.random.default_rng(options.seed)
    figures = {(name, number): Counter[str]() for name in names for number in SIGNALS}
    with tempfile.TemporaryDirectory(prefix="kills-") as place:
        kills = Kills(Path(place), names)
        for k in range(options.kills):
            name, number = names[k % len(names)], SIGNALS[k // len(names) % len(SIGNALS)]
            clock, fresh = CLOCKS[rng.integers(len(CLOCKS))]
            when = float(rng.integers(1, kills.events[name, fresh] + 1)) if clock == "events" else rng.random() * 1.1
            moment = Moment(clock, when, number, bool(number == signal.SIGINT and rng.random() < 0.5), fresh)
            figures[name, number] += kills.kill(name, moment, rng)
            if k % 25 == 24:
                print(f"{k + 1} of {options.kills} kills", flush=True)
    rows = [[name, number.name, *(int(counts[key]) for key in FIGURES)] for (name, number), counts in figures.items()]
    total = sum(figures.values(), Counter[str]())
    table("Commands that were killed", ["command", "signal", *FIGURES],
          [*rows, ["all", "", *(int(total[key]) for key in FIGURES)]])
    results = {"seed": options.seed, "total": {key: int(total[key]) for key in FIGURES},
               "commands": {f"{name} {number.name}": {key: int(counts[key]) for key in FIGURES}
                            for (name, number), counts in figures.items()}}
    options.output.parent.mkdir(parents=True, exist_ok=True)
    options.output.write_text(json.dumps(results, indent=1) + "\n", encoding="utf-8")
    raise SystemExit(1 if any(total[key] for key in COUNTED) else 0)


if __name__ == "__main__":
    main()
