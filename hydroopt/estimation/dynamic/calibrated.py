"""The calibrated machine: the nominal description with the estimate's numbers and their confidences."""

from __future__ import annotations

from itertools import chain

import numpy as np

from hydroopt.errors import MachineError, ProblemError
from hydroopt.estimation.dynamic.identification import Identification
from hydroopt.estimation.inference.certificate import AT_BOUND
from hydroopt.machine.links import Note
from hydroopt.machine.machine import Machine
from hydroopt.parameters import dynamic as dynamic_parameters
from hydroopt.spatial.inertia import Array


def calibrated_machine(estimate: Identification) -> Machine:
    """Machine with the identified bodies (about their frames' origins), friction and offsets, and their confidences.

    Parameters that are not identifiable keep the confidence of the file. The machine is a prior for other logs:
    identifying it again from the same ones would count them twice. The reduced model has no barrels and rods; the links
    carry their share.

    Raises:
        ProblemError: a body is not physically consistent, a friction is negative or beyond its bounds, or a statement
            of the file does not hold, so that no machine can have these numbers.
    """
    problem = estimate.problem
    machine, names = problem.model.machine, problem.parameters.names
    where = f"{machine.name} by {estimate.algorithm}"
    if own := list(chain.from_iterable(term.addresses for term in problem.model.terms)):
        raise ProblemError(f"a machine file cannot state force terms of the user's own: {', '.join(own)}", where=where,
                           remedy="keep the parameters with the model, or identify without the terms")
    impossible = [owner for owner, smallest in estimate.consistency.items() if smallest < 0]
    bounded = np.clip(estimate.psi, problem.parameters.lower, problem.parameters.upper)
    rounded = abs(bounded - estimate.psi) <= AT_BOUND * problem.parameters.scale
    psi = np.where(rounded, bounded, estimate.psi)
    below = [name for name, value, low in zip(names, psi, problem.parameters.lower, strict=True) if value < low]
    if impossible or below:
        raise ProblemError(f"{', '.join([*impossible, *below])} cannot exist",
                           where=where, remedy="identify with method 'sdp'")
    broken = [condition.name for condition in problem.conditions if condition.margin(estimate.psi) < -AT_BOUND]
    if broken:
        raise ProblemError(f"{'; '.join(dict.fromkeys(broken))}: this does not hold",
                           where=where, remedy="identify with method 'sdp'")
    logs = ", ".join(each.log.path or each.log.name for each in problem.experiments)
    source = f"identified by {estimate.algorithm} from {logs}"
    confidence = np.where(np.isfinite(estimate.std), estimate.std, problem.parameters.prior_std)
    values = dict(zip(names, psi.tolist(), strict=True))
    notes, numbers = dict[str, Note](), machine.numbers
    for columns in problem.parameters.bodies.values():
        k = columns.start
        for span in (slice(k, k + 1), slice(k + 1, k + 4), slice(k + 4, k + 10)):
            notes |= dict.fromkeys(names[span], _note(estimate, span, confidence, source))
    for k, (name, kind) in enumerate(zip(names, problem.parameters.kinds, strict=True)):
        if not kind.is_inertial:
            before = machine.notes.get(numbers[name].path, Note())
            notes[name] = _note(estimate, slice(k, k + 1), confidence, source).model_copy(
                update={"lower": before.lower, "upper": before.upper})
    try:
        left_out = dynamic_parameters.bodies(machine).keys() - problem.parameters.bodies.keys()
        return (machine.without_bodies(left_out) if left_out else machine).with_values(values, notes)
    except MachineError as error:  # limits without bound or constraint, such as seals as wide as the rod side
        raise ProblemError(error.what, where=where,
                           remedy="state a confidence or bounds of it, or identify with method 'sdp'") from None


def _note(estimate: Identification, span: slice, confidence: Array, source: str) -> Note:
    """Source and confidence of some parameters: of a vector, the largest; numbers that were not identified say so."""
    names = estimate.problem.parameters.names[span]
    if any(name in estimate.problem.fixed for name in names):
        return Note(source="held at a value chosen by the user")
    known = confidence[span][np.isfinite(confidence[span]) & (confidence[span] > 0)]
    identified = [name for name, std in zip(names, estimate.std[span], strict=True) if np.isfinite(std)]
    missing = ", ".join(name for name in names if name not in identified)
    origin = f"{source}; not identified: {missing}" if missing else source
    first = estimate.problem.parameters.index(names[0])
    if any(estimate.category(first + k) == "stated" for k in range(len(names))):
        stated = (one.name for one in estimate.problem.own_statements if np.any(one.row[span]) and not one.at_least)
        origin = f"from the constraint or prior {', '.join(repr(name) for name in dict.fromkeys(stated))}; {origin}"
    return Note(sigma=float(np.max(known)) if known.size else None,
                source=origin if identified else "nominal, not identified")
