"""The interface of a problem for solvers and sampler; each kind of estimation implements it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Literal, Protocol

from hydroopt.estimation.inference.conditions import Condition, ScaledBody
from hydroopt.estimation.inference.constraints import Constraint
from hydroopt.parameters.parameter_set import ParameterSet
from hydroopt.spatial.inertia import Array

Distance = Literal["gaussian", "log-det"]


class InferenceProblem(Protocol):
    """Parameters, priors and constraints; solvers get the residuals as ``‖R·ψ − r‖²``."""

    @property
    def where(self) -> str:
        """Subject for error messages."""

    @property
    def parameters(self) -> ParameterSet:
        """The unknowns ψ (p,)."""

    @property
    def constraints(self) -> tuple[Constraint, ...]:
        """The user's relations between them."""

    @property
    def consistent(self) -> bool:
        """Whether every body must be physically possible."""

    @property
    def distance(self) -> Distance:
        """How the distance of a body from its nominal one is measured."""

    @property
    def bodies(self) -> tuple[ScaledBody, ...]:
        """All bodies, scaled, with the weights of their log-det distances."""

    @property
    def prior_rows(self) -> tuple[Array, Array]:
        """Rows and right-hand side of ``‖A·ψ − b‖²``: all priors, a log-det distance by the Gaussian nearest to it."""

    @property
    def square_rows(self) -> tuple[Array, Array]:
        """The same of the priors that are squares, without the log-det distances."""

    @property
    def fixed(self) -> Mapping[str, float]:
        """Parameters that are held at a value."""

    def statements(self, *, consistent: bool) -> tuple[Condition, ...]:
        """Linear conditions on ψ: physically consistent bodies on request, and what machine file and user state."""

    def requirements(self, *, consistent: bool) -> tuple[Condition, ...]:
        """The same with the bounds of single parameters."""


def names_of(problem: InferenceProblem, *, consistent: bool) -> tuple[str, ...]:
    """Names of all conditions and constraints, each once."""
    conditions = problem.requirements(consistent=consistent)
    return tuple(dict.fromkeys([c.name for c in conditions] + [c.name for c in problem.constraints]))
