"""Simulated machines to weigh with: everything the file calls uncertain is drawn, and more goes wrong than it says."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from scipy.signal import lfilter

from hydroopt import Log, Model, ProblemError, random_trajectory, random_truth
from hydroopt.machine.actuators import Drive
from hydroopt.machine.balances import undriven
from hydroopt.model.carried_load import carried_load
from hydroopt.model.kinematics import gravity_in_base
from hydroopt.simulation.passive_joints import passive_motion
from hydroopt.simulation.simulate import BACK_PRESSURE, Trajectory, forces
from hydroopt.spatial.inertia import Array, from_centre_of_mass

RATE = 50.0
CALIBRATION = 60.0
"""Rate [Hz] of all logs, and duration [s] of the one that calibrates."""
LOAD_FRICTION = 0.01
"""Standard deviation of the friction per force, of which the absolute value counts."""


@dataclass(frozen=True)
class Carrier:
    """A bundled machine that weighs: the link that carries, where the load's centre is expected there [m], largest load
    [kg]."""

    machine: str
    link: str
    centre: tuple[float, float, float]
    full_scale: float


CAT = Carrier("cat215b", "stick", (1.8, 0.0, 0.0), 2500.0)
OTHERS = (Carrier("excavator_bucket", "bucket", (0.85, 0.4, 0.0), 2500.0),
          Carrier("wheel_loader", "bucket", (0.42, 0.28, 0.0), 1500.0),
          Carrier("backhoe", "bucket", (0.5, 0.2, 0.0), 600.0),
          Carrier("forestry_crane", "rotator", (0.0, 0.0, 0.8), 600.0))
STEPS = 10
"""Number of steps in which the mass at passive joints grows while a load leaves the ground."""


@dataclass(frozen=True)
class Noise:
    """What pressures do besides the white errors of their sensors.

    Attributes:
        pulsation: amplitude of a sine in all chambers [Pa], its frequency drawn from 2 to 6 Hz, as a pump's strokes
            and valves make it.
        memory: time constant of the sensor's errors [s], which then are a first-order process of the same size.
        wander: standard deviation of a random walk of each zero after a minute [Pa].
    """

    pulsation: float = 0.0
    memory: float = 0.0
    wander: float = 0.0

    def of(self, t: Array, std: float, rng: np.random.Generator, pulses: Array) -> Array:
        """(N,) error of one chamber's reading [Pa], white errors apart."""
        error = self.pulsation * pulses
        if self.memory:
            kept = np.exp(-(t[1] - t[0]) / self.memory)
            error = error + lfilter([std * np.sqrt(1 - kept**2)], [1, -kept], rng.standard_normal(len(t)))
        if self.wander:
            steps = rng.standard_normal(len(t)) * self.wander * np.sqrt((t[1] - t[0]) / 60)
            error = error + np.cumsum(steps)
        return error


WHITE = Noise()


@dataclass(frozen=True)
class Session:
    """What a machine does and carries while it weighs.

    Attributes:
        motion: of the joints.
        mass: (N,) of the load [kg].
        centre: (3,) of the load from where it is expected [m].
        slope: roll and pitch of the base [rad]; none where several actuators share a balance.
        drift: standard deviation of each pressure's zero since the calibration [Pa].
        noise: of the pressures.
    """

    motion: Trajectory
    mass: Array
    centre: Array
    slope: tuple[float, float] = (0.0, 0.0)
    drift: float = 0.0
    noise: Noise = WHITE


class SwingsTooFarError(Exception):
    """A drawn load swings beyond the range of its joint, so that there is nothing to weigh."""


@dataclass(frozen=True)
class SimulatedMachine:
    """A machine's truth: its parameters ψ (p,) and its friction per force (r,)."""

    carrier: Carrier
    model: Model
    psi: Array
    load_friction: Array

    @classmethod
    def drawn(cls, carrier: Carrier, model: Model, seed: int) -> SimulatedMachine:
        """A machine drawn from the file's confidences."""
        rng = np.random.default_rng([seed, 1])
        friction = np.abs(rng.normal(0.0, LOAD_FRICTION, len(model.machine.measured_actuators)))
        return cls(carrier, model, random_truth(model, seed), friction)

    def calibration(self, seed: int, noise: Noise = WHITE) -> Log:
        """The log without load that identifies the machine, on level ground."""
        motion = random_trajectory(self.model, duration=CALIBRATION, rate=RATE, seed=seed)
        return self.log(Session(motion, np.zeros(len(motion.t)), np.zeros(3), noise=noise), seed, "calibration")

    def swinging(self, session: Session, load: Array) -> Trajectory:
        """The motion in which passive joints follow the others, with what a load adds to ψ (p,) per mass.

        Raises:
            SwingsTooFarError: a passive joint leaves its range.
        """
        motion, mass = session.motion, session.mass
        if not undriven(self.model.machine.balances):
            return motion
        step = np.round(STEPS * mass / max(np.max(mass), 1e-300))
        edges = [0, *(np.flatnonzero(np.diff(step)) + 1).tolist(), len(mass) - 1]
        made = [np.array(each) for each in (motion.q, motion.qd, motion.qdd)]
        for first, last in pairwise(edges):
            if first < last:
                here, psi = slice(first, last + 1), self.psi + mass[first:last].mean() * load
                before = made[0][here], made[1][here], made[2][here]
                try:
                    parts = passive_motion(self.model, motion.t[here], before, psi)
                except ProblemError as error:
                    raise SwingsTooFarError from error
                for whole, part in zip(made, parts, strict=True):
                    whole[here] = part
        return replace(motion, q=made[0], qd=made[1], qdd=made[2])

    def log(self, session: Session, seed: int, name: str = "weighing") -> Log:
        """What the sensors record of a session."""
        model, machine = self.model, self.model.machine
        rng = np.random.default_rng([seed, 2])
        body = from_centre_of_mass(1.0, session.centre, [0.05, 0, 0, 0.05, 0, 0.05])
        load = carried_load(model, self.carrier.link, self.carrier.centre) @ body
        motion = self.swinging(session, load)
        places = [machine.actuators.index(each) for each in machine.measured_actuators]
        force = forces(model, motion, self.psi)
        if session.mass.any():
            force = force + session.mass[:, None] * (forces(model, motion, self.psi + load) - force)
        force = force[:, places]
        roll, pitch = session.slope
        if roll or pitch:  # balances are the actuators' forces
            g = np.asarray(gravity_in_base(machine)).ravel()
            tilted = machine.gravity * np.array([np.sin(pitch), -np.cos(pitch) * np.sin(roll),
                                                 -np.cos(pitch) * np.cos(roll)])
            psi = self.psi + np.outer(session.mass, load)
            force = force + model.over(model.gravity_forces, motion.q, psi)[0] @ (tilted - g)
        speed = np.einsum("naj,nj->na", model.over(model.transmission, motion.q)[0][:, places], motion.qd)
        force = force + self.load_friction * np.abs(force) * np.sign(speed)
        channels = {f"{joint}.q": motion.q[:, k] for k, joint in enumerate(machine.joints)}
        for k, actuator in enumerate(machine.measured_actuators):
            if isinstance(actuator, Drive):
                raise TypeError("electric drives have no chambers")
            (area, other), (pushing, pulling) = actuator.areas, actuator.chambers
            back = BACK_PRESSURE * (1 + 2 * rng.random())
            forward = force[:, k] + other * back > area * back
            channels[pushing] = np.where(forward, (force[:, k] + other * back) / area, back)
            channels[pulling] = np.where(forward, back, (area * back - force[:, k]) / other)
        phase, hertz = rng.uniform(0, 2 * np.pi), rng.uniform(2, 6)
        pulses = np.sin(2 * np.pi * hertz * motion.t + phase)
        for channel, values in channels.items():
            sensor, pressure = machine.sensor(channel), not channel.endswith(".q")
            if sensor is None:
                raise LookupError(channel)
            zero = rng.normal(0.0, session.drift or 1e-300) if pressure else 0.0
            extra = session.noise.of(motion.t, sensor.std, rng, pulses) if pressure else 0.0
            white = 0.0 if pressure and session.noise.memory else sensor.accuracy
            channels[channel] = sensor.model_copy(update={"accuracy": white}).read(values + zero + extra, rng)
        return Log(name, motion.t, channels, units={c: machine.channel_units[c] for c in channels})


def pick_up(t: Array, mass: float, begin: float, duration: float) -> Array:
    """(N,) mass of a load that leaves the ground within `duration` [s], smoothly."""
    part = np.clip((t - begin) / duration, 0.0, 1.0)
    return mass * part**2 * (3 - 2 * part)
