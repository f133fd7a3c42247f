"""Experiments whose forces determine parameters, and how their residuals are to be weighted."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Literal, Self

import numpy as np

from hydroopt.errors import ProblemError
from hydroopt.estimation.dynamic.experiment import Experiment
from hydroopt.estimation.dynamic.fitted_motion import NumbersBeside
from hydroopt.estimation.inference.problem import StatedProblem
from hydroopt.logs.smoothing import Motion
from hydroopt.spatial.inertia import Array

Loss = Literal["squares", "huber", "student_t"]
HUBER = 1.345
"""Residual, in its standard deviations, beyond which Huber's loss is linear."""
LOSSES: Mapping[Loss, str] = {
    "squares": "Σ (e/σ)²", "huber": f"Huber's loss of e/σ, linear beyond {HUBER:g}",
    "student_t": "Student's t loss of e/σ with 4 degrees of freedom"}
"""The losses as terms of the objective."""


@dataclass(frozen=True, eq=False)
class ForceProblem(StatedProblem):
    """Residuals f − K·ψ of some experiments, with all that is stated of ψ.

    Attributes:
        experiments, validation: training data, and data for validation only.
        force_std: (n,) standard deviations of force readings, NaN if unknown; residuals estimate them anew.
        loss: of the residuals; the robust ones are solved by iterative reweighting.
        correlated: whether the actuators' residuals in one sample may correlate; their correlation is estimated.
        fitted_motion: whether motion and parameters are fitted together, instead of smoothing the motion beforehand.
        beside: for each experiment the numbers that are fitted along, see `hydroopt.estimation.combined`.
        instruments: for each experiment another motion at its samples, whose errors are not those of the measured one.
        freed: faults of instruments that are estimated with the parameters, see `free`.
    """

    experiments: tuple[Experiment, ...]
    validation: tuple[Experiment, ...] = ()
    force_std: Array = field(default_factory=lambda: np.empty(0))
    loss: Loss = "squares"
    correlated: bool = False
    fitted_motion: bool = False
    beside: tuple[NumbersBeside, ...] = ()
    instruments: tuple[Motion, ...] = ()
    freed: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        for data in (*self.experiments, *self.validation):
            if data.model is not self.model and data.model.parameters.names != self.model.parameters.names:
                raise ProblemError("the log was prepared with a model that has other parameters than the problem's",
                                   where=data.log.path or data.log.name,
                                   remedy="give the problem and its experiments the same model")

    def with_experiments(self, experiments: Sequence[Experiment], beside: Sequence[NumbersBeside] = ()) -> Self:
        """With other training data, and other numbers fitted along, if there are any."""
        return replace(self, experiments=tuple(experiments), beside=tuple(beside) or self.beside)
