"""CAT 215B, thesis's sensors, a designed motion, 500 machines: intervals that hold, and forces of other motions."""

import tempfile

import numpy as np

from hydroopt import (
    Model,
    excitation_problem,
    identification_problem,
    load_machine,
    random_truth,
    simulate,
    solve,
)
from hydroopt.excitation.motion.basis import Fourier
from hydroopt.machine.machine import Machine
from hydroopt.results.diagnostic import of_kind
from hydroopt.simulation.simulate import Trajectory
from hydroopt.study.montecarlo import montecarlo
from hydroopt.study.run import run as computed

CELLS, STARTS = 500, 4
SURPRISING, WIDER = 60, 2.0
"""Machines that differ from their file by so many times as much as it states."""


def run() -> dict:
    """Share of true parameters inside their intervals, over truths drawn from the machine file's confidences."""
    machine = load_machine("cat215b")
    motion = solve(excitation_problem(machine, Fourier(29.0, 10)), starts=STARTS, processes=2).trajectory
    study = montecarlo(machine, cells=CELLS, motion=motion)
    with tempfile.TemporaryDirectory() as folder:
        table = computed(study, folder, workers=2)
    names = [key.removesuffix(".inside") for key in table.results[0] if key.endswith(".inside")]
    links = {name for name in names if name.endswith(" in all")}
    inside = {name: table.column(f"{name}.inside") for name in names}
    held = {name: float(np.mean(values)) for name, values in inside.items() if np.all(np.isfinite(values))}
    alone = {name: share for name, share in held.items() if name not in links}
    below = [np.mean(table.column(f"{name}.truth") < table.column(f"{name}.value")) for name in alone]
    results = {"machines": len(table.results), "intervals_per_machine": len(alone),
               "pooled_coverage": round(float(np.mean(list(alone.values()))), 4),
               "lowest_coverage": round(min(alone.values()), 3),
               "lowest_coverage_of": min(alone, key=alone.__getitem__),
               "truth_below_value": round(float(np.mean(below)), 4)}
    for name in ("boom.m", "stick.m", "boom in all", "stick in all"):
        error = table.column(f"{name}.value") - table.column(f"{name}.truth")
        results |= {f"coverage of the mass of {name.removesuffix('.m')}": round(held[name], 4),
                    f"error of the mass of {name.removesuffix('.m')} [kg RMS]": round(float(np.std(error)), 1)}
    for actuator in machine.actuators:
        rms = table.column(f"{actuator.name}.rms")
        results |= {f"unseen_{actuator.name}_median": round(float(np.median(rms)), 4),
                    f"unseen_{actuator.name}_worst_of_20": round(float(np.quantile(rms, 0.95)), 4)}
    return results | with_wrong_priors(machine, motion)


def with_wrong_priors(machine: Machine, motion: Trajectory) -> dict:
    """The same where machines differ from their file twice as much as it states; which of them are called suspect."""
    notes = {name: note.model_copy(update={"sigma": note.sigma and WIDER * note.sigma})
             for name, note in machine.notes.items()}
    model, wider = Model(machine), Model(machine.model_copy(update={"notes": notes}))
    inside, suspect = [], []
    for seed in range(SURPRISING):
        truth = random_truth(wider, seed)
        estimate = solve(identification_problem(machine, [simulate(model, motion, truth, seed=seed)]))
        rows = [(row, value) for row, value in zip(estimate.parameters.rows, truth, strict=True) if row.ci95]
        inside.append(np.mean([row.ci95[0] <= value <= row.ci95[1] for row, value in rows]))
        suspect.append(bool(of_kind(estimate.diagnostics, "priors contradicted", "prior of bodies contradicted")))
    believed = np.array(inside)[~np.array(suspect)]
    return {"wrong_priors_machines": SURPRISING, "wrong_priors_coverage": round(float(np.mean(inside)), 4),
            "wrong_priors_named": round(float(np.mean(suspect)), 4),
            "wrong_priors_coverage_unnamed": round(float(np.mean(believed)), 4) if believed.size else None}
