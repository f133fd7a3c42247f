"""Machines with linkages, telescopes and shared joints: poses planned, simulated on drawn machines, and calibrated."""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from hydroopt import load_machine, solve
from hydroopt.errors import ProblemError
from hydroopt.estimation.kinematic.accuracy import exact_lengths, machine_end
from hydroopt.estimation.kinematic.calibration import Calibration, calibrate
from hydroopt.estimation.kinematic.problem import calibration_problem
from hydroopt.excitation.selection.pose_problem import pose_problem
from hydroopt.machine.links import Note
from hydroopt.machine.machine import Machine
from hydroopt.model.closed_chain import KinematicModel
from hydroopt.results.verdict import Purpose
from hydroopt.simulation.pose_table import SimulatedPoses, simulate_poses
from studies.show import table

MACHINES = ("excavator_bucket", "cat215b_bucket", "wheel_loader", "backhoe", "knuckle_boom_crane", "mini_excavator",
            "forestry_crane")
POSES, RUNS, UNSEEN = 20, 20, 200
WRONG = 2.0
"""How many times as far numbers are off as the file says, in the second half of the study."""


class Outcome(NamedTuple):
    """Of one drawn machine: which intervals hold, squared errors [m²] of tip and lengths at unseen postures before and
    after, part of the postures within the figure of the verdict, whether it is ok and gives a machine."""

    inside: list[bool]
    tip: tuple[float, float]
    length: tuple[float, float]
    within: float
    good: bool
    written: bool


def run() -> dict:
    results: dict = {}
    for title, factor in (("", 1.0), ("_wrong", WRONG)):
        found = {name: list(outcomes(surveyed(name), factor)) for name in MACHINES}
        every = [each for some in found.values() for each in some]
        coverage = {name: float(np.mean(np.concatenate([each.inside for each in some])))
                    for name, some in found.items()}
        table(f"numbers {factor:g} times as far off as stated", (
            "machine", "calibrated", "coverage", "tip before [mm]", "after", "within the figure", "lengths before [mm]",
            "after", "ok", "machine written"),
            [(name, len(some), coverage[name], *root(some, "tip"), float(np.mean([each.within for each in some])),
              *root(some, "length"), sum(each.good for each in some), sum(each.written for each in some))
             for name, some in found.items()])
        results |= {
            f"coverage{title}": round(float(np.mean(np.concatenate([each.inside for each in every]))), 4),
            f"coverage_least{title}": round(min(coverage.values()), 4),
            f"tip_within_figure{title}": round(float(np.mean([each.within for each in every])), 4),
            f"not_ok{title}": sum(not each.good for each in every),
            f"ok_without_machine{title}": sum(each.good and not each.written for each in every),
            f"calibrated{title}": len(every)}
    return results


def surveyed(name: str) -> Machine:
    """The machine; one without a calibrator with a survey of its tip to 3 mm, and links whose lengths are known to
    10 mm."""
    machine = load_machine(name)
    if machine.calibrator:
        return machine
    data = machine.model_dump(exclude={"notes"})
    lengths = [address for address in exact_lengths(KinematicModel(machine)) if address.endswith(".a")]
    tip = {"channels": ("tip.x", "tip.y", "tip.z"), "accuracy": 0.003, "distribution": "gaussian"}
    return Machine.model_validate(data | {
        "calibrator": {"parent": machine.tip}, "tracker": {}, "sensors": (*data["sensors"], tip),
        "notes": dict(machine.notes) | {machine.numbers[each].path: Note(sigma=0.01) for each in lengths}})


def outcomes(machine: Machine, factor: float) -> Iterator[Outcome]:
    """Of machines drawn from the file's confidences times a factor, without those that do not reach the plan."""
    model = KinematicModel(machine)
    plan = solve(pose_problem(machine, POSES, priors=True), candidates=500, seed=1)
    drawn = KinematicModel(machine.model_copy(update={"notes": {
        path: note.model_copy(update={"sigma": factor * note.sigma}) if note.sigma else note
        for path, note in machine.notes.items()}}))
    q = np.random.default_rng(7).uniform(*model.ranges.T, (UNSEEN, len(model.joints)))
    for seed in range(RUNS):
        try:
            made = simulate_poses(drawn, plan.postures, random=True, seed=seed)
        except ProblemError:  # a stage of the plan that this machine cannot close
            continue
        yield outcome(calibrate(calibration_problem(machine, made.poses), seed=seed), made, q)


def outcome(found: Calibration, made: SimulatedPoses, q: np.ndarray) -> Outcome:
    """Errors of a calibration against the truth."""
    model, names = found.problem.model, found.problem.model.parameters.names
    geometry = found.theta[:len(names)], np.array([made.truth[name] for name in names]), model.parameters.nominal
    _, end = machine_end(model)
    tips, lengths = ([model.over(function, each, q)[0][:, :, 0] for each in geometry]
                     for function in (end, model.lengths))
    off = np.linalg.norm(tips[0] - tips[1], axis=1)
    (claim,) = (each for each in found.claims if each.purpose is Purpose.POSITION)
    inside = [row.ci95[0] <= made.truth[row.name] <= row.ci95[1] for row in found.parameters.rows
              if row.name in made.truth and row.identifiability != "none" and row.ci95 and row.ci95[0] is not None]
    return Outcome(inside, (square(tips[2] - tips[1]), square(tips[0] - tips[1])),
                   (square(lengths[2] - lengths[1]) / lengths[0].shape[1],
                    square(lengths[0] - lengths[1]) / lengths[0].shape[1]),
                   float(np.mean(off <= (claim.bound or 0.0))), found.status == "ok",
                   any(name.endswith(".toml") for name in found.files()))


def square(apart: np.ndarray) -> float:
    """Mean over rows of the squared norm, where linkages close."""
    return float(np.nanmean(np.sum(apart**2, axis=1)))


def root(some: list[Outcome], key: str) -> tuple[float, float]:
    """RMS [mm] over machines, before and after."""
    before, after = (1e3 * float(np.sqrt(np.mean([getattr(each, key)[k] for each in some]))) for k in (0, 1))
    return before, after
