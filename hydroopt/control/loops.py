"""All loops of a controller at one operating point: frequency responses, poles, zeros and step responses."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import control
import numpy as np
from control import StateSpace

from hydroopt.control.loop_margins import responses
from hydroopt.spatial.inertia import Array

INFINITE = 1e8
"""Size from which on a zero counts as one at infinity."""


@dataclass(frozen=True, eq=False)
class Loops:
    """Machine and controller about an operating point, with the gains that the controller has there.

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
    plant: StateSpace
    feedback: StateSpace
    joints: tuple[int, ...]

    @cached_property
    def closed(self) -> StateSpace:
        """From references of the joints' positions, which are fed back alone, to these positions."""
        names = [self.plant.output_labels[k].removesuffix("_measured") for k in self.joints]
        open_loop, joints = self.plant * self.feedback, list(self.joints)
        # readings y = P·C·(y − r)
        closed = -control.feedback(open_loop, np.eye(open_loop.noutputs), sign=1)[joints, joints]
        return control.ss(closed, inputs=[f"{name}_reference" for name in names], outputs=names,
                          states=[*self.feedback.state_labels, *self.plant.state_labels])

    @cached_property
    def poles(self) -> Array:
        """Of the closed loops, in the z plane."""
        return np.asarray(self.closed.poles())

    @cached_property
    def zeros(self) -> Array:
        """Transmission zeros of the closed loops, in the z plane."""
        found = self.closed.zeros()
        return np.asarray(found[np.abs(found) < INFINITE])

    def at(self, omega: Array) -> Loops:
        """The same loops at other frequencies (ω,) [rad/s]."""
        return replace(self, omega=omega, cut=responses(self.plant, self.feedback, omega))

    def steps(self, seconds: float) -> tuple[Array, Array]:
        """Times (N,), and (N, m) the position of each joint after a unit step of its own reference."""
        t = np.asarray(np.arange(int(seconds / self.plant.dt) + 1) * self.plant.dt, dtype=float)
        return t, np.diagonal(control.step_response(self.closed, t, squeeze=False).outputs)
