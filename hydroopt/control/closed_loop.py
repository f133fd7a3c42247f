"""Simulation of the closed loop: the true plant between samples, sensors with errors, commands with delays."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from hydroopt.control.reference import Demands, offset
from hydroopt.control.sampled_plant import Reading
from hydroopt.errors import SolverError
from hydroopt.logs.sensors import measure
from hydroopt.model.plant import Plant
from hydroopt.spatial.inertia import Array

OVERRUN = 0.2
"""Part of a joint's range by which it may exceed its limits; beyond that the machine hits its stops and the run
ends."""


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

    def __init__(self, plant: Plant, offsets: Array, period: float, seed: int | None) -> None:
        machine = plant.machine
        names = [f"{joint}.q" for joint in machine.joints]
        for each in plant.actuators:
            names += each.chambers
        self.channels = [*names, "pump.p_supply"]
        self.sensors = [machine.sensor(name) for name in self.channels]
        # a sensor slower than the controller holds its last reading in between
        self.every = [max(1, round(1 / (sensor.rate * period))) if sensor and sensor.rate else 1
                      for sensor in self.sensors]
        self.areas = np.array([each.areas for each in plant.actuators])
        self.added = np.zeros(len(self.channels))
        # the offset of the measured force is added to the pressure of chamber a
        self.added[len(machine.joints):-1:2] = offsets / self.areas[:, 0]
        self.rng = None if seed is None else np.random.default_rng(seed)
        self.held = np.zeros(len(self.channels))
        lags = np.array([machine.lag(name).value for name in self.channels])
        self.follows = -np.expm1(-period / np.maximum(lags, 1e-12))
        self.behind = np.full(len(self.channels), np.nan)

    def read(self, k: int, q: Array, pressure: Array, p_supply: float) -> Array:
        """Readings (m,) at sample k."""
        true = np.array([*q, *pressure.ravel(), p_supply]) + self.added
        before = np.where(np.isnan(self.behind), true, self.behind)
        true = self.behind = before + self.follows * (true - before)
        for i, sensor in enumerate(self.sensors):
            if k % self.every[i] == 0:
                self.held[i] = true[i] if sensor is None or self.rng is None else float(measure(
                    true[i], sensor.accuracy, sensor.resolution, self.rng, sensor.distribution))
        return self.held


def simulate(demands: Demands, controller: Controller, psi: Array, theta: Array, *,
             seed: int | None = 0) -> Run:
    """Simulate a controller that drives the machine along a motion and starts on it.

    Args:
        demands: plant, motion and samples.
        controller: what drives it.
        psi: true dynamic parameters (p,).
        theta: true hydraulic ones.
        seed: of the sensors' errors; None for sensors without any.

    Raises:
        ProblemError: the motion's start cannot be held.
        SolverError: the plant could not be integrated.
    """
    plant, t = demands.plant, demands.t
    machine, n, period = plant.machine, len(plant.machine.joints), float(t[1] - t[0])
    first = demands.reference.at(t[:1])
    steady = plant.steady(first.q[0], first.qd[0], psi, theta)
    sensors = Sensors(plant, offset(plant, plant.model, psi), period, seed)
    delay = CommandDelay(np.array([each.valve.delay for each in plant.actuators]), period, steady.u)
    steps = {seconds: plant.integrator(seconds, psi, theta) for seconds in delay.pieces}
    lower, upper = np.array([machine.link(joint).joint.range for joint in machine.joints]).T
    overrun = OVERRUN * (upper - lower)
    x, tank, stopped = steady.x, plant.supply[1], ""
    rows: list[tuple[Array, ...]] = []
    controller.reset()
    for k in range(len(t)):
        outputs = plant.outputs.call({"x": x, "u": delay.current, "supply": plant.supply, "psi": psi, "theta": theta})
        q, flow = (np.asarray(outputs[key]).ravel() for key in ("q", "flow"))
        pressure, p_supply = np.asarray(outputs["pressure"]), float(outputs["p_supply"])
        contact = np.asarray(outputs["contact"]).ravel()
        if np.any((q < lower - overrun) | (q > upper + overrun)):
            stopped = f"the machine hits its stops at {t[k]:.2f} s"
            break
        readings = sensors.read(k, q, pressure, p_supply)
        p = readings[n:-1].reshape(-1, 2)
        angles = readings[:n].copy()
        length = np.asarray(plant.actuator_motion(angles, angles)[0]).ravel()
        force = sensors.areas[:, 0] * p[:, 0] - sensors.areas[:, 1] * p[:, 1]
        reading = Reading(angles, length, force, np.array([readings[-1], tank]))
        u = np.clip(controller.command(k, reading), *demands.valves.limits)
        rows.append((q, u, pressure, flow, np.array(p_supply), contact))
        try:
            for seconds, command in delay.push(u):
                x = np.asarray(steps[seconds](x, command, plant.supply)).ravel()
        except RuntimeError:
            raise SolverError(f"the plant cannot be integrated beyond {t[k]:.2f} s", where="control",
                              remedy="check the numbers of its circuits, or lower the gains") from None
    q, u, pressure, flow, supply, pushed = (np.array(column) for column in zip(*rows, strict=True))
    return Run(t[:len(rows)], q, u, pressure, flow, supply, pushed, stopped)


class CommandDelay:
    """The valves' delays: which commands act in which part of a sampling period."""

    def __init__(self, delays: Array, period: float, u: Array) -> None:
        self.whole = np.floor(delays / period * (1 + 1e-12)).astype(int)
        part = np.round(np.maximum(delays - self.whole * period, 0.0), 12)
        edges = np.unique([0.0, *part, period])
        self.starts, self.lengths = edges[:-1], np.diff(edges)
        self.pieces = set(self.lengths.tolist())
        self.part = part
        self.history = np.tile(u, (int(np.max(self.whole)) + 2, 1))  # newest first
        self.current = u

    def push(self, u: Array) -> list[tuple[float, Array]]:
        """Enter new commands; returns the pieces of the next period, each with its length [s] and the commands acting
        in it."""
        self.history = np.vstack([u, self.history[:-1]])
        each = np.arange(len(u))
        pieces = [(float(length), self.history[self.whole + (self.part > start), each])
                  for start, length in zip(self.starts, self.lengths, strict=True)]
        self.current = pieces[-1][1]
        return pieces
