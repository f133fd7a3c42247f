"""What a comparison of two sessions answers beyond `SessionAnswer`: a joint test, and samples of the unknowns."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

from scipy import stats

from hydroopt.estimation.dynamic.session_answer import SessionAnswer
from hydroopt.estimation.dynamic.stored_information import StoredInformation
from hydroopt.estimation.inference.posterior import Posterior
from hydroopt.machine.machine import Machine
from hydroopt.results.diagnostic import Diagnostic
from hydroopt.results.wording import Kind

METHOD = "joint least squares"
"""One least squares over both sessions, with an F test."""


@dataclass(frozen=True, eq=False, repr=False)
class TwoSessionAnswer(SessionAnswer):
    """An answer about two sessions.

    Attributes:
        machine: of both.
        statistic, rank, degrees_of_freedom, p_value: of the joint test that nothing differs: F with `rank`
            (identifiable directions) and `degrees_of_freedom`.
        before, after: the sessions.
        posterior: samples of all unknowns; None where bounds leave no interior, or no intervals were requested.
        notes: how it was computed, in sentences.
    """

    machine: Machine
    statistic: float
    rank: int
    degrees_of_freedom: float
    p_value: float
    before: StoredInformation
    after: StoredInformation
    posterior: Posterior | None
    notes: tuple[str, ...]
    roles: ClassVar[tuple[str, str]]
    """What the sessions are called in files."""

    @property
    def p_value_repeat(self) -> float:
        """p-value of the statistic over φ: whether the sessions differ more than the halves of their own logs do."""
        return float(stats.f.sf(self.statistic / self.split_half, self.rank, self.degrees_of_freedom))

    @property
    def method(self) -> str:
        """One least squares over both sessions, with an F test."""
        return METHOD

    @property
    def sessions(self) -> dict[str, StoredInformation]:
        """Both sessions by role."""
        return dict(zip(self.roles, (self.before, self.after), strict=True))

    def details(self) -> Mapping[str, Any]:
        """Joint test, weights of both sessions, and notes."""
        return {"test": {"statistic": self.statistic, "rank": self.rank, "degrees_of_freedom": self.degrees_of_freedom,
                         "p_value": self.p_value, "phi": self.split_half, "p_value_over_phi": self.p_value_repeat,
                         "steady": self.steady},
                "weights": self.weights, "notes": list(self.notes)}

    def of_sampling(self, *, requested: bool) -> tuple[Diagnostic, ...]:
        """What to know about intervals that were sampled, or could not be."""
        if self.posterior is None:
            return (Diagnostic(Kind.NO_INTERIOR),) if requested else ()
        return () if self.posterior.converged else (Diagnostic(Kind.SAMPLING_NOT_CONVERGED),)
