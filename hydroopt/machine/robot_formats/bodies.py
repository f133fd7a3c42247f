"""Bodies as robot formats state them: mass, centre of mass, and moments of inertia about it."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from hydroopt.spatial import inertia
from hydroopt.spatial.inertia import Array


class CentralInertia(NamedTuple):
    """Mass [kg], centre of mass (3,) [m] and moments of inertia ``xx…zz`` (6,) [kg·m²] about it, along the frame."""

    m: float
    com: Array
    six: Array

    def pseudo(self) -> Array:
        """The pseudo-inertia (4, 4) about the frame's origin."""
        return inertia.pseudo_inertia(inertia.from_centre_of_mass(self.m, self.com, self.six))


def central(pseudo: Array) -> CentralInertia:
    """What a pseudo-inertia (4, 4) is about the centre of mass; that of no mass is the origin."""
    m = float(pseudo[3, 3])
    com = pseudo[:3, 3] / (m or 1.0)
    about = np.zeros((4, 4))
    about[:3, :3], about[3, 3] = pseudo[:3, :3] - m * np.outer(com, com), m
    return CentralInertia(m, com, inertia.from_pseudo_inertia(about)[4:])
