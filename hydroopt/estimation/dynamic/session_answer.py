"""What a comparison of sessions answers: numbers with intervals, and the sessions' logs."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from hydroopt.estimation.dynamic.stored_information import StoredInformation
from hydroopt.machine.machine import Machine
from hydroopt.model.scene_graph import SceneGraph
from hydroopt.results.answer import Answer
from hydroopt.results.diagnostic import Diagnostic
from hydroopt.results.parameter_table import ParameterRow, row
from hydroopt.results.tables import number


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


class SessionAnswer(Answer):
    """An answer about sessions of one machine."""

    machine: Machine

    @property
    @abstractmethod
    def sessions(self) -> Mapping[str, StoredInformation]:
        """The sessions by role, in time order."""

    @property
    def split_half(self) -> float:
        """φ, how much more friction and offsets differ between the halves of the logs than residuals explain."""
        return float(np.mean([session.split_half for session in self.sessions.values()]))

    @property
    def steady(self) -> bool:
        """Whether friction and offsets are the same in the halves of each log; else changes are held against φ."""
        return all(session.steady for session in self.sessions.values())

    @property
    def of_logs(self) -> tuple[Diagnostic, ...]:
        """What contradicts the machine file in the logs as they are read."""
        return tuple(found for session in self.sessions.values() for found in session.of_logs)

    @property
    def scene(self) -> SceneGraph:
        """The machine's bodies and how they move together."""
        return SceneGraph(self.machine)

    @property
    def headline(self) -> str:
        """What the sessions say, in a sentence."""
        return self.findings[0].text

    @property
    def inputs(self) -> tuple[Mapping[str, Any], ...]:
        """The logs of all sessions."""
        return tuple({**log, "role": role} for role, session in self.sessions.items() for log in session.inputs)

    @property
    def weights(self) -> dict[str, dict[str, dict[str, float]]]:
        """σ, τ and number of residuals of each actuator, by role and name."""
        return {role: session.weights(self.machine) for role, session in self.sessions.items()}


def rounded(value: float, std: float) -> str:
    """Value ± std to two digits of the latter, and to ten of the value at most."""
    place = 1 - int(np.floor(np.log10(max(std, 1e-9 * abs(value))))) if std > 0 else 6
    return f"{round(value, place) + 0.0:.{max(0, place)}f} ± {round(std, place):.{max(0, place)}f}"
