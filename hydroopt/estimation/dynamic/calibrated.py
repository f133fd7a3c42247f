"""The calibrated machine: the nominal description with the estimate's numbers and their confidences."""

from __future__ import annotations

import numpy as np

from hydroopt.errors import MachineError, ProblemError
from hydroopt.estimation.dynamic.estimate import Estimate
from hydroopt.machine.components import Note
from hydroopt.machine.machine import Machine
from hydroopt.parameters import dynamic as dynamic_parameters
from hydroopt.parameters.parameter_set import ParameterSet
from hydroopt.spatial.inertia import Array


def calibrated_machine(estimate: Estimate) -> Machine:
    """Machine with the identified bodies (about their frames' origins), friction and offsets, and their confidences.

    What the data did not show keeps the confidence it had. The file is a prior for other logs: identifying again on
    the same ones would count them twice. Of the reduced model barrels and rods are left out, whose part the links took.

    Raises:
        ProblemError: a body is impossible, a friction negative or beyond its bounds, or something that the file states
            does not hold, so that no machine could have these numbers.
    """
    problem = estimate.problem
    machine, names = problem.model.machine, problem.parameters.names
    impossible = [owner for owner, smallest in estimate.consistency.items() if smallest < 0]
    below = [name for k, name in enumerate(names) if estimate.psi[k] < problem.parameters.lower[k] - 1e-9]
    if impossible or below:
        raise ProblemError(f"{', '.join([*impossible, *below])} cannot exist",
                           where=f"{machine.name} by {estimate.method}", remedy="identify with method 'sdp'")
    broken = [condition.name for condition in problem.conditions if condition.margin(estimate.psi) < -1e-6]
    if broken:
        raise ProblemError(f"{'; '.join(dict.fromkeys(broken))}: this does not hold",
                           where=f"{machine.name} by {estimate.method}", remedy="identify with method 'sdp'")
    source = f"identified by {estimate.method} from {', '.join(e.log.path or e.log.name for e in problem.experiments)}"
    confidence = np.where(np.isfinite(estimate.std), estimate.std, prior_std(problem.parameters))
    values = dict(zip(names, estimate.psi.tolist(), strict=True))
    notes: dict[str, Note] = {}
    for columns in problem.parameters.bodies.values():
        k = columns.start
        for span in (slice(k, k + 1), slice(k + 1, k + 4), slice(k + 4, k + 10)):
            notes |= dict.fromkeys(names[span], _note(estimate, span, confidence, source))
    for k, (name, kind) in enumerate(zip(names, problem.parameters.kinds, strict=True)):
        if not kind.is_inertial:
            before = machine.notes.get(machine.numbers[name].path, Note())
            notes[name] = _note(estimate, slice(k, k + 1), confidence, source).model_copy(
                update={"lower": before.lower, "upper": before.upper})
    try:
        left_out = dynamic_parameters.bodies(machine).keys() - problem.parameters.bodies.keys()
        return machine.without_bodies(left_out).with_values(values, notes)
    except MachineError as error:  # what no bound or constraint says, such as seals as wide as the rod side
        raise ProblemError(error.what, where=f"{machine.name} by {estimate.method}",
                           remedy="state a confidence or bounds of it, or identify with method 'sdp'") from None


def prior_std(parameters: ParameterSet) -> Array:
    """Standard deviations (p,) of the machine file's priors, NaN where it states none."""
    return np.where(np.diag(parameters.information) > 0, parameters.scale, np.nan)


def _note(estimate: Estimate, span: slice, confidence: Array, source: str) -> Note:
    """One confidence for a whole vector can only be its largest; numbers that were not identified say so."""
    names = estimate.problem.parameters.names[span]
    if any(name in estimate.problem.fixed for name in names):
        return Note(source="held at a value chosen by the user")
    known = confidence[span][np.isfinite(confidence[span]) & (confidence[span] > 0)]
    seen = [name for name, std in zip(names, estimate.std[span], strict=True) if np.isfinite(std)]
    missing = ", ".join(name for name in names if name not in seen)
    said = f"{source}; not shown by the data: {missing}" if missing else source
    return Note(sigma=float(np.max(known)) if known.size else None, source=said if seen else "nominal, not identified")
