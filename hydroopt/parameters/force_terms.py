"""Terms of an actuator's force that a user states: coefficients with unit, prior and bounds, and an expression."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from hydroopt.errors import ProblemError
from hydroopt.units import base_unit, factor


@dataclass(frozen=True)
class Coefficient:
    """A number of a force term, in SI, as `ForceTerm` shows.

    Attributes:
        unit: an SI unit, such as ``N/m``; ``1`` of a plain number.
        nominal: value before identification, and mean of the prior.
        sigma: standard deviation of the prior; None without a prior.
        lower, upper: bounds.

    Raises:
        ProblemError: a number is not finite, sigma is not positive, the bounds exclude the nominal value, or the unit
            is not an SI unit.

    >>> Coefficient("N/m", sigma=5e3, lower=0.0)
    Coefficient(unit='N/m', nominal=0.0, sigma=5000.0, lower=0.0, upper=inf)
    """

    unit: str = "1"
    nominal: float = 0.0
    sigma: float | None = None
    lower: float = -math.inf
    upper: float = math.inf

    def __post_init__(self) -> None:
        where = "coefficient of a force term"
        if factor(self.unit, si := base_unit(self.unit, where=where), where=where) != 1:
            raise ProblemError(f"'{self.unit}' is not an SI unit", where=where, remedy=f"use '{si}'")
        if not math.isfinite(self.nominal) or (self.sigma is not None and not 0 < self.sigma < math.inf):
            raise ProblemError(f"{self.nominal:g} ± {self.sigma} is not a number with a positive standard deviation",
                               where=where, remedy="give finite numbers")
        if not self.lower <= self.nominal <= self.upper or self.lower == self.upper:
            raise ProblemError(f"the nominal value {self.nominal:g} is not within the bounds {self.lower:g} and "
                               f"{self.upper:g}", where=where, remedy="widen the bounds or move the value")


@dataclass(frozen=True)
class ForceTerm:
    """A term of an actuator's force as a CasADi expression of motion, pressures and coefficients.

    It is part of what the actuator exerts, as friction is: positive in the direction in which the cylinder lengthens,
    or the joint turns. Give it to `Model`; the coefficients are then parameters ``<actuator>.<coefficient>``, with
    intervals, and the term is in all forces that the model predicts. Terms that are not linear in their coefficients
    are identified by Gauss-Newton steps from the nominal values, as Stribeck friction is.

    Attributes:
        actuator: whose force.
        coefficients: by name.
        expression: called once with the motion (`hydroopt.model.regressor.MotionSymbols`) and the coefficients by
            name, both as CasADi symbols in SI; returns the force [N or N·m].

    Raises:
        ProblemError: there are no coefficients, or a name is not a plain word.

    >>> import casadi as ca, hydroopt as ho
    >>> hose = ho.ForceTerm("lift_cylinder", {"k_hose": ho.Coefficient("N/m", sigma=1e4)},
    ...                     lambda x, p: p["k_hose"] * (x.position - 2.0))
    >>> model = ho.Model(ho.load_machine("patu655_lift"), terms=[hose])
    >>> psi = model.parameters.nominal.copy()
    >>> still, force = [0.3], []
    >>> for psi[model.parameters.index("lift_cylinder.k_hose")] in (0.0, 1000.0):
    ...     force.append(float(model.inverse_dynamics(still, [0], [0], psi)))
    >>> length = float(model.cylinder_kinematics(still, [0], [0])[0])
    >>> round(force[1] - force[0] - 1000 * (length - 2.0), 6)
    0.0
    """

    actuator: str
    coefficients: Mapping[str, Coefficient]
    expression: Callable[[Any, Mapping[str, Any]], Any]

    def __post_init__(self) -> None:
        if not self.coefficients:
            raise ProblemError("there are no coefficients", where=self.where, remedy="name at least one")
        for name in self.coefficients:
            if not name.isidentifier():
                raise ProblemError(f"'{name}' is not a name", where=self.where, remedy="use letters, digits and _")

    @property
    def where(self) -> str:
        """Subject for error messages."""
        return f"force term of {self.actuator}"

    @property
    def addresses(self) -> dict[str, Coefficient]:
        """Coefficients by the name of their parameter."""
        return {f"{self.actuator}.{name}": each for name, each in self.coefficients.items()}
