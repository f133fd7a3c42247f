"""What every comparison of two sessions answers: numbers with intervals, a joint test, and the sessions' logs."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from scipy import stats

from hydroopt.estimation.dynamic.stored_information import StoredInformation
from hydroopt.estimation.inference.posterior import Posterior
from hydroopt.machine.machine import Machine
from hydroopt.results.answer import Answer
from hydroopt.results.diagnostic import Diagnostic
from hydroopt.results.fit import Fit
from hydroopt.results.json_file import MachineId
from hydroopt.results.parameter_table import ParameterRow, row
from hydroopt.results.tables import number
from hydroopt.results.wording import Kind

METHOD = "joint least squares"
"""One least squares over both sessions, with an F test."""


@dataclass(frozen=True)
class Quantity:
    """A number with its standard deviation and 95 % interval, in SI; NaN where it is not identifiable."""

    name: str
    kind: str
    unit: str
    value: float
    std: float
    ci95: tuple[float, float]

    @property
    def identifiable(self) -> bool:
        """Whether the logs determine it."""
        return bool(np.isfinite(self.value))

    def as_dict(self) -> dict[str, Any]:
        """The entry of a JSON file."""
        return {"name": self.name, "unit": self.unit, "value": number(self.value), "std": number(self.std),
                "ci95": list(self.ci95) if np.all(np.isfinite(self.ci95)) else None}

    def row(self, name: str = "") -> ParameterRow:
        """The row of a table of parameters, under its own name or another."""
        return row(name or self.name, self.kind, self.unit, value=self.value, std=self.std, ci95=self.ci95,
                   identifiability="full" if self.identifiable else "none")


@dataclass(frozen=True, eq=False, repr=False)
class TwoSessionAnswer(Answer):
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
    def split_half(self) -> float:
        """φ, how much more friction and offsets differ between the halves of the logs than residuals explain."""
        return (self.before.split_half + self.after.split_half) / 2

    @property
    def p_value_repeat(self) -> float:
        """p-value of the statistic over φ: whether the sessions differ more than the halves of their own logs do."""
        return float(stats.f.sf(self.statistic / self.split_half, self.rank, self.degrees_of_freedom))

    @property
    def steady(self) -> bool:
        """Whether friction and offsets are the same in the halves of each log; else `p_value_repeat` decides."""
        return self.before.steady and self.after.steady

    @property
    def of_logs(self) -> tuple[Diagnostic, ...]:
        """What contradicts the machine file in the logs as they are read."""
        return (*self.before.of_logs, *self.after.of_logs)

    @property
    def machine_id(self) -> MachineId:
        """Which machine it is about."""
        return MachineId.of(self.machine)

    @property
    def method(self) -> str:
        """One least squares over both sessions, with an F test."""
        return METHOD

    @property
    def fit(self) -> Mapping[str, Mapping[str, Fit]]:
        """Empty: two sessions are compared, not predicted."""
        return {}

    @property
    def sessions(self) -> dict[str, StoredInformation]:
        """Both sessions by role."""
        return dict(zip(self.roles, (self.before, self.after), strict=True))

    @property
    def inputs(self) -> tuple[Mapping[str, Any], ...]:
        """The logs of both sessions."""
        return tuple({**log, "role": role} for role, session in self.sessions.items() for log in session.inputs)

    def details(self) -> Mapping[str, Any]:
        """Joint test, weights of both sessions, and notes."""
        return {"test": {"statistic": self.statistic, "rank": self.rank, "degrees_of_freedom": self.degrees_of_freedom,
                         "p_value": self.p_value, "phi": self.split_half, "p_value_over_phi": self.p_value_repeat,
                         "steady": self.steady},
                "weights": {role: session.weights(self.machine) for role, session in self.sessions.items()},
                "notes": list(self.notes)}

    def of_sampling(self, *, requested: bool) -> tuple[Diagnostic, ...]:
        """What to know about intervals that were sampled, or could not be."""
        if self.posterior is None:
            return (Diagnostic(Kind.NO_INTERIOR),) if requested else ()
        return () if self.posterior.converged else (Diagnostic(Kind.SAMPLING_NOT_CONVERGED),)


def rounded(value: float, std: float) -> str:
    """Value ± std to two digits of the latter, and to ten of the value at most."""
    place = 1 - int(np.floor(np.log10(max(std, 1e-9 * abs(value))))) if std > 0 else 6
    return f"{round(value, place) + 0.0:.{max(0, place)}f} ± {round(std, place):.{max(0, place)}f}"
