"""A machine with calibrated numbers and their standard deviations in the place of those of its file."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from hydroopt.machine.addresses import AXES
from hydroopt.machine.geometry import Geometry
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


def closed_flat(machine: Machine, values: Mapping[str, float]) -> dict[str, float]:
    """Numbers by address, in SI, and with them the places of pins that close planar loops along their axes.

    A loop that closes by a pin leaves open where its pins are along their axis: of calibrated numbers it is the pin of
    the other link that follows.

    >>> from hydroopt.machine.machine_file import load_machine
    >>> closed_flat(load_machine("excavator_bucket"), {"rocker.pin.z": 0.002})["bucket_linkage.z"]
    0.002
    """
    found = dict(values)
    for loop in machine.loops:
        if loop.closed_by != "pin":
            continue
        geometry = Geometry(machine, {name: value for name, value in found.items() if name in machine.numbers})
        aside = float(geometry.loop_gap(loop, {})[2])
        axis = np.asarray(geometry.from_seat(geometry.loop_axis(loop), loop.to.link, {}).rotation)[2]
        if aside:
            found |= {address: float(geometry.value[address]) - aside * float(along) for address, along in zip(
                (f"{loop.name}.{each}" for each in AXES), axis, strict=True) if along}
    return found


def standing_for(machine: Machine, other: Machine) -> Machine:
    """The machine itself, with the `source` of the one for which it stands, so that commands name that one.

    >>> from hydroopt.machine.machine_file import load_machine
    >>> machine = load_machine("cat215b")
    >>> standing_for(machine.with_values({"boom.a": 5.2}), machine).source
    'cat215b'
    """
    machine.__dict__["source"] = other.source
    return machine
