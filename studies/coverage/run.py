"""Do the 95 % intervals of the physically possible estimate hold 95 % of the truths? CAT 215B, thesis's sensors."""

import numpy as np

from hydroopt import Model, identification_problem, load_machine, random_trajectory, random_truth, simulate, solve

SEEDS = 60


def run() -> dict:
    """Share of true parameters inside their intervals, over truths drawn from the machine file's confidences."""
    machine = load_machine("cat215b")
    model = Model(machine)
    inside, below = [], []
    for seed in range(SEEDS):
        truth = random_truth(model, 1000 + seed)
        motion = random_trajectory(model, duration=33.28, rate=50, seed=2000 + seed)
        estimate = solve(identification_problem(machine, [simulate(model, motion, truth, seed=3000 + seed)]), seed=seed)
        known = np.isfinite(estimate.std)
        low, high = estimate.ci95[known].T
        inside.append((truth[known] >= low) & (truth[known] <= high))
        below.append(truth[known] < low)
    share = np.mean(inside, axis=0)
    names = np.array(model.parameters.names)[known]
    return {"pooled_coverage": round(float(np.mean(inside)), 4),
            "truth_below_interval": round(float(np.mean(below)), 4),
            "intervals_per_seed": int(known.sum()), "lowest_coverage": round(float(share.min()), 3),
            "lowest_coverage_of": str(names[np.argmin(share)])}
