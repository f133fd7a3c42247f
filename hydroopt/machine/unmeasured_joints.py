"""Joints whose equation of motion is lost, since an actuator there is not measured."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from hydroopt.machine.actuators import Actuator, Cylinder
from hydroopt.machine.machine import Machine


class UnmeasuredJoint(NamedTuple):
    """A joint without a balance: forces there are neither predicted nor compared with any log.

    Attributes:
        joint: its name.
        actuators: that are there to move it.
        unmeasured: names of those that no log measures.
    """

    joint: str
    actuators: tuple[Actuator, ...]
    unmeasured: tuple[str, ...]

    @property
    def remedy(self) -> str:
        """What to do about it: measure, or state equal cylinders with the same oil as jacks of one."""
        measure = f"measure {' and '.join(self.unmeasured)}"
        sizes = [each.areas for each in self.actuators if isinstance(each, Cylinder)]
        if 1 < len(sizes) == len(self.actuators) and np.ptp(sizes, axis=0).max() <= 1e-6 * np.max(sizes):
            measure += (f", or if these {len(sizes)} cylinders share their oil state one in their place with "
                        f"jacks = {len(sizes)}")
        return measure


def unmeasured_joints(machine: Machine) -> tuple[UnmeasuredJoint, ...]:
    """Every joint that has no balance though something moves it; none of those that the ground moves.

    >>> from hydroopt.machine.machine_file import load_machine
    >>> unmeasured_joints(load_machine("cat215b"))
    ()
    """
    return tuple(UnmeasuredJoint(joint, actuators, lost) for joint, actuators in machine.drivers.items()
                 if joint not in machine.base_joints
                 and (lost := tuple(each.name for each in actuators if not each.measured)))
