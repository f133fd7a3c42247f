"""Planar loops that stay closed along their axes while other numbers of the machine change."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from hydroopt.machine.addresses import AXES
from hydroopt.machine.geometry import Geometry
from hydroopt.machine.machine import Machine


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
