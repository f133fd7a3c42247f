"""All loops of a controller at one operating point: frequency responses, poles, zeros and step responses."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from hydroopt.control.linear_system import LinearSystem, closed_loop
from hydroopt.control.loop_margins import responses
from hydroopt.spatial.inertia import Array


@dataclass(frozen=True, eq=False)
class Loops:
    """Machine and controller about an operating point, with the gains that the controller has there.

    All systems have names and become python-control's by `LinearSystem.python_control`.

    Attributes:
        point: its name.
        omega: frequencies (ω,) [rad/s].
        cut: L(jω) (a, ω) of each loop, cut at its valve's command while all others are closed.
        plant: the true machine, sampled, with its valves' delays, from commands to readings; its states are scaled.
        feedback: the controller, from readings to commands.
        joints: places of the joints that actuators move among the readings.
    """

    point: str
    omega: Array
    cut: Array
    plant: LinearSystem
    feedback: LinearSystem
    joints: tuple[int, ...]

    @cached_property
    def closed(self) -> LinearSystem:
        """From references of the joints' positions, which are fed back alone, to these positions."""
        names = tuple(self.plant.outputs[k].removesuffix("_measured") for k in self.joints)
        return closed_loop(self.plant, self.feedback, self.joints, names)

    @cached_property
    def poles(self) -> Array:
        """Of the closed loops, in the z plane."""
        return self.closed.poles

    @cached_property
    def zeros(self) -> Array:
        """Transmission zeros of the closed loops, in the z plane."""
        return self.closed.zeros

    def at(self, omega: Array) -> Loops:
        """The same loops at other frequencies (ω,) [rad/s]."""
        return replace(self, omega=omega, cut=responses(self.plant, self.feedback, omega))

    def steps(self, seconds: float) -> tuple[Array, Array]:
        """Times (N,), and (N, m) the position of each joint after a unit step of its own reference."""
        t = np.asarray(np.arange(int(seconds / self.plant.period) + 1) * self.plant.period, dtype=float)
        return t, np.diagonal(self.closed.steps(len(t)), axis1=1, axis2=2)
