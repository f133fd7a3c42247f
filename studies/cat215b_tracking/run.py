"""CAT 215B with the thesis's sensors: what identification buys when an unseen motion is to be followed."""

from dataclasses import replace

import numpy as np
from scipy.integrate import cumulative_simpson
from scipy.interpolate import CubicSpline

from hydroopt import Model, identification_problem, load_machine, random_trajectory, random_truth, simulate, solve
from hydroopt.control.comparison import FEEDFORWARD, Comparison, compare
from hydroopt.control.setting import COMPLETE, NOMINAL, REDUCED, TRUE, ModelVariant, Setting
from hydroopt.limits.limits import Limits
from hydroopt.model.plant import Plant
from hydroopt.simulation.drive_valves import random_numbers
from hydroopt.simulation.simulate import Trajectory
from studies import show

SEEDS = range(10, 16)  # 0 to 5 served to improve the controller
OFF = 0.8
"""What every nominal parameter is of the true one."""
FLOW = 0.8
"""Part of the pump's flow that the motions take at most."""
START = 1.5
"""Time [s] in which a motion comes to its pace."""
RATE = 50.0
"""Of sensors and controller [Hz]."""
SENSITIVITY = 1.3
"""To which gains are tuned."""


def run() -> dict:
    """RMS tracking errors of the tip and their ratios, over truths, logs and motions of several seeds.

    Valves and oil are first as the controllers know them, then drawn from the file's confidences.
    """
    plant = Plant(Model(load_machine("cat215b")))
    cases = [case(plant, seed) for seed in SEEDS]
    known = [compare(setting, variants, [FEEDFORWARD]) for setting, variants in cases]
    drawn = [compare(replace(setting, true_theta=random_numbers(plant, seed)), variants, [FEEDFORWARD])
             for seed, (setting, variants) in zip(SEEDS, cases, strict=True)]
    margins = [least_margins(plant, compared) for compared in known]
    results = ratios(known, "")
    return results | {
        "gain_margin_db": round(min(gain for gain, _ in margins), 1),
        "phase_margin_deg": round(min(phase for _, phase in margins), 1), **ratios(drawn, "valves_drawn_")}


def case(plant: Plant, seed: int) -> tuple[Setting, list[ModelVariant]]:
    """An unseen motion on a true machine, and what is known of it: nominal, and identified from two logs."""
    model = plant.model
    reduced = Model(model.machine, actuator_inertia=False)
    truth = random_truth(model, seed)
    logs = [simulate(model, feasible(model, 20.0, 100 * seed + k), truth, seed=100 * seed + k) for k in (1, 2)]
    known = [ModelVariant(NOMINAL, "all 20 % too small", model, OFF * truth),
             ModelVariant(REDUCED, "identified", reduced, solve(identification_problem(reduced, logs)).psi),
             ModelVariant(COMPLETE, "identified", model, solve(identification_problem(model, logs)).psi)]
    theta = plant.parameters.nominal
    return Setting(plant, feasible(model, 12.0, 100 * seed), ModelVariant(TRUE, "drawn", model, truth), theta, theta,
                   RATE, seed, SENSITIVITY), known


def least_margins(plant: Plant, compared: Comparison) -> tuple[float, float]:
    """Least gain margin [dB] and phase margin [deg] of all loops anywhere, on the true machine."""
    best, loops = compared.outcomes[0], [each.actuator.name for each in plant.actuators]
    return (min(float(20 * np.log10(best.worst(loop, "gain").gain)) for loop in loops),
            min(float(np.degrees(best.worst(loop, "phase").phase)) for loop in loops))


def ratios(compared: list[Comparison], prefix: str) -> dict[str, float]:
    """RMS distances [mm] over all seeds by variant, their ratios, and the least and greatest of a single seed."""
    rms = {name: np.array([next(1e3 * outcome.tip_rms for outcome in one.outcomes if outcome.variant.name == name)
                           for one in compared]) for name in (NOMINAL, REDUCED, COMPLETE, TRUE)}
    show.table(f"RMS distance of the tip from an unseen motion [mm] {prefix}", ("seed", *rms), [
        (seed, *(f"{values[k]:.1f}" for values in rms.values())) for k, seed in enumerate(SEEDS)])
    better, beside = rms[NOMINAL] / rms[COMPLETE], rms[COMPLETE] / rms[TRUE]
    pooled = {name: float(np.sqrt(np.mean(values**2))) for name, values in rms.items()}
    found = {f"{name}_mm": round(value, 2) for name, value in pooled.items()} | {
        "nominal_by_complete": round(pooled[NOMINAL] / pooled[COMPLETE], 2),
        "nominal_by_complete_least": round(float(better.min()), 2),
        "nominal_by_complete_greatest": round(float(better.max()), 2),
        "complete_by_true": round(pooled[COMPLETE] / pooled[TRUE], 3),
        "complete_by_true_greatest": round(float(beside.max()), 3),
        "reduced_by_complete": round(pooled[REDUCED] / pooled[COMPLETE], 2)}
    return {prefix + name: value for name, value in found.items()}


def feasible(model: Model, duration: float, seed: int) -> Trajectory:
    """A random motion from rest to rest, slow enough for the pump."""
    path = random_trajectory(model, duration=duration, rate=20 * RATE, seed=seed)
    limits = Limits(model)
    rows = [k for k, row in enumerate(limits.rows) if row.name == "pump flow"]
    flow = np.max(limits.values(path.q, path.qd, path.qdd)[:, rows])  # as a part of what the pump gives
    pace = min(1.0, FLOW / flow)
    # along the path at this pace, to which it takes START seconds to come, and as long to stop
    t = np.arange(int((path.t[-1] / pace + START) * RATE)) / RATE
    share = [np.clip(x / START, 0, 1) for x in (t, t[-1] - t)]
    rate = pace * np.prod([x**3 * (10 - 15 * x + 6 * x**2) for x in share], axis=0)
    place = np.minimum(cumulative_simpson(rate, x=t, initial=0), path.t[-1])
    q, qd, qdd = (CubicSpline(path.t, path.q)(place, order) for order in range(3))
    change = CubicSpline(t, rate)(t, 1)
    return Trajectory(t, q, qd * rate[:, None], qdd * rate[:, None] ** 2 + qd * change[:, None])
