"""CAT 215B with the thesis's sensors: what identification buys when an unseen motion is to be followed."""

import numpy as np
from scipy.integrate import cumulative_simpson
from scipy.interpolate import CubicSpline

from hydroopt import Model, identification_problem, load_machine, random_trajectory, random_truth, simulate, solve
from hydroopt.control.comparison import compare
from hydroopt.control.model_variants import COMPLETE, NOMINAL, REDUCED, TRUE, ModelVariant
from hydroopt.control.outcome import FEEDFORWARD
from hydroopt.control.setting import Setting
from hydroopt.excitation.motion.limits import Limits
from hydroopt.model.plant import Plant
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


def run() -> dict:
    """RMS tracking errors of the tip and their ratios, over truths, logs and motions of several seeds."""
    model = Model(load_machine("cat215b"))
    plant = Plant(model)
    reduced = Model(model.machine, actuator_inertia=False)
    rms: dict[str, list[float]] = {name: [] for name in (NOMINAL, REDUCED, COMPLETE, TRUE)}
    gain, phase, rows = [], [], []
    for seed in SEEDS:
        truth = random_truth(model, seed)
        logs = [simulate(model, feasible(model, 20.0, 100 * seed + k), truth, seed=100 * seed + k) for k in (1, 2)]
        known = [ModelVariant(NOMINAL, "all 20 % too small", model, OFF * truth),
                 ModelVariant(REDUCED, "identified", reduced, solve(identification_problem(reduced, logs)).psi),
                 ModelVariant(COMPLETE, "identified", model, solve(identification_problem(model, logs)).psi)]
        motion = feasible(model, 12.0, 100 * seed)
        theta = plant.parameters.nominal
        setting = Setting(plant, motion, ModelVariant(TRUE, "drawn", model, truth), theta, theta, RATE, seed)
        compared = compare(setting, known, [FEEDFORWARD])
        for outcome in compared.outcomes:
            rms[outcome.variant.name].append(1e3 * outcome.tip_rms)
        loops = [each.actuator.name for each in plant.actuators]
        best = compared.outcomes[0]
        gain.append(min(20 * np.log10(best.worst(loop, "gain").gain) for loop in loops))
        phase.append(min(np.degrees(best.worst(loop, "phase").phase) for loop in loops))
        rows.append((seed, *(f"{values[-1]:.1f}" for values in rms.values()), f"{gain[-1]:.1f}", f"{phase[-1]:.1f}"))
    show.table("RMS distance of the tip from an unseen motion [mm], and least margins anywhere", (
        "seed", *rms, "gain margin [dB]", "phase margin [deg]"), rows)
    found = {name: np.array(values) for name, values in rms.items()}
    better, beside = found[NOMINAL] / found[COMPLETE], found[COMPLETE] / found[TRUE]
    pooled = {name: float(np.sqrt(np.mean(values**2))) for name, values in found.items()}
    return {f"{name}_mm": round(value, 2) for name, value in pooled.items()} | {
        "nominal_by_complete": round(pooled[NOMINAL] / pooled[COMPLETE], 2),
        "nominal_by_complete_least": round(float(better.min()), 2),
        "nominal_by_complete_greatest": round(float(better.max()), 2),
        "complete_by_true": round(pooled[COMPLETE] / pooled[TRUE], 3),
        "complete_by_true_greatest": round(float(beside.max()), 3),
        "reduced_by_complete": round(pooled[REDUCED] / pooled[COMPLETE], 2),
        "gain_margin_db": round(float(min(gain)), 1), "phase_margin_deg": round(float(min(phase)), 1)}


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
