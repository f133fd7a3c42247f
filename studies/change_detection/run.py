"""Are changes seen as often as they should be, and false alarms as seldom? CAT 215B, the thesis's sensors."""

from collections.abc import Iterable

import numpy as np
from scipy import stats
from threadpoolctl import threadpool_limits

from hydroopt import Log, Model, load_machine, payload, random_trajectory, random_truth, simulate
from hydroopt.estimation.dynamic.session_comparison import named_parts
from hydroopt.estimation.dynamic.session_model import SessionModel, session_model
from hydroopt.estimation.dynamic.stored_information import StoredInformation, stored_information
from studies.change_detection import sessions
from studies.panda_gaz2019 import run as panda
from studies.ur10e_mamedov import run as ur10e

PAIRS, CHANGED, LOADED = 240, 60, 20
STEP, OF = 400.0, "boom_cylinder.f_coulomb"
LOAD = 250.0
MODEL = Model(load_machine("cat215b"))
NAMES = named_parts(MODEL.parameters, ["friction", "offset"])


def run() -> dict | None:
    """False alarms and their distribution, power for one change, coverage of a load's intervals; several sessions."""
    if not (ur10e.DATA.exists() and panda.DATA.exists()):
        return None
    p, least, changed = false_alarms(range(PAIRS))
    inside, misses = loads(range(LOADED))
    seen, kept, errors = np.array(changed).T
    return {"false_alarms": round(float(np.mean(p < 0.05)), 4),
            "false_alarms_at_1_percent": round(float(np.mean(p < 0.01)), 4),
            "false_alarms_of_any_parameter": round(float(np.mean(least < 0.05)), 4),
            "uniformity_p": round(float(stats.kstest(p, "uniform").pvalue), 4),
            "p_value_median": round(float(np.median(p)), 3), "power": round(float(np.mean(seen)), 3),
            "true_cause_kept": round(float(np.mean(kept)), 3),
            "single_cause_error_std": round(float(np.std(errors)), 3),
            "load_coverage": round(float(np.mean(inside)), 3), "load_numbers_told": len(inside),
            "load_error_kg_median": round(float(np.median(misses)), 2), **sessions.run()}


def false_alarms(seeds: Iterable[int]) -> tuple[np.ndarray, np.ndarray, list[tuple[bool, bool, float]]]:
    """p-values of no change, and the least of any parameter, where nothing changed; what is seen of a change."""
    at = NAMES.index(OF)

    def tested(before: StoredInformation, after: StoredInformation) -> SessionModel:
        return session_model(MODEL, NAMES, [before, after])

    together, single, changed = [], [], []
    with threadpool_limits(limits=1, user_api="blas"):
        for seed in seeds:
            truth = random_truth(MODEL, seed)
            before = stored_information(MODEL, [_log(truth, 2 * seed)])
            test = tested(before, stored_information(MODEL, [_log(truth, 2 * seed + 1)]))
            together.append(test.p_value)
            single.append(np.nanmin(test.each[2]))
            if seed < CHANGED:
                truth[MODEL.parameters.index(OF)] += STEP
                test = tested(before, stored_information(MODEL, [_log(truth, 100_000 + seed)]))
                _, (value, std, _), left = test.shapes[test.likeliest].alone()
                changed.append((test.p_value < 0.05, left[at] >= 0.05, (value[at] - STEP) / std[at]))
    return np.array(together), np.array(single), changed


def loads(seeds: Iterable[int]) -> tuple[list[bool], list[float]]:
    """Which numbers of a load on the stick lie inside their intervals, and by how much the mass is off [kg]."""
    inside, misses = [], []
    first = MODEL.parameters.index("stick.m")
    for seed in seeds:
        truth = random_truth(MODEL, seed)
        com = np.array([1.8, 0.5, 0.0]) + np.random.default_rng(seed).uniform(-0.2, 0.2, 3)
        loaded = truth.copy()
        loaded[first : first + 10] += _ball(LOAD, com, 0.4)
        found = payload(MODEL.machine, [_log(truth, 200_000 + 2 * seed)], [_log(loaded, 200_001 + 2 * seed)],
                        link="stick", seed=seed)
        inside += [one.ci95[0] <= true <= one.ci95[1]
                   for one, true in zip((found.mass, *found.com), (LOAD, *com), strict=True) if np.isfinite(one.std)]
        misses.append(abs(found.mass.value - LOAD))
    return inside, misses


def _log(psi: np.ndarray, seed: int) -> Log:
    return simulate(MODEL, random_trajectory(MODEL, duration=33.28, rate=50, seed=50_000 + seed), psi, seed=seed)


def _ball(m: float, com: np.ndarray, radius: float) -> np.ndarray:
    """A solid ball's ten parameters, written out rather than taken from the package."""
    x, y, z = com
    i = 0.4 * m * radius**2
    return np.array([m, m * x, m * y, m * z, i + m * (y * y + z * z), -m * x * y, -m * x * z, i + m * (x * x + z * z),
                     -m * y * z, i + m * (x * x + y * y)])
