"""Cells of a few milliseconds that worker processes can import, and a study to kill."""

from __future__ import annotations

import os
import signal
import sys
import time

import numpy as np

from hydroopt.errors import IdentifiabilityError
from hydroopt.study.run import run
from hydroopt.study.study import Study, Values, seeds


def cell(*, seed: int, index: int, pause: float, bad: int = -1, deadly: int = -1) -> Values:
    """Numbers with all their bits in use; fails, or kills its process, if it is told to."""
    time.sleep(pause)
    if index == bad:
        raise IdentifiabilityError("the data show nothing", where=f"cell {index}", remedy="measure more")
    if index == deadly:
        os.kill(os.getpid(), signal.SIGKILL)
    rng = np.random.default_rng(seed)
    inverse = np.linalg.inv(rng.standard_normal((60, 60)))  # by BLAS, whose threads would change the last bits
    return {"sum": float(inverse.sum()), "first": float(rng.standard_normal()), "nothing": float("nan"), "word": "a,b"}


def study(count: int, *, pause: float = 0.0, seed: int = 3, **more: int) -> Study:
    cells = tuple({"seed": own, "index": k, "pause": pause, **more} for k, own in enumerate(seeds(seed, count)))
    return Study("quick", cell, cells, {"seed": seed})


if __name__ == "__main__":
    run(study(int(sys.argv[2]), pause=float(sys.argv[3])), sys.argv[1])
