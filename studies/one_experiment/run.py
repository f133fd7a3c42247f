"""One recording of 33 s with the calibrator attached: geometry and forces together against one after the other."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from hydroopt import (
    KinematicModel,
    Log,
    Machine,
    Model,
    combined_problem,
    identification_problem,
    load_machine,
    random_trajectory,
    random_truth,
    simulate,
    solve,
)
from hydroopt.estimation.combined.log_geometry import ForcesByGeometry, postures
from hydroopt.simulation.postures import close
from hydroopt.simulation.simulate import Trajectory

SEEDS = {"stated": 200, "accurate": 5, "further_off": 10}
DURATION, RATE = 33.28, 50.0
MIDDLE, PART = np.radians([0.0, -22.0, 85.0]), 0.8
"""Posture about which the machine moves while the calibrator is attached, and how far, as a part of its ranges."""
LOCKED = np.radians(42.9)
"""Angle of the grapple's swing, which no sensor reads."""
START = (LOCKED, 0.0, np.radians(40.0), 0.0, np.radians(-100.0))
"""Initial guess of the calibrator's joints."""
CASES = {"stated": (1.0, 1.0), "accurate": (25.0, 1.0), "further_off": (1.0, 2.0)}
"""How many times as accurate as stated pressures are, and how many times as far off as stated the geometry is."""
INSTANTS = 40
"""Samples of the unseen motion at which intervals of forces are looked at."""
WAYS = ("together", "two_steps", "two_steps_fitted")


def run() -> dict:
    """By case and way: errors of geometry and of unseen forces, and how many 95 % intervals hold."""
    results: dict = {}
    for case, (factor, spread) in CASES.items():
        results |= summary(case, [one(seed, factor, spread) for seed in range(SEEDS[case])])
    return results


def summary(case: str, found: list[dict]) -> dict:
    """Figures over all machines."""
    results: dict = {f"machines_{case}": len(found),
                     f"ok_{case}": float(np.mean([each["ok"] for each in found])) if "ok" in found[0] else None}
    for way in WAYS:
        z = np.concatenate([each[f"z_geometry_{way}"] for each in found]) if way != "two_steps_fitted" else np.zeros(0)
        if len(z):
            results[f"geometry_held_{way}_{case}"] = float(np.mean(np.abs(z) < 1.96))
        for what in ("parameters", "forces"):
            results[f"{what}_held_{way}_{case}"] = float(np.mean(np.concatenate([each[f"{what}_held_{way}"]
                                                                                  for each in found])))
        for what in ("unseen", "same_kind"):
            results[f"{what}_forces_{way}_{case}"] = rms([each[f"{what}_{way}"] for each in found])
    for way in WAYS[1:]:
        for what in ("unseen", "same_kind"):
            results[f"{what}_forces_over_{way}_{case}"] = (results[f"{what}_forces_together_{case}"]
                                                           / results[f"{what}_forces_{way}_{case}"])
    for kind in ("length", "angle", "pin"):
        errors = {way: rms([each[f"{kind}_{way}"] for each in found]) for way in WAYS[:2]}
        results[f"{kind}_ratio_{case}"] = errors["together"] / errors["two_steps"]
        results[f"{kind}_rms_{case}"] = errors["together"]
    return results


def rms(values: list) -> float:
    return float(np.sqrt(np.mean(np.concatenate([np.ravel(each) for each in values]) ** 2)))


def one(seed: int, factor: float, spread: float = 1.0) -> dict:
    """A machine drawn within the confidences of its file, its geometry within so many times these, and what is found.
    """
    machine = with_pressures(load_machine("cat215b"), factor)
    chain, nominal = KinematicModel(machine), Model(machine)
    rng = np.random.default_rng((seed, 25))
    parameters = chain.parameters
    g = parameters.nominal + rng.standard_normal(len(parameters)) * spread * parameters.prior_std
    ball = np.array(machine.fixtures[0].position) + 0.1 * spread * rng.standard_normal(3)
    log, psi = record(machine, chain, g, ball, seed)
    truth = dict(zip(parameters.names, g.tolist(), strict=True)) | dict(zip(("ball.x", "ball.y", "ball.z"),
                                                                             ball.tolist(), strict=True))
    together = solve(combined_problem(machine, log))
    kinematics = solve(postures(machine, together.asked.identification.experiments))
    then = {"two_steps": identification_problem(kinematics.machine, log)}
    then["two_steps_fitted"] = then["two_steps"].with_fitted_motion()
    dynamics = {way: solve(problem) for way, problem in then.items()}
    made: dict = {"ok": together.status == "ok"}
    names = kinematics.problem.parameters.names
    at = [names.index(name) for name in truth]
    own = [together.numbers.names.index(name) for name in truth]
    values = np.array([*truth.values()])
    errors = {"together": together.geometry[own] - values, "two_steps": kinematics.theta[at] - values}
    std = {"together": np.sqrt(np.diag(together.covariance))[own], "two_steps": kinematics.std[at]}
    kinds = np.array(["pin" if "_cylinder" in name or "ball" in name else
                      "angle" if name.endswith(("alpha", "beta")) else "length" for name in truth])
    for way in WAYS[:2]:
        known = np.isfinite(std[way])
        made[f"z_geometry_{way}"] = (errors[way][known] / std[way][known]).tolist()
        made |= {f"{kind}_{way}": errors[way][kinds == kind].tolist() for kind in ("length", "angle", "pin")}
    force = ForcesByGeometry(nominal, parameters.names)
    count = len(parameters)
    for what, motion in {"same_kind": attached_motion(nominal, seed + 1000),
                         "unseen": random_trajectory(nominal, duration=DURATION, rate=RATE, seed=seed + 2000)}.items():
        exact, *_ = predicted(force, motion, psi, g)
        for way, estimate in {"together": together, **dynamics}.items():
            geometry = (together.geometry[[together.numbers.names.index(name) for name in parameters.names]]
                        if way == "together" else kinematics.theta[:count])
            value, by_psi, by_g = predicted(force, motion, estimate.psi, geometry)
            made[f"{what}_{way}"] = (np.sqrt(np.mean((value - exact) ** 2, axis=0)) / np.std(exact, axis=0)).tolist()
            if what == "same_kind":
                continue
            some = np.linspace(0, len(value) - 1, INSTANTS).astype(int)
            if way == "together":
                k = [together.numbers.names.index(name) for name in parameters.names]
                every = [*k, *range(len(together.numbers.names), len(together.covariance))]
                rows = np.concatenate([by_g, by_psi], axis=2)[some]
                covariance = together.covariance[np.ix_(every, every)]
            else:
                rows, covariance = by_psi[some], np.cov(estimate.posterior.samples.T)
            spread = np.sqrt(np.einsum("nra,ab,nrb->nr", rows, covariance, rows))
            made[f"forces_held_{way}"] = (np.abs(value - exact)[some] < 1.96 * spread).ravel().tolist()
    for way, estimate in {"together": together, **dynamics}.items():
        known = np.isfinite(estimate.ci95[:, 0])
        held = (estimate.ci95[:, 0] <= psi) & (psi <= estimate.ci95[:, 1])
        made[f"parameters_held_{way}"] = held[known].tolist()
    return made


def predicted(force: ForcesByGeometry, motion: Trajectory, psi: np.ndarray, g: np.ndarray) -> tuple[np.ndarray, ...]:
    """Forces (N, r) of a motion, and their derivatives by ψ (N, r, p) and geometry (N, r, k)."""
    value, _, _, _, by_psi, by_g = force.over(motion.q, motion.qd, motion.qdd, psi, g)
    return value[:, :, 0], by_psi, by_g


def with_pressures(machine: Machine, factor: float) -> Machine:
    """The machine with pressure sensors that are so many times as accurate."""
    data = machine.model_dump()
    for sensor in data["sensors"]:
        if sensor["channels"][0].endswith("p_a"):
            sensor |= {"accuracy": sensor["accuracy"] / factor, "resolution": sensor["resolution"] / factor}
    return Machine.model_validate(data)


def attached_motion(model: Model, seed: int) -> Trajectory:
    """A random motion of all joints that the calibrator can follow."""
    motion = random_trajectory(model, duration=DURATION, rate=RATE, seed=seed)
    middle = model.machine.ranges.mean(axis=1)
    return replace(motion, q=MIDDLE + PART * (motion.q - middle), qd=PART * motion.qd, qdd=PART * motion.qdd)


def record(machine: Machine, chain: KinematicModel, g: np.ndarray, ball: np.ndarray,
           seed: int) -> tuple[Log, np.ndarray]:
    """A log of the machine with the geometry g and the calibrator's tip in the ball, and its true parameters."""
    names = chain.parameters.names
    true = machine.with_values(dict(zip(names, g.tolist(), strict=True)))
    model = Model(true)
    motion, psi = attached_motion(model, seed), random_truth(model, seed)
    log = simulate(model, motion, psi, seed=seed, name="one experiment")
    whole = np.hstack([motion.q, np.tile(START, (len(motion.t), 1))])
    whole, closed = close(chain, g, whole, [4, 5, 6, 7], ball)
    assert np.all(closed), f"the calibrator of machine {seed} does not reach its fixture"
    channels = dict(log.channels) | dict(read(machine, chain, whole, np.random.default_rng((seed, 1))))
    for stated, own in zip(machine.cylinders, true.cylinders, strict=True):  # strokes are read, the stated added
        name = f"{own.name}.length"
        channels[name] = channels[name] + stated.dead_length - own.dead_length
    return Log(log.name, log.t, channels, units={name: machine.channel_units[name] for name in channels}), psi


def read(machine: Machine, chain: KinematicModel, q: np.ndarray,
         rng: np.random.Generator) -> Iterator[tuple[str, np.ndarray]]:
    """What the calibrator's sensors read."""
    for k, joint in enumerate(chain.joints):
        sensor = machine.sensor(f"{joint}.q")
        if joint not in machine.joints and sensor is not None:
            yield f"{joint}.q", sensor.read(q[:, k], rng)
