"""Uniqueness of a calibration, from its null space and several initial guesses."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hydroopt.estimation.kinematic.observability import Observability
from hydroopt.results.tables import number
from hydroopt.spatial.inertia import Array

SAME = 0.1
"""Distance in standard deviations within which two solutions are the same."""


@dataclass(frozen=True)
class Uniqueness:
    """What is known about other solutions.

    Attributes:
        null_directions: combinations that neither data nor priors determine.
        starts: initial guesses solved from.
        same: how many of them lead to the same solution, `failed` to none, and `worse` to one with larger cost.
        next_cost: cost of the best worse solution above that of the solution; NaN where there is none.
    """

    null_directions: int
    starts: int
    same: int
    failed: int = 0
    worse: int = 0
    next_cost: float = float("nan")

    @property
    def examined(self) -> bool:
        """Whether there was more than one initial guess."""
        return self.starts > 1

    def __str__(self) -> str:
        if self.null_directions:
            return f"not unique, {self.null_directions} combinations are not identifiable"
        if not self.examined:
            return "not examined, solved from one initial guess"
        parts = [f"{self.same} of {self.starts} initial guesses lead to the same solution"]
        parts += [f"{self.failed} to none"] * bool(self.failed)
        parts += [f"{self.worse} to worse ones (the next by {self.next_cost:.3g} in squared errors)"] * bool(self.worse)
        return ", ".join(parts)

    def as_dict(self) -> dict[str, Any]:
        """The entry of a JSON file."""
        return {"null_directions": self.null_directions, "starts": self.starts, "same": self.same,
                "failed": self.failed, "worse": self.worse, "next_cost": number(self.next_cost), "text": str(self)}


def uniqueness(observability: Observability, solutions: list[tuple[float, Array]], failed: int,
               free: NDArray[np.bool_]) -> Uniqueness:
    """Compare solutions, each cost and parameters (P,), the best first, in units of the best one's standard deviations.

    Args:
        observability: at the best solution.
        solutions: one for each initial guess that led to one.
        failed: how many led to none.
        free: (P,) which parameters are estimated.
    """
    null = 0 if np.any(observability.prior) else int(observability.null_space.shape[1])
    std = np.where(np.isfinite(observability.std), observability.std, np.inf)
    least, best = solutions[0]
    same = [bool(np.all(np.abs(theta - best)[free] < SAME * std)) for _, theta in solutions]
    other = [cost - least for (cost, _), equal in zip(solutions, same, strict=True) if not equal]
    return Uniqueness(null, len(solutions) + failed, sum(same), failed, len(other), min(other, default=float("nan")))
