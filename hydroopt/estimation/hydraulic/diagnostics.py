"""Diagnostics of identified valves and oil."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from hydroopt.estimation.hydraulic.bounded_gaussian import SHARE, BoundedGaussian, WeakDirection
from hydroopt.results.diagnostic import Diagnostic
from hydroopt.results.wording import Kind
from hydroopt.spatial.inertia import Array

MISFIT = 1.5
"""Ratio of residuals and what sensors' errors leave, from which on the model does not explain an actuator."""
LATE, BARELY = 4.0, 1e-3
"""How many of its standard deviations a delay must be off to be named, and how far [s] at least: the model's flows
within an interval are no more exact."""
NOTHING = 1e-6
"""Part of the prior's information below which the data carry none."""


def unexplained_actuators(actuators: Sequence[str], misfit: Array) -> Iterator[Diagnostic]:
    """Actuators whose residuals, in units (a,) of what sensors' errors leave, the model does not explain."""
    for actuator, factor in zip(actuators, misfit, strict=True):
        if factor > MISFIT:
            yield Diagnostic(Kind.UNEXPLAINED_FLOW, (actuator,), {"factor": float(factor)})


def late_commands(actuators: Sequence[str], later: Array) -> Iterator[Diagnostic]:
    """Actuators whose commands arrive at another time than the machine file states, by `Adjustment.later` (a, 2)."""
    for actuator, (by, std) in zip(actuators, later, strict=True):
        if abs(by) > max(LATE * std, BARELY):
            yield Diagnostic(Kind.COMMANDS_LATE, (actuator,), {
                "by": float(abs(by)), "std": float(std), "sense": "later" if by > 0 else "earlier"})


def exact_delays(actuators: Sequence[str], later: Array) -> Iterator[Diagnostic]:
    """Actuators whose delay is not identified, by `Adjustment.later` (a, 2)."""
    some = [k for k in range(len(actuators)) if np.isfinite(later[k, 1]) and LATE * later[k, 1] > BARELY]
    if some:
        yield Diagnostic(Kind.DELAY_EXACT, tuple(actuators[k] for k in some),
                         {"least": float(LATE * np.max(later[some, 1]))})


def parameter_diagnostics(estimate: BoundedGaussian) -> tuple[Diagnostic, ...]:
    """Parameters that the data do not determine, and those at a bound."""
    return (*(_weak(estimate, each) for each in estimate.weak_directions),
            *(_at_bound(estimate, int(k)) for k in np.flatnonzero(estimate.at_bound)))


def _weak(estimate: BoundedGaussian, weak: WeakDirection) -> Diagnostic:
    """A direction on which the data carry little information."""
    parameters, theta, members = estimate.parameters, estimate.theta, weak.members
    names = tuple(parameters.names[k] for k in members)
    informed = all(parameters.information[k, k] > 0 for k in members)
    evidence = {"information": weak.information, "determined_by": "the prior" if informed else "nothing"}
    if len(names) == 1:
        if weak.information < NOTHING:
            return Diagnostic(Kind.NO_INFORMATION, names, evidence)
        k = members[0]
        reach = 1.96 * abs(weak.direction[k]) / np.sqrt(weak.information)
        return Diagnostic(Kind.LITTLE_INFORMATION, names, evidence | {
            "low": float(max(theta[k] - reach, parameters.lower[k])),
            "high": float(min(theta[k] + reach, parameters.upper[k])), "unit": parameters.units[k]})
    if len(names) == 2 and np.all(theta[members] != 0):
        relative = weak.direction[members] / theta[members]
        if abs(abs(relative[0] / relative[1]) - 1) < SHARE:
            form = "ratio" if relative[0] * relative[1] > 0 else "product"
            return Diagnostic(Kind.RATIO_OR_PRODUCT_ONLY, names, evidence | {"form": form})
    return Diagnostic(Kind.COMBINATION_ONLY, names, evidence)


def _at_bound(estimate: BoundedGaussian, k: int) -> Diagnostic:
    """A parameter that a bound holds, with the other end of its interval."""
    parameters, (low, high) = estimate.parameters, estimate.ci95[k]
    lower = bool(estimate.gradient[k] > 0)
    return Diagnostic(Kind.PARAMETER_AT_BOUND, (parameters.names[k],), {
        "side": "lower" if lower else "upper", "bound": float((parameters.lower if lower else parameters.upper)[k]),
        "unit": parameters.units[k], "beyond": "below" if lower else "above", "limit": float(high if lower else low)})
