"""The calibrated machine: the nominal description with the estimate's numbers and their confidences."""

from __future__ import annotations

from typing import Any

import numpy as np

from hydroopt import dynamic_parameters
from hydroopt.errors import ProblemError
from hydroopt.estimation.estimate import Estimate
from hydroopt.machine import Machine
from hydroopt.parts import Note


def calibrated_machine(estimate: Estimate) -> Machine:
    """Machine with the identified bodies (about their frames' origins), friction and offsets.

    Raises:
        ProblemError: a body is impossible or a friction negative, so that no machine could have these numbers.
    """
    problem = estimate.problem
    machine, names = problem.model.machine, problem.parameters.names
    impossible = [owner for owner, smallest in estimate.consistency.items() if smallest < 0]
    below = [name for k, name in enumerate(names) if estimate.psi[k] < problem.parameters.lower[k] - 1e-9]
    if impossible or below:
        raise ProblemError(f"{', '.join([*impossible, *below])} cannot exist",
                           where=f"{machine.name} by {estimate.method}", remedy="identify with method 'sdp'")
    source = f"identified by {estimate.method} from {', '.join(e.log.path or e.log.name for e in problem.experiments)}"
    data: dict[str, Any] = machine.model_dump(exclude={"notes"})
    notes = dict(machine.notes)
    parts = {part["name"]: part for key in ("links", "cylinders", "motors", "drives", "gas_cylinders")
             for part in data[key]}
    for owner, owned in dynamic_parameters.bodies(machine, actuator_inertia=problem.model.actuator_inertia).items():
        k = problem.parameters.index(f"{owner}.m")
        phi, std = estimate.psi[k : k + 10].tolist(), estimate.std[k : k + 10]
        name, _, end = owner.partition(".")
        (parts[name][end] if end else parts[name])["body"] = {"m": phi[0], "mc": phi[1:4], "inertia": phi[4:]}
        for key in ("com", "inertia_com"):
            notes.pop(f"{owned.path}.{key}", None)
        for key, span in (("m", slice(0, 1)), ("mc", slice(1, 4)), ("inertia", slice(4, 10))):
            notes[f"{owned.path}.{key}"] = _note(std[span], source, notes.get(f"{owned.path}.{key}"))
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
        notes[scalar.path] = _note(estimate.std[k : k + 1], source, notes.get(scalar.path))
    return Machine.model_validate(data | {"notes": notes})


def _note(std: Any, source: str, before: Note | None) -> Note:
    """One confidence for a whole vector can only be its largest; without any, the nominal one stays."""
    known = std[np.isfinite(std) & (std > 0)]
    if not known.size:
        return before or Note(source=source)
    bounds = {"lower": before.lower, "upper": before.upper} if before else {}
    return Note(sigma=float(np.max(known)), source=source, **bounds)
