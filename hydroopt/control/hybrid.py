"""Hybrid control of the tip: force along the normal of a wall, position along the wall (Figure 1 of the thesis)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from hydroopt.control.axes import Axes
from hydroopt.control.cascade import Cascade, Gains
from hydroopt.control.linear_plant import SHORTEST, Reading
from hydroopt.control.reference import Demand
from hydroopt.control.setting import ModelVariant
from hydroopt.control.valve_inversion import Valves
from hydroopt.errors import ProblemError
from hydroopt.simulation.simulate import Trajectory
from hydroopt.spatial.inertia import Array


class ForceGains(NamedTuple):
    """Feedback of the normal force.

    Attributes:
        proportional: normal speed of the tip per error of the force [m/(s·N)].
        integral_time: T_i of the integral action [s].
        filter_time: time constant of a low pass on the estimated force [s].
        fastest: normal speed [m/s] that force control demands at most, also of the approach.
    """

    proportional: float
    integral_time: float
    filter_time: float
    fastest: float


@dataclass(frozen=True, eq=False)
class Pressing:
    """A motion along a wall with a normal force.

    Attributes:
        motion: of the joints at the samples (N, n), along the wall where it is thought to be; its `wrench` (N, 6) is
            what the wall exerts on the tip, which position control feeds forward.
        normal: (3,) out of the wall, of length one.
        force: normal force (N,) [N] that is demanded.
    """

    motion: Trajectory
    normal: Array
    force: Array


class Hybrid(Cascade):
    """A cascade that controls position only along a wall, and across it the force that the model finds in pressures.

    With the speeds ẋ = J·q̇ of the tip, l̇ = T·q̇ of the actuators and P = 1 − n·nᵀ, the actuators' position loops keep
    T·J⁻¹·P·J·T⁻¹ of their errors and of their speeds: what moves the tip along the wall (the selection matrix of
    Raibert and Craig 1981, resolved to speeds, since a valve sets a speed). Across the wall the tip moves at
    K_F·(f + ∫f/T_i) towards it, with f the demanded force less the estimated one, and at most at `fastest`: without
    contact it so approaches the wall, wherever that is. The estimate is the force at the tip that explains the actuator
    forces by the model (`Model.tip_wrench`), at the measured posture and the demanded speeds and accelerations; no
    sensor at the tip is needed, and errors of the model's masses, friction and offsets are errors of the force.

    Raises:
        ProblemError: the machine has not three joints that move its tip, each with an actuator of its own.
    """

    def __init__(self, valves: Valves, demand: Demand, gains: Gains, period: float, *, variant: ModelVariant,
                 pressing: Pressing, force_gains: ForceGains) -> None:
        model, path, axes = variant.model, pressing.motion, Axes(valves.plant)
        n = len(model.machine.joints)
        if n != 3 or not axes.one_each:
            raise ProblemError(f"{n} joints move the tip, by {len(axes.of)} actuators", where=model.machine.name,
                               remedy="hybrid control is for machines with three joints, which place the tip, each "
                               "with an actuator of its own; follow the motion by position alone")
        super().__init__(valves, demand, gains, period)
        self.variant, self.pressing, self.force_gains = variant, pressing, force_gains
        J = model.over(model.tip_jacobian, path.q)[0][:, :3]
        T = np.stack([valves.plant.model.over(valves.plant.actuator_motion, path.q, np.tile(unit, (len(path.q), 1)))[1][
            :, :, 0] for unit in np.eye(n)], axis=2)
        to_actuators = T @ np.linalg.inv(J)
        along = np.eye(3) - np.outer(pressing.normal, pressing.normal)
        self._along = to_actuators @ along @ np.linalg.inv(to_actuators)
        self._across = -to_actuators @ pressing.normal
        self._decay = np.exp(-period / max(force_gains.filter_time, SHORTEST))
        self._estimate, self._force_integral = np.nan, 0.0

    def reset(self) -> None:
        """Return to the initial state."""
        super().reset()
        self._estimate, self._force_integral = np.nan, 0.0

    def _controlled(self, k: int, error: Array) -> Array:
        return np.asarray(self._along[k] @ error)

    def estimated_force(self, k: int, reading: Reading) -> float:
        """Normal force [N] of the wall on the tip by pressures and model, without the low pass."""
        path, model = self.pressing.motion, self.variant.model
        wrench, _ = model.tip_wrench(reading.q, path.qd[k], path.qdd[k], reading.force, self.variant.psi)
        return float(self.pressing.normal @ np.asarray(wrench)[:3, 0])

    def _speed(self, k: int, reading: Reading) -> Array:
        gains, found = self.force_gains, self.estimated_force(k, reading)
        self._estimate = found if np.isnan(self._estimate) else (
            self._decay * self._estimate + (1 - self._decay) * found)
        error = self.pressing.force[k] - self._estimate
        wanted = gains.proportional * (error + self._force_integral)
        limited = float(np.clip(wanted, -gains.fastest, gains.fastest))
        if limited == wanted or error * wanted < 0:  # anti-windup: the integral is held while the speed is limited
            self._force_integral += self.period * error / gains.integral_time
        return np.asarray(self._along[k] @ super()._speed(k, reading) + self._across[k] * limited)
