"""One cell: its outcome, with the same bits wherever it is computed."""

from __future__ import annotations

import os
from collections.abc import Callable

import numpy as np
from threadpoolctl import threadpool_limits

from hydroopt.errors import HydrooptError
from hydroopt.study.study import Outcome, Values


def outcome(function: Callable[..., Values], values: Values) -> Outcome:
    """What a study's function returns for a cell's values, or why it returns nothing; on one thread.

    >>> outcome(lambda x: {"half": x / 2}, {"x": 3})
    {'result': {'half': 1.5}}
    """
    os.environ["OMP_NUM_THREADS"] = "1"  # for compiled kernels
    with threadpool_limits(limits=1):
        try:
            return {"result": dict(function(**values))}
        except (HydrooptError, ArithmeticError, np.linalg.LinAlgError) as error:
            return {"error": str(error)}
