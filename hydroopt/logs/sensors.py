"""What a sensor makes of a true value: noise within its accuracy, then the steps of its resolution."""

from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hydroopt.errors import ProblemError

Distribution = Literal["uniform", "gaussian"]


def measure(
    values: ArrayLike,
    accuracy: float,
    resolution: float | None,
    rng: np.random.Generator,
    distribution: Distribution = "uniform",
) -> NDArray[np.float64]:
    """Readings of `values` (any shape, any unit), as a sensor of this accuracy and resolution gives them.

    Args:
        values: true values.
        accuracy: half width of the uniform noise, or standard deviation of the Gaussian; unit of `values`.
        resolution: quantisation step in the unit of `values`; None or 0 for none.
        rng: source of the noise.
        distribution: ``"uniform"`` or ``"gaussian"``.

    Raises:
        ProblemError: negative accuracy or resolution, or an unknown distribution.
    """
    step = _step(accuracy, resolution, distribution)
    true = np.asarray(values, dtype=float)
    if distribution == "uniform":
        reading = true + rng.uniform(-accuracy, accuracy, true.shape)
    else:
        reading = true + rng.normal(0.0, accuracy, true.shape)
    return quantised(reading, step) if step > 0 else reading


def quantised(values: NDArray[np.float64], step: NDArray[np.float64] | float) -> NDArray[np.float64]:
    """Values at the nearest multiple of a step, in their unit, that is not 0."""
    return np.asarray(np.round(values / step) * step)


def _step(accuracy: float, resolution: float | None, distribution: str) -> float:
    step = resolution or 0.0
    for name, value in (("accuracy", accuracy), ("resolution", step)):
        if not (np.isfinite(value) and value >= 0):
            raise ProblemError(f"a sensor's {name} cannot be {value}", where="sensor",
                               remedy="give a finite number that is not negative")
    if distribution not in ("uniform", "gaussian"):
        raise ProblemError(f"'{distribution}' is not a noise distribution", where="sensor",
                           remedy="choose 'uniform' or 'gaussian'")
    return step
