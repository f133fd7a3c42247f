"""Logs with one fault of known kind and size, made without any code of the tests of fit."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy.signal import lfilter

from hydroopt import Log, Machine, Model, random_trajectory, random_truth, simulate
from hydroopt.model.kinematics import gravity_in_base
from hydroopt.simulation.simulate import Trajectory, _chambers, forces

RATE, FINE, SECONDS = 50.0, 1000.0, 30.0
Array = np.ndarray


@dataclass
class Truth:
    """A machine's true motion and forces at `FINE` [Hz], and what of them is recorded when."""

    model: Model
    psi: Array
    motion: Trajectory
    force: Array
    seed: int
    noise: bool = True

    def log(self, *, q: Array | None = None, force: Array | None = None) -> Log:
        """The log of sensors that see these positions and forces (at `FINE`)."""
        step = round(FINE / RATE)
        chosen = slice(None, None, step)
        motion = Trajectory(*(x[chosen] for x in (self.motion.t, self.motion.q, self.motion.qd, self.motion.qdd)))
        log = simulate(self.model, motion, self.psi, noise=self.noise, seed=self.seed)
        clean = simulate(self.model, motion, self.psi, noise=False)
        channels = dict(log.channels)
        if q is not None:
            for k, joint in enumerate(self.model.machine.joints):
                channels[f"{joint}.q"] = channels[f"{joint}.q"] + (q - self.motion.q)[chosen, k]
        if force is not None:
            for k, actuator in enumerate(self.model.machine.actuators):
                if hasattr(actuator, "chambers"):
                    made = _chambers(force[chosen, k], *actuator.areas, *actuator.chambers)
                else:
                    made = {f"{actuator.joint}.tau": force[chosen, k]}
                for name, values in made.items():
                    channels[name] = channels[name] + values - clean.channels[name]
        return replace(log, channels=channels)


def truth(model: Model, seed: int, psi: Array | None = None, *, noise: bool = True) -> Truth:
    """A random machine, unless ψ is given, and a random motion; another seed is another of both."""
    psi = random_truth(model, seed) if psi is None else psi
    motion = random_trajectory(model, duration=SECONDS, rate=FINE, seed=seed)
    return Truth(model, psi, motion, forces(model, motion, psi), seed, noise)


def _earlier(x: Array, samples: Array | int) -> Array:
    at = np.arange(len(x)) - np.asarray(samples)
    return x[np.clip(np.round(at).astype(int), 0, len(x) - 1)]


def _columns(x: Array, k: int, values: Array) -> Array:
    made = x.copy()
    made[:, k] = values
    return made


def _lagged(x: Array, seconds: float) -> Array:
    a = 1 / (1 + seconds * FINE)
    return lfilter([a], [1, a - 1], x - x[0], axis=0) + x[0]


def _speed(t: Truth, k: int) -> Array:
    actuator, machine = t.model.machine.actuators[k], t.model.machine
    if hasattr(actuator, "barrel"):
        made = t.model.over(t.model.cylinder_kinematics, t.motion.q, t.motion.qd, t.motion.qdd)[1][:, :, 0]
        v = made[:, machine.pinned.index(actuator)]
    else:
        v = t.motion.qd[:, k]
    return v / np.sqrt(np.mean(v**2))


def _rms(t: Truth, k: int) -> float:
    return float(np.sqrt(np.mean(t.force[:, k] ** 2)))


def _added(k: int, part: float, course: Callable[[Truth, int], Array]) -> Callable[[Truth], Log]:
    return lambda t: t.log(force=_columns(t.force, k, t.force[:, k] + part * _rms(t, k) * course(t, k)))


def _gain(channel: str, factor: float) -> Callable[[Truth], Log]:
    def make(t: Truth) -> Log:
        log = t.log()
        return replace(log, channels={**log.channels, channel: factor * log.channels[channel]})
    return make


def _tilted(axis: int, degrees: float) -> Callable[[Truth], Log]:
    def make(t: Truth) -> Log:
        turn = list(t.model.machine.orientation)
        turn[axis] += np.radians(degrees)
        tilted = Model(Machine.model_validate({**t.model.machine.model_dump(), "orientation": turn}))
        return t.log(force=forces(tilted, t.motion, t.psi))
    return make


def _heavier(chosen: Callable[[str], bool], factor: float) -> Callable[[Truth], Truth]:
    def make(t: Truth) -> Truth:
        psi = t.psi.copy()
        for owner, columns in t.model.parameters.bodies.items():
            psi[columns] *= factor if chosen(owner) else 1.0
        return Truth(t.model, psi, t.motion, forces(t.model, t.motion, psi), t.seed, t.noise)
    return make


def _ramp(t: Truth) -> Array:
    return np.linspace(-0.5, 0.5, len(t.motion.t))


@dataclass(frozen=True)
class Kind:
    """A kind of fault: how its log is made, and what is a right name for it.

    Attributes:
        make: from the truth to the log.
        right: names of faults that are a right answer, or their group.
        fault: name of the true fault; "" where it is none of those that are looked for by their sensitivity.
        size: of it [SI], or as a part of the RMS force of `of_force`.
        course: of friction over speed or load.
        changed: from the truth to that of the faulty machine, where its parameters are others.
    """

    make: Callable[[Truth], Log]
    right: frozenset[str]
    fault: str = ""
    size: float = 0.0
    of_force: int | None = None
    course: str = ""
    changed: Callable[[Truth], Truth] = lambda t: t

    def si(self, t: Truth) -> float:
        """The size in SI."""
        return abs(self.size) * (1.0 if self.of_force is None else _rms(t, self.of_force))


def listed(model: Model) -> dict[str, Kind]:
    """Faults that the list has, by name."""
    machine, n = model.machine, len(model.machine.joints)
    main = min(1, n - 1)
    joint, force = machine.joints[main], machine.actuators[main].name
    alone = {f"{group} {force}" for group in ("delay", "lag")} | {f"delay {joint}.q"}
    # of one joint, all forces late, its force late and its angle early are one and the same
    together = {"delay forces", "lag forces"} | (alone if n == 1 else set())
    return {**_late(model, main, together, alone), **_of_posture(model, main), **_of_forces(model, main),
            **_of_bodies(model)}


def _late(model: Model, main: int, together: set[str], alone: set[str]) -> dict[str, Kind]:
    machine, n = model.machine, len(model.machine.joints)
    joint, force = machine.joints[main], machine.actuators[main].name
    made = {}
    for ms in (60, 30, -40):
        made[f"all forces {ms} ms late"] = Kind(
            lambda t, ms=ms: t.log(force=_earlier(t.force, ms)), frozenset(together), "delay forces", ms / 1e3)
    for ms in (60, 100):
        made[f"all forces lag by {ms} ms"] = Kind(
            lambda t, ms=ms: t.log(force=_lagged(t.force, ms / 1e3)), frozenset(together), "lag forces", ms / 1e3)
    for ms in (80, 150):
        made[f"clock drifts by {ms} ms"] = Kind(lambda t, ms=ms: t.log(
            force=_earlier(t.force, ms * (_ramp(t) + 0.5))), frozenset({"clock forces"}), "clock forces", ms / 1e3)
    if n > 1:
        first = machine.actuators[0].name
        made["one force 60 ms late"] = Kind(lambda t: t.log(force=_columns(
            t.force, main, _earlier(t.force[:, main], 60))), frozenset(alone), f"delay {force}", 0.06)
        made["another force 100 ms late"] = Kind(
            lambda t: t.log(force=_columns(t.force, 0, _earlier(t.force[:, 0], 100))),
            frozenset({f"delay {first}", f"lag {first}"}), f"delay {first}", 0.1)
        made["one force lags by 80 ms"] = Kind(lambda t: t.log(force=_columns(
            t.force, main, _lagged(t.force[:, main], 0.08))), frozenset(alone), f"lag {force}", 0.08)
    made["one angle 60 ms late"] = Kind(
        lambda t: t.log(q=_columns(t.motion.q, main, _earlier(t.motion.q[:, main], 60))),
        frozenset({f"delay {joint}.q", f"delay {force}", *(together if n == 1 else ())}), f"delay {joint}.q", 0.06)
    return made


def _of_posture(model: Model, main: int) -> dict[str, Kind]:
    machine, joint = model.machine, model.machine.joints[main]
    gravity = np.abs(np.asarray(gravity_in_base(machine), dtype=float).ravel())
    made = {}
    for axis in np.flatnonzero(gravity < gravity.max()).tolist():
        made[f"base tilted by 3 deg about {'xyz'[axis]}"] = Kind(
            _tilted(axis, 3.0), frozenset({"tilt"}), f"tilt base about {'xyz'[axis]}", np.radians(3.0))
    for degrees in (4.0, -6.0):
        made[f"{joint}.q {degrees:g} deg off"] = Kind(lambda t, degrees=degrees: t.log(
            q=_columns(t.motion.q, main, t.motion.q[:, main] + np.radians(degrees))),
            frozenset({f"offset {joint}.q"}), f"offset {joint}.q", np.radians(degrees))
    for degrees in (0.4, 0.8):
        made[f"play of {degrees:g} deg"] = Kind(lambda t, degrees=degrees: t.log(q=_columns(
            t.motion.q, main, t.motion.q[:, main] + np.radians(degrees / 2) * np.sign(t.motion.qd[:, main]))),
            frozenset({f"play {joint}.q"}), f"play {joint}.q", np.radians(degrees))
    return made


def _of_forces(model: Model, main: int) -> dict[str, Kind]:
    machine, n, force = model.machine, len(model.machine.joints), model.machine.actuators[main].name
    kinds, made = {kind.name for kind in model.parameters.kinds}, {}
    for part in (0.05, -0.10):
        made[f"drift of one force by {100 * part:g} %"] = Kind(
            _added(main, part, lambda t, k: _ramp(t)), frozenset({f"drift {force}"}), f"drift {force}", part, main)
    courses: dict[str, Callable[[Truth, int], Array]] = {
        "quadratic": lambda t, k: _speed(t, k) * np.abs(_speed(t, k)),
        "one way": lambda t, k: (_speed(t, k) > 0).astype(float),
        "stribeck": lambda t, k: np.sign(_speed(t, k)) * np.exp(-(3 * _speed(t, k)) ** 2),
        "load": lambda t, k: np.sign(_speed(t, k)) * np.abs(t.force[:, k]) / _rms(t, k)}
    if "VISCOUS_FRICTION" not in kinds:
        courses["viscous"] = _speed
    for word, course in courses.items():
        for part in (0.05, 0.10):
            made[f"{word} friction of {100 * part:g} %"] = Kind(
                _added(main, part, course), frozenset({f"friction {force}"}), f"friction {force}", part, main, word)
    for hertz in (12.3, 7.1):
        made[f"pulsation at {hertz:g} Hz"] = Kind(_added(main, 0.03, lambda t, k, hertz=hertz: np.sin(
            2 * np.pi * hertz * t.motion.t)), frozenset({"line"}))
    made["spikes"] = Kind(_spiked, frozenset({"spikes"}))
    for actuator in machine.actuators[: 2 if n > 1 else 1]:
        channels = [c for c in actuator.effort_factors if ".p_" in c]
        for channel in channels or [f"{actuator.joint}.tau"]:
            for factor in (1.10, 0.85):
                made[f"{channel} reads {100 * factor - 100:+.0f} %"] = Kind(
                    _gain(channel, factor), frozenset({f"gain {one}" for one in channels or [actuator.name]}),
                    f"gain {channel if channels else actuator.name}", factor - 1)
    if "FORCE_OFFSET" not in kinds:
        for part in (0.05, -0.08):
            made[f"one force off by {100 * part:g} %"] = Kind(_added(
                main, part, lambda t, k: np.ones(len(t.motion.t))), frozenset({f"bias {force}"}), f"bias {force}",
                part, main)
    return made


def _of_bodies(model: Model) -> dict[str, Kind]:
    owners, made = list(model.parameters.bodies), {}
    for words, chosen, factor in (("all bodies", lambda owner: True, 1.35), ("all links", _is_link, 1.4),
                                  ("all barrels and rods", lambda owner: not _is_link(owner), 3.0)):
        some = [owner for owner in owners if chosen(owner)]
        if some and (words == "all bodies" or len(some) < len(owners)):
            change = _heavier(chosen, factor)
            made[f"{words} {factor:g} times as heavy"] = Kind(
                lambda t, change=change: change(t).log(), frozenset({"bodies"}), f"bodies {words}", factor - 1,
                changed=change)
    return made


def _is_link(owner: str) -> bool:
    return "." not in owner


def _spiked(t: Truth) -> Log:
    log, rng = t.log(), np.random.default_rng(t.seed)
    channels = dict(log.channels)
    for name, x in log.channels.items():
        if not name.endswith((".q", ".length")):
            hit = rng.random(log.size) < 0.01
            size = 0.5 * np.std(x) + 20 * np.std(np.diff(x))
            channels[name] = x + hit * size * rng.choice([-1.0, 1.0], log.size)
    return replace(log, channels=channels)


def outside(model: Model) -> dict[str, Callable[[Truth], Log]]:
    """Effects that no listed fault is."""
    main = min(1, len(model.machine.joints) - 1)
    return {
        "ripple over position": _added(main, 0.05, lambda t, k: np.sin(15 * t.motion.q[:, k])),
        "settling after the start": _added(main, 0.08, lambda t, k: np.exp(-(t.motion.t) / 3.0)),
        "disturbances": _added(main, 0.06, lambda t, k: np.sign(np.sin(2 * np.pi * 0.23 * t.motion.t + 1.0))),
        "two stiffnesses": _added(main, 0.05, lambda t, k: np.abs(t.motion.q[:, k] - np.median(t.motion.q[:, k]))),
        "friction of one end": _added(main, 0.06, lambda t, k: np.sign(_speed(t, k)) * _along(t, k)),
        "a step midway": _added(main, 0.05, lambda t, k: (t.motion.t > 0.4 * t.motion.t[-1]).astype(float)),
        "another's force in it": _added(main, 0.05, lambda t, k: t.force[:, 0] / _rms(t, 0) if k else
                                        (t.force[:, 0] / _rms(t, 0)) ** 2),
        "yielding to force": lambda t: t.log(q=_columns(t.motion.q, main, t.motion.q[:, main] + np.radians(0.3) * (
            np.abs(t.force[:, main]) * t.force[:, main] / _rms(t, main) ** 2))),
    }


def _along(t: Truth, k: int) -> Array:
    q = t.motion.q[:, k]
    return (q - q.min()) / np.ptp(q)
