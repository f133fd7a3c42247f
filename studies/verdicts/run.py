"""Status against claims that come true: on simulated machines that share no code with hydroopt, and on real ones."""

from __future__ import annotations

import argparse
import json
import warnings
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import binom

from studies.show import OUT, table
from studies.verdicts import real
from studies.verdicts.judge import case, named
from studies.verdicts.kinds import OTHER_FRICTION, SIZES, SOUND, applies
from studies.verdicts.machines import MACHINES

CORES = 2
FIRST = 4000
"""The first seed; those below are for work on the tool."""
SEEDS = 20
MOTIONS, DRAWS = 8, 10
"""Of logs with white noise alone."""
NORMAL = 1.96
"""Half-width of a 95 % interval in standard deviations."""
Row = dict[str, Any]


def cells(machines: Sequence[str], kinds: Sequence[str], seeds: Iterable[int]) -> list[tuple]:
    """Machine, kind, size and seed of all runs, seed by seed."""
    return [(machine, name, size, seed) for seed in seeds for machine in machines for name in kinds
            for size in range(1 if name in SOUND or name == "swap" else 3)
            if name in SOUND or applies(MACHINES[machine], name)]


def white_cells() -> list[tuple]:
    """Logs of 8 motions with 10 draws of noise and of the machine file each."""
    return [("excavator", "white", 0, FIRST + 1000 + 100 * motion + draw, FIRST + 1000 + motion)
            for motion in range(MOTIONS) for draw in range(DRAWS)]


def computed(wanted: Sequence[tuple], keep: Path, *, kept_only: bool = False) -> list[Row]:
    """Rows of cells, by two processes; those that are kept already are not computed again."""
    kept = {tuple(row["cell"]): row for row in map(json.loads, keep.read_text("utf-8").splitlines())
            } if keep.is_file() else {}
    if kept_only:
        return [with_verdict(kept[cell]) for cell in wanted if cell in kept]
    keep.parent.mkdir(parents=True, exist_ok=True)
    missing = [cell for cell in wanted if cell not in kept]
    with ProcessPoolExecutor(CORES, get_context("spawn")) as pool, keep.open("a", encoding="utf-8") as file:
        for cell, row in zip(missing, pool.map(_row, missing), strict=True):
            kept[cell] = row | {"cell": cell}
            file.write(json.dumps(kept[cell]) + "\n")
            file.flush()
    return [with_verdict(kept[cell]) for cell in wanted]


def _row(cell: tuple) -> Row:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return case(*cell)


def with_verdict(row: Row) -> Row:
    """A row with whether its fault is named, and with what its normalised errors say of intervals: as many may lie
    outside as chance puts there in 95 % of runs. Friction counts where it is the model's."""
    row = row | {"named": named(row)}
    if "z" not in row:
        return row
    counted = [value for name, value in row["z"].items()
               if row["kind"] not in OTHER_FRICTION or not name.endswith(("_coulomb", "_viscous"))]
    outside = int(np.sum(np.abs(counted) > NORMAL))
    true = outside <= int(binom.ppf(0.95, len(counted), 0.05))
    return row | {"base": len(counted), "outside": outside, "base_true": true,
                  "true": row["reading_true"] and row["truth_true"] and true}


def share(rows: Sequence[Row], holds: Callable[[Row], bool]) -> float | None:
    """Part of the rows of which something holds."""
    return round(float(np.mean([bool(holds(row)) for row in rows])), 3) if rows else None


def ratios(rows: Sequence[Row], about: str = "reading") -> list[float]:
    """Actual errors over claimed ones, by run and actuator."""
    return [each["actual"] / each["bound"] for row in rows for each in row.get("claims", ()) if each["about"] == about]


def coverage(rows: Sequence[Row]) -> float | None:
    """Part of all base parameters that are within their 95 % intervals."""
    count = sum(row.get("base", 0) for row in rows)
    return round(1 - sum(row.get("outside", 0) for row in rows) / count, 3) if count else None


def summary(rows: Sequence[Row]) -> dict[str, Any]:
    """The figures of all simulated runs but those with white noise alone."""
    answered = [row for row in rows if row["status"] in ("ok", "suspect")]
    ok, suspect = ([row for row in answered if row["status"] == status] for status in ("ok", "suspect"))
    sound = [row for row in rows if not row["fault"]]
    shown = [row for row in rows if row["fault"] and row["visible"] and row["material"]]
    small = [row for row in rows if row["fault"] and not (row["visible"] and row["material"])]
    judged = [row for row in small if "true" in row]
    of_kind = {name: [row for row in rows if row["kind"] == name] for name in SOUND}
    outside = {name: sum(abs(row["z"].get(name, 0.0)) > NORMAL for row in sound if "z" in row)
               for name in {name for row in sound for name in row.get("z", ())}}
    print("Base parameters of sound runs outside their intervals:",
          ", ".join(f"{name} {count}" for name, count in sorted(outside.items(), key=lambda each: -each[1])[:8]))
    return {
        "runs": len(rows), "ok though a claim fails": share(ok, lambda row: not row["true"]),
        "ok though a claim of readings fails": share(ok, lambda row: not row["reading_true"]),
        "ok though a claim of force fails": share(ok, lambda row: not (row["reading_true"] and row["truth_true"])),
        "suspect though all claims hold": share(suspect, lambda row: row["true"]),
        "sound, ok": share(sound, lambda row: row["status"] == "ok"),
        "sound, named": share(sound, lambda row: row["named"] != "none"),
        "sound, named wrongly": share(sound, lambda row: row["named"] == "wrong"),
        "actual over claimed, median, reading": _median(ratios(answered)),
        "actual over claimed, median, truth": _median(ratios(answered, "truth")),
        "claims of readings that hold": _within(ratios(answered)),
        "claims of truth that hold, sound": _within(ratios(sound, "truth")),
        "faults that show and move a claim": len(shown),
        "faults that show: not ok": share(shown, lambda row: row["status"] != "ok"),
        "faults that show: named rightly": share(shown, lambda row: row["named"] == "right"),
        "faults that show: named wrongly": share(shown, lambda row: row["named"] == "wrong"),
        "other faults": len(small), "other faults: ok": share(small, lambda row: row["status"] == "ok"),
        "other faults: claims of readings true": share(judged, lambda row: row["reading_true"]),
        "other faults: claims of truth true": share(judged, lambda row: row["truth_true"]),
        **{f"coverage, {name}": coverage(some) for name, some in of_kind.items() if some}}


def _median(values: Sequence[float]) -> float | None:
    return round(float(np.median(values)), 3) if values else None


def _within(values: Sequence[float]) -> float | None:
    return round(float(np.mean(np.array(values) <= 1)), 3) if values else None


def by_kind(rows: Sequence[Row]) -> None:
    """Print the table: status against claims, by machine, kind and size."""
    lines = []
    order = [*SOUND, *SIZES]
    for key in sorted({(row["machine"], row["kind"], row["size"]) for row in rows}, key=lambda key: (
            key[0], order.index(key[1]), key[2])):
        some = [row for row in rows if (row["machine"], row["kind"], row["size"]) == key]
        said = [row for row in some if row["status"] in ("ok", "suspect")]
        counts = [sum(row["status"] == status and row.get("true", False) is holds for row in said)
                  for status in ("ok", "suspect") for holds in (True, False)]
        names = [sum(row["named"] == name for row in some) for name in ("right", "wrong", "none")]
        held = [f"{sum(row[of] for row in said)}" for of in ("reading_true", "truth_true", "base_true")]
        lines.append((" ".join((key[0], key[1], f"·{key[2] + 1}" if some[0]["fault"] else "")), len(some),
                      f"{counts[0]}/{counts[1]}", f"{counts[2]}/{counts[3]}", len(some) - len(said), "/".join(held),
                      coverage(said), _median(ratios(said)), _median(ratios(said, "truth")), "/".join(map(str, names)),
                      "/".join(str(sum(row.get(of, False) for row in some)) for of in ("visible", "material"))
                      if some[0]["fault"] else ""))
    table("Status against claims that come true", (
        "kind", "runs", "ok: true/not", "suspect: true/not", "refused", "reading/truth/base hold", "coverage",
        "actual/claimed read", "truth", "named right/wrong/none", "shows/material"), lines)


def white(rows: Sequence[Row]) -> dict[str, Any]:
    """Coverage by base parameter, and how many logs are accused."""
    names = dict.fromkeys(name for row in rows for name in row.get("z", ()))
    inside = {name: [abs(row["z"][name]) < NORMAL for row in rows if name in row.get("z", ())] for name in names}
    mean = {name: float(np.mean([row["z"][name] for row in rows if name in row.get("z", ())])) for name in names}
    table("White noise alone", ("base parameter", "logs", "inside its 95 % interval", "mean of the normalised error"),
          [(name, len(inside[name]), float(np.mean(inside[name])), mean[name]) for name in names])
    shares = [float(np.mean(each)) for each in inside.values() if len(each) >= len(rows) / 2]
    return {"white logs": len(rows), "white accused": sum(row["status"] != "ok" for row in rows),
            "white, least coverage of a base parameter": round(min(shares), 3),
            "white, greatest coverage of a base parameter": round(max(shares), 3),
            "white, coverage": coverage(rows)}


def run() -> dict:
    """Four seeds of the excavator and of the arm, and the real logs that are at hand."""
    wanted = cells(("excavator", "arm"), [*SOUND, *SIZES], range(FIRST, FIRST + 4))
    rows = computed(wanted, OUT / "verdicts" / "rows.jsonl")
    by_kind(rows)
    return summary(rows) | real.run()


def main() -> None:
    """Compute what is asked for; rows are kept in a file, from which they are taken the next time."""
    parser = argparse.ArgumentParser(prog="python -m studies.verdicts.run", description=__doc__)
    parser.add_argument("--machine", nargs="+", default=["excavator"], choices=MACHINES)
    parser.add_argument("--kind", nargs="+", default=[*SOUND, *SIZES], choices=[*SOUND, *SIZES])
    parser.add_argument("--seeds", type=int, default=SEEDS, help="how many")
    parser.add_argument("--seed", type=int, help="this one alone, counted from 0; its rows are printed whole")
    parser.add_argument("--kept", action="store_true", help="compute nothing: judge the rows that are kept")
    parser.add_argument("--white", action="store_true", help="80 logs with white noise alone, instead")
    parser.add_argument("--real", nargs="*", metavar="NAME",
                        help="real logs, instead: all, or kr300, ur10e, panda, patu")
    parser.add_argument("--keep", type=Path, default=OUT / "verdicts" / "rows.jsonl", help="file of the rows")
    given = parser.parse_args()
    if given.real is not None:
        print(json.dumps(real.run(*given.real), indent=1))
        return
    if given.white:
        found = white(computed(white_cells(), given.keep, kept_only=given.kept))
    else:
        seeds = range(FIRST, FIRST + given.seeds) if given.seed is None else [FIRST + given.seed]
        rows = computed(cells(given.machine, given.kind, seeds), given.keep, kept_only=given.kept)
        if given.seed is not None:
            print(json.dumps(rows, indent=1))
        by_kind(rows)
        found = summary(rows)
    print(json.dumps(found, indent=1))
    given.keep.with_suffix(".json").write_text(json.dumps(found, indent=1) + "\n", "utf-8")


if __name__ == "__main__":
    main()
