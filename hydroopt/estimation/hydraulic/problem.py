"""Valves, oil and friction from commands, pressures and motion: the plant's numbers as a shooting problem."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from typing import Any, NoReturn

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from hydroopt.errors import IdentifiabilityError, LogError, ProblemError
from hydroopt.estimation.hydraulic.collocated_program import nonlinear_program
from hydroopt.estimation.hydraulic.dynamics import Dynamics, Record, ShootingProblem
from hydroopt.estimation.hydraulic.shooting import measured_states
from hydroopt.estimation.inference.identifiability import PREDICTED_TOLERANCE, significant
from hydroopt.estimation.inference.program import NonlinearProgram
from hydroopt.logs.frames import all_of
from hydroopt.logs.joint_angles import measured_angles
from hydroopt.logs.log import Log
from hydroopt.logs.readings import bridged, reading
from hydroopt.logs.smoothing import Motion, SmoothingSpline, condition
from hydroopt.logs.tip_wrench import wrench_channels
from hydroopt.machine.actuators import Cylinder
from hydroopt.machine.given_machine import GivenMachine, machine_of
from hydroopt.model.hydraulics import spool_position
from hydroopt.model.model import Model
from hydroopt.model.plant import Plant
from hydroopt.notebook_card import Card, Shown
from hydroopt.parameters.parameter_set import ParameterKind, ParameterSet, parameter_table
from hydroopt.simulation.drive_valves import arrived
from hydroopt.spatial.inertia import Array

SUPPLY = ("pump.p_supply", "pump.p_tank")
"""Channels of the pressures that feed and drain the valves."""
LONGEST = 0.01
"""Collocated interval [s] that follows spools and dry friction well enough: twice as long ones bend spools' numbers by
a standard deviation."""
RANDOM = 200
"""States at which forces are evaluated to find the identifiable directions of bodies."""
REST, ROUNDING = 3.0, 1e-6
"""Scatter of a base at rest, in standard deviations of its sensor, and what is added for rounding [rad or m]."""
AT_WORST = 3.0
"""How many of its σ a dead band may be smaller than stated, before a command counts as never leaving it."""


@dataclass(frozen=True, eq=False, repr=False)
class HydraulicProblem(Shown):
    """The identification of valves, oil and friction from logs; solving does not change it.

    It is a nonlinear program: `print` shows its variables, objective and constraints, `nlp` hands it on.

    Attributes:
        plant: the machine with its valves.
        logs: training logs; `validation` those held out.
        parameters: friction and hydraulic parameters that state a `sigma`, then, on request, the identifiable
            directions of the bodies, in standard deviations of the machine file.
        psi, theta: positions of the first two among the plant's dynamic and hydraulic parameters.
        bodies: (p, b) how the plant's dynamic parameters change with the last b.
        channels: measured channels that the logs hold; `sigma` (ny,) of their readings, in SI.
        steps: collocated intervals between two samples; as many as keep them below `LONGEST` if None.

    Example:
        >>> import hydroopt as ho
        >>> plant = ho.Plant(ho.Model(ho.load_machine("patu655_lift")))
        >>> t = np.arange(160) / 50
        >>> log = ho.drive(plant, t, 5.7 + np.cos(2 * t)[:, None], np.array([0.2]), seed=1)
        >>> ho.hydraulic_problem(plant.machine, [log])
        HydraulicProblem(patu655_lift: 9 parameters, 160 samples, 4 channels)
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
        model, friction, last = self.plant.model, len(self.psi), len(self.psi) + len(self.theta)
        given = values if isinstance(values, ca.SX) else ca.DM(values)
        made = []
        for nominal, at, part in (
                (ca.DM(model.parameters.nominal) + ca.DM(self.bodies) @ given[last:, :], self.psi, given[:friction, :]),
                (ca.DM(self.plant.parameters.nominal), self.theta, given[friction:last, :])):
            whole = type(given)(nominal)
            whole[at.tolist()] = part
            made.append(whole)
        return made[0], made[1]

    @cached_property
    def dynamics(self) -> Dynamics:
        """The plant as a function of what is identified."""
        plant, n = self.plant, len(self.plant.inputs)
        x, u, free = ca.SX.sym("x", len(plant.states)), ca.SX.sym("u", n + 2), ca.SX.sym("p", len(self.parameters))
        given = (x, u[:n], u[n:], *self.split(free))
        outputs = dict(zip(plant.outputs.name_out(), plant.outputs(*given), strict=True))
        values = [_channel(plant, outputs, channel) for channel in self.channels]
        return Dynamics(ca.Function("rates", [x, u, free], [plant.rates(*given)]),
                        ca.Function("outputs", [x, u, free], [ca.vertcat(*values)]), plant.states,
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
            guess |= self._pressures(log, k, motion)
        guess[SUPPLY[0]] = log.channels.get(SUPPLY[0], u[:, -2])
        states = np.column_stack([guess[name] for name in plant.states])
        edges = np.flatnonzero(np.diff(log.segment, prepend=log.segment[0] - 1, append=log.segment[-1] + 1))
        spans = [slice(a, b) for a, b in pairwise(edges.tolist()) if b - a > 1]
        steps = self.steps or max(1, math.ceil(float(np.median(np.diff(log.t))) / LONGEST - 1e-3))
        return tuple(Record(log.t[at], u[at], y[at], states[at], steps=steps, name=log.path or log.name)
                     for at in spans)

    def _pressures(self, log: Log, k: int, motion: Motion) -> dict[str, Array]:
        """Initial guess of both pressures (N,) of an actuator: as read, or what the nominal force leaves for one that
        the log lacks."""
        plant, each = self.plant, self.plant.actuators[k]
        read = {channel: bridged(reading(plant.machine, log, channel)) for channel in each.chambers
                if channel in log.channels}
        for channel in each.chambers:
            if channel not in read:
                model, place = plant.model, plant.machine.actuators.index(each.actuator)
                extra = [np.zeros((log.size, len(plant.machine.actuators)))] if model.needs_pressure else []
                force = model.over(model.inverse_dynamics, motion.q, motion.qd, motion.qdd, *extra,
                                   model.parameters.nominal)[0][:, place, 0]
                (known, pressure), factors = next(iter(read.items())), each.actuator.effort_factors
                read[channel] = np.maximum((force - factors[known] * pressure) / factors[channel], 0.0)
        return read

    @property
    def lost_pressures(self) -> dict[str, tuple[str, ...]]:
        """The pressures that each log lacks, of those logs that lack any."""
        wanted = [channel for each in self.plant.actuators for channel in each.chambers]
        lacking = {log.path or log.name: tuple(channel for channel in wanted if channel not in log.channels)
                   for log in (*self.logs, *self.validation)}
        return {where: channels for where, channels in lacking.items() if channels}

    @property
    def held_bodies(self) -> tuple[str, ...]:
        """Bodies that count as exact although the machine file states confidences of their masses or inertias."""
        known = self.plant.model.parameters
        return () if self.bodies.shape[1] else tuple(
            owner for owner, columns in known.bodies.items() if np.diag(known.information)[columns].any())

    @cached_property
    def shooting(self) -> ShootingProblem:
        """The problem as the solver takes it."""
        records = tuple(record for log in self.logs for record in self.records(log))
        return ShootingProblem(self.dynamics, self.parameters, self.sigma, records, self.plant.machine.name)

    @property
    def inputs(self) -> tuple[dict[str, Any], ...]:
        """The logs it is from: path, sha256, samples, role, rows and findings."""
        return tuple({"path": log.path or log.name, "sha256": log.sha256 or None, "samples": log.size, "role": role,
                      "first_sample": log.rows[0], "last_sample": log.rows[1],
                      "findings": [finding.text for finding in log.findings]}
                     for role, logs in (("train", self.logs), ("validation", self.validation)) for log in logs)

    def nlp(self, sigma: Array | None = None) -> NonlinearProgram:
        """The nonlinear program that is solved: maximum a posteriori, the dynamics as constraints (collocation).

        Variables are the parameters and the states of all records at all points, in units of their scales, the
        parameters from their nominal values; that guess is the initial one. `solve` computes it twice: first with the
        sensors' σ, then with each channel's σ raised to what the residuals of the first show, correlation included
        (``estimate.shooting.problem.sigma``).

        Args:
            sigma: (ny,) standard deviation of each channel's readings, in SI; by default the sensors'.
        """
        problem = self.shooting if sigma is None else replace(self.shooting, sigma=sigma)
        return nonlinear_program(problem, measured_states(problem))

    def cvxpy(self) -> NoReturn:
        """Refuse: the problem is not convex.

        Raises:
            ProblemError: always.
        """
        raise ProblemError("the identification of valves and oil is not convex, so that CVXPY cannot state it",
                           where=f"machine '{self.plant.machine.name}'", remedy="use nlp() with IPOPT")

    def __repr__(self) -> str:
        return (f"HydraulicProblem({self.plant.machine.name}: {len(self.parameters)} parameters, "
                f"{sum(log.size for log in self.logs)} samples, {len(self.channels)} channels)")

    def __str__(self) -> str:
        return f"{self!r}\n{self.nlp()}"

    def card(self) -> Card:
        """What a notebook shows: the parameters with what the machine file states of them; the program is in `print`.
        """
        return Card(repr(self), tables=[parameter_table(self.parameters)])


def hydraulic_problem(machine: GivenMachine, logs: Log | Sequence[Log], validation: Log | Sequence[Log] = (), *,
                     bodies: bool = False, steps: int | None = None) -> HydraulicProblem:
    """The identification of valves, oil and friction from logs, with the machine file's confidences as priors.

    Every number of the hydraulics that states a `sigma` is identified, and every friction that does; all others are
    exact.

    Args:
        machine: with a circuit for every actuator, and sensors.
        logs: training logs: commands, motion and pressures of all actuators. One chamber of each may be unmeasured; a
            pressure without a number in some samples does not count in these.
        validation: validation logs.
        bodies: whether masses and inertias are identified, too, as far as forces identify them; else they are exact,
            as after an identification of their own.
        steps: collocated intervals between two samples; as many as keep them below `LONGEST` if None. More follow dry
            friction and the edges of valves more exactly.

    Raises:
        ProblemError: the file states no circuit, no confidence or no sensors, or a supply pressure is neither logged
            nor stated.
        LogError: a command, a pressure or a motion is missing, or the base moves.
        IdentifiabilityError: no command leaves its dead band.

    Example:
        See `HydraulicProblem`.
    """
    machine = machine_of(machine, "hydraulic_problem")
    logs, validation = (all_of(some, (Log,), "log", "identification of valves and oil") for some in (logs, validation))
    plant = Plant(Model(machine))
    for log in (*logs, *validation):
        for channel in (*plant.inputs, *(next((c for c in each.chambers if c in log.channels), each.chambers[0])
                                         for each in plant.actuators)):
            reading(machine, log, channel)
        if found := wrench_channels(log):
            raise LogError(f"the wrench at the tip ({', '.join(sorted(found))}) is not part of the valves' model",
                           where=log.path or log.name,
                           remedy="give logs without contact, or leave these columns out if nothing acted")
        _refuse_moving_base(plant, log)
    _refuse_dead_band(plant, logs)
    psi, theta = _identified(plant)
    if not len(psi) + len(theta):
        raise ProblemError("no hydraulic parameter states a confidence, so that nothing is identified",
                           where=f"machine '{machine.name}'",
                           remedy="state a 'sigma' for the uncertain flows, dead bands, volumes and moduli")
    identifiable = _identifiable(plant.model) if bodies else np.zeros((len(plant.model.parameters), 0))
    channels, sigma = _sensed(plant, logs)
    parameters = _joined(plant, psi, theta, identifiable.shape[1])
    return HydraulicProblem(plant, tuple(logs), tuple(validation), parameters, psi, theta, identifiable, channels,
                            sigma, steps)


def _identified(plant: Plant) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Positions of what states a confidence: friction, gas and springs among ψ, and the hydraulics' numbers."""
    dynamic, hydraulic = plant.model.parameters, plant.parameters
    free = [k for k, kind in enumerate(dynamic.kinds) if dynamic.information[k, k] > 0
            and (kind.is_friction or kind.is_elastic)]
    return np.array(free, dtype=np.intp), np.flatnonzero(np.diag(hydraulic.information) > 0)


def _identifiable(model: Model) -> Array:
    """(p, b) the directions of the bodies' parameters that forces identify, each one standard deviation long.

    In units of the priors' standard deviations they span the row space of the regressor.
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
        ProblemError: the file does not state a sensor, or states a lag.
    """
    machine = plant.machine
    measured = [channel for channel in _measurable(plant) if any(channel in log.channels for log in logs)
             and (channel != SUPPLY[0] or machine.sensor(channel))]
    stated = {channel: sensor.std for channel in measured if (sensor := machine.sensor(channel)) is not None}
    missing = [channel for channel in measured if not stated.get(channel, 0.0) > 0]
    if missing:
        raise ProblemError(f"no accuracy is stated for {', '.join(missing)}", where=f"machine '{machine.name}'",
                           remedy="state the accuracy of each in [[sensors]]")
    late = [channel for channel in measured if machine.lag(channel).value]
    if late:
        raise ProblemError(f"a lag is stated for {', '.join(late)}, which the identification of valves and oil "
                           "does not take into account", where=f"machine '{machine.name}'",
                           remedy="remove 'lag' there, if it is far below the periods of the motion")
    return tuple(measured), np.array([stated[channel] for channel in measured])


def _measurable(plant: Plant) -> Iterator[str]:
    """Channels that the plant's outputs predict."""
    for joint in plant.machine.joints:
        yield f"{joint}.q"
    for each in plant.actuators:
        if isinstance(each.actuator, Cylinder):
            yield f"{each.actuator.name}.length"
        yield from each.chambers
    if plant.states[-1] == SUPPLY[0]:
        yield SUPPLY[0]


def _channel(plant: Plant, outputs: dict[str, ca.SX], channel: str) -> ca.SX:
    """The plant's output that a channel measures."""
    owner, _, key = channel.rpartition(".")
    if key == "q":
        return outputs["q"][plant.machine.joints.index(owner)]
    if channel == SUPPLY[0]:
        return outputs["p_supply"]
    k = [each.actuator.name for each in plant.actuators].index(owner)
    if key == "length":
        return outputs["length"][k]
    return outputs["pressure"][k, plant.actuators[k].chambers.index(channel)]


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
    wanted = spool_position(plant.actuators[k].valve, symbol,
                       lambda key: float(nominal.nominal[nominal.index(f"{owner}.{key}")]))
    return np.asarray(ca.Function("wanted", [symbol], [wanted])(command)).ravel()


def _refuse_moving_base(plant: Plant, log: Log) -> None:
    """Refuse a log in which the base moves by more than its sensors err."""
    for joint in plant.machine.base_joints:
        sensor = plant.machine.sensor(f"{joint}.q")
        moved, unit = np.nanstd(reading(plant.machine, log, f"{joint}.q")), plant.machine.channel_units[f"{joint}.q"]
        if moved > REST * (sensor.std if sensor else 0.0) + ROUNDING:
            raise LogError(f"the base moves: {joint}.q scatters by {moved:.3g} {unit}",
                           where=log.path or log.name, remedy="give logs in which it stands still, at any slope: the "
                           "ground's forces on it are not known to the valves' model")


def _refuse_dead_band(plant: Plant, logs: Sequence[Log]) -> None:
    """Refuse logs in which an actuator's command stays within the dead band, even a plausibly small one."""
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
