"""The volume balance of an actuator's chambers between two samples: what valve, leaks and spring of the oil must yield.

The equations of both pressures, integrated over an interval (Merritt 1967), need neither masses nor friction:

    A_a·ΔL = ∫q_a dt − C_a·Δp_a  and  −A_b·ΔL = ∫q_b dt − C_b·Δp_b,

with the flows q into the chambers and the oil C that raises their pressures by one pascal. Pressures are straight
between samples, the spool follows its commands exactly, whenever they arrive, and Simpson's rule integrates the flows.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache, cached_property
from typing import NamedTuple

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from hydroopt.errors import ProblemError
from hydroopt.kernels.native import Runner
from hydroopt.logs.joint_angles import angle_noise, measured_angles
from hydroopt.logs.log import Log
from hydroopt.logs.readings import bridged, reading
from hydroopt.logs.smoothing import Motion, SmoothingSpline, condition
from hydroopt.machine.actuators import Cylinder
from hydroopt.model.hydraulics import ActuatorHydraulics, chamber_flows, spool_position
from hydroopt.model.plant import Plant
from hydroopt.simulation.drive_valves import arrived
from hydroopt.spatial.inertia import Array

QUANTITIES = ("length", "p_a", "p_b", "p_supply", "p_tank")
"""What is read at each sample: a cylinder's length or the angle of a motor's joint, pressures of both chambers, supply
and tank."""
PIECE = 0.005
"""Duration [s] of the pieces of an interval over which flows are integrated, at most."""


@dataclass(frozen=True, eq=False)
class Readings:
    """One actuator over N samples without a gap.

    Attributes:
        t: (N,) times [s].
        times: (N - 1, parts) when each piece of an interval begins [s].
        command: (N,) given at the samples, before it arrives.
        values: (N, 5) the `QUANTITIES`.
        variance: (N, 5) of their errors, which differ at every sample.
        chambers: whose pressures are read, 0 or 1 or both.
        begin: first interval that counts: before, the spool's place may still be another than its first command's.
        lever: (N, g) change of the length per standard deviation of each uncertain number of the geometry; none where
            the length itself is read.
    """

    t: Array
    times: Array
    command: Array
    values: Array
    variance: Array
    chambers: tuple[int, ...]
    begin: int
    lever: Array

    @cached_property
    def dt(self) -> Array:
        """(N - 1,) durations of the intervals [s]."""
        return np.diff(self.t)

    @property
    def used(self) -> int:
        """Number of intervals that count."""
        return len(self.dt) - self.begin

    @property
    def balances(self) -> int:
        """Number of balances: one for each chamber that is read in each interval that counts."""
        return self.used * len(self.chambers)


def pieces(t: Array) -> Array:
    """(N - 1, parts) beginnings of an even number of pieces, the same in all intervals of the times (N,)."""
    dt = np.diff(t)
    parts = 2 * max(1, int(np.ceil(float(np.median(dt)) / PIECE / 2 - 1e-6)))
    return np.asarray(t[:-1, None] + dt[:, None] * np.arange(parts) / parts)


class MotionReadings:
    """The motion in samples without a gap; nothing is computed before it is asked for."""

    def __init__(self, plant: Plant, log: Log) -> None:
        self.plant, self.log = plant, log

    @cached_property
    def q(self) -> Array:
        """(N, n) joint positions as read."""
        return measured_angles(self.plant.model, self.log)

    @cached_property
    def smooth(self) -> Motion:
        """The motion up to the machine's bandwidth."""
        machine, log = self.plant.machine, self.log
        return condition(log.t, self.q, log.segment, SmoothingSpline(bandwidth=machine.bandwidth),
                         names=machine.joints, where=log.path or log.name)

    def length(self, actuator: int) -> tuple[Array, Array, Array]:
        """A cylinder's length (N,), or the angle of a motor's joint; its variance; what the geometry may change.

        A length that is logged is taken as it is; lever arms are then of no account. Otherwise the joints' angles give
        it by the geometry.
        """
        plant, log, each = self.plant, self.log, self.plant.actuators[actuator].actuator
        channel = f"{each.name}.length"
        if isinstance(each, Cylinder) and channel in log.channels:
            sensor = plant.machine.sensor(channel)
            std = sensor.std if sensor else 0.0
            return bridged(reading(plant.machine, log, channel)), np.full(log.size, std**2), np.zeros((log.size, 0))
        noise = angle_noise(plant.model, log)
        arms = np.asarray(plant.transmission.map(log.size)(self.q.T)).T.reshape(log.size, -1, len(plant.actuators))
        spread = arms[:, :, actuator] * np.where(np.any(arms[:, :, actuator], axis=0), noise, 0.0)
        if not np.all(np.isfinite(spread)):
            raise ProblemError(f"no accuracy is stated for the angles that give the length of '{each.name}'",
                               where=f"machine '{plant.machine.name}'", remedy="state it in [[sensors]]")
        length = np.asarray(plant.actuator_motion.map(log.size)(self.q.T, 0 * self.q.T)[0])[actuator]
        return length, np.sum(spread**2, axis=1), np.zeros((log.size, 0))

    def pressure(self, actuator: int, channel: str) -> Array:
        """(N,) a pressure that the log lacks: what the nominal force leaves for it beside the other chamber's."""
        plant, each = self.plant, self.plant.actuators[actuator]
        model, place = plant.model, plant.machine.actuators.index(each.actuator)
        known = next(other for other in each.chambers if other in self.log.channels)
        extra = [np.zeros((self.log.size, len(plant.machine.actuators)))] if model.needs_pressure else []
        motion = self.smooth
        force = model.over(model.inverse_dynamics, motion.q, motion.qd, motion.qdd, *extra,
                           model.parameters.nominal)[0][:, place, 0]
        factors = each.actuator.effort_factors
        other = bridged(reading(plant.machine, self.log, known))
        return np.maximum((force - factors[known] * other) / factors[channel], 0.0)


@dataclass(frozen=True, eq=False)
class Misclosure:
    """By how much I intervals miss the balances of c chambers [m³], and the derivatives of that.

    Attributes:
        value: (I, c).
        by_theta: (I, c, p).
        by_first, by_last: (I, c, 5) by the readings at both ends of an interval.
        by_delay: (I, c) by the delay of the commands [m³/s], be it identified or not.
    """

    value: Array
    by_theta: Array
    by_first: Array
    by_last: Array
    by_delay: Array


class Spools(NamedTuple):
    """Places (M + 1,) of a spool at the ends of all pieces, and their derivatives by the balance's own numbers
    (M + 1, p) and by the delay (M + 1,) of the commands [s]."""

    place: Array
    by_own: Array
    by_delay: Array


class VolumeBalance:
    """The balances of one actuator as a function of the identified numbers.

    Args:
        plant: the machine.
        actuator: the place of the actuator in `Plant.actuators`.
        free: (p,) positions of the identified numbers among the plant's parameters.
        parts: pieces of an interval.
    """

    def __init__(self, plant: Plant, actuator: int, free: Sequence[int], parts: int) -> None:
        each, names = plant.actuators[actuator], plant.parameters.names
        late = f"{each.actuator.name}.delay"
        owned = [k for k, at in enumerate(free)
                 if names[at].partition(".")[0] in (each.actuator.name, "oil") and names[at] != late]
        self.own: NDArray[np.intp] = np.array(owned, dtype=np.intp)
        """Positions of the numbers on which the balances depend among the identified ones, but for the delay."""
        self.late = [k for k, at in enumerate(free) if names[at] == late]
        """Position of the delay among the identified numbers, if it is one."""
        self.delay = float(plant.delays[actuator])
        """As the machine file states it [s]."""
        self.owner, self.parts = each.actuator.name, parts
        theta = ca.SX.sym("theta", len(owned))
        whole = ca.SX(ca.DM(plant.parameters.nominal))
        whole[[free[k] for k in owned]] = theta
        value = plant.value(each, whole)
        self.begin, piece = _spool(each, theta, value)
        self.interval, self._runner = _interval(each, theta, value, parts), Runner()
        self.pieces = cache(piece.mapaccum)  # making it takes longer than a run
        self._spools: tuple[Readings, Array, Spools] | None = None

    def misclosure(self, readings: Readings, values: Array, theta: Array) -> Misclosure:
        """The balances of all intervals that count, with `values` (N, 5) for the readings and identified θ (p,)."""
        own, count, parts, first = theta[self.own], len(readings.dt), self.parts, readings.begin
        spool, by_own, by_delay = self.spools(readings, theta)
        at = np.arange(count)[:, None] * parts + np.arange(parts + 1)
        value, by_theta, by_spool, by_first, by_last = self._runner.over(
            self.interval, spool[at], values[:-1], values[1:], readings.dt[:, None], own)
        rows = list(readings.chambers)
        whole = np.zeros((count - first, len(rows), len(theta)))
        whole[:, :, self.own] = (by_theta + by_spool @ by_own[at])[first:, rows]
        late = np.einsum("ick,ik->ic", by_spool, by_delay[at])[first:, rows]
        whole[:, :, self.late] = late[:, :, None]
        return Misclosure(value[first:, rows, 0], whole, by_first[first:, rows], by_last[first:, rows], late)

    def symbolic(self, readings: Readings, values: ca.MX, theta: ca.MX) -> ca.MX:
        """The balances (2, N - 1) of both chambers in all intervals as an expression in readings (5, N) and θ (p,)."""
        own, count, parts = theta[self.own.tolist()], len(readings.dt), self.parts
        inputs = ca.MX(self._inputs(readings, self.delay))
        for late in self.late:
            inputs[2, :] += inputs[3, :] * (theta[late] - self.delay)
        start = self.begin(inputs[0, 0], own)
        states = ca.horzcat(start, self.pieces(inputs.shape[1])(start, inputs, ca.repmat(own, 1, inputs.shape[1])))
        spool = ca.vertcat(*(states[0, k : k + 1 + (count - 1) * parts : parts] for k in range(parts + 1)))
        return self.interval.map(count)(spool, values[:, :-1], values[:, 1:], readings.dt[None],
                                     ca.repmat(own, 1, count))[0]

    def spools(self, readings: Readings, theta: Array) -> Spools:
        """What the spool does at identified θ (p,).

        The last one is kept: corrections of readings do not move the spool.
        """
        own = theta[[*self.own, *self.late]]
        if self._spools is None or self._spools[0] is not readings or not np.array_equal(self._spools[1], own):
            self._spools = readings, own, self._moved(readings, theta)
        return self._spools[2]

    def _moved(self, readings: Readings, theta: Array) -> Spools:
        own, inputs = theta[self.own], self._inputs(readings, float(theta[self.late[0]]) if self.late else self.delay)
        (start,) = _called(self.begin, inputs[:1, :1], own[:, None])
        (after,) = _called(self.pieces(inputs.shape[1]), start, inputs, np.tile(own[:, None], inputs.shape[1]))
        states = np.hstack([start, after])
        return Spools(states[0], states[2:-2:2].T, states[-2])

    def _inputs(self, readings: Readings, delay: float) -> Array:
        """(5, M) commands at the begin and at the end of all pieces, when the second one arrives after the begin,
        whether it does so in this piece, and durations."""
        begin, duration = readings.times.ravel(), np.repeat(readings.dt / self.parts, self.parts)
        places = np.arange(len(readings.t), dtype=float)
        first, second = (arrived(readings.t, places, delay, at).astype(int)
                         for at in (begin, begin + duration))
        moves = (first != second).astype(float)
        after = np.clip(readings.t[second] + delay - begin, 0.0, duration) * moves
        return np.vstack([readings.command[first], readings.command[second], after, moves, duration])


def _called(function: ca.Function, *arguments: Array) -> list[Array]:
    """Results of a function of matrices, without the lists of numbers that CasADi makes of its own matrices."""
    buffer, run = function.buffer()
    results = [np.empty(function.size_out(i), order="F") for i in range(function.n_out())]
    held = [np.asfortranarray(each, dtype=float) for each in arguments]
    for give, matrices in ((buffer.set_arg, held), (buffer.set_res, results)):
        for i, each in enumerate(matrices):
            if each.size:
                give(i, memoryview(each.T.data).cast("B").cast("d"))
    run()
    return results


def _spool(each: ActuatorHydraulics, theta: ca.SX, value: ca.SX) -> tuple[ca.Function, ca.Function]:
    """At rest where a command wants it, and after a piece in which another one arrives: place, speed, derivatives by θ
    and by how much later it arrives.

    A system of second order, stepped by the Padé approximant (2, 2) of its exponential, stable for any duration.
    """
    state, slope, later = ca.SX.sym("spool", 2), ca.SX.sym("slope", 2, theta.numel() + 1), ca.SX.sym("later")
    first, second, arrives, moves, duration = inputs = [ca.SX.sym(name) for name in (
        "first", "second", "arrives", "moves", "duration")]
    by = ca.vertcat(theta, later)

    def wanted(command: ca.SX) -> ca.SX:
        return ca.vertcat(spool_position(each.valve, command, value), 0)

    def after(begin: ca.SX, command: ca.SX, seconds: ca.SX) -> ca.SX:
        if not each.spool_states:
            return wanted(command)
        rates = ca.vertcat(*each.spool_rates(state[0], state[1], ca.SX(0), value))
        step = ca.jacobian(rates, state) * seconds
        even, odd, one = step @ step / 12, step / 2, ca.SX.eye(2)
        top, (a, b, c, d) = one + odd + even, ca.vertsplit(ca.vec((one - odd + even).T))
        inverse = ca.vertcat(ca.horzcat(d, -b), ca.horzcat(-c, a)) / (a * d - b * c)
        return wanted(command) + inverse @ (top @ (begin - wanted(command)))

    def whole(place: ca.SX, derivative: ca.SX) -> ca.SX:
        return ca.vertcat(place, ca.vec(ca.densify(derivative)))

    # where the second one arrives later than the piece ends, it acts for less than no time
    at = arrives + moves * later
    end = after(after(state, first, at), second, duration - at)
    by_state, by_numbers = ca.jacobian(end, state), ca.jacobian(end, by)
    rest = wanted(first)
    return (ca.Function("begin", [first, theta], [whole(rest, ca.jacobian(rest, by))]),
            ca.Function("piece", [whole(state, slope), ca.vertcat(*inputs), theta],
                        [ca.substitute(whole(end, by_state @ slope + by_numbers), later, ca.SX(0))]))


def _interval(each: ActuatorHydraulics, theta: ca.SX, value: ca.SX, parts: int) -> ca.Function:
    """(spool, first, last, dt, θ) → misclosures (2,) [m³] and their derivatives by θ, spool and both readings."""
    spool, dt = ca.SX.sym("spool", parts + 1), ca.SX.sym("dt")
    first, last = (ca.SX.sym(name, len(QUANTITIES)) for name in ("first", "last"))
    weight = np.ones(parts + 1)
    weight[1:-1:2], weight[2:-1:2] = 4, 2
    into = ca.SX.zeros(2)
    for k in range(parts + 1):
        _, p_a, p_b, p_supply, p_tank = ca.vertsplit(first + (last - first) * (k / parts))
        flows = each.flows(spool[k], p_a, p_b, ca.vertcat(p_supply, p_tank), value)
        into += weight[k] / (3 * parts) * ca.vertcat(flows.into_a, flows.into_b)
    length, p_a, p_b = ca.vertsplit((first + last) / 2)[:3]
    change = last - first
    missed = (ca.vertcat(*chamber_flows(each.actuator, change[0]))
              + ca.vertcat(*each.capacities(p_a, p_b, length, value)) * change[1:3] - dt * into)
    return ca.Function("interval", [spool, first, last, dt, theta], [missed, *(
        ca.densify(ca.jacobian(missed, by)) for by in (theta, spool, first, last))])
