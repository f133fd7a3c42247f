"""The faults of instruments and model that residuals are searched for: what each would do to the readings.

A fault of size δ adds `effect(view, δ)` to the predicted readings. `scale` is a usual size: the standard deviation of
the prior under which evidence for a fault is weighed.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hydroopt.estimation.dynamic.misfit.view import View
from hydroopt.logs.lag import lagged
from hydroopt.machine.actuators import Cylinder
from hydroopt.model.kinematics import gravity_in_base
from hydroopt.parameters.parameter_set import ParameterKind
from hydroopt.spatial.inertia import Array

TYPICAL = 0.03
"""Part of the RMS force that a usual friction, gain or drift of a torque has."""
DRIFT = 3e5
"""Usual drift of a pressure reading over a log [Pa]."""
OF_FORCE = ("drift", "friction")
"""Faults whose usual sizes a machine file states as parts of the RMS force."""
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


@dataclass(frozen=True)
class Fault(ABC):
    """One fault.

    Attributes:
        group: the word that stands for it and its like in options: ``delay``.
        subject: channels, actuators or bodies that have it.
        words: what it is, for sentences; `opposite`: the same where its size is negative.
        unit: of its size as printed, `factor` times the SI size.
        scale: usual size in SI.
        positive: whether its size cannot be negative.
        motion: whether its effect is not linear in its size.
        free: whether its size can be estimated along; bodies are parameters with priors of their own.
    """

    group: str
    subject: tuple[str, ...]
    words: str
    unit: str
    scale: float
    factor: float = 1.0
    positive: bool = False
    motion: bool = False
    free: bool = True
    opposite: str = field(default="", kw_only=True)

    def said(self, size: float) -> tuple[str, float]:
        """What it is at a size [SI], and the size in the direction of these words."""
        return (self.opposite, -size) if self.opposite and size < 0 else (self.words, size)

    @abstractmethod
    def effect(self, view: View, size: float) -> Array:
        """Change of the predicted readings (N, c) by a fault of this size [SI]."""

    def sensitivity(self, view: View, at: float = 0.0) -> Array:
        """Derivative of the effect by the size (N, c), steps of dry friction aside."""
        if not self.motion:
            return self.effect(view, 1.0)
        h = 0.05 * self.scale
        return (self.effect(view, at + h) - self.effect(view, at - h)) / (2 * h)

    def by_parameters(self, view: View, size: float) -> Array | None:
        """Derivative of the effect by ψ (N, c, p); None where it is zero or small."""
        return None

    def unsteady(self, view: View, size: float) -> NDArray[np.bool_]:
        """Readings (N, c) whose dry friction is not known if a fault of this size is there."""
        return np.zeros(view.predicted.shape, dtype=bool)

    @property
    def name(self) -> str:
        """The group and the subject."""
        return f"{self.group} {', '.join(self.subject)}"


@dataclass(frozen=True)
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


@dataclass(frozen=True)
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
        alike = replace(self, group="", subject=(), words="", opposite="", readings=())
        if (alike, at) not in view.kept:
            view.kept[alike, at] = super(ForcesLate, alike).sensitivity(view, at)
        return _only(view.kept[alike, at], self._concerned(view))

    def by_parameters(self, view: View, size: float) -> Array:
        """The regressor of that motion beyond that with the faults before."""
        found = super().by_parameters(view, size)
        return found - super().by_parameters(view, 0.0) if self.before else found


@dataclass(frozen=True)
class AngleLate(OfMotion):
    """The reading of a joint's position is late by the size [s]."""

    joint: int = 0

    def state(self, view: View, size: float) -> tuple[Array, Array, Array]:
        """The motion with this joint further on."""
        shift = np.zeros_like(view.motion.q)
        shift[:, self.joint] = size
        return view.moved(shift)


@dataclass(frozen=True)
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


@dataclass(frozen=True)
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


@dataclass(frozen=True)
class AngleOffset(OfMotion):
    """The reading of a joint's position is too large by the size [rad or m]."""

    joint: int = 0

    def state(self, view: View, size: float) -> tuple[Array, Array, Array]:
        """The shifted posture."""
        q = view.motion.q.copy()
        q[:, self.joint] -= size
        return q, view.motion.qd, view.motion.qdd


@dataclass(frozen=True)
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


@dataclass(frozen=True)
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


@dataclass(frozen=True)
class Scaled(Fault):
    """A pressure reads too much, in proportion, whichever readings it is a part of."""

    def effect(self, view: View, size: float) -> Array:
        """What it adds to the readings, times the size."""
        added = view.contributions.get(self.subject[0])  # None in a log without this pressure
        return np.zeros_like(view.predicted) if added is None else np.asarray(size * added)


@dataclass(frozen=True)
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
