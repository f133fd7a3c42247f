"""1000 random machines and limits: no motion breaks a limit; where there is none, limits in conflict are named."""

from collections import Counter
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context

from studies.excitation_limits.parts import outcomes

SETTINGS, CORES, EACH = 1000, 2, 25


def run() -> dict:
    """How many settings led to what."""
    with ProcessPoolExecutor(CORES, get_context("spawn")) as pool:
        found = [one for part in pool.map(outcomes, [range(k, k + EACH) for k in range(0, SETTINGS, EACH)])
                 for one in part]
    kept = [one for one in found if not one.refused]
    slow = [one for one in found if "bandwidth" in one.refused]
    resting = [one for one in found if "by any motion" in one.refused]
    named = [one for one in found if "in any posture" in one.refused]
    return {"settings": len(found), "motions": len(kept), "that_move": sum(one.moves for one in kept),
            "that_break_a_limit": sum(bool(one.broken) for one in kept),
            "broken": dict(Counter(name for one in kept for name in one.broken)),
            "refused_for_bandwidth": len(slow), "refused_with_names": len(named),
            "refused_though_rest_is_possible": len(resting),
            "refused_otherwise": len(found) - len(kept) - len(slow) - len(named) - len(resting),
            "refused_although_possible": sum(one.wrongly for one in named)}
