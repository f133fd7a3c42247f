"""What is known of a machine's parameters after an identification: what limits under uncertain masses rest on."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from threadpoolctl import threadpool_limits

from hydroopt.estimation.dynamic.problem import IdentificationProblem
from hydroopt.estimation.dynamic.stored_information import stored_information
from hydroopt.estimation.inference.whitening import WIDEST, gaussian_posterior
from hydroopt.limits.uncertain import UncertainParameters
from hydroopt.logs.log import Log
from hydroopt.machine.machine_file import GivenMachine
from hydroopt.model.model import Model, model_of


def identified(machine: Model | GivenMachine, source: Log | Sequence[Log] | str | Path) -> UncertainParameters:
    """The parameters after logs, with their covariance; directions that neither logs nor file tell count as exact.

    Args:
        machine: nominal description, or its model.
        source: logs, or the folder that `hydroopt identify` wrote from them.

    Raises:
        LogError: the logs cannot be used.
        ProblemError: the folder cannot be used, or is of another machine description.

    Example:
        >>> import hydroopt as ho
        >>> model = ho.Model(ho.load_machine("patu655_lift"))
        >>> log = ho.simulate(model, ho.random_trajectory(model, duration=20, rate=20, seed=1), seed=1)
        >>> before, after = UncertainParameters.stated(model), identified(model, log)
        >>> force = model.over(model.regressor, *(np.array([[value]]) for value in (0.3, 0.0, 0.0)))[0][0]
        >>> bool(np.linalg.norm(force @ after.root) < 0.5 * np.linalg.norm(force @ before.root))
        True
    """
    model = model_of(machine, "identified")
    with threadpool_limits(limits=1, user_api="blas"):
        known, p = stored_information(model, source), len(model.parameters)
        rows = known.triangles.reshape(-1, p + 1)
        found = gaussian_posterior(IdentificationProblem(model, ()), rows[:, :p], rows[:, p])
    determined = np.linalg.norm(found.slope / model.parameters.scale[:, None], axis=0) < WIDEST / 2
    return UncertainParameters(found.offset, found.slope[:, determined])
