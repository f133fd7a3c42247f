"""How often a fault is named by its cause, how often a sound log raises an alarm, and whether intervals hold."""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Iterable, Sequence
from functools import cache

import numpy as np

from hydroopt import Estimate, Log, Model, identification_problem, load_machine, solve
from hydroopt.errors import HydrooptError
from hydroopt.estimation.dynamic.misfit.naming import Misfit
from hydroopt.spatial.inertia import Array
from studies.faults.injected import Kind as Fault
from studies.faults.injected import listed, outside, truth
from studies.show import OUT

MACHINES, FRESH = ("cat215b", "patu655_lift", "ur10"), 9000
SOUND = "sound"
OTHERS = ("kr300", "wheel_loader", "scissor_lift")
"""Machines of which sound logs alone are judged, one of them without noise in its torques."""
CELLS = OUT / "faults" / "cells.jsonl"
"""One line a cell, written as it comes."""


def cell(model: Model, kind: str, seed: int, *, intervals: bool = False) -> dict:
    """What identification says of one log."""
    faults, others, real = listed(model), outside(model), truth(model, seed)
    fault = faults.get(kind)
    log = fault.make(real) if fault else others[kind](real) if kind in others else real.log()
    began = time.process_time()
    made = {"machine": model.machine.name, "kind": kind, "seed": seed, "list": "in" if fault else "out" if
            kind in others else SOUND, "right": sorted(fault.right) if fault else []}
    try:
        problem = identification_problem(model, [log])
        estimate = solve(problem, intervals=intervals, seed=1)
        made |= {"status": str(estimate.status), "said": _said(estimate), "error": ""}
        if estimate.misfit:
            made["left"] = max(ratio for ratio, _ in estimate.misfit.excess.values())
        if fault:
            made["tellable"] = bool(not fault.fault or fault.si(real) > _smallest(model, seed, fault))
        if intervals:
            unseen = truth(model, seed + 100_000, real.psi, noise=False)
            other = fault.make(unseen) if fault else others[kind](unseen) if kind in others else unseen.log()
            psi = fault.changed(real).psi if fault else real.psi
            made |= _judged(estimate, psi, other, "")
            if fault and fault.fault and not fault.fault.startswith("bodies"):  # these are parameters
                made |= _judged(solve(problem.free(fault.fault), seed=1), psi, other, "freed ")
    except HydrooptError as error:
        made |= {"status": "failed", "said": [], "error": str(error)}
    return made | {"cpu_s": round(time.process_time() - began, 2)}


def _said(estimate: Estimate) -> list[list]:
    """Contradictions, spikes and lines: kind, name of the fault, and names of those that are tied with it."""
    marks = {"spikes": "spikes", "line in the spectrum": "line"}
    return [[d.kind, marks.get(d.kind, d.evidence.get("fault", "")), d.evidence.get("tied", [])]
            for d in estimate.diagnostics if d.contradicts or d.kind in marks]


@cache
def _sound_misfit(model: Model, seed: int) -> Misfit | None:
    return solve(identification_problem(model, [truth(model, seed).log()]), intervals=False).misfit


def _smallest(model: Model, seed: int, fault: Fault) -> float:
    """The size that the sound log of the same motion says it would have shown with a probability of 95 %."""
    misfit = _sound_misfit(model, seed)
    return min((size for one, size in misfit.smallest.items() if one.name == fault.fault
                and fault.course in ("", getattr(one, "course", ""))), default=np.inf) if misfit else np.inf


def _judged(estimate: Estimate, psi: Array, unseen: Log, prefix: str) -> dict[str, float]:
    """Coverage of the base parameters' 95 % intervals, and the error of forces of an unseen motion without noise.

    The unseen log has the same fault; of a freed one, the estimate corrects it as it does validation logs. Samples
    count where joints move, so that dry friction is known.
    """
    error = estimate.identifiability.grouping @ (estimate.psi - psi)
    problem = identification_problem(estimate.problem.model, [unseen])
    held_out, = (estimate.freed.corrected(problem) if estimate.freed else problem).experiments
    off = (held_out.force - held_out.predicted(estimate.psi)) / estimate.problem.force_std
    used = held_out.inside[:, None] & held_out.known
    return {f"{prefix}coverage": float(np.mean(np.abs(error) < 1.96 * estimate.base_std)),
            f"{prefix}unseen": float(np.sqrt(np.mean(off[used] ** 2)))}


def misnamed(result: dict) -> bool:
    """Whether an effect outside the list is given a cause; friction of its actuator is one of dry friction."""
    own = "friction " if result["kind"] == "friction of one end" else "none"
    causes = [name for _, name, _ in result["said"] if name and name not in ("spikes", "line")]
    return any(not name.startswith(own) for name in causes)


def named(result: dict) -> tuple[bool, bool]:
    """Whether the right cause is named first, or tied with the first, and whether a wrong one is."""
    names = [[name, *tied] for _, name, tied in result["said"] if name]
    marks, causes = ([n for n in names if (n[0] in ("spikes", "line")) == so] for so in (True, False))
    right = set(result["right"])

    def fits(name: str) -> bool:
        return name in right or name.partition(" ")[0] in right

    if right & {"spikes", "line"}:
        return any(fits(n[0]) for n in marks), bool(causes)
    hit = bool(causes) and any(fits(name) for name in causes[0])
    return hit, bool(causes) and not hit


def summary(results: Sequence[dict]) -> dict:
    """Shares over all cells."""
    faulty, sound, out = ([r for r in results if r["list"] == name] for name in ("in", SOUND, "out"))
    tellable = [r for r in faulty if r.get("tellable")]

    def mean(values: Iterable[float], digits: int = 4) -> float | None:
        some = list(values)
        return round(float(np.mean(some)), digits) if some else None

    def unseen(key: str, chosen: Sequence[dict]) -> float:
        return float(np.sqrt(np.mean([r[key] ** 2 for r in chosen if key in r])))

    ratios = [unseen("freed unseen", [r for r in faulty if r["machine"] == name and r["kind"] == kind])
              / unseen("unseen", [r for r in sound if r["machine"] == name and "unseen" in r])
              for name, kind in dict.fromkeys((r["machine"], r["kind"]) for r in faulty if "freed unseen" in r)
              if any("unseen" in r for r in sound if r["machine"] == name)]
    within = [ratio <= 1.2 for ratio in ratios]
    return {
        "cells": len(results), "kinds of faults": len({r["kind"] for r in faulty}), "faulty": len(faulty),
        "tellable": len(tellable), "right of tellable": mean(named(r)[0] for r in tellable),
        "right of all": mean(named(r)[0] for r in faulty), "wrong": mean(named(r)[1] for r in faulty),
        "silent": mean(r["status"] == "ok" and not named(r)[0] for r in faulty), "sound": len(sound),
        "alarms of sound logs": mean(r["status"] != "ok" for r in sound), "outside": len(out),
        "wrong outside": mean(misnamed(r) for r in out),
        "suspect outside": mean(r["status"] != "ok" for r in out),
        "coverage of sound logs": mean(r["coverage"] for r in sound if "coverage" in r),
        "coverage with the cause freed": mean(r["freed coverage"] for r in faulty if "freed coverage" in r),
        "coverage where nothing is named": mean(r["coverage"] for r in faulty if "coverage" in r
                                                and r["status"] == "ok"),
        "coverage where status is ok": mean(r["coverage"] for r in [*faulty, *out]
                                            if "coverage" in r and r["status"] == "ok"),
        "unseen with the cause freed, of sound": round(float(np.median(ratios)), 3) if ratios else None,
        "kinds within 1.2 times of sound": mean(within)}


def kept() -> dict[tuple[str, str, int], dict]:
    """Cells computed so far."""
    lines = CELLS.read_text().splitlines() if CELLS.is_file() else []
    return {(r["machine"], r["kind"], r["seed"]): r for r in map(json.loads, lines)}


def run() -> dict:
    """One seed of each machine, computed afresh."""
    made = []
    for name in MACHINES:
        model = Model(load_machine(name))
        made += [cell(model, kind, FRESH - 1) for kind in [SOUND, *listed(model), *outside(model)]]
    made += [cell(Model(load_machine(name)), SOUND, FRESH - k) for name in OTHERS for k in (1, 2)]
    return summary(made)


def main() -> None:
    """Compute the cells that are not kept yet, and print the figures of all."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--machines", nargs="+", default=MACHINES)
    parser.add_argument("--seeds", nargs=2, type=int, default=(FRESH, FRESH + 10), help="first, and one after the last")
    parser.add_argument("--intervals", type=int, default=0, help="seeds of which intervals are judged too")
    parser.add_argument("--kinds", nargs="+", help="these only; 'sound' is one of them")
    parser.add_argument("--summary", action="store_true", help="compute nothing")
    given = parser.parse_args()
    found = kept()
    models = {} if given.summary else {name: Model(load_machine(name)) for name in given.machines}
    for seed in range(*given.seeds):
        for name, model in models.items():
            for kind in [SOUND, *listed(model), *outside(model)]:
                if (name, kind, seed) in found or (given.kinds and kind not in given.kinds):
                    continue
                last = cell(model, kind, seed, intervals=seed < given.seeds[0] + given.intervals)
                found[name, kind, seed] = last
                CELLS.parent.mkdir(parents=True, exist_ok=True)
                with CELLS.open("a") as file:
                    file.write(json.dumps(last) + "\n")
    for name, kind in sorted({key[:2] for key in found}):
        some = [r for key, r in found.items() if key[:2] == (name, kind)]
        marks = [named(r) for r in some]
        print(f"{name} | {kind} | {len(some)} | right {sum(hit for hit, _ in marks)} | wrong {sum(x for _, x in marks)}"
              f" | tellable {sum(r.get('tellable', False) for r in some)}"
              f" | suspect {sum(r['status'] != 'ok' for r in some)}")
    print(json.dumps(summary(list(found.values())), indent=1))


if __name__ == "__main__":
    main()
