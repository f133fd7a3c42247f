"""A motion that was designed: its samples, its functions of time, what it uses of the limits, what it tells."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import casadi as ca
import numpy as np

from hydroopt.excitation.motion.problem import ExcitationProblem, State
from hydroopt.simulation.simulate import Trajectory
from hydroopt.spatial.inertia import Array


class Use(NamedTuple):
    """What a motion uses of a limit, over all of its samples [`unit`]; infinite bounds are none."""

    name: str
    unit: str
    lower: float
    lowest: float
    highest: float
    upper: float

    @property
    def room(self) -> float:
        """What is left; not negative if the limit is kept."""
        return min(self.lowest - self.lower, self.upper - self.highest)

    @property
    def part(self) -> float:
        """What is left of the range, or of the bound if there is but one; not a number if that is zero."""
        bounds = [bound for bound in (self.lower, self.upper) if np.isfinite(bound)]
        size = float(np.ptp(bounds)) or abs(bounds[0])
        return self.room / size if size else float("nan")


@dataclass(frozen=True, eq=False)
class Excitation:
    """A motion to drive.

    Attributes:
        program: what was asked within which limits, with which functions of time.
        x: its variables.
        stopped: whether the search was interrupted.
    """

    program: ExcitationProblem
    x: Array
    stopped: bool = False

    @cached_property
    def coefficients(self) -> Array:
        """(m, n) of the functions, for all joints [rad, m], those that rest included."""
        return self.program.coefficients(self.x)

    @cached_property
    def trajectory(self) -> Trajectory:
        """Samples at the controller's rate."""
        return Trajectory(self.program.t, *self._states)

    @cached_property
    def _states(self) -> State:
        return self.program.states(self.x, self.program.fine)

    @cached_property
    def function(self) -> ca.Function:
        """Time (1, 1) [s] → q, qd and qdd (n,): what the controller reckons."""
        t = ca.SX.sym("t")
        c = ca.DM(self.coefficients.T)
        still = self.program.idle
        made = [ca.densify(c @ each) for each in self.program.basis.expressions(t)]
        for order, each in enumerate(made):
            each[still] = self.program.still[still] if order == 0 else 0
        return ca.Function("excitation", [t], made, ["t"], ["q", "qd", "qdd"])

    @cached_property
    def histories(self) -> dict[str, Array]:
        """What is limited (N,), by the limit's name; of limits that share a name, the greatest at each sample."""
        limits, found = self.program.limits, dict[str, Array]()
        values = limits.values(*self._states)
        for k, row in enumerate(limits.rows):
            own = np.maximum(values[:, k] * row.scale, row.floor)
            found[row.name] = np.maximum(found[row.name], own) if row.name in found else own
        return found

    @cached_property
    def limits(self) -> tuple[Use, ...]:
        """What it uses of each limit."""
        rows = {row.name: row for row in self.program.limits.rows}
        return tuple(Use(name, row.unit, row.lower, float(np.min(self.histories[name])),
                         float(np.max(self.histories[name])), row.upper) for name, row in rows.items())

    @cached_property
    def value(self) -> float:
        """Of the criterion, by the program's nodes."""
        return self.program.value(self.x)

    @cached_property
    def factor(self) -> Array:
        """R (r, r) with RᵀR the information of all samples and of what was known before, on scaled base parameters."""
        return self.program.information.factor(*self._states, 1.0)

    @property
    def names(self) -> tuple[str, ...]:
        """Base parameters in words."""
        return self.program.information.asked.names

    @property
    def units(self) -> tuple[str, ...]:
        """Their units."""
        units = self.program.information.model.parameters.units
        return tuple(units[k] for k in self.program.information.asked.columns)

    @property
    def condition_number(self) -> float:
        """Of the weighted, scaled regressor, with what was known before."""
        s = np.linalg.svd(self.factor, compute_uv=False)
        return float(s[0] / s[-1]) if s[-1] > 0 else float("inf")
