"""Pins and lengths of an excavator with bucket linkage from 40 planned poses: errors against the Cramér-Rao bound."""

import numpy as np

from hydroopt import load_machine, solve
from hydroopt.estimation.kinematic.calibration import calibrate
from hydroopt.estimation.kinematic.problem import calibration_problem
from hydroopt.excitation.selection.pose_problem import pose_problem
from hydroopt.machine.links import Note
from hydroopt.machine.machine import Machine
from hydroopt.model.closed_chain import KinematicModel
from hydroopt.simulation import postures
from studies.pin_sheet.excavator import jacobians, observed

POSES, RUNS, UNSEEN = 40, 40, 200
SHEET = 0.01
"""σ [m] of each number of the pin sheet."""
WRONG = 2.0
"""How many times as far pins are off as the sheet says, in the second half of the study."""
LENGTHS = tuple(f"{name}_cylinder.length" for name in ("boom", "stick", "bucket"))
ANGLES = tuple(f"{name}.q" for name in ("swing", "boom", "stick", "bucket"))
TIP = ("tip.x", "tip.y", "tip.z")


def survey() -> Machine:
    """The excavator with string potentiometers of ±2 mm, resolvers of ±0.1°, and a survey of its edge to 3 mm."""
    machine = load_machine("excavator_bucket")
    data = machine.model_dump(exclude={"notes"})
    tip = {"channels": TIP, "accuracy": 0.003, "distribution": "gaussian"}
    paths = [*(f"{link}.joint.a" for link in ("boom", "stick", "bucket", "rocker", "coupler")), "rocker.pin",
             "bucket_linkage.to.pin", *(f"{cylinder}_cylinder.{part}" for cylinder in ("boom", "stick", "bucket")
                                        for part in ("rod.pin", "dead_length")),
             "stick_cylinder.barrel.pin", "bucket_cylinder.barrel.pin"]
    return Machine.model_validate(data | {
        "calibrator": {"parent": "bucket"}, "tracker": {}, "sensors": (*data["sensors"], tip),
        "notes": {path: note for path, note in machine.notes.items() if path != "boom_cylinder.barrel.pin"}
        | dict.fromkeys(paths, Note(sigma=SHEET))})


def run() -> dict:
    machine = survey()
    model = KinematicModel(machine)
    names, nominal = model.parameters.names, model.parameters.nominal
    numbers = {name: float(value) for name, value in zip(names, nominal, strict=True)}
    plan = solve(pose_problem(machine, POSES, priors=True))
    q, planned = plan.q, dict(zip(plan.names, plan.std, strict=True))
    unseen = np.random.default_rng(5).uniform(*model.ranges.T, (UNSEEN, 4))
    lengths = model.over(model.lengths, nominal, unseen)[0][:, :, 0]
    tips = model.over(model.tip, nominal, unseen)[0][:, :, 0]
    apart = float(np.max(np.abs(observed(dict(numbers), unseen) - np.hstack([lengths, tips]))))
    sigma = {name: machine.sensor(name).std for name in (*ANGLES, *LENGTHS, *TIP)}
    data = information(numbers, q, sigma)
    prior = np.eye(len(names)) / SHEET**2
    bound = np.linalg.inv(data + prior)
    at, _ = jacobians(numbers, unseen)
    results: dict = {"poses": len(q), "numbers_of_the_sheet": len(names), "own_positions_apart_m": apart,
                     "planned_std_off_bound": max(abs(planned[name] / std - 1) for name, std in zip(
                         names, np.sqrt(np.diag(bound)), strict=True))}
    for case, factor in (("", 1.0), ("_priors_wrong", WRONG)):
        # the mean square error of the estimate that believes the sheet where it is off by `factor` times as much
        expected = bound @ (data + factor**2 * prior) @ bound
        errors = [error(machine, model, q, unseen, factor, seed) for seed in range(RUNS)]
        for place, rows, key in (("tip", slice(3, 6), 0), ("bucket_length", slice(2, 3), 1)):
            limit = np.sqrt(np.mean(np.einsum("kip,pr,kir->k", at[:, rows], expected, at[:, rows])))
            found = np.array([each[key] for each in errors])
            rms = float(np.sqrt(np.mean(found**2)))
            results |= {f"{place}_mm{case}": round(1e3 * rms, 3),
                        f"{place}_worst_run_mm{case}": round(1e3 * float(found.max()), 2),
                        f"{place}_bound_mm{case}": round(1e3 * float(limit), 3),
                        f"{place}_over_bound{case}": round(rms / float(limit), 3)}
        before = float(np.sqrt(np.mean([each[2] ** 2 for each in errors])))
        results[f"tip_before_mm{case}"] = round(1e3 * before, 1)
        results[f"suspect{case}"] = sum(each[3] for each in errors)
    return results


def information(numbers: dict[str, float], q: np.ndarray, sigma: dict[str, float]) -> np.ndarray:
    """Of the sheet's numbers (p, p) from the poses, whose true angles are unknown."""
    by_numbers, by_joints = jacobians(numbers, q)
    weights = np.array([1 / sigma[name] ** 2 for name in (*ANGLES, *LENGTHS, *TIP)])
    whole = np.zeros((len(numbers),) * 2)
    for of_numbers, of_joints in zip(by_numbers, by_joints, strict=True):
        g = np.vstack([np.zeros((4, len(numbers))), of_numbers])
        h = np.vstack([np.eye(4), of_joints])
        crossed = g.T @ (weights[:, None] * h)
        whole += g.T @ (weights[:, None] * g) - crossed @ np.linalg.solve(h.T @ (weights[:, None] * h), crossed.T)
    return whole


def error(machine: Machine, model: KinematicModel, q: np.ndarray, unseen: np.ndarray, factor: float,
          seed: int) -> tuple[float, float, float, bool]:
    """RMS errors [m] at unseen postures of tip and bucket cylinder, and of the tip before; whether it is suspect."""
    nominal, none = model.parameters.nominal, [""] * len(q)
    truth = nominal + factor * SHEET * np.random.default_rng(100 + seed).standard_normal(len(nominal))
    poses = postures.record(model, q, none, none, geometry=truth, channels=(*ANGLES, *TIP, *LENGTHS), seed=seed)
    found = calibrate(calibration_problem(machine, poses))

    def apart(of: np.ndarray) -> tuple[float, float]:
        tip, length = ([model.over(function, g, unseen)[0][:, :, 0] for g in (of, truth)]
                       for function in (model.tip, model.lengths))
        return (float(np.sqrt(np.mean(np.sum((tip[0] - tip[1]) ** 2, axis=1)))),
                float(np.sqrt(np.mean((length[0] - length[1])[:, 2] ** 2))))

    return (*apart(found.theta[:len(truth)]), apart(nominal)[0], found.status != "ok")
