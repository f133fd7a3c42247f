"""A test of valves: each joint in turn, in steps of its valve's command, turned back before it reaches a limit."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from hydroopt.control.closed_loop import CommandDelay
from hydroopt.errors import ProblemError
from hydroopt.limits.limits import MARGIN as STOPPED
from hydroopt.limits.limits import UseOfLimit
from hydroopt.limits.reserves import DEFAULT
from hydroopt.limits.watch import Watch, largest_reach, watch
from hydroopt.logs.log import Log
from hydroopt.model.plant import Plant
from hydroopt.model.workspace import top_speed
from hydroopt.results.tables import csv_text
from hydroopt.simulation.drive_valves import drive
from hydroopt.spatial.inertia import Array

OPENINGS = (1.0, 0.5, 0.25, 0.75, 0.12, 1.0)
"""Commands of successive pairs of steps, one each way, as parts of a full one: full ones show the edges, small ones
of the dead band."""
LONGEST, SHORTEST = 1.3, 0.5
"""Time [s] for which a command of nearly nothing and a full one are held."""
SLEW = 6.0
"""Full commands per second at which a command changes: a step to the valve, hardly one to the machine."""
MARGIN = 0.1
"""Part of its range that a joint keeps from either end."""
SECONDS = 10.0
"""For each actuator; for all that move one joint together."""
HEAVIER = 1.3
"""How much heavier than known a machine may be that a test brakes in time."""
WINDOW = 0.1
"""Time [s] over which a joint's speed is taken from its readings."""


class Step(NamedTuple):
    """One step of a test: the actuators of one joint, the command as a part of a full one, and for how long [s] it is
    held."""

    actuators: tuple[str, ...]
    opening: float
    seconds: float


@dataclass(frozen=True, eq=False)
class ValveTest:
    """Steps of commands for one joint after the other, each the other way than the one before.

    Several actuators of a joint cannot move alone while the others are shut. They are driven together: each valve opens
    by the part that its actuator's lever arm is of the longest one, the other way where that is negative.

    A joint that would come nearer than `MARGIN` of its range to an end of it is turned back at once: at its speed,
    within the time that its valve takes to shut and the way that its relief valves need to brake it. Which way it goes
    is therefore not known before: what is stated are the steps and the limits. All other valves are shut meanwhile.

    Attributes:
        plant: the machine as it is known.
        steps: in their order.
        lower, upper: positions (n,) of the joints [rad or m] that a test keeps between.

    Example:
        >>> import hydroopt as ho
        >>> plant = ho.Plant(ho.load_machine("patu655_lift"))
        >>> test = valve_test(plant)
        >>> test.steps[0]
        Step(actuators=('lift_cylinder',), opening=1.0, seconds=0.5)
        >>> round(test.duration)
        10
    """

    plant: Plant
    steps: tuple[Step, ...]
    lower: Array
    upper: Array

    @property
    def duration(self) -> float:
        """Of the test [s]."""
        return sum(step.seconds for step in self.steps)

    @property
    def bandwidth(self) -> float | None:
        """Frequency [Hz] up to which steps may move the machine: that of its fastest spool, or its own `bandwidth`
        where that is higher; None where a spool follows at once.

        Bodies are identified from motion that is smoothed no more than this: smoother reversals show too little dry
        friction.
        """
        spools = [each.valve.natural_frequency for each in self.plant.actuators]
        return max([*filter(None, spools), self.plant.machine.bandwidth or 0.0]) if all(spools) else None

    @cached_property
    def watch(self) -> Watch:
        """What people beside the machine keep."""
        machine, uses = self.plant.machine, []
        for joint, lowest, highest in zip(machine.joints, self.lower, self.upper, strict=True):
            lower, upper = machine.link(joint).joint.range
            margin = STOPPED * DEFAULT.tracking * (upper - lower)
            uses.append(UseOfLimit(f"{joint} position", machine.channel_units[f"{joint}.q"], lower + margin,
                                   float(lowest), float(highest), upper - margin, margin=margin, seen=True))
        model = self.plant.model
        return watch(model, largest_reach(model, self.lower, self.upper), uses, DEFAULT)

    def sheet(self) -> str:
        """What an operator, or a controller, has to do, in words."""
        machine = self.plant.machine
        lines = [f"Test of the valves of {machine.name}: {self.duration:.0f} s, in free space, without a load.", "",
                 self.watch.list, "",
                 "Begin with every joint in the middle of its planned range, at rest. Log commands, pressures of",
                 "chambers and supply, and angles or lengths. Command one valve at a time, all others shut. Each step",
                 "goes the other way than the one before; turn back at once where a joint would leave its planned",
                 "range. Try a quarter of the openings first, and stop where anything moves that should not.", ""]
        if self.bandwidth:
            lines += [f"Steps move the machine at up to {self.bandwidth:g} Hz: identify its bodies from the log with "
                      f"--bandwidth {self.bandwidth:g}.", ""]
        lines += [self.watch.table]
        middle = (self.lower + self.upper) / 2
        for joint, places in self.plant.drivers.items():
            if len(places) > 1:
                names = [self.plant.actuators[k].actuator.name for k in places]
                parts = [f"{name} {100 * part:.0f} %" for name, part in zip(names, self.opened(middle, joint),
                                                                            strict=True)]
                lines += ["", f"{' and '.join(names)} move {joint}: neither moves while the other is shut, and they",
                          "are driven together. Each valve takes the part of the command that its lever arm is of the",
                          "longest one, the other way where they oppose each other. In the middle of the limits:",
                          f"{', '.join(parts)}. Flows and leaks of each show in its own pressures;",
                          "their friction separates only as far as their lever arms differ."]
        wide = max(24, 2 + max(len(" and ".join(step.actuators)) for step in self.steps))
        lines += ["", f"{'actuator':<{wide}}{'command':>10}{'time':>8}"]
        lines += [f"{' and '.join(step.actuators):<{wide}}{100 * step.opening:>8.0f} %{step.seconds:>6.1f} s"
                  for step in self.steps]
        return "\n".join(lines) + "\n"

    def table(self) -> str:
        """The steps as a CSV table: actuators, part of a full command, seconds."""
        return csv_text([{"actuator": " and ".join(step.actuators), "opening": step.opening, "seconds": step.seconds}
                         for step in self.steps])

    def opened(self, q: Array, joint: str) -> Array:
        """Openings (g,) of the valves of a joint's actuators in a posture (n,), as parts of the widest; their signs are
        those with which the first one extends in the middle of the limits."""
        places, column = list(self.plant.drivers[joint]), self.plant.machine.joints.index(joint)
        middle = (self.lower + self.upper) / 2
        lever, usual = (self.plant.transmission(at).full()[places, column] for at in (q, middle))
        return np.asarray(np.sign(usual[0]) * lever / np.max(np.abs(lever)))

    @cached_property
    def stopping(self) -> Array:
        """Time (a,) [s] that each actuator takes to stop: delay of its valve, change of its command, lag of its spool.
        """
        found = []
        for each in self.plant.actuators:
            spool = 2 * (each.valve.damping or 1.0) / (2 * np.pi * each.valve.natural_frequency) if (
                each.valve.natural_frequency) else 0.0
            found.append(each.valve.delay + 1 / SLEW + spool)
        return np.array(found)


    def braking(self, q: Array, joint: int, way: float) -> float:
        """Deceleration [rad/s² or m/s²] of a joint that moves up (1) or down (-1) in a posture (n,): what its actuators
        make of their relief pressure, the machine `HEAVIER` than known. Infinite where no relief valve opens."""
        plant, psi = self.plant, self.plant.model.parameters.nominal
        places = plant.drivers[plant.machine.joints[joint]]
        levers = plant.transmission(q).full()[:, joint]
        most = [abs(levers[k]) * each.areas[int(levers[k] * way > 0)] * (each.actuator.relief_pressure or np.inf)
                for k, each in ((k, plant.actuators[k]) for k in places)]
        load = float(way * plant.model.gravity_torques(q, psi).full()[joint, 0])
        mass = float(plant.mass(q, psi).full()[joint, joint])
        return max(0.0, float(sum(most)) + load * (HEAVIER if load < 0 else 1.0)) / (HEAVIER * mass)


def valve_test(plant: Plant, *, seconds: float = SECONDS) -> ValveTest:
    """A test of all valves of a machine.

    Args:
        plant: the machine as it is known.
        seconds: for each actuator.

    Raises:
        ProblemError: the test is too short for the openings that tell valves apart.
    """
    machine = plant.machine
    pairs = [(opening, LONGEST + (SHORTEST - LONGEST) * opening) for opening in OPENINGS for _ in range(2)]
    least = sum(hold for _, hold in pairs)
    if seconds < least:
        raise ProblemError(f"a test of {seconds:g} s for each actuator does not cover all openings", where="valve test",
                           remedy=f"give {np.ceil(least):.0f} s or more")
    steps = []
    for places in sorted(plant.drivers.values()):
        names = tuple(plant.actuators[place].actuator.name for place in places)
        left, k = seconds, 0
        while left > 1e-9:
            opening, hold = pairs[k % len(pairs)]
            steps.append(Step(names, opening, min(hold, left)))
            left, k = left - hold, k + 1
    lower, upper = machine.ranges.T
    kept = MARGIN * (upper - lower)
    return ValveTest(plant, tuple(steps), lower + kept, upper - kept)


class StepDriver:
    """What drives a test: the commands of a `ValveTest` from readings of the joints' positions, sample by sample."""

    def __init__(self, test: ValveTest, period: float) -> None:
        self.test, self.period, plant = test, period, test.plant
        self.names = [each.actuator.name for each in plant.actuators]
        self.neutral = np.array([each.valve.neutral for each in plant.actuators])
        self.span = np.array([each.valve.span for each in plant.actuators])
        self._ends = np.cumsum([step.seconds for step in test.steps])
        self._joints = {tuple(self.names[k] for k in places): joint for joint, places in plant.drivers.items()}
        self._fastest = {joint: top_speed(plant, joint) for joint in plant.drivers}
        self._window = max(1, round(WINDOW / period))
        self._opening, self._way, self._step = np.zeros(len(self.names)), 1.0, 0
        self._before: list[Array] = []

    def command(self, k: int, q: Array) -> Array:
        """Commands (a,) at sample k, in the unit of each valve, from the joints' positions (n,)."""
        test = self.test
        now = min(int(np.searchsorted(self._ends, k * self.period, side="right")), len(test.steps) - 1)
        step = test.steps[now]
        name = self._joints[step.actuators]
        active, joint = list(test.plant.drivers[name]), test.plant.machine.joints.index(name)
        self._before = [*self._before[-self._window:], q]
        # over the window and over its later half: a joint that falls is faster now than both
        whole, half = ((q[joint] - some[0][joint]) / (self.period * max(1, len(some) - 1))
                       for some in (self._before, self._before[-1 - self._window // 2:]))
        speed = 2 * half - whole
        # a cylinder that extends may lower its joint
        opened, levers = test.opened(q, name), test.plant.transmission(q).full()[active, joint]
        side = np.sign(opened @ levers)

        def beyond(way: float, speed: float) -> float:
            """How far the joint would pass its limit on one way, turned back now at a speed."""
            end = q.copy()
            end[joint] = (test.upper if speed > 0 else test.lower)[joint]
            # as fast as the same flow moves it at the limit, where a linkage may make more of it
            longest = [np.max(np.abs(test.plant.transmission(at).full()[active, joint])) for at in (q, end)]
            speed *= max(1.0, longest[0] / longest[1])
            brakes = min(test.braking(at, joint, np.sign(speed)) for at in (q, end))
            reach = q[joint] + speed * np.max(test.stopping[active]) + (
                speed * abs(speed) / (2 * brakes) if brakes else np.copysign(np.inf, speed))
            return float(reach - test.upper[joint] if way * side > 0 else test.lower[joint] - reach)

        if now != self._step:
            self._step, self._way = now, -self._way
            # before its speed shows, a joint may be too near a limit to be turned back
            most = side * step.opening * self._fastest[name]
            there, back = (beyond(way, way * most) for way in (self._way, -self._way))
            if there > max(0.0, back):
                self._way = -self._way
        if beyond(self._way, speed) > 0:
            self._way = -self._way
        wanted = np.zeros(len(self.names))
        wanted[active] = self._way * step.opening * opened
        change = SLEW * self.period
        self._opening = self._opening + np.clip(wanted - self._opening, -change, change)
        return np.asarray(self.neutral + self.span * self._opening)


def driven_test(test: ValveTest, psi: Array, theta: Array, *, plant: Plant | None = None, rate: float = 50.0,
                noise: bool = True, seed: int = 0) -> Log:
    """The log that a machine's sensors would record of a test, from the middle of the joints' limits on.

    Args:
        test: what is driven.
        psi: the machine's true dynamic parameters (p,).
        theta: its true hydraulic ones.
        plant: the true machine; the test's if None.
        rate: samples per second [Hz].
        noise: whether sensors err.
        seed: of their errors.

    Raises:
        ProblemError: a joint leaves its range all the same, or the machine cannot stand where it starts.
    """
    plant = plant or test.plant
    n, period = len(plant.machine.joints), 1 / rate
    start = plant.steady((test.lower + test.upper) / 2, np.zeros(n), psi, theta)
    tester, delay = StepDriver(test, period), CommandDelay(plant.delays, period, start.u)
    t, integrator, x = np.arange(int(test.duration * rate) + 1) / rate, plant.integrator(psi, theta), start.x
    commands = []
    for k in range(len(t)):
        commands.append(tester.command(k, x[:n]))
        for seconds, command in delay.push(commands[-1]):
            x = integrator(x, seconds, command, plant.supply)
    return drive(plant, t, np.array(commands), start.x, psi=psi, theta=theta, noise=noise, seed=seed, name="valve test")
