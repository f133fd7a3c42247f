"""The same lift with the tilt linkage in the model: the lift as before, and what the tilt cylinder contradicts."""

from pathlib import Path

import numpy as np

from hydroopt import Log, Model, identification_problem, load_machine, read_log, solve
from hydroopt.estimation.dynamic.regressor_qr import predict
from hydroopt.machine.machine import Machine

MAPPING = Path(__file__).with_name("map_tilt.toml")
SPIKE = slice(2010, 2030)
"""Samples around an artefact of the published plot, from which the angles were recovered."""
BEFORE, MOVING, AFTER = (0.0, 1.6), (3.5, 20.0), (22.5, 27.0)
"""Stretches [s]: at rest at 0.5 deg, lifting, at rest at 48 deg."""
START = 5.224301361479872e5
"""p3 [Pa] with which the published simulation of this log starts, set by hand where 10.15e5 was measured
(true_hydraulics_PATU.m of qkhadim22/DeepMechDyn); its p4 is as measured."""
ONE_PIN = {"tilt_cylinder.rod.x": 0.454219671, "tilt_cylinder.rod.y": 0.0}
"""Where the tilt cylinder would act if it shared the pin of both bars [m]."""


def with_tilt(data: Path) -> dict:
    """Residuals of the lift, lengths against angles, and forces at rest against the sheet's bodies."""
    machine, log = load_machine("patu655"), read_log(data, mapping=MAPPING)
    parts = [log.slice(0, SPIKE.start), log.slice(SPIKE.stop, log.size)]
    problem = identification_problem(machine, parts)
    error, whole = [], []
    for experiment in problem.experiments:
        nominal, inside = predict(problem.model, experiment, problem.parameters.nominal), experiment.inside
        error.append((experiment.force - nominal)[inside][:, 0])
        whole.append(experiment.force[inside][:, 0])
    ratio = np.linalg.norm(np.concatenate(error)) / np.linalg.norm(np.concatenate(whole))
    estimate = solve(problem)
    friction = problem.parameters.index("tilt_cylinder.f_coulomb")
    return {"with_tilt_nominal_residual_of_lift": round(float(ratio), 4),
            "with_tilt_fit_residual_of_lift": round(estimate.fit["train"]["lift_cylinder"].relative, 4),
            "with_tilt_friction_of_tilt_N": round(float(estimate.psi[friction]), -1),
            "tilt_length_error_mm": round(length_error(machine, log), 1),
            "tilt_length_error_one_pin_mm": round(
                length_error(machine.with_values(ONE_PIN), log), 1), **at_rest(machine, log)}


def length_error(machine: Machine, log: Log) -> float:
    """Median measured minus computed length [mm] of the tilt cylinder."""
    model, q = Model(machine), np.column_stack([log.channel("lift.q"), log.channel("tilt.q")])
    lengths = model.over(model.cylinder_kinematics, q, 0 * q, 0 * q)[0][:, 1, 0]
    return 1e3 * float(np.median(log.channel("tilt_cylinder.length") - lengths))


def at_rest(machine: Machine, log: Log) -> dict:
    """Measured forces against the weight of the sheet's bodies, and what would explain those of the tilt cylinder."""
    model, areas = Model(machine), [cylinder.areas for cylinder in machine.cylinders]
    measured = np.column_stack([
        head * log.channel(f"{cylinder.name}.p_head") - rod * log.channel(f"{cylinder.name}.p_rod")
        for cylinder, (head, rod) in zip(machine.cylinders, areas, strict=True)])
    q = np.column_stack([log.channel("lift.q"), np.full(log.size, np.median(log.channel("tilt.q")))])
    bodies = np.where([".f_" in name for name in model.parameters.names], 0.0, model.parameters.nominal)
    weight = forces(model, q, bodies)
    during = {name: (log.t >= first) & (log.t <= last) & ~in_spike(log)
              for name, (first, last) in (("before", BEFORE), ("moving", MOVING), ("after", AFTER))}
    found: dict[str, float] = {}
    for name, rows in during.items():
        for k, cylinder in enumerate(("lift", "tilt")):
            found[f"{cylinder}_force_over_weight_{name}"] = round(float(np.mean((measured / weight)[rows, k])), 3)
    before, moving, after = (float(np.mean((measured - weight)[rows, 0])) for rows in during.values())
    found["lift_friction_N"] = round(moving - (before + after) / 2, -2)
    for name in ("before", "after"):
        found[f"tilt_force_missing_{name}_N"] = round(float(np.mean((measured - weight)[during[name], 1])), -1)
    # if the tilt's bodies weighed about its pivot only what its cylinder carries, the lift would carry less, too
    lighter = bodies.copy()
    for owner in ("tilt", "extension", "payload"):
        for moment in ("mc_x", "mc_y"):
            lighter[model.parameters.index(f"{owner}.{moment}")] *= found["tilt_force_over_weight_before"]
    for name in ("before", "after"):
        rows = during[name]
        found[f"lift_force_over_lighter_weight_{name}"] = round(
            float(np.mean(measured[rows, 0] / forces(model, q, lighter)[rows, 0])), 3)
    head, rod = areas[1]
    found["tilt_force_of_published_start_over_weight"] = round(
        float((head * START - rod * log.channel("tilt_cylinder.p_rod")[0]) / weight[0, 1]), 3)
    return found


def forces(model: Model, q: np.ndarray, psi: np.ndarray) -> np.ndarray:
    """Actuator forces (N, n) that hold the machine."""
    (held,) = model.over(model.inverse_dynamics, q, 0 * q, 0 * q, np.tile(psi, (len(q), 1)))
    return held[:, :, 0]


def in_spike(log: Log) -> np.ndarray:
    rows = np.zeros(log.size, bool)
    rows[SPIKE] = True
    return rows
