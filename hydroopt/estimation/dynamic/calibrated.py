"""The calibrated machine: the nominal description with the estimate's numbers and their confidences."""

from __future__ import annotations

from typing import Any

import numpy as np

from hydroopt.errors import ProblemError
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
    data: dict[str, Any] = machine.model_dump(exclude={"notes"})
    notes = dict(machine.notes)
    parts = {part["name"]: part for key in ("links", "cylinders", "motors", "drives", "gas_cylinders")
             for part in data[key]}
    confidence = np.where(np.isfinite(estimate.std), estimate.std, prior_std(problem.parameters))
    for owner, owned in dynamic_parameters.bodies(machine).items():
        name, _, end = owner.partition(".")
        holder = parts[name][end] if end else parts[name]
        for key in ("m", "com", "mc", "inertia_com", "inertia"):
            notes.pop(f"{owned.path}.{key}", None)
        if f"{owner}.m" not in problem.parameters.positions:
            holder["body"] = None
            continue
        k = problem.parameters.index(f"{owner}.m")
        phi = estimate.psi[k : k + 10].tolist()
        stated = {key: holder["body"][key] for key in ("shape", "symmetric")}
        holder["body"] = {"m": phi[0], "mc": phi[1:4], "inertia": phi[4:], **stated}
        for key, span in (("m", slice(k, k + 1)), ("mc", slice(k + 1, k + 4)), ("inertia", slice(k + 4, k + 10))):
            notes[f"{owned.path}.{key}"] = _note(estimate, span, confidence, source)
    for one in data["identical"]:
        one["bodies"] = [owner for owner in one["bodies"] if f"{owner}.m" in problem.parameters.positions]
    data["identical"] = [one for one in data["identical"] if one["bodies"] or one["friction"]]
    scalars = dynamic_parameters.passive_scalars(machine)
    for joint in machine.joints:
        scalars |= dynamic_parameters.scalars(machine, joint)
    for name, scalar in scalars.items():
        k = problem.parameters.index(name)
        first, *steps, last = scalar.path.split(".")
        node = parts[first]
        for step in steps:
            node = node[step]
        node[last] = float(estimate.psi[k])
        before = machine.notes.get(scalar.path, Note())
        notes[scalar.path] = _note(estimate, slice(k, k + 1), confidence, source).model_copy(
            update={"lower": before.lower, "upper": before.upper})
    try:
        return Machine.model_validate(data | {"notes": notes})
    except ValueError as error:  # what no bound or constraint says, such as seals as wide as the rod side
        said = str(error).partition("Value error, ")[2].partition("; ")[0]
        raise ProblemError(said or "its numbers cannot be", where=f"{machine.name} by {estimate.method}",
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
