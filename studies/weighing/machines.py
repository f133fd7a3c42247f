"""Simulated machines to weigh with: everything the file calls uncertain is drawn, and more goes wrong than it says."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hydroopt import Log, Model, random_trajectory, random_truth
from hydroopt.logs import sensors
from hydroopt.model.carried_load import carried_load
from hydroopt.model.kinematics import gravity_in_base
from hydroopt.simulation.simulate import BACK_PRESSURE, Trajectory
from hydroopt.spatial.inertia import Array, from_centre_of_mass

RATE = 50.0
CALIBRATION = 60.0
"""Rate [Hz] of all logs, and duration [s] of the one that calibrates."""
LOAD_FRICTION = 0.01
"""Standard deviation of the friction per force, of which the absolute value counts."""
LINK, PIN = "stick", (1.8, 0.0, 0.0)
"""What carries the load, and where it hangs [m]."""


@dataclass(frozen=True)
class Session:
    """What a machine does and carries while it weighs.

    Attributes:
        motion: of the joints.
        mass: (N,) of the load [kg].
        centre: (3,) of the load from `PIN` [m].
        slope: roll and pitch of the base [rad].
        drift: standard deviation of each pressure's zero since the calibration [Pa].
    """

    motion: Trajectory
    mass: Array
    centre: Array
    slope: tuple[float, float] = (0.0, 0.0)
    drift: float = 0.0


@dataclass(frozen=True)
class SimulatedMachine:
    """A machine's truth: its parameters ψ (p,) and its friction per force (r,)."""

    model: Model
    psi: Array
    load_friction: Array

    @classmethod
    def drawn(cls, model: Model, seed: int) -> SimulatedMachine:
        """A machine drawn from the file's confidences."""
        rng = np.random.default_rng([seed, 1])
        friction = np.abs(rng.normal(0.0, LOAD_FRICTION, len(model.machine.balances)))
        return cls(model, random_truth(model, seed), friction)

    def calibration(self, seed: int) -> Log:
        """The log without load that identifies the machine, on level ground."""
        motion = random_trajectory(self.model, duration=CALIBRATION, rate=RATE, seed=seed)
        return self.log(Session(motion, np.zeros(len(motion.t)), np.zeros(3)), seed, "calibration")

    def log(self, session: Session, seed: int, name: str = "weighing") -> Log:
        """What the sensors record of a session."""
        model, machine, motion = self.model, self.model.machine, session.motion
        rng = np.random.default_rng([seed, 2])
        body = from_centre_of_mass(1.0, session.centre, [0.05, 0, 0, 0.05, 0, 0.05])
        psi = self.psi + np.outer(session.mass, carried_load(model, LINK, PIN) @ body)
        force = model.over(model.inverse_dynamics, motion.q, motion.qd, motion.qdd, psi)[0][:, :, 0]
        roll, pitch = session.slope
        g = np.asarray(gravity_in_base(machine)).ravel()
        tilted = machine.gravity * np.array([np.sin(pitch), -np.cos(pitch) * np.sin(roll),
                                             -np.cos(pitch) * np.cos(roll)])
        force += model.over(model.gravity_forces, motion.q, psi)[0] @ (tilted - g)
        arms = model.over(model.transmission, motion.q)[0]
        speed = np.einsum("naj,nj->na", arms, motion.qd)
        force += self.load_friction * np.abs(force) * np.sign(speed)
        channels = {f"{joint}.q": motion.q[:, k] for k, joint in enumerate(machine.joints)}
        for k, actuator in enumerate(machine.actuators):
            area, other, pushing, pulling = (*actuator.areas, *actuator.chambers)
            back = BACK_PRESSURE * (1 + 2 * rng.random())
            forward = force[:, k] + other * back > area * back
            channels[pushing] = np.where(forward, (force[:, k] + other * back) / area, back)
            channels[pulling] = np.where(forward, back, (area * back - force[:, k]) / other)
        for channel, values in channels.items():
            sensor = machine.sensor(channel)
            zero = 0.0 if channel.endswith(".q") else rng.normal(0.0, session.drift or 1e-300)
            channels[channel] = sensors.measure(values + zero, sensor.accuracy, sensor.resolution, rng,
                                                sensor.distribution)
        return Log(name, motion.t, channels, units={c: machine.channel_units[c] for c in channels})


def pick_up(t: Array, mass: float, begin: float, duration: float) -> Array:
    """(N,) mass of a load that leaves the ground within `duration` [s], smoothly."""
    part = np.clip((t - begin) / duration, 0.0, 1.0)
    return mass * part**2 * (3 - 2 * part)
