"""The check of a solver's solution: feasibility and stationarity."""

from __future__ import annotations

from dataclasses import dataclass

from hydroopt.errors import SolverError

AT_BOUND = 1e-6
"""How far beyond a bound or a statement a solver may end, in the scale of the numbers concerned: it works in that."""


@dataclass(frozen=True)
class Certificate:
    """Residuals of the optimality conditions, recomputed from a solution and relative to the size of their terms.

    `violation` of the worst constraint and `stationarity`, the gradient of the Lagrangian.
    """

    violation: float
    stationarity: float

    def trust(self, where: str, *, tolerance: float = 1e-4) -> None:
        """Accept the solution or raise a SolverError with the evidence."""
        if not (self.violation < tolerance and self.stationarity < tolerance):
            raise SolverError(
                f"the solver's answer failed our check (constraint violation {self.violation:.1e}, stationarity "
                f"{self.stationarity:.1e}, both should be below {tolerance:.0e})", where=where,
                remedy="loosen contradictory priors or constraints, or use another method")
