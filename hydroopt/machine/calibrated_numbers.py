"""A machine with calibrated numbers and their standard deviations in the place of those of its file."""

from __future__ import annotations

import math
from collections.abc import Mapping

from hydroopt.machine.flat_loops import closed_flat
from hydroopt.machine.links import Note
from hydroopt.machine.machine import Machine


def with_calibrated(machine: Machine, found: Mapping[str, tuple[float, float]], source: str,
                    held: Mapping[str, float] | None = None) -> Machine:
    """The machine with numbers by address, each its value and standard deviation in SI; other addresses are left out.

    A vector keeps the largest confidence of its own numbers, and correlations are lost. One whose standard deviation is
    not known keeps the confidence of the file. `held` are values that were chosen, whose notes stay.

    Raises:
        MachineError: no machine can have these numbers.

    >>> from hydroopt.machine.machine_file import load_machine
    >>> machine = with_calibrated(load_machine("cat215b"), {"boom.a": (5.2, 1e-3)}, "calibrated")
    >>> machine.link("boom").joint.a, machine.notes["boom.joint.a"].sigma
    (5.2, 0.001)
    """
    numbers, widest, of_paths = machine.numbers, dict[str, float](), dict(machine.notes)
    values, notes = {name: value for name, value in (held or {}).items() if name in numbers}, dict[str, Note]()
    for name, (value, std) in found.items():
        if name not in numbers:
            continue
        path, known = numbers[name].path, {}
        if math.isfinite(std) and std > 0:
            widest[path] = max(widest.get(path, 0.0), std)
            known = {"sigma": widest[path], "relative": False}
        values[name] = value
        notes[name] = of_paths[path] = of_paths.get(path, Note()).model_copy(update={**known, "source": source})
    return machine.with_values(closed_flat(machine, values), notes)
