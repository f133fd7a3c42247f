"""How often a fault is named by its cause, and how often a sound log raises an alarm."""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import time
from pathlib import Path

import numpy as np

from hydroopt import Model, identification_problem, load_machine, solve
from hydroopt.errors import HydrooptError
from hydroopt.results.wording import CONTRADICTIONS, Kind
from studies.faults.injected import listed, outside, truth

MACHINES, QUICK = ("cat215b", "patu655_lift", "ur10"), (1000,)
SOUND = "sound"


def folder() -> Path:
    """Where cells are kept."""
    return Path(os.environ.get("HYDROOPT_FAULTS", "faults-cells"))


def cell(model: Model, kind: str, seed: int) -> dict:
    """What identification says of one log; from the folder if it is there."""
    digest = hashlib.sha256(f"{model.machine.name} {kind} {seed}".encode()).hexdigest()[:16]
    file = folder() / f"{digest}.json"
    if file.is_file():
        return json.loads(file.read_text())
    faults, others = listed(model), outside(model)
    real = truth(model, seed)
    log = real.log() if kind == SOUND else faults[kind][1](real) if kind in faults else others[kind](real)
    began = time.process_time()
    result = {"machine": model.machine.name, "kind": kind, "seed": seed, "right": sorted(faults[kind][0])
              if kind in faults else [], "list": "sound" if kind == SOUND else "in" if kind in faults else "out"}
    try:
        estimate = solve(identification_problem(model, [log]), seed=1)
        found = [d for d in estimate.diagnostics if d.kind in {*CONTRADICTIONS, Kind.SPIKES, Kind.LINE}]
        groups = {Kind.SPIKES: "spikes", Kind.LINE: "line"}
        std, error = estimate.base_std, estimate.identifiability.grouping @ (estimate.psi - real.psi)
        result |= {"status": str(estimate.status),
                   "said": [[str(d.kind), groups.get(d.kind, d.evidence.get("group", "")), list(d.subject),
                             [name.split()[0] for name in d.evidence.get("tied", ())]] for d in found],
                   "base_coverage": float(np.mean(np.abs(error) < 1.96 * std)), "error": ""}
    except HydrooptError as error:
        result |= {"status": "failed", "said": [], "base_coverage": float("nan"), "error": str(error)}
    result["cpu_s"] = time.process_time() - began
    file.parent.mkdir(parents=True, exist_ok=True)
    partial = file.with_suffix(".part")
    partial.write_text(json.dumps(result))
    partial.rename(file)
    return result


def named(result: dict) -> tuple[bool, bool]:
    """Whether the right cause is named (first or tied with it), and whether a wrong one is."""
    causes = [each for each in result["said"] if each[1] and each[1] not in ("spikes", "line")]
    marks = {each[1] for each in result["said"] if each[1] in ("spikes", "line")}
    right = set(result["right"])
    if right & {"spikes", "line"}:
        return bool(right & marks), bool(causes)
    hit = bool(causes) and bool(right & {causes[0][1], *causes[0][3]})
    return hit, bool(causes) and not hit


def summary(results: list[dict]) -> dict:
    """Shares over all cells."""
    faulty, sound, out = ([r for r in results if r["list"] == name] for name in ("in", "sound", "out"))

    def share(values: list[bool]) -> float | None:
        return round(float(np.mean(values)), 4) if values else None

    return {"cells": len(results), "faulty": len(faulty), "right": share([named(r)[0] for r in faulty]),
            "wrong": share([named(r)[1] for r in faulty]), "sound": len(sound),
            "alarms of sound logs": share([r["status"] != "ok" for r in sound]), "outside": len(out),
            "wrong outside": share([bool([e for e in r["said"] if e[0] == str(Kind.MISFIT_CAUSE)]) for r in out]),
            "suspect outside": share([r["status"] != "ok" for r in out])}


def run() -> dict:
    """The quick part: all kinds of the CAT 215B, a few seeds."""
    model = Model(load_machine("cat215b"))
    kinds = [SOUND, *listed(model), *outside(model)]
    return summary([cell(model, kind, seed) for seed in QUICK for kind in kinds])


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("--machines", nargs="+", default=MACHINES)
    parser.add_argument("--seeds", nargs=2, type=int, default=(1000, 1010))
    parser.add_argument("--sound", action="store_true", help="sound logs only")
    given = parser.parse_args()
    computed = []
    for name in given.machines:
        model = Model(load_machine(name))
        for seed in range(*given.seeds):
            for kind in [SOUND] if given.sound else [SOUND, *listed(model), *outside(model)]:
                computed.append(cell(model, kind, seed))
                last = computed[-1]
                print(name, seed, kind, last["status"], last["said"], last["error"][:80], round(last["cpu_s"], 1),
                      flush=True)
    print(json.dumps(summary(computed), indent=1))
