"""Chapter 3 on the CAT 215B: Tables 4 to 12 and Figures 22 to 25, and 200 seeds against the Cramér-Rao bound."""

import math

import numpy as np

from hydroopt import solve
from studies.cat215b_calibration.chain import Machine
from studies.cat215b_calibration.tables import NAMES, accuracies, bound, end_paths, is_length, simulated, uneven
from studies.cat215b_calibration.triangles import triangles

SEEDS = 200


def monte_carlo(setup) -> dict:
    """Scatter of the joint estimate over noise, against the bound, and coverage of its intervals."""
    names, least = bound(setup)
    errors, inside = [], []
    for seed in range(SEEDS):
        problem = setup.problem(setup.poses(seed))
        solved = solve(problem)
        free = problem.free
        truth = problem.parameters.nominal[free]
        errors.append(solved.theta[free] - truth)
        interval = solved.ci95[free]
        inside.append((interval[:, 0] <= truth) & (truth <= interval[:, 1]))
    rms = np.sqrt(np.mean(np.square(errors), axis=0))
    ratio = rms / least
    worst = int(np.argmax(ratio))
    return {"worst_rms_over_bound": round(float(ratio[worst]), 3), "worst_rms_over_bound_of": names[worst],
            "pooled_coverage": round(float(np.mean(inside)), 4),
            "pooled_rms_over_bound": round(float(np.sqrt(np.mean(ratio**2))), 3),
            "a_1_rms_mm": round(1e3 * float(rms[names.index("swing.a")]), 2),
            "a_1_bound_mm": round(1e3 * float(least[names.index("swing.a")]), 2)}


def run() -> dict:
    """Everything, in millimetres and degrees."""
    quiet = Machine()
    names, least = bound(quiet)
    results = {"bound: " + name: round(float(1e3 * std if is_length(name) else math.degrees(std)), 3)
               for name, std in zip(names, least, strict=True) if name in NAMES}
    results |= simulated() | uneven() | accuracies(20) | end_paths() | triangles(quiet) | monte_carlo(quiet)
    return results
