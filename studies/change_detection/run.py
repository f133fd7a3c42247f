"""Are changes seen as often as they should be, and false alarms as seldom? CAT 215B, the thesis's sensors."""

import numpy as np
from scipy import stats
from threadpoolctl import threadpool_limits

from hydroopt import Model, load_machine, payload, random_trajectory, random_truth, simulate
from hydroopt.estimation.change import holm, named_parts
from hydroopt.estimation.comparison import comparison, wald
from hydroopt.estimation.session import session

PAIRS, CHANGED, LOADED = 300, 60, 40
STEP, OF = 400.0, "boom_cylinder.f_coulomb"
LOAD = 250.0


def run() -> dict:
    """False alarms and their distribution, power for one change, and coverage of a load's intervals."""
    model = Model(load_machine("cat215b"))
    names = named_parts(model.parameters, ["friction", "offset"])
    problem = comparison(model, names)
    place = model.parameters.index(OF)

    def log(psi, seed):
        return simulate(model, random_trajectory(model, duration=33.28, rate=50, seed=50_000 + seed), psi, seed=seed)

    def tested(before, after):
        A, b = problem.rows(before, after)
        return wald(problem, A, b, before.freedom + after.freedom)

    together, single, power, named, errors = [], [], [], [], []
    with threadpool_limits(limits=1, user_api="blas"):
        for seed in range(PAIRS):
            truth = random_truth(model, seed)
            before = session(model, [log(truth, 2 * seed)])
            test = tested(before, session(model, [log(truth, 2 * seed + 1)]))
            together.append(test.p_value)
            single.append(np.nanmin(holm(test.single())))
            if seed < CHANGED:
                changed = truth.copy()
                changed[place] += STEP
                test = tested(before, session(model, [log(changed, 100_000 + seed)]))
                power.append(test.p_value < 0.05)
                named.append(test.alone[2][names.index(OF)] >= 0.05)
                errors.append((test.alone[0][names.index(OF)] - STEP) / test.alone[1][names.index(OF)])
    inside, misses = [], []
    first = model.parameters.index("stick.m")
    for seed in range(LOADED):
        rng = np.random.default_rng(seed)
        truth = random_truth(model, seed)
        com = np.array([1.8, 0.5, 0.0]) + rng.uniform(-0.2, 0.2, 3)
        loaded = truth.copy()
        loaded[first : first + 10] += _ball(LOAD, com, 0.4)
        found = payload(model.machine, [log(truth, 200_000 + 2 * seed)], [log(loaded, 200_001 + 2 * seed)], seed=seed)
        for one, true in zip((found.mass, *found.com), (LOAD, *com), strict=True):
            if np.isfinite(one.std):
                inside.append(one.ci95[0] <= true <= one.ci95[1])
        misses.append(abs(found.mass.value - LOAD))
    p = np.array(together)
    return {"false_alarms": round(float(np.mean(p < 0.05)), 4),
            "false_alarms_at_1_percent": round(float(np.mean(p < 0.01)), 4),
            "false_alarms_of_any_parameter": round(float(np.mean(np.array(single) < 0.05)), 4),
            "uniformity_p": round(float(stats.kstest(p, "uniform").pvalue), 4),
            "p_value_median": round(float(np.median(p)), 3),
            "power": round(float(np.mean(power)), 3), "true_cause_kept": round(float(np.mean(named)), 3),
            "single_cause_error_std": round(float(np.std(errors)), 3),
            "load_coverage": round(float(np.mean(inside)), 3), "load_numbers_told": len(inside),
            "load_error_kg_median": round(float(np.median(misses)), 2)}


def _ball(m: float, com: np.ndarray, radius: float) -> np.ndarray:
    """A solid ball's ten parameters (the source of truth here, written out rather than taken from the package)."""
    x, y, z = com
    i = 0.4 * m * radius**2
    return np.array([m, m * x, m * y, m * z, i + m * (y * y + z * z), -m * x * y, -m * x * z, i + m * (x * x + z * z),
                     -m * y * z, i + m * (x * x + y * y)])
