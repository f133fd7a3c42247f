"""How much the margins of loops depend on the numbers of valves and oil, which are known to a confidence only."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from hydroopt.control.loop_margins import disk_margins
from hydroopt.control.loops import Loops
from hydroopt.control.sampled_plant import Point, linearised, point, sampled
from hydroopt.errors import ProblemError
from hydroopt.model.plant import Plant
from hydroopt.spatial.inertia import Array


class LostMargin(NamedTuple):
    """What a number of valves or oil takes from the disk margin of a loop where it is off by one standard deviation.

    Attributes:
        loop: the actuator at whose command it is cut.
        parameter: the number.
        std: its standard deviation by the machine file.
        unit: of the standard deviation.
        disk: the loop's disk margin, see `Margin`.
        lost: by the worse of both signs; 0 if neither takes any.
    """

    loop: str
    parameter: str
    std: float
    unit: str
    disk: float
    lost: float


def lost_margins(plant: Plant, at: Point, loops: Loops, psi: Array, theta: Array) -> tuple[LostMargin, ...]:
    """Of every loop at a point, by every number that the machine file states a confidence of.

    The controller stays as it is, the machine changes. Numbers with which it could not move at the point are left out.

    Args:
        plant: the machine as it is known.
        at: the operating point.
        loops: at this point.
        psi: dynamic parameters (p,) that are known.
        theta: hydraulic ones.
    """
    known = plant.parameters
    names = [each.actuator.name for each in plant.actuators]
    found: list[LostMargin] = []
    try:
        disks = _disks(plant, at, loops, psi, theta)
    except ProblemError:  # the machine can move here, but not as it is known
        return ()
    for k in np.flatnonzero(np.diag(known.information) > 0):
        std, least = float(known.scale[k]), disks
        for side in (-std, std):
            moved = theta.copy()
            moved[k] = np.clip(theta[k] + side, known.lower[k], known.upper[k])
            try:
                least = np.minimum(least, _disks(plant, at, loops, psi, moved))
            except ProblemError:
                continue
        found += [LostMargin(name, known.names[k], std, known.units[k], float(disk), float(disk - low))
                  for name, disk, low in zip(names, disks, least, strict=True)]
    return tuple(found)


def _disks(plant: Plant, at: Point, loops: Loops, psi: Array, theta: Array) -> Array:
    """Disk margins (a,) of the loops of a machine with other numbers."""
    moved = point(plant, at.name, at.q, at.qd, psi, theta)
    held = sampled(linearised(plant, moved, psi, theta), plant.delays, loops.plant.dt)
    return disk_margins(held, loops.feedback)
