"""1000 random machines and sites: what designed motions keep under 100 draws of the uncertain masses."""

from collections import Counter
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context

import numpy as np

from studies.safe_motions.parts import Outcome, outcomes

FIRST, SETTINGS, CORES, EACH = 20000, 1000, 2, 10
ROUNDING = 0.002
"""Distance [m] by which points on lines and instants between samples of the controller may miss a clearance."""


def run() -> dict:
    """How many motions break what."""
    with ProcessPoolExecutor(CORES, get_context("spawn")) as pool:
        parts = [range(k, k + EACH) for k in range(FIRST, FIRST + SETTINGS, EACH)]
        return summed([one for part in pool.map(outcomes, parts) for one in part])


def summed(found: list[Outcome]) -> dict:
    """Of all outcomes together."""
    kept = [one for one in found if not one.refused]
    return {"settings": len(found), "motions": len(kept), "that_move": sum(one.moves for one in kept),
            "near_tipping": sum(one.tips for one in kept), "near_parts_or_obstacles": sum(one.touches for one in kept),
            "near_pressures": sum(one.presses for one in kept),
            "motions_that_break_a_limit_in_more_than_1_percent_of_draws": sum(one.broken > 0.01 for one in kept),
            "motions_that_tip_under_any_draw": sum(one.tipped > 0 for one in kept),
            "percent_of_draws_that_break_a_limit": 100 * float(np.mean([one.broken for one in kept])),
            "motions_that_use_a_reserve_at_an_instant_in_more_than_5_percent_of_draws": sum(
                one.used > 0.05 for one in kept),
            "largest_percent_of_draws_that_use_a_reserve_at_an_instant": 100 * max(one.used for one in kept),
            "percent_of_draws_that_use_any_reserve_at_any_time": 100 * float(
                np.mean([one.used_at_all for one in kept])),
            "motions_that_miss_a_clearance": sum(one.short > ROUNDING for one in kept),
            "largest_miss_of_a_clearance_mm": 1e3 * max(one.short for one in kept),
            "missed": dict(Counter(one.nearest for one in kept if one.short > ROUNDING)),
            "refused": dict(Counter(one.refused.split(":")[1].split("cannot")[-1].split(";")[0] for one in found
                                    if one.refused))}
