"""Valves and oil from commands, pressures and motion: what is identified, and the readings that determine it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import Any, NoReturn

import numpy as np
from numpy.typing import NDArray

from hydroopt.errors import IdentifiabilityError, LogError, ProblemError
from hydroopt.estimation.hydraulic.adjustment import Balanced, nonlinear_program
from hydroopt.estimation.hydraulic.volume_balance import MotionReadings, Readings, VolumeBalance, pieces
from hydroopt.estimation.inference.program import NonlinearProgram
from hydroopt.logs.frames import all_of
from hydroopt.logs.log import Log
from hydroopt.logs.readings import bridged, reading
from hydroopt.logs.tip_wrench import wrench_channels
from hydroopt.machine.actuators import Cylinder
from hydroopt.machine.machine_file import GivenMachine, machine_of
from hydroopt.model.hydraulics import ActuatorHydraulics
from hydroopt.model.model import Model
from hydroopt.model.plant import Plant
from hydroopt.parameters.parameter_set import ParameterSet, parameter_table
from hydroopt.results.diagnostic import Diagnostic
from hydroopt.spatial.inertia import Array
from hydroopt.support.notebook_card import Card, Shown

SUPPLY = ("pump.p_supply", "pump.p_tank")
"""Channels of the pressures that feed and drain the valves."""
UNREAD = 1e7
"""Standard deviation [Pa] of a pressure in a sample that holds no number."""
FORGOTTEN = 6.0
"""Time constants of its spool after which an actuator's first command is forgotten."""
REST, ROUNDING = 3.0, 1e-6
"""Scatter of a base at rest, in standard deviations of its sensor, and what is added for rounding [rad or m]."""
AT_WORST = 3.0
"""How many of its σ a dead band may be smaller than stated, before a command counts as never leaving it."""


@dataclass(frozen=True, eq=False)
class Stretch:
    """Samples of a log without a gap; `log` holds these samples alone."""

    log: Log
    actuators: tuple[Readings, ...]


@dataclass(frozen=True, eq=False, repr=False)
class HydraulicProblem(Shown):
    """The identification of valves and oil from logs; solving does not change it.

    Volume balances of each chamber determine them: inflow moves the piston or compresses oil. Motion and pressures
    are read, so that neither masses nor friction have a part in it; these are identified from forces (`identify`).

    It is a nonlinear program: `print` shows its variables, objective and constraints, `nlp` hands it on.

    Attributes:
        plant: the machine with its valves.
        logs: training logs; `validation` those held out.
        parameters: hydraulic parameters that state a `sigma`.
        theta: (p,) their positions among the plant's.
        channels: measured channels that the logs hold; `sigma` (ny,) of their readings, in SI.

    Example:
        >>> import hydroopt as ho
        >>> plant = ho.Plant(ho.Model(ho.load_machine("patu655_lift")))
        >>> t = np.arange(160) / 50
        >>> log = ho.drive(plant, t, 5.7 + np.cos(2 * t)[:, None], np.array([0.2]), seed=1)
        >>> ho.hydraulic_problem(plant.machine, [log])
        HydraulicProblem(patu655_lift: 7 parameters, 160 samples, 4 channels)
        >>> problem = ho.hydraulic_problem(plant.machine, [log])
        >>> problem.whole(problem.parameters.nominal).shape == plant.parameters.nominal.shape
        True
    """

    plant: Plant
    logs: tuple[Log, ...]
    validation: tuple[Log, ...]
    parameters: ParameterSet
    theta: NDArray[np.intp]
    channels: tuple[str, ...]
    sigma: Array

    def whole(self, values: Array) -> Array:
        """All hydraulic parameters of the plant (h,) from those identified (p,)."""
        found = self.plant.parameters.nominal.copy()
        found[self.theta] = values
        return found

    @cached_property
    def stretches(self) -> tuple[Stretch, ...]:
        """Readings of all actuators, one stretch for each part of a training log without a gap.

        Raises:
            LogError: a channel is missing, or no stretch is long enough.
            ProblemError: the supply's pressure is neither logged nor stated, or a sensor's accuracy is not.
        """
        found = tuple(stretch for log in self.logs for stretch in self.stretches_of(log))
        if not any(each.used > 0 for stretch in found for each in stretch.actuators):
            raise LogError("no part without a gap is longer than the spools' own motion",
                           where=", ".join(log.path or log.name for log in self.logs),
                           remedy="give a log of some seconds")
        return found

    def stretches_of(self, log: Log) -> Iterator[Stretch]:
        """The stretches of one log."""
        edges = np.flatnonzero(np.diff(log.segment, prepend=log.segment[0] - 1, append=log.segment[-1] + 1))
        for a, b in pairwise(edges.tolist()):
            if b - a > 1:
                part = log.slice(a, b)
                motion = MotionReadings(self.plant, part)
                yield Stretch(part, tuple(self._readings(part, motion, k, each)
                                          for k, each in enumerate(self.plant.actuators)))

    @cached_property
    def balanced(self) -> tuple[Balanced, ...]:
        """What is solved: the balances of every actuator in every stretch that is long enough."""
        functions: dict[tuple[int, int], VolumeBalance] = {}
        found = []
        for stretch in self.stretches:
            for k, readings in enumerate(stretch.actuators):
                key = k, readings.times.shape[1]
                if key not in functions:
                    functions[key] = VolumeBalance(self.plant, k, self.theta.tolist(), key[1])
                if readings.used > 0:
                    found.append(Balanced(k, functions[key], readings))
        return tuple(found)

    def _readings(self, log: Log, motion: MotionReadings, k: int, each: ActuatorHydraulics) -> Readings:
        machine, name = self.plant.machine, each.actuator.name
        length, length_variance, lever = motion.length(k)
        values, variance = [length], [length_variance]
        for place, channel in enumerate((*each.chambers, *SUPPLY)):
            sensor, stated = machine.sensor(channel), np.full(log.size, self.plant.supply[place - 2]
                                                              if place >= 2 and channel not in log.channels else 0.0)
            read = reading(machine, log, channel) if channel in log.channels else (
                stated if place >= 2 else motion.pressure(k, channel))
            std = sensor.std if sensor and channel in log.channels else 0.0
            values.append(bridged(read))
            variance.append(np.where(np.isfinite(read), std, UNREAD) ** 2)
        times, frequency = pieces(log.t), each.valve.natural_frequency
        late = self.plant.delays[k]
        if frequency:
            late += FORGOTTEN / (2 * np.pi * frequency * min(each.valve.damping or 1.0, 1.0))
        return Readings(log.t, times, reading(machine, log, f"{name}.u"), np.column_stack(values),
                        np.column_stack(variance),
                        tuple(side for side, channel in enumerate(each.chambers) if channel in log.channels),
                        int(np.searchsorted(log.t, log.t[0] + late)), lever)

    @property
    def lost_pressures(self) -> dict[str, tuple[str, ...]]:
        """The pressures that each log lacks, of those logs that lack any."""
        wanted = [channel for each in self.plant.actuators for channel in each.chambers]
        lacking = {log.path or log.name: tuple(channel for channel in wanted if channel not in log.channels)
                   for log in (*self.logs, *self.validation)}
        return {where: channels for where, channels in lacking.items() if channels}

    @property
    def assumed_supplies(self) -> Iterator[Diagnostic]:
        """Logs without the supply's pressure, though it follows what the machine draws from its pump."""
        pump = self.plant.machine.pump
        for log in (*self.logs, *self.validation):
            if pump and SUPPLY[0] in self.plant.states and SUPPLY[0] not in log.channels:
                yield Diagnostic.of("pressure of the supply not measured", SUPPLY[:1], {
                    "log": log.path or log.name, "pressure": float(self.plant.supply[0]) / 1e5,
                    "flow": 6e4 * float(pump.max_flow or np.inf)},
                    "{log} lacks {subject}: the supply counts as exactly {pressure:.3g} bar, but its pump gives at "
                    "most {flow:.3g} L/min into a volume of its own, so that it falls under load; flows and their "
                    "intervals are wrong by that.",
                    "Log pump.p_supply.")

    @property
    def inputs(self) -> tuple[dict[str, Any], ...]:
        """The logs it is from: path, sha256, samples, role, rows and findings."""
        return tuple({"path": log.path or log.name, "sha256": log.sha256 or None, "samples": log.size, "role": role,
                      "first_sample": log.rows[0], "last_sample": log.rows[1],
                      "findings": [finding.text for finding in log.findings]}
                     for role, logs in (("train", self.logs), ("validation", self.validation)) for log in logs)

    def nlp(self) -> NonlinearProgram:
        """The nonlinear program that is solved first: the least corrections of readings that close all balances.

        Variables are the parameters, from their nominal values in units of their scales, and the corrections of all
        readings that err, in units of their σ. `solve` then adds a random flow to each balance, as large as what is
        left shows.
        """
        return nonlinear_program(self.balanced, self.parameters)

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


def hydraulic_problem(machine: GivenMachine, logs: Log | Sequence[Log],
                      validation: Log | Sequence[Log] = ()) -> HydraulicProblem:
    """The identification of valves and oil from logs, with the machine file's confidences as priors.

    Every number of the hydraulics that states a `sigma` is identified; all others are exact. Bodies and friction have
    no part in it.

    Args:
        machine: with a circuit for every actuator, and sensors.
        logs: training logs: commands, motion and pressures of all actuators. One chamber of each may be unmeasured; a
            pressure without a number in some samples does not count in these.
        validation: validation logs.

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
    free = np.flatnonzero(np.diag(plant.parameters.information) > 0)
    if not free.size:
        raise ProblemError("no hydraulic parameter states a confidence, so that nothing is identified",
                           where=f"machine '{machine.name}'",
                           remedy="state a 'sigma' for the uncertain flows, dead bands, volumes and moduli")
    channels, sigma = _sensed(plant, logs)
    return HydraulicProblem(plant, tuple(logs), tuple(validation), _of(plant.parameters, free), free, channels, sigma)


def _of(known: ParameterSet, at: NDArray[np.intp]) -> ParameterSet:
    """Some of a set's parameters."""
    names, kinds, units = ([values[k] for k in at] for values in (known.names, known.kinds, known.units))
    return ParameterSet(tuple(names), tuple(kinds), tuple(units), known.nominal[at], known.lower[at], known.upper[at],
                        known.scale[at], known.information[np.ix_(at, at)])


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
