"""Valves, oil and friction from commands, pressures and motion: the plant's numbers as a shooting problem."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from hydroopt.errors import IdentifiabilityError, ProblemError
from hydroopt.estimation.hydraulic.dynamics import Dynamics, Record, ShootingProblem
from hydroopt.estimation.inference.identifiability import PREDICTED_TOLERANCE, significant
from hydroopt.logs.log import Log
from hydroopt.logs.readings import measured_angles, reading
from hydroopt.logs.smoothing import SmoothingSpline, condition
from hydroopt.machine.components import Cylinder
from hydroopt.machine.machine import Machine
from hydroopt.model.hydraulics import displaced
from hydroopt.model.model import Model
from hydroopt.model.plant import Plant
from hydroopt.parameters.parameter_set import ParameterKind, ParameterSet
from hydroopt.simulation.drive_valves import arrived
from hydroopt.spatial.inertia import Array

SUPPLY = ("pump.p_supply", "pump.p_tank")
"""Channels of the pressures that feed and drain the valves."""
LONGEST = 0.01
"""Collocated interval [s] that follows spools and dry friction well enough: twice as long ones bend spools' numbers by
a standard deviation."""
RANDOM = 200
"""States at which forces are looked at to tell what of bodies they show."""
AT_WORST = 3.0
"""How many of its σ a dead band may be smaller than stated, before a command counts as never leaving it."""


@dataclass(frozen=True, eq=False)
class HydraulicProblem:
    """What is to be identified from which logs; solving never changes it.

    Attributes:
        plant: the machine with its valves.
        logs: to learn from; `validation` those held out.
        parameters: what is identified: friction and numbers of the hydraulics that state a `sigma`, then, where bodies
            are asked for, what forces can show of these, in standard deviations of the machine file.
        psi, theta: positions of the first two among the plant's dynamic and hydraulic parameters.
        bodies: (p, b) how the plant's dynamic parameters change with the last b.
        channels: what the sensors see, as far as logs have it; `sigma` of their readings.
        steps: collocated intervals between two samples; as many as keep them below `LONGEST` if None.
    """

    plant: Plant
    logs: tuple[Log, ...]
    validation: tuple[Log, ...]
    parameters: ParameterSet
    psi: NDArray[np.intp]
    theta: NDArray[np.intp]
    bodies: Array
    channels: tuple[str, ...]
    sigma: Array
    steps: int | None = None

    def split(self, values: Any) -> tuple[Any, Any]:
        """Dynamic and hydraulic parameters of the plant (p,), (h,) from those identified: numbers or symbols."""
        model, friction = self.plant.model, len(self.psi)
        made = []
        moved = ca.DM(self.bodies) @ values[friction + len(self.theta) :]
        for nominal, at, part in ((ca.DM(model.parameters.nominal) + moved, self.psi, values[:friction]),
                                  (ca.DM(self.plant.parameters.nominal), self.theta,
                                   values[friction : friction + len(self.theta)])):
            whole = type(moved)(nominal)
            whole[at.tolist()] = part
            made.append(whole)
        return made[0], made[1]

    @cached_property
    def dynamics(self) -> Dynamics:
        """The plant as a function of what is identified."""
        plant, n = self.plant, len(self.plant.inputs)
        x, u, free = ca.SX.sym("x", len(plant.states)), ca.SX.sym("u", n + 2), ca.SX.sym("p", len(self.parameters))
        given = (x, u[:n], u[n:], *self.split(free))
        seen = dict(zip(plant.seen.name_out(), plant.seen(*given), strict=True))
        values = [_channel(plant, seen, channel) for channel in self.channels]
        return Dynamics(ca.Function("rates", [x, u, free], [plant.rates(*given)]),
                        ca.Function("seen", [x, u, free], [ca.vertcat(*values)]), plant.states,
                        (*plant.inputs, *SUPPLY), self.channels, plant.scale, np.array([True] * n + [False] * 2))

    def records(self, log: Log) -> tuple[Record, ...]:
        """One for each uninterrupted stretch of a log.

        Raises:
            LogError: a channel that is needed is missing.
            ProblemError: the supply's pressure is neither logged nor stated.
        """
        plant, machine = self.plant, self.plant.machine
        angles = measured_angles(plant.model, log)
        motion = condition(log.t, angles, log.segment, SmoothingSpline(bandwidth=machine.bandwidth),
                           names=machine.joints, where=log.path or log.name)
        u = np.column_stack([*(arrived(log.t, reading(machine, log, name), each.valve.delay)
                               for name, each in zip(plant.inputs, plant.actuators, strict=True)),
                             *_supply(plant, log)])
        y = np.column_stack([log.channels[channel] if channel in log.channels else np.full(log.size, np.nan)
                             for channel in self.channels])
        guess = {f"{joint}.{key}": values[:, k] for k, joint in enumerate(machine.joints)
                 for key, values in (("q", motion.q), ("qd", motion.qd))}
        for k, each in enumerate(plant.actuators):
            owner = each.actuator.name
            guess |= {f"{owner}.spool": _placed(plant, k, u[:, k]), f"{owner}.spool_rate": np.zeros(log.size)}
            guess |= {channel: reading(machine, log, channel) for channel in each.chambers}
        guess[SUPPLY[0]] = log.channels.get(SUPPLY[0], u[:, -2])
        states = np.column_stack([guess[name] for name in plant.states])
        edges = np.flatnonzero(np.diff(log.segment, prepend=log.segment[0] - 1, append=log.segment[-1] + 1))
        spans = [slice(a, b) for a, b in pairwise(edges.tolist()) if b - a > 1]
        steps = self.steps or max(1, math.ceil(float(np.median(np.diff(log.t))) / LONGEST - 1e-3))
        return tuple(Record(log.t[at], u[at], y[at], states[at], steps=steps, name=log.path or log.name)
                     for at in spans)

    @cached_property
    def shooting(self) -> ShootingProblem:
        """The problem as the solver takes it."""
        records = tuple(record for log in self.logs for record in self.records(log))
        return ShootingProblem(self.dynamics, self.parameters, self.sigma, records, self.plant.machine.name)


def hydraulic_problem(machine: Machine, logs: Sequence[Log], validation: Sequence[Log] = (), *,
                     bodies: bool = False, steps: int | None = None) -> HydraulicProblem:
    """The identification of valves, oil and friction from logs, with the machine file's confidences as priors.

    Every number of the hydraulics that states a `sigma` is identified, and every friction that does; all others are
    exact.

    Args:
        machine: with a circuit for every actuator, and sensors.
        logs: to learn from: commands, motion and pressures of all actuators.
        validation: logs to judge by.
        bodies: whether masses and inertias are identified, too, as far as forces show them; else they are exact, as
            after an identification of their own.
        steps: collocated intervals between two samples; as many as keep them below `LONGEST` if None. More follow dry
            friction and the edges of valves more exactly.

    Raises:
        ProblemError: the file states no circuit, no confidence or no sensors, or a supply pressure is neither logged
            nor stated.
        LogError: a command, a pressure or a motion is missing.
        IdentifiabilityError: no command leaves its dead band.
    """
    plant = Plant(Model(machine))
    for log in (*logs, *validation):
        for channel in (*plant.inputs, *(c for each in plant.actuators for c in each.chambers)):
            reading(machine, log, channel)
    _refuse_idle(plant, logs)
    psi, theta = _identified(plant)
    if not len(psi) + len(theta):
        raise ProblemError("no number of the hydraulics states a confidence, so that nothing is identified",
                           where=f"machine '{machine.name}'",
                           remedy="give a 'sigma' to the flows, dead bands, volumes and moduli that are in doubt")
    shown = _shown(plant.model) if bodies else np.zeros((len(plant.model.parameters), 0))
    channels, sigma = _sensed(plant, logs)
    parameters = _joined(plant, psi, theta, shown.shape[1])
    return HydraulicProblem(plant, tuple(logs), tuple(validation), parameters, psi, theta, shown, channels, sigma,
                            steps)


def _identified(plant: Plant) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Positions of what states a confidence: friction and gas pressures among ψ, and the hydraulics' numbers."""
    dynamic, hydraulic = plant.model.parameters, plant.parameters
    free = [k for k, kind in enumerate(dynamic.kinds) if dynamic.information[k, k] > 0
            and (kind.is_friction or kind is ParameterKind.GAS_PRESSURE)]
    return np.array(free, dtype=np.intp), np.flatnonzero(np.diag(hydraulic.information) > 0)


def _shown(model: Model) -> Array:
    """(p, b) the directions of the bodies' parameters that forces show, each as long as one standard deviation.

    In units of the priors' standard deviations the row space of the regressor; nothing is learned across it.
    """
    parameters, machine = model.parameters, model.machine
    bodies = np.flatnonzero([kind.is_inertial for kind in parameters.kinds])
    information = parameters.information[np.ix_(bodies, bodies)]
    unknown = np.diag(information) == 0
    values, vectors = np.linalg.eigh(information + np.diag(unknown * 1.0))
    root = vectors / np.sqrt(values) * ~unknown[:, None]
    rng = np.random.default_rng(0)
    lower, upper = np.array([machine.link(joint).joint.range for joint in machine.joints]).T
    states = [rng.uniform(lower, upper, (RANDOM, len(lower))), *rng.standard_normal((2, RANDOM, len(lower)))]
    extra = [np.zeros((RANDOM, len(lower)))] if model.needs_pressure else []
    K = model.over(model.regressor, *states, *extra)[0].reshape(-1, len(parameters))[:, bodies]
    _, size, directions = np.linalg.svd(K @ root, full_matrices=False)
    slope = np.zeros((len(parameters), int(np.sum(significant(size, PREDICTED_TOLERANCE)))))
    slope[bodies] = root @ directions[: slope.shape[1]].T
    return slope


def _joined(plant: Plant, psi: NDArray[np.intp], theta: NDArray[np.intp], bodies: int) -> ParameterSet:
    parts = [(plant.model.parameters, psi), (plant.parameters, theta)]
    names = [one.names[k] for one, at in parts for k in at] + [f"bodies.{k + 1}" for k in range(bodies)]
    kinds = [one.kinds[k] for one, at in parts for k in at] + [ParameterKind.BODY_DIRECTION] * bodies
    units = [one.units[k] for one, at in parts for k in at] + ["1"] * bodies

    def numbers(key: str, rest: float) -> Array:
        return np.concatenate([*(getattr(one, key)[at] for one, at in parts), np.full(bodies, rest)])

    information = np.concatenate([*(np.diag(one.information)[at] for one, at in parts), np.ones(bodies)])
    return ParameterSet(tuple(names), tuple(kinds), tuple(units), numbers("nominal", 0.0), numbers("lower", -np.inf),
                        numbers("upper", np.inf), numbers("scale", 1.0), np.diag(information))


def _sensed(plant: Plant, logs: Sequence[Log]) -> tuple[tuple[str, ...], Array]:
    """Channels that some log has, with the σ of their sensors; the supply's pressure only if it has a sensor.

    Raises:
        ProblemError: the file does not state a sensor.
    """
    machine = plant.machine
    there = [channel for channel in _seen(plant) if any(channel in log.channels for log in logs)
             and (channel != SUPPLY[0] or machine.sensor(channel))]
    stated = {channel: sensor.std for channel in there if (sensor := machine.sensor(channel)) is not None}
    missing = [channel for channel in there if not stated.get(channel, 0.0) > 0]
    if missing:
        raise ProblemError(f"how well {', '.join(missing)} is measured is not said", where=f"machine '{machine.name}'",
                           remedy="state the accuracy in [[sensors]]")
    return tuple(there), np.array([stated[channel] for channel in there])


def _seen(plant: Plant) -> Iterator[str]:
    """Channels that the plant can tell."""
    for joint in plant.machine.joints:
        yield f"{joint}.q"
    for each in plant.actuators:
        if isinstance(each.actuator, Cylinder):
            yield f"{each.actuator.name}.length"
        yield from each.chambers
    if plant.states[-1] == SUPPLY[0]:
        yield SUPPLY[0]


def _channel(plant: Plant, seen: dict[str, ca.SX], channel: str) -> ca.SX:
    """What the plant would show in a channel."""
    owner, _, key = channel.rpartition(".")
    if key == "q":
        return seen["q"][plant.machine.joints.index(owner)]
    if channel == SUPPLY[0]:
        return seen["p_supply"]
    k = [each.actuator.name for each in plant.actuators].index(owner)
    return seen["length"][k] if key == "length" else seen["pressure"][k, plant.actuators[k].chambers.index(channel)]


def _supply(plant: Plant, log: Log) -> list[Array]:
    """Pressures of supply and tank (N,): as logged, or as stated; what the pump is set to where it feeds a volume."""
    found = []
    for k, channel in enumerate(SUPPLY):
        if channel in log.channels and channel not in plant.states:
            found.append(reading(plant.machine, log, channel))
        else:
            found.append(np.full(log.size, plant.supply[k]))
    return found


def _placed(plant: Plant, k: int, command: Array) -> Array:
    """Where a command (N,) wants the spool, by the nominal dead bands."""
    owner, nominal = plant.actuators[k].actuator.name, plant.parameters
    symbol = ca.SX.sym("u")
    wanted = displaced(plant.actuators[k].valve, symbol,
                       lambda key: float(nominal.nominal[nominal.index(f"{owner}.{key}")]))
    return np.asarray(ca.Function("wanted", [symbol], [wanted])(command)).ravel()


def _refuse_idle(plant: Plant, logs: Sequence[Log]) -> None:
    """Refuse logs in which an actuator's command stays within the dead band, at its smallest that is plausible."""
    nominal, parameters = plant.parameters.nominal, plant.parameters
    for name, each in zip(plant.inputs, plant.actuators, strict=True):
        owner, valve = each.actuator.name, each.valve
        bands: list[float] = []
        for key in ("dead_band", "dead_band_reverse"):
            if getattr(valve, key) is None:
                bands.append(bands[0])
                continue
            k = parameters.index(f"{owner}.{key}")
            known = parameters.information[k, k]
            bands.append(max(0.0, nominal[k] - (AT_WORST / np.sqrt(known) if known > 0 else 0.0)))
        off = np.concatenate([(log.channel(name) - valve.neutral) * np.sign(valve.span) for log in logs])
        if not (np.max(off) > bands[0] or np.max(-off) > bands[1]):
            raise IdentifiabilityError(
                f"the command '{name}' never leaves the dead band: it is off neutral by at most "
                f"{np.max(np.abs(off)):.3g} {valve.command}, and nothing moves below {min(bands):.3g} {valve.command}",
                where=", ".join(log.path or log.name for log in logs),
                remedy="drive the valve further, or correct its dead band in the machine file")
