"""What position control regulates: one axis for each joint that oil moves, however many actuators share it."""

from __future__ import annotations

from functools import cached_property
from typing import TypeVar

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from hydroopt.errors import ProblemError
from hydroopt.model.plant import Plant
from hydroopt.spatial.inertia import Array

Sharing = TypeVar("Sharing", Array, ca.SX)


class Axes:
    """The axes of a machine with n joints, a actuators and m joints that oil moves.

    An actuator that alone is there to move a joint is an axis of its own, whose position is its length or angle. Where
    several share a joint, the axis is the joint itself: its regulator demands a speed of the joint, of which each
    actuator takes what its lever arm makes of it, so that they do not work against each other. Passive joints and those
    of the base have no axis.

    Attributes:
        plant: the machine.
        names: of the axes: the actuator's, or the shared joint's.
        actuators: of each axis, their places in `Plant.actuators`.
        of: the axis (a,) of each actuator; own: 1 there (a, m), 0 elsewhere.
        joints: of each axis, the place of its joint.
        places: of the axes' positions (m,) among those of the joints and the lengths of actuators behind them.

    >>> from hydroopt.machine.machine_file import load_machine
    >>> Axes(Plant(load_machine("backhoe"))).names
    ('swing', 'boom_cylinder', 'stick_cylinder', 'bucket_cylinder')
    """

    def __init__(self, plant: Plant) -> None:
        self.plant = plant
        if shared := tuple(plant.machine.redundant):
            raise ProblemError(f"more actuators than joints move {', '.join(shared)} together, between which position "
                               "control does not choose", where=plant.machine.name, remedy="state as many as joints")
        self.actuators = tuple(plant.drivers.values())
        self.names = tuple(joint if len(places) > 1 else plant.actuators[places[0]].actuator.name
                           for joint, places in plant.drivers.items())
        self.of = np.array([next(i for i, places in enumerate(self.actuators) if k in places)
                            for k in range(len(plant.actuators))])
        self.joints = [plant.machine.joints.index(joint) for joint in plant.drivers]
        self.own: Array = np.eye(len(self.names))[self.of]
        self._joint: Array = np.eye(len(plant.machine.joints))[:, self.joints]
        self._shared: Array = self.own * np.array([len(places) > 1 for places in self.actuators])
        self._alone = self.own - self._shared
        self.places = np.array([joint if len(places) > 1 else len(plant.machine.joints) + places[0]
                                    for joint, places in zip(self.joints, self.actuators, strict=True)])

    @property
    def one_each(self) -> bool:
        """Whether every joint has an actuator of its own."""
        return len(self.plant.machine.joints) == len(self.names) == len(self.of)

    def units(self, axis: int) -> str:
        """Unit of an axis' position: m or rad."""
        return self.plant.machine.position_unit(self.plant.machine.joints[self.joints[axis]])

    def positions(self, q: Array, length: Array) -> Array:
        """Positions (..., m) of the axes from those of joints (..., n) and the lengths of actuators (..., a)."""
        return np.asarray(np.concatenate([q, length], axis=-1)[..., self.places])

    def slopes(self, lever_arm: Array) -> Array:
        """Speeds (m, n) of the axes per speed of each joint, at lever arms (a, n)."""
        return np.asarray(np.vstack([np.eye(lever_arm.shape[1]), lever_arm])[self.places])

    def shares(self, lever_arm: Sharing) -> Sharing:
        """Speeds (..., a, m) of the actuators per speed of their own axis, at lever arms (..., a, n), or symbolic ones.
        """
        made: Sharing = lever_arm @ self._joint * self._shared + self._alone
        return made

    def shares_along(self, q: Array) -> Array:
        """`shares` (N, a, m) in postures (N, n)."""
        return np.asarray(self.shares(self.plant.model.over(self.plant.transmission, q)[0]))

    def open(self, opening: Array) -> NDArray[np.bool_]:
        """Whether no valve (a,) of an axis (m,) is fully open."""
        found = np.ones(len(self.names), dtype=bool)
        found[self.of[np.abs(opening) >= 1]] = False
        return found

    @cached_property
    def measured(self) -> NDArray[np.bool_]:
        """Whether the forces of the actuators (a,) are measured."""
        return np.array([each.actuator.measured for each in self.plant.actuators])
