"""Diagnostics of identified valves and oil."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from hydroopt.estimation.hydraulic.bounded_gaussian import SHARE, BoundedGaussian, WeakDirection
from hydroopt.results.diagnostic import Diagnostic, Meaning
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
            yield Diagnostic.of("flow not explained by the model", (actuator,), {"factor": float(factor)}, (
                "The flow of {subject} differs from the model by {factor:.1f} times what its sensors' errors leave; "
                "the intervals are widened."),
                "Check the sensors' accuracy and the signs of commands, and whether edges and directions differ "
                "(flow_pa, dead_band_reverse).", Meaning.CONTRADICTION)


def late_commands(actuators: Sequence[str], later: Array) -> Iterator[Diagnostic]:
    """Actuators whose commands arrive at another time than the machine file states, by `Adjustment.later` (a, 2)."""
    for actuator, (by, std) in zip(actuators, later, strict=True):
        if abs(by) > max(LATE * std, BARELY):
            yield Diagnostic.of("commands arrive at another time than stated", (actuator,), {
                "by": float(abs(by)), "std": float(std), "sense": "later" if by > 0 else "earlier"},
                "The commands of {subject} arrive about {by:.2g} s {sense} than the machine file's delay says (± "
                "{std:.1g} s); spool and intervals are wrong by that.",
                "State a 'sigma' of its valve's 'delay', which is then identified, or correct the clocks of the log.",
                Meaning.CONTRADICTION)


def exact_delays(actuators: Sequence[str], later: Array) -> Iterator[Diagnostic]:
    """Actuators whose delay is not identified, by `Adjustment.later` (a, 2)."""
    some = [k for k in range(len(actuators)) if np.isfinite(later[k, 1]) and LATE * later[k, 1] > BARELY]
    if some:
        yield Diagnostic.of("delay taken as exact", tuple(actuators[k] for k in some), {
            "least": float(LATE * np.max(later[some, 1]))},
            "The delays of {subject} count as exact, since the machine file states no 'sigma' of them; these logs "
            "would show an error from {least:.2g} s on, and smaller ones end in the spools' numbers.",
            "State a 'sigma' of each valve's 'delay', which is then identified.")


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
            return Diagnostic.of("no information in the data", names, evidence, (
                "The logs carry no information on {subject}; {determined_by} determines it."),
                "Record a motion that excites it, or remove its sigma.", Meaning.PROPERTY)
        k = members[0]
        reach = 1.96 * abs(weak.direction[k]) / np.sqrt(weak.information)
        return Diagnostic.of("little information in the data", names, {
            **evidence, "low": float(max(theta[k] - reach, parameters.lower[k])),
            "high": float(min(theta[k] + reach, parameters.upper[k])), "unit": parameters.units[k]},
            "The logs alone admit {subject} from {low:.3g} to {high:.3g} {unit}; {determined_by} determines it within.",
            meaning=Meaning.PROPERTY)
    if len(names) == 2 and np.all(theta[members] != 0):
        relative = weak.direction[members] / theta[members]
        if abs(abs(relative[0] / relative[1]) - 1) < SHARE:
            form = "ratio" if relative[0] * relative[1] > 0 else "product"
            return Diagnostic.of("only a ratio or product identifiable", names, evidence | {"form": form}, (
                "The logs determine only the {form} of {subject}; {determined_by} determines each."),
                meaning=Meaning.PROPERTY)
    return Diagnostic.of("only a combination identifiable", names, evidence, (
        "The logs determine {subject} only in combination; {determined_by} determines each."),
        meaning=Meaning.PROPERTY)


def _at_bound(estimate: BoundedGaussian, k: int) -> Diagnostic:
    """A parameter that a bound holds, with the other end of its interval."""
    parameters, (low, high) = estimate.parameters, estimate.ci95[k]
    lower = bool(estimate.gradient[k] > 0)
    return Diagnostic.of("parameter at a bound", (parameters.names[k],), {
        "side": "lower" if lower else "upper", "bound": float((parameters.lower if lower else parameters.upper)[k]),
        "unit": parameters.units[k], "beyond": "below" if lower else "above", "limit": float(high if lower else low)},
        "{subject} is at its {side} bound, {bound:.3g} {unit}; 95 % of its probability lies {beyond} {limit:.3g} "
        "{unit}.")
