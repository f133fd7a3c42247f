"""Hypotheses about readings of forces and lengths: faults of instruments and what the model lacks, and their words.

A hypothesis of amount δ adds `effect(view, δ)` to the predicted readings; its standard deviation is a usual size.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hydroopt.estimation.dynamic.misfit.view import View
from hydroopt.estimation.inference.hypotheses import Hypothesis
from hydroopt.logs.forces_from_pressures import force_channels
from hydroopt.logs.lag import lagged
from hydroopt.machine.actuators import Cylinder
from hydroopt.machine.balances import Balance
from hydroopt.model.kinematics import gravity_in_base
from hydroopt.parameters.dynamic import owners_with_confidence
from hydroopt.parameters.parameter_set import ParameterKind
from hydroopt.spatial.inertia import Array

TYPICAL = 0.03
"""Part of the RMS force that a usual friction, gain or drift of a torque has."""
DRIFT = 3e5
"""Usual drift of a pressure reading over a log [Pa]."""
LATE = 0.03
"""Usual delay or lag of a reading [s]."""
OF_FORCE = ("drift", "friction")
"""Groups whose usual sizes a machine file states as parts of the RMS force."""
FRICTION = {"viscous": "speed-dependent (viscous) friction", "quadratic": "friction with the square of the speed",
            "coulomb": "dry (Coulomb) friction", "one way": "friction that differs between the two directions",
            "stribeck": "friction that falls with speed (Stribeck)", "load": "friction that grows with the load",
            "seal": "friction of seals that grows with the pressures"}
"""Courses of friction, in words."""
KNOWN = {"viscous": ParameterKind.VISCOUS_FRICTION, "coulomb": ParameterKind.COULOMB_FRICTION,
         "stribeck": ParameterKind.STRIBECK_FRICTION, "seal": ParameterKind.SEAL_FRICTION}
"""Kinds of parameters of a model that has such friction."""
REVERSALS = 4
"""How often the times are found again at which a joint with play reverses."""
PICKED_UP = np.linspace(0, 1, 13)[2:-2]
"""Parts of a log after which a load may be picked up or put down: more than one of its blocks has to show it."""


@dataclass(frozen=True, kw_only=True)
class Fault(Hypothesis[View]):
    """One hypothesis, which has one amount.

    Attributes:
        group: the word that stands for it and its like in options: ``delay``.
        words: what it is, for sentences; `opposite`: the same where its amount is negative.
        free: whether its amount can be estimated along; bodies are parameters with priors of their own.
    """

    group: str
    words: str
    opposite: str = ""
    free: bool = True

    @property
    def scale(self) -> float:
        """Standard deviation of its amount [SI]."""
        return self.std[0]

    def scaled(self, std: float) -> Fault:
        """The same with another standard deviation."""
        return replace(self, std=(std,))

    def said(self, size: float) -> tuple[str, float]:
        """What it is at a size [SI], and the size in the direction of these words."""
        return (self.opposite, -size) if self.opposite and size < 0 else (self.words, size)

    def sentence(self, amount: Array) -> str:
        """What it says where it holds with this amount (1,)."""
        return self.said(float(amount[0]))[0]

    @property
    def remedy(self) -> str:
        """What to do if it holds."""
        if not self.free:
            return "Correct these bodies in the machine file, or state a larger sigma of their numbers."
        word = self.group if self.subject == ("forces",) else self.name
        if self.lack:
            return f"State such friction in the machine file, or estimate it along: --free '{word}'."
        return f"Correct it in the log or the machine file, or estimate it along: --free '{word}'."

    @abstractmethod
    def effect(self, view: View, size: float) -> Array:
        """Change of the predicted readings (N, c) by a fault of this size [SI]."""

    def columns(self, data: View, amount: Array) -> Array:
        """Derivative of the effect by the amount (N, c, 1)."""
        return self.sensitivity(data, float(amount[0]))[:, :, None]

    def sensitivity(self, view: View, at: float = 0.0) -> Array:
        """Derivative of the effect by the size (N, c), steps of dry friction aside."""
        if self.linear:
            return self.effect(view, 1.0)
        h = 0.05 * self.scale
        return (self.effect(view, at + h) - self.effect(view, at - h)) / (2 * h)

    def by_parameters(self, view: View, size: float) -> Array | None:
        """Derivative of the effect by ψ (N, c, p); None where it is zero or small."""
        return None

    def unsteady(self, view: View, size: float) -> NDArray[np.bool_]:
        """Readings (N, c) whose dry friction is not known if a fault of this size is there."""
        return np.zeros(view.predicted.shape, dtype=bool)


@dataclass(frozen=True, kw_only=True)
class OfMotion(Fault):
    """A fault for which `readings` (none: all) are those of another motion than the one that the log shows."""

    readings: tuple[int, ...] = ()

    @abstractmethod
    def state(self, view: View, size: float) -> tuple[Array, Array, Array]:
        """That motion: q, qd and qdd (N, n)."""

    def effect(self, view: View, size: float) -> Array:
        """Readings of that motion beyond those of the log's."""
        return self._beyond(view, self.state(view, size))

    def sensitivity(self, view: View, at: float = 0.0) -> Array:
        """Derivative of the effect by the size (N, c), zero where an actuator reverses between both sides of it."""
        return self._difference(view, self.state(view, at + self._step), self.state(view, at - self._step))

    def by_parameters(self, view: View, size: float) -> Array:
        """The regressor of that motion beyond the log's."""
        return _only(view.regressor_of(*self.state(view, size)) - view.regressor, self._concerned(view))

    def unsteady(self, view: View, size: float) -> NDArray[np.bool_]:
        """Readings (N, c) of actuators too slow in that motion for the sign of their friction to be known."""
        chosen = np.zeros(view.predicted.shape, dtype=bool)
        q, qd, _ = self.state(view, size)
        slow = view.courses.in_any(np.abs(view.courses.speeds(q, qd)) <= view.slowest)
        chosen[:, : slow.shape[1]] = slow
        return _only(chosen, self._concerned(view))

    @property
    def _step(self) -> float:
        return 0.05 * self.scale

    def _beyond(self, view: View, state: Sequence[Array]) -> Array:
        return _only(view.readings(*state) - view.predicted, self._concerned(view))

    def _concerned(self, view: View) -> tuple[int, ...]:
        return self.readings or tuple(range(len(view.names)))

    def _difference(self, view: View, up: Sequence[Array], down: Sequence[Array]) -> Array:
        made = (self._beyond(view, up) - self._beyond(view, down)) / (2 * self._step)
        one, other = (np.sign(view.courses.speeds(q, qd)) for q, qd, _ in (up, down))
        reverses = view.courses.in_any(one != other)
        made[:, : reverses.shape[1]][reverses] = 0.0
        return made


@dataclass(frozen=True, kw_only=True)
class ForcesLate(OfMotion):
    """Readings of forces stand later in the log than those of angles, by the size [s]; `readings` are concerned.

    The effect is that beyond the faults `before`, of stated sizes, which make the same readings late already.
    """

    drifts: bool = False
    before: tuple[tuple[ForcesLate, float], ...] = ()

    def state(self, view: View, size: float) -> tuple[Array, Array, Array]:
        """An earlier motion; where clocks drift, the size is what they differ by at the end."""
        return view.moved(-sum((fault.lateness(view, own) for fault, own in self.before), self.lateness(view, size)))

    def lateness(self, view: View, size: float) -> Array:
        """How late readings (N,) are by the fault alone [s]."""
        return size * (view.elapsed if self.drifts else np.ones(view.elapsed.size))

    def effect(self, view: View, size: float) -> Array:
        """Readings of that motion beyond those with the faults before."""
        found = super().effect(view, size)
        return found - super().effect(view, 0.0) if self.before else found

    def sensitivity(self, view: View, at: float = 0.0) -> Array:
        """Derivative of the effect by the size (N, c), which the view keeps for faults of other readings."""
        alike = replace(self, name="", group="", subject=(), words="", opposite="", readings=())
        if (alike, at) not in view.kept:
            view.kept[alike, at] = super(ForcesLate, alike).sensitivity(view, at)
        return _only(view.kept[alike, at], self._concerned(view))

    def by_parameters(self, view: View, size: float) -> Array:
        """The regressor of that motion beyond that with the faults before."""
        found = super().by_parameters(view, size)
        return found - super().by_parameters(view, 0.0) if self.before else found


@dataclass(frozen=True, kw_only=True)
class AngleLate(OfMotion):
    """The reading of a joint's position is late by the size [s]."""

    joint: int = 0

    def state(self, view: View, size: float) -> tuple[Array, Array, Array]:
        """The motion with this joint further on."""
        shift = np.zeros_like(view.motion.q)
        shift[:, self.joint] = size
        return view.moved(shift)


@dataclass(frozen=True, kw_only=True)
class Lag(Fault):
    """Readings follow as a first-order system of the size [s] does."""

    readings: tuple[int, ...] = ()

    def effect(self, view: View, size: float) -> Array:
        """Low-passed minus true readings; the same with the other sign where a size is negative."""
        return _only(self._slowed(view, view.predicted, size), self.readings)

    def by_parameters(self, view: View, size: float) -> Array:
        """What the same does to the regressor."""
        return _only(self._slowed(view, view.regressor, size), self.readings)

    def _slowed(self, view: View, true: Array, size: float) -> Array:
        motion = view.motion
        return np.asarray(np.sign(size) * (lagged(motion.t, true, abs(size), motion.segment) - true))


@dataclass(frozen=True, kw_only=True)
class Tilt(Fault):
    """The base is turned by the size [rad] about an axis of the base frame, against gravity as stated."""

    axis: int = 0

    def effect(self, view: View, size: float) -> Array:
        """What the change of gravity does."""
        return np.asarray(size * view.weights @ self._change(view))

    def by_parameters(self, view: View, size: float) -> Array:
        """The same for a unit of each parameter."""
        units = np.eye(len(view.psi))
        return np.stack([size * view.gravity(one) @ self._change(view) for one in units], axis=2)

    def _change(self, view: View) -> Array:
        """Of gravity in the base frame (3,) [m/s²] by a unit of the size."""
        return -np.cross(np.eye(3)[self.axis], np.asarray(gravity_in_base(view.model.machine), dtype=float).ravel())


@dataclass(frozen=True, kw_only=True)
class AngleOffset(OfMotion):
    """The reading of a joint's position is too large by the size [rad or m]."""

    joint: int = 0

    def state(self, view: View, size: float) -> tuple[Array, Array, Array]:
        """The shifted posture."""
        q = view.motion.q.copy()
        q[:, self.joint] -= size
        return q, view.motion.qd, view.motion.qdd


@dataclass(frozen=True, kw_only=True)
class Play(OfMotion):
    """Between a joint and the reading of its position there is play of the size [rad or m]."""

    joint: int = 0

    def state(self, view: View, size: float) -> tuple[Array, Array, Array]:
        """A joint that lags behind its sensor, on the side that it comes from."""
        return self._with(view, size, self._jumps(view, size))

    def sensitivity(self, view: View, at: float = 0.0) -> Array:
        """Derivative of the effect by the size (N, c), with reversals where they are at this size."""
        jumps = self._jumps(view, at)
        return self._difference(view, *(self._with(view, at + h, jumps) for h in (self._step, -self._step)))

    def _with(self, view: View, size: float, jumps: Array) -> tuple[Array, Array, Array]:
        state = [view.motion.q.copy(), view.motion.qd.copy(), view.motion.qdd.copy()]
        for values, change in zip(state, jumps, strict=True):
            values[:, self.joint] -= 0.5 * size * change
        return state[0], state[1], state[2]

    def _jumps(self, view: View, size: float) -> Array:
        """What smoothing makes of the sign of the joint's speed, which shows once the jumps are taken out of it."""
        speed = view.motion.qd[:, self.joint]
        jumps = view.smoothed(np.sign(speed), self.joint)
        for _ in range(REVERSALS if size else 0):
            jumps = view.smoothed(np.sign(speed - 0.5 * size * jumps[1]), self.joint)
        return jumps


@dataclass(frozen=True, kw_only=True)
class Added(Fault):
    """Something in proportion to a known course, added to one reading: a drift, a missing friction term."""

    course: str = ""
    reading: int = 0

    def effect(self, view: View, size: float) -> Array:
        """The course times the size."""
        return _placed(view, size * self._course(view)[:, None], (self.reading,))

    def by_parameters(self, view: View, size: float) -> Array | None:
        """Of a gain, the regressor times the size."""
        return _only(size * view.regressor, (self.reading,)) if self.course == "reading" else None

    def _course(self, view: View) -> Array:
        true = view.predicted[:, self.reading]
        if self.course == "constant":
            return np.ones(len(true))
        if self.course == "time":
            return view.elapsed - 0.5
        if self.course == "reading":
            return true
        speed = view.speeds[:, self.reading]
        speed = speed / max(float(np.sqrt(np.mean(speed**2))), 1e-12)
        courses = {"viscous": speed, "quadratic": speed * np.abs(speed), "coulomb": np.sign(speed),
                   "one way": (speed > 0).astype(float), "stribeck": np.sign(speed) * np.exp(-(3 * speed) ** 2)}
        if self.course in courses:
            return courses[self.course]
        load = np.abs(true) if self.course == "load" else np.abs(_seal_pressure(view, self.reading))
        return np.asarray(np.sign(speed) * load / max(float(np.sqrt(np.mean(load**2))), 1e-12))


@dataclass(frozen=True, kw_only=True)
class Scaled(Fault):
    """A pressure reads too much, in proportion, whichever readings it is a part of."""

    def effect(self, view: View, size: float) -> Array:
        """What it adds to the readings, times the size."""
        added = view.contributions.get(self.subject[0])  # None in a log without this pressure
        return np.zeros_like(view.predicted) if added is None else np.asarray(size * added)


@dataclass(frozen=True, kw_only=True)
class Warming(Fault):
    """The friction of one reading changes over the log by the size, as a part of it."""

    reading: int = 0

    def effect(self, view: View, size: float) -> Array:
        """What the change does about the middle of the log."""
        friction = view.friction[:, self.reading, None] * (view.elapsed[:, None] - 0.5)
        return _placed(view, size * friction, (self.reading,))


@dataclass(frozen=True, kw_only=True)
class ChamberLate(Fault):
    """A pressure is late by the size [s] against all other readings."""

    def effect(self, view: View, size: float) -> Array:
        """What a late pressure misses of its part of the readings."""
        own = view.contributions.get(self.subject[0])
        return np.zeros_like(view.predicted) if own is None else -size * np.gradient(own, view.motion.t, axis=0)


@dataclass(frozen=True, kw_only=True)
class Load(Fault):
    """From a part of the log on, the last body is heavier by the size, as a part of it, in every number."""

    body: str = ""
    after: float = 0.5

    def effect(self, view: View, size: float) -> Array:
        """What its nominal numbers do then."""
        return size * view.of_bodies[self.body] * (view.elapsed > self.after)[:, None]


@dataclass(frozen=True, kw_only=True)
class Bodies(Fault):
    """The bodies of some parts are heavier than stated by the size, as a part of it, in every number."""

    owners: tuple[str, ...] = ()

    def effect(self, view: View, size: float) -> Array:
        """What their nominal numbers do."""
        return np.asarray(size * sum(view.of_bodies[owner] for owner in self.owners))


def _only(change: NDArray[Any], readings: tuple[int, ...]) -> NDArray[Any]:
    kept = np.zeros_like(change)
    kept[:, list(readings)] = change[:, list(readings)]
    return kept


def _placed(view: View, values: Array, readings: tuple[int, ...]) -> Array:
    made = np.zeros_like(view.predicted)
    made[:, list(readings)] = values
    return made


def _seal_pressure(view: View, reading: int) -> Array:
    actuator = view.model.machine.balances[reading].alone
    assert isinstance(actuator, Cylinder)
    return np.asarray(sum((view.pressures[channel] for channel in actuator.chambers if channel in view.pressures),
                          np.zeros(len(view.predicted))))


def one_after_another(faults: Sequence[Fault], sizes: Sequence[float]) -> tuple[Fault, ...]:
    """The same faults; those that make readings late do so beyond the ones before: delays add up."""
    def late(k: int, own: ForcesLate) -> tuple[tuple[ForcesLate, float], ...]:
        return tuple((replace(other, before=()), size) for other, size in zip(faults[:k], sizes[:k], strict=True)
                     if isinstance(other, ForcesLate) and set(other.readings) >= set(own.readings))
    return tuple(replace(fault, before=late(k, fault)) if isinstance(fault, ForcesLate) else fault
                 for k, fault in enumerate(faults))


def listed(view: View) -> Iterator[Fault]:
    """All hypotheses about a log's readings, of the sizes that the machine file states."""
    forces = range(len(view.model.machine.balances))
    for fault in _usual(view):
        stated = stated_size(view, fault)
        if stated is not None and fault.group in OF_FORCE and isinstance(fault, Added) and fault.reading in forces:
            stated *= float(np.sqrt(np.mean(view.measured[:, fault.reading] ** 2)))
        fits = stated is not None and (fault.group not in ("offset", "play") or fault.unit == "deg")
        yield fault.scaled(stated) if stated is not None and fits else fault


def stated_size(view: View, fault: Fault) -> float | None:
    """The standard deviation [SI] that the machine file states: of a sensor's lag, or of the fault's group."""
    of_group, machine = getattr(view.model.machine.faults, fault.group, None), view.model.machine
    if not isinstance(fault, Lag):
        return of_group
    return max((machine.lag(channel).sigma for channel in force_channels(view.model, view.experiment.log)
                if fault.subject == ("forces",) or channel.partition(".")[0] in fault.subject), default=0.0) or of_group


def _named(group: str, subject: str, words: str) -> dict[str, Any]:
    return {"name": f"{group} {subject}", "group": group, "subject": (subject,), "words": words}


MILLISECONDS: dict[str, Any] = {"unit": "ms", "factor": 1e3, "std": (LATE,), "linear": False}
PERCENT: dict[str, Any] = {"unit": "%", "factor": 100.0}
DEGREES = 180 / np.pi


def _usual(view: View) -> Iterator[Fault]:
    machine, n = view.model.machine, len(view.model.machine.balances)
    read = tuple(np.flatnonzero(view.read[:n]).tolist())  # no transducer of a passive joint can be late
    clock = MILLISECONDS | {"std": (0.05,)}
    yield ForcesLate(**_named("delay", "forces", "all force readings are late against the angles"), **MILLISECONDS,
                     readings=read, opposite="all force readings are early against the angles")
    yield ForcesLate(**_named("clock", "forces", "the clock of the forces drifts against that of the angles, over the "
                              "log"), **clock, readings=read, drifts=True)
    yield Lag(**_named("lag", "forces", "all force readings lag behind"), **MILLISECONDS, positive=True, readings=read)
    for k in read if len(read) > 1 else ():
        name = machine.balances[k].name
        yield ForcesLate(**_named("delay", name, f"the force readings of {name} are late"), **MILLISECONDS,
                         readings=(k,), opposite=f"the force readings of {name} are early")
        yield Lag(**_named("lag", name, f"the force readings of {name} lag behind"), **MILLISECONDS, positive=True,
                  readings=(k,))
    yield from _of_joints(view)
    gravity = np.abs(np.asarray(gravity_in_base(machine), dtype=float).ravel())
    for axis in np.argsort(gravity, kind="stable")[:2].tolist() if np.any(gravity) else ():
        about = "xyz"[axis]
        yield Tilt(**_named("tilt", f"base about {about}", f"the base is tilted about its {about} axis"), unit="deg",
                   std=(np.radians(2.0),), factor=DEGREES, axis=axis)
    for k in range(n):
        yield from _of_forces(view, k)
    for k in range(n, len(view.names)):
        yield from _of_lengths(view, k)
    yield from _of_bodies(view)


def _of_joints(view: View) -> Iterator[Fault]:
    machine = view.model.machine
    for j, joint in enumerate(machine.joints):
        turns, channel = machine.channel_units[f"{joint}.q"] == "rad", f"{joint}.q"
        angle = np.radians(1.0) if turns else 0.01
        units: dict[str, Any] = {"unit": "deg" if turns else "mm", "factor": DEGREES if turns else 1e3, "linear": False}
        if len(machine.joints) > 1 or view.lengths:
            yield AngleLate(**_named("delay", channel, f"the readings of {channel} are late"), **MILLISECONDS, joint=j,
                            opposite=f"the readings of {channel} are early")
        yield AngleOffset(**_named("offset", channel, f"{channel} reads too much"), **units, std=(angle,), joint=j,
                          opposite=f"{channel} reads too little")
        yield Play(**_named("play", channel, f"{joint} has play against its sensor"), **units, std=(0.3 * angle,),
                   positive=True, joint=j)


def _of_forces(view: View, k: int) -> Iterator[Fault]:
    balance = view.model.machine.balances[k]
    actuator, name, unit, has = balance.alone, balance.name, balance.unit, set(_kinds_of(view, balance))
    size = TYPICAL * float(np.sqrt(np.mean(view.measured[:, k] ** 2)))
    if not balance.actuators:  # nothing is read, and forces that cancel have the size of the largest of them
        terms = view.regressor[:, k] * view.psi
        size = TYPICAL * float(np.sqrt(np.max(np.mean(terms**2, axis=0), initial=0.0)))
        for course in ("viscous", "coulomb"):
            yield Added(**_named("friction", name, f"{name} has {FRICTION[course]}, which the model lacks"), unit=unit,
                        std=(size,), course=course, reading=k, lack=True)
        return
    factors = actuator.effort_factors if actuator else {}
    chambers = [channel for each in balance.actuators for channel in each.effort_factors if channel in view.pressures]
    for channel in chambers:
        yield Scaled(**_named("gain", channel, f"{channel} reads too much, or the area stated for it is too large"),
                     **PERCENT, std=(TYPICAL,),
                     opposite=f"{channel} reads too little, or the area stated for it is too small")
        if len(chambers) > 1:
            yield ChamberLate(**_named("delay", channel, f"the readings of {channel} are late"),
                              **MILLISECONDS | {"linear": True}, opposite=f"the readings of {channel} are early",
                              free=False)
    if not chambers:
        yield Added(**_named("gain", name, f"the force readings of {name} are too large"), **PERCENT, std=(TYPICAL,),
                    course="reading", reading=k, opposite=f"the force readings of {name} are too small")
    drift = max(abs(f) for f in factors.values()) * DRIFT if chambers and factors else size
    yield Added(**_named("drift", name, f"the force readings of {name} drift over the log"), unit=unit, std=(drift,),
                course="time", reading=k)
    if ParameterKind.FORCE_OFFSET not in has:
        yield Added(**_named("bias", name, f"the force readings of {name} have an offset"), unit=unit, std=(drift,),
                    course="constant", reading=k)
    if has & set(KNOWN.values()):
        yield Warming(**_named("warming", name, f"the friction of {name} grows over the log"), **PERCENT, std=(0.3,),
                      reading=k, opposite=f"the friction of {name} falls over the log, as where its oil warms",
                      free=False)
    sealed = len(chambers) == len(factors) == 2 and isinstance(actuator, Cylinder)
    for course, words in FRICTION.items():
        if KNOWN.get(course) not in has and (sealed or course != "seal"):
            yield Added(**_named("friction", name, f"{name} has {words}, which the model lacks"), unit=unit,
                        std=(size,), course=course, reading=k, lack=True)


def _kinds_of(view: View, balance: Balance) -> Iterator[ParameterKind]:
    parameters, owners = view.model.parameters, (balance.joint, *(each.name for each in balance.actuators))
    for name, kind in zip(parameters.names, parameters.kinds, strict=True):
        if not kind.is_inertial and parameters.owner(name) in owners:
            yield kind


def _of_lengths(view: View, k: int) -> Iterator[Fault]:
    name = view.names[k]
    yield ForcesLate(**_named("delay", name, f"the readings of {name} are late"), **MILLISECONDS, readings=(k,),
                     opposite=f"the readings of {name} are early")
    yield Added(**_named("drift", name, f"the readings of {name} drift over the log"), unit="mm", std=(0.01,),
                factor=1e3, course="time", reading=k)


def _of_bodies(view: View) -> Iterator[Fault]:
    stated = owners_with_confidence(view.model.machine, view.model.bodies)  # what is only assumed cannot be wrong
    owners = tuple(owner for owner in view.model.parameters.bodies if owner in stated)
    ends = tuple(owner for owner in owners if "." in owner)
    links = tuple(owner for owner in owners if "." not in owner)
    groups = {"all bodies": owners, "all links": links, "all barrels and rods": ends}
    for words, group in (*groups.items(), *((owner, (owner,)) for owner in owners)):
        if group == (words,) or (len(group) > 1 and (words == "all bodies" or len(group) < len(owners))):
            are = "is" if group == (words,) else "are"
            yield Bodies(**_named("bodies", words, f"{words} {are} heavier than stated"), **PERCENT, std=(1.0,),
                         free=False, owners=group, opposite=f"{words} {are} lighter than stated")
    last = next((link for link in reversed(view.model.machine.joints) if link in view.of_bodies), None)
    for part in PICKED_UP.tolist() if last is not None else ():
        yield Load(**_named("load", str(last), f"{last} picks up a load after {part:.0%} of the log"), **PERCENT,
                   std=(0.5,), free=False, body=str(last), after=part,
                   opposite=f"{last} puts down a load after {part:.0%} of the log")
