"""Real machines: status, and whether claims of force hold on what was left out."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from hydroopt import Log, Machine, identification_problem, load_machine, read_log, solve
from hydroopt.errors import HydrooptError
from studies import show
from studies.panda_gaz2019 import run as panda
from studies.patu_lift import run as patu
from studies.ur10e_mamedov import run as ur10e

KR300 = Path(__file__).parents[2] / "data" / "kr300"
SLICES = 3
"""Parts of one run of the Panda."""


def logs() -> Iterator[tuple[str, Machine, list[Log]]]:
    """Machines, each with logs that are to tell each other; those whose data are at hand."""
    run = read_log(KR300 / "run_A.mat", mapping=KR300 / "map.toml")
    yield "kr300 run A, halves", load_machine("kr300"), list(run.split(0.5))
    if ur10e.DATA.exists():
        yield "ur10e, three days", load_machine("ur10e"), [
            ur10e.log(*which) for which in (ur10e.LEARNT, ur10e.UNSEEN, ur10e.UNLOADED)]
    if panda.DATA.exists():
        whole, _ = panda.recordings()
        edges = np.linspace(0, whole.size, SLICES + 1).astype(int)
        yield "panda, thirds of a run", load_machine("panda"), [
            whole.slice(int(a), int(b)) for a, b in itertools.pairwise(edges)]
    if patu.DATA.exists():
        lift = read_log(patu.DATA, mapping=patu.HERE / "map.toml")
        yield "patu lift, halves", load_machine("patu655_lift"), list(lift.split(0.5))


def judged(machine: Machine, train: Log, others: list[Log]) -> dict[str, Any]:
    """Status of one log's answer, and of each other log the errors of forces over their bounds.

    Samples of the others count in the region of the log: where all angles and speeds are within its range.
    """
    try:
        problem = identification_problem(machine, [train])
        estimate = solve(problem, seed=1)
    except HydrooptError as error:
        return {"status": "refused", "cause": str(error), "ratios": [], "everywhere": []}
    bounds = {each.of: each.bound for each in estimate.verdict.claims
              if str(each.purpose) == "force" and str(each.about) == "reading" and each.bound is not None}
    own = problem.experiments[0].motion
    limits = [(getattr(own, key)[own.interior].min(axis=0), getattr(own, key)[own.interior].max(axis=0))
              for key in ("q", "qd")]
    ratios, everywhere = [], []
    for other in others:
        data, = identification_problem(machine, [other]).experiments
        off = data.force - estimate.predict(data)
        inside = np.all([(state >= low) & (state <= high) for state, (low, high) in zip(
            (data.motion.q, data.motion.qd), limits, strict=True)], axis=(0, 2))
        for k, balance in enumerate(machine.balances):
            used = data.inside & data.known[:, k]
            for found, rows in ((ratios, used & inside), (everywhere, used)):
                if balance.name in bounds and rows.sum() > 0.1 * used.sum():
                    found.append(float(np.sqrt(np.mean(off[rows, k] ** 2)) / bounds[balance.name]))
    return {"status": str(estimate.status), "cause": estimate.verdict.cause, "ratios": ratios,
            "everywhere": everywhere}


def run(*wanted: str) -> dict[str, Any]:
    """By set (all, or those whose names begin so): how many answers are ok, and how many claims hold in their region
    and everywhere."""
    results, lines = {}, []
    for name, machine, recorded in logs():
        if wanted and not name.startswith(wanted):
            continue
        rows = [judged(machine, log, [other for other in recorded if other is not log]) for log in recorded]
        for row, log in zip(rows, recorded, strict=True):
            part = [sum(np.array(row[of]) <= 1) for of in ("ratios", "everywhere")]
            lines.append((name, log.name, row["status"], row["cause"][:120], f"{part[0]} of {len(row['ratios'])}",
                          f"{part[1]} of {len(row['everywhere'])}",
                          float(np.median(row["everywhere"])) if row["everywhere"] else None))
        everywhere = [ratio for row in rows for ratio in row["everywhere"]]
        within = [ratio for row in rows for ratio in row["ratios"]]
        results |= {f"{name}: ok": sum(row["status"] == "ok" for row in rows),
                    f"{name}: claims that hold in their region": _share(within),
                    f"{name}: claims that hold everywhere": _share(everywhere),
                    f"{name}: actual over claimed": round(float(np.median(everywhere)), 3) if everywhere else None}
    show.table("Real logs, each judged on those left out", (
        "set", "log", "status", "cause", "hold in the region", "hold everywhere", "actual/claimed"), lines)
    return results


def _share(ratios: list[float]) -> float | None:
    return round(float(np.mean(np.array(ratios) <= 1)), 3) if ratios else None
