"""Simulation of the closed loop: the true plant between samples, sensors with errors, commands with delays."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from hydroopt.control.linear_plant import SHORTEST, Reading, in_samples
from hydroopt.control.reference import Demands, offset
from hydroopt.errors import SolverError
from hydroopt.kernels.integrator import IntegrationError
from hydroopt.kernels.virtual_machine import OneSample
from hydroopt.machine.machine import Machine
from hydroopt.model.plant import Plant
from hydroopt.spatial.inertia import Array
from hydroopt.support.progress import Progress, silent

REPORTED = 200
"""Samples after which progress is reported."""
OVERRUN = 0.2
"""Part of a joint's range by which it may exceed its limits; beyond that the machine hits its stops and the run
ends."""
LEAST_STD = 1e-4
"""Standard deviation [rad or m] of a joint's reading that estimators count with at least."""


class Controller(Protocol):
    """A sampled controller."""

    def reset(self) -> None:
        """Return to the initial state."""

    def command(self, k: int, reading: Reading) -> Array:
        """Commands (a,) at sample k."""


@dataclass(frozen=True, eq=False)
class Run:
    """One simulated run of the closed loop.

    Attributes:
        t: times (N,) of the samples.
        q: joint positions (N, n).
        u: commands (N, a) after saturation, before the valves' delays.
        pressure: of the chambers (N, a, 2) [Pa].
        flow: into the valves (N, a) [m³/s].
        p_supply: (N,) [Pa].
        contact: force (N, 3) [N] of the plant's wall on the tip, in the base frame.
        stopped: why the run ended early, in words, with arrays that end there; "" if it did not.
    """

    t: Array
    q: Array
    u: Array
    pressure: Array
    flow: Array
    p_supply: Array
    contact: Array
    stopped: str

    @property
    def energy(self) -> float:
        """Energy drawn from the supply [J]."""
        return float(np.trapezoid(self.p_supply * np.sum(self.flow, axis=1), self.t))


class Sensors:
    """Readings of angles, chamber pressures and supply pressure, with the errors, lags and rates that the machine file
    states."""

    def __init__(self, plant: Plant, offsets: Array, bias: Array | None, period: float, seed: int | None) -> None:
        machine, n = plant.machine, len(plant.machine.joints)
        channels = [*(f"{joint}.q" for joint in machine.joints),
                    *(name for each in plant.actuators for name in each.chambers), "pump.p_supply"]
        self.areas = np.array([each.areas for each in plant.actuators])
        self.added = np.zeros(len(channels))
        # the offset of the measured force is added to the pressure of chamber a
        self.added[n:-1:2] = offsets / self.areas[:, 0]
        if bias is not None:
            self.added[:n] = bias
        self.sensors = [machine.sensor(name) for name in channels]
        # one slower than the controller holds its last reading in between
        self.every = [max(1, round(1 / (each.rate * period))) if each and each.rate else 1 for each in self.sensors]
        lags = np.array([machine.lag(name).value for name in channels])
        self.follows = -np.expm1(-period / np.maximum(lags, SHORTEST))
        self.rng = None if seed is None else np.random.default_rng(seed)
        self.behind: Array | None = None
        self.held = np.zeros(len(channels))

    def read(self, k: int, q: Array, pressure: Array, p_supply: Array | float) -> Array:
        """Readings (m,) at sample k."""
        true = np.concatenate([q, pressure.ravel(), [p_supply]]) + self.added
        self.behind = true if self.behind is None else self.behind + self.follows * (true - self.behind)
        for i, (sensor, every) in enumerate(zip(self.sensors, self.every, strict=True)):
            if k % every == 0:
                self.held[i] = sensor.read(self.behind[i:i + 1], self.rng)[0] if sensor else self.behind[i]
        return self.held.copy()


def reading_std(machine: Machine, channel: str, least: float = LEAST_STD) -> float:
    """Standard deviation of the readings of a channel, at least the given one, which counts where none is stated."""
    sensor = machine.sensor(channel)
    return max(sensor.std, least) if sensor else least


def simulate(demands: Demands, controller: Controller, plant: Plant, psi: Array, theta: Array, *,
             seed: int | None = 0, bias: Array | None = None, progress: Progress = silent) -> Run:
    """Simulate a controller that drives the machine along a motion and starts on it.

    Args:
        demands: motion and samples, by the plant as the controller knows it.
        controller: what drives it.
        plant: the true one.
        psi: its dynamic parameters (p,).
        theta: its hydraulic ones.
        seed: of the sensors' errors; None for sensors without any.
        bias: by which the readings of the joints' angles are off (n,) [rad or m]; None for no bias.
        progress: receives the part of the motion that is done.

    Raises:
        ProblemError: the motion's start cannot be held.
        SolverError: the plant could not be integrated.
    """
    t = demands.t
    machine, n, period, supply = plant.machine, len(plant.machine.joints), float(t[1] - t[0]), plant.supply
    first = demands.reference.at(t[:1])
    steady = plant.steady(first.q[0], first.qd[0], psi, theta)
    sensors = Sensors(plant, offset(plant, plant.model, psi), bias, period, seed)
    delay = CommandDelay(plant.delays, period, steady.u)
    integrator, motion = plant.integrator(psi, theta), OneSample(demands.plant.actuator_motion)
    lower, upper = machine.ranges.T
    middle, reach = (lower + upper) / 2, (0.5 + OVERRUN) * (upper - lower)
    least, most = demands.valves.limits
    x, stopped = steady.x, ""
    states, acting, commands = [], [], []
    controller.reset()
    for k in range(len(t)):
        if k % REPORTED == 0:
            progress("", k / len(t))
        q = x[:n]
        if np.any(np.abs(q - middle) > reach):
            stopped = f"the machine hits its stops at {t[k]:.2f} s"
            break
        readings = sensors.read(k, q, plant.chamber_pressures(x), plant.supply_pressure(x))
        p, angles = readings[n:-1].reshape(-1, 2), readings[:n]
        force = sensors.areas[:, 0] * p[:, 0] - sensors.areas[:, 1] * p[:, 1]
        reading = Reading(angles, motion(angles, angles)[0], force, p, np.array([readings[-1], supply[1]]))
        u = np.minimum(np.maximum(controller.command(k, reading), least), most)
        states.append(x)
        acting.append(delay.current)
        commands.append(u)
        try:
            for seconds, command in delay.push(u):
                x = integrator(x, seconds, command, supply)
        except IntegrationError:
            raise SolverError(f"the plant cannot be integrated beyond {t[k]:.2f} s", where="closed loop",
                              remedy="check the numbers of its circuits, or lower the gains") from None
    x, done = np.array(states), len(states)
    pushed = [plant.flow_and_contact(*each, psi, theta) for each in zip(states, acting, strict=True)]
    flow, contact = (np.array(column) for column in zip(*pushed, strict=True))
    return Run(t[:done], x[:, :n], np.array(commands), plant.chamber_pressures(x), flow,
               np.broadcast_to(plant.supply_pressure(x), done), contact, stopped)


def tip(plant: Plant, q: Array) -> Array:
    """Positions (N, 3) [m] of the last link's far end in the base frame."""
    model = plant.model
    return np.asarray(model.over(model.forward_kinematics, q)[-1][:, :3, 3])


class CommandDelay:
    """The valves' delays: which commands act in which part of a sampling period."""

    def __init__(self, delays: Array, period: float, u: Array) -> None:
        whole, part = in_samples(delays, period)
        edges = np.unique([0.0, *part, period])
        self.lengths = np.diff(edges).tolist()
        self.history = np.tile(u, (int(np.max(whole)) + 2, 1))  # newest first
        self.each = np.arange(len(u))
        self.ago = [whole + (part > start) for start in edges[:-1]]
        self.current = u

    def push(self, u: Array) -> list[tuple[float, Array]]:
        """Enter new commands; returns the pieces of the next period, each with its length [s] and the commands acting
        in it."""
        self.history[1:] = self.history[:-1].copy()
        self.history[0] = u
        pieces = [(length, self.history[ago, self.each]) for length, ago in zip(self.lengths, self.ago, strict=True)]
        self.current = pieces[-1][1]
        return pieces
