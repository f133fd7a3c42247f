"""PATU 655 log crane, twelve holds of 3 s: gravity to the Cramér-Rao bound, whatever friction does at rest."""

from dataclasses import replace

import numpy as np

from hydroopt import Log, Machine, Model, identification_problem, load_machine, random_truth, simulate, solve
from hydroopt.logs.forces_from_pressures import force_noise
from hydroopt.simulation.simulate import Trajectory

HOLDS, SECONDS, RATE, BREAK = 12, 3.0, 50.0, 10.0
"""Holds, duration [s] and sampling rate [Hz] of each, and what is not recorded between two of them [s]."""
LOGS = 200
FRICTION, OFFSET = 1500.0, 4000.0
"""Dry friction [N] just before the joint moves, and error of the force by its pressure readings [N]."""
INERTIAS = ("I_xx", "I_xy", "I_xz", "I_yy", "I_yz", "I_zz")


def run() -> dict:
    """Coverage of base parameters by 95 % intervals, errors over the bound, and largest mean error in deviations."""
    crane = load_machine("patu655_lift")
    results: dict = {}
    for name, machine, at_rest in (
            ("no dry friction", stated(crane), "none"),
            ("no dry friction, offset unknown", stated(crane, offset=True), "none"),
            ("friction unknown, uniform at rest", stated(crane, (210.0, 2000.0), offset=True), "uniform"),
            ("friction unknown, zero at rest", stated(crane, (210.0, 2000.0), offset=True), "none"),
            ("friction unknown, from one side", stated(crane, (210.0, 2000.0), offset=True), "one side"),
            ("friction unknown, from either side", stated(crane, (210.0, 2000.0), offset=True), "either side"),
            ("friction stated twice as large", stated(crane, (2 * FRICTION, 300.0), offset=True), "uniform"),
            ("friction stated half as large", stated(crane, (FRICTION / 2, 75.0), offset=True), "uniform"),
            ("without an offset, from one side", stated(crane, (FRICTION, 150.0)), "one side"),
            ("without an offset, half as large, from one side", stated(crane, (FRICTION / 2, 75.0)), "one side")):
        results |= {f"{name}: {key}": value for key, value in trial(machine, at_rest, LOGS).items()}
    return results | by_default(crane)


def stated(machine: Machine, friction: tuple[float, float] | None = None, *, offset: bool = False) -> Machine:
    """The crane whose file states this dry friction and its confidence [N], or none, and perhaps an offset."""
    cylinder = machine.cylinders[0]
    changed = cylinder.friction.model_copy(update={"coulomb": friction and friction[0],
                                                   "offset": 0.0 if offset else None})
    notes = dict(machine.notes)
    path = f"{cylinder.name}.friction.coulomb"
    note = notes.pop(path)
    if friction is not None:
        notes[path] = note.model_copy(update={"sigma": friction[1]})
    return machine.model_copy(update={
        "cylinders": (cylinder.model_copy(update={"friction": changed}),), "notes": notes})


def holds(model: Model) -> Trajectory:
    """The joint at rest in postures spread evenly over nine tenths of its range."""
    lower, upper = model.machine.link(model.machine.joints[0]).joint.range
    count = round(SECONDS * RATE)
    t = np.concatenate([k * (SECONDS + BREAK) + np.arange(count) / RATE for k in range(HOLDS)])
    share = 0.05 + 0.9 * np.arange(HOLDS) / (HOLDS - 1)
    q = np.repeat(lower + share * (upper - lower), count)[:, None]
    return Trajectory(t, q, 0 * q, 0 * q)


def recorded(model: Model, psi: np.ndarray, at_rest: str, seed: int) -> Log:
    """A log of the holds with parameters ψ (p,), whose dry friction at rest is as named."""
    log, rng = simulate(model, holds(model), psi, seed=seed), np.random.default_rng(seed)
    friction = {"none": np.zeros(HOLDS), "uniform": rng.uniform(-FRICTION, FRICTION, HOLDS),
                "one side": np.full(HOLDS, FRICTION), "either side": rng.choice([-FRICTION, FRICTION], HOLDS)}[at_rest]
    cylinder = model.machine.cylinders[0]
    channel, area = cylinder.chambers[0], cylinder.areas[0]
    pressure = log.channel(channel) + np.repeat(friction, log.size // HOLDS) / area
    return replace(log, channels=dict(log.channels) | {channel: pressure})


def trial(machine: Machine, at_rest: str, logs: int) -> dict:
    """Least squares without priors on bodies: coverage, RMS error over the bound, and bias in standard deviations."""
    model = Model(machine)
    names, offset = model.parameters.names, "lift_cylinder.f_offset"
    errors, deviations, excited = [], [], 0
    for seed in range(logs):
        truth = random_truth(model, seed)
        truth[[k for k, name in enumerate(names) if name.endswith("f_coulomb")]] = 0.0  # it is added to the log
        if offset in names:
            truth[names.index(offset)] = OFFSET
        problem = identification_problem(model, [recorded(model, truth, at_rest, seed)])
        estimate = solve(problem.by_data_alone(), "wls")
        found = estimate.identifiability
        gravity = [i for i, k in enumerate(found.basis) if names[k] != offset]
        errors.append((estimate.base_value - found.grouping @ truth)[gravity])
        deviations.append(estimate.base_std[gravity])
        excited += sum(found.category[k] != "none" for k, name in enumerate(names) if name.endswith(INERTIAS))
    error, deviation = np.array(errors), np.array(deviations)
    ratio = np.sqrt(np.mean(error**2, axis=0)) / bound(model, found.basis, at_rest, offset)[:error.shape[1]]
    scaled = error / deviation
    return {"coverage": round(float(np.mean(np.abs(scaled) < 1.959964)), 4),
            "error over bound": round(float(np.max(ratio)), 3),
            "mean error": round(float(np.max(np.abs(np.mean(scaled, axis=0)))), 3),
            "stated deviation over bound": round(float(np.median(
                deviation / bound(model, found.basis, at_rest, offset)[:error.shape[1]])), 3),
            "inertias taken for identified": excited}


def bound(model: Model, basis: tuple[int, ...], at_rest: str, offset: str) -> np.ndarray:
    """Cramér-Rao bound of the base parameters' deviations, the offset last, at the true postures.

    The means of the holds have the noise of their samples and a friction of the variance that it has from hold to hold.
    """
    motion = holds(model)
    each = slice(None, None, motion.q.shape[0] // HOLDS)
    K = model.over(model.regressor, motion.q[each], motion.qd[each], motion.qdd[each])[0][:, 0]
    names = model.parameters.names
    columns = [k for k in basis if names[k] != offset] + [k for k in basis if names[k] == offset]
    noise = force_noise(model, recorded(model, model.parameters.nominal, "none", 0))[0]
    between = {"none": 0.0, "one side": 0.0, "uniform": FRICTION**2 / 3, "either side": FRICTION**2}[at_rest]
    variance = noise**2 / (SECONDS * RATE) + between
    return np.sqrt(variance * np.diag(np.linalg.inv(K[:, columns].T @ K[:, columns])))


def by_default(crane: Machine) -> dict:
    """The default method with priors, no dry friction: coverage of all parameters, and inertias given as estimates."""
    model = Model(stated(crane))
    inside, given = [], 0
    for seed in range(LOGS // 4):
        truth = random_truth(model, seed)
        estimate = solve(identification_problem(model, [recorded(model, truth, "none", seed)]), seed=seed)
        for row, value in zip(estimate.parameters.rows, truth, strict=True):
            if row.ci95 is not None:
                inside.append(row.ci95[0] <= value <= row.ci95[1])
                given += row.name.endswith(INERTIAS)
    return {"default method: coverage": round(float(np.mean(inside)), 4),
            "default method: inertias with an interval": given}
