"""Readings of forces that lag behind: the model is made to lag alike, since undoing a lag would amplify noise.

With L the first-order system of a sensor, readings of an actuator's force are ``L(K·ψ) = (L·K)·ψ``: each column of the
regressor passes through L. Dry friction is not known until L has forgotten the samples at which its sign was not.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hydroopt.errors import ProblemError
from hydroopt.logs.forces_from_pressures import force_lags
from hydroopt.logs.lag import lagged
from hydroopt.logs.log import Log
from hydroopt.logs.smoothing import Motion
from hydroopt.model.model import Model
from hydroopt.spatial.inertia import Array

FORGOTTEN = 0.05
"""Weight of samples whose dry friction is not known, below which a lagging reading counts."""


def added_by_lags(K: Array, lags: Array, motion: Motion) -> Array:
    """What lags (r,) [s] of the forces add to the regressor K (N, r, p) of a motion of N samples."""
    made = np.zeros_like(K)
    for k in np.flatnonzero(lags):
        made[:, k] = lagged(motion.t, K[:, k], float(lags[k]), motion.segment) - K[:, k]
    return made


def known_in_spite_of(lags: Array, known: NDArray[np.bool_], motion: Motion) -> NDArray[np.bool_]:
    """Readings (N, r) of known dry friction, which lags do not mix with others by more than `FORGOTTEN`."""
    return np.column_stack([column & (lagged(motion.t, 1.0 - column, float(lag), motion.segment) < FORGOTTEN)
                            for column, lag in zip(known.T, lags, strict=True)])


def refuse_lags(what: str, model: Model, log: Log) -> None:
    """Refuse forces that lag, which `what` cannot be combined with.

    Raises:
        ProblemError: a sensor of the log's forces has a lag.
    """
    if np.any(force_lags(model, log)):
        raise ProblemError(f"{what} cannot be combined with forces that lag", where=log.path or log.name,
                           remedy="leave out one of the two, or the 'lag' of pressures and forces in the machine file")
