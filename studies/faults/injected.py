"""Logs with one fault of known kind and size, made without any code of the tests of fit."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy.signal import lfilter

from hydroopt import Log, Machine, Model, random_trajectory, random_truth, simulate
from hydroopt.simulation.simulate import Trajectory, _chambers, forces

RATE, FINE = 50.0, 1000.0
Array = np.ndarray


@dataclass
class Truth:
    """A machine's true motion and forces at `FINE` [Hz], and what of them is recorded when."""

    model: Model
    psi: Array
    motion: Trajectory
    force: Array
    seed: int

    def log(self, *, q: Array | None = None, force: Array | None = None) -> Log:
        """The log of sensors that see these positions and forces (at `FINE`)."""
        step = round(FINE / RATE)
        chosen = slice(None, None, step)
        motion = Trajectory(*(x[chosen] for x in (self.motion.t, self.motion.q, self.motion.qd, self.motion.qdd)))
        log = simulate(self.model, motion, self.psi, noise=True, seed=self.seed)
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


def truth(model: Model, seed: int, psi: Array | None = None) -> Truth:
    """A random machine and motion; another seed is another of both."""
    psi = random_truth(model, seed) if psi is None else psi
    motion = random_trajectory(model, duration=16.0, rate=FINE, seed=seed)
    return Truth(model, psi, motion, forces(model, motion, psi), seed)


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
        v = made[:, machine.all_cylinders.index(actuator)]
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


def _heavier(chosen: Callable[[str], bool], factor: float) -> Callable[[Truth], Log]:
    def make(t: Truth) -> Log:
        psi = t.model.parameters.nominal.copy()
        for owner, columns in t.model.parameters.bodies.items():
            psi[columns] *= factor if chosen(owner) else 1.0
        return truth(t.model, t.seed, psi).log()
    return make


def _ramp(t: Truth) -> Array:
    return np.linspace(-0.5, 0.5, len(t.motion.t))


def listed(model: Model) -> dict[str, tuple[set[str], Callable[[Truth], Log]]]:
    """By name: the groups of faults that are a right answer, and the log with that fault."""
    machine, n = model.machine, len(model.machine.joints)
    turning = [k for k, joint in enumerate(machine.joints) if machine.link(joint).joint.type == "revolute"]
    heavy = int(np.argmax([np.ptp(machine.link(j).joint.range) * 0 + k for k, j in enumerate(machine.joints)][:2]))
    main = min(heavy, n - 1)
    stated = {kind.name for kind in model.parameters.kinds}
    made: dict[str, tuple[set[str], Callable[[Truth], Log]]] = {
        "all forces 60 ms late": ({"delay", "lag"}, lambda t: t.log(force=_earlier(t.force, 60))),
        "all forces 30 ms late": ({"delay", "lag"}, lambda t: t.log(force=_earlier(t.force, 30))),
        "forces 40 ms early": ({"delay"}, lambda t: t.log(force=_earlier(t.force, -40))),
        "one force 60 ms late": ({"delay", "lag"}, lambda t: t.log(
            force=_columns(t.force, main, _earlier(t.force[:, main], 60)))),
        "one angle 60 ms late": ({"delay", "lag"}, lambda t: t.log(
            q=_columns(t.motion.q, main, _earlier(t.motion.q[:, main], 60)))),
        "transducers lag by 60 ms": ({"lag", "delay"}, lambda t: t.log(force=_lagged(t.force, 0.06))),
        "transducers lag by 100 ms": ({"lag", "delay"}, lambda t: t.log(force=_lagged(t.force, 0.10))),
        "one transducer lags by 80 ms": ({"lag", "delay"}, lambda t: t.log(
            force=_columns(t.force, main, _lagged(t.force[:, main], 0.08)))),
        "clock drifts by 80 ms": ({"clock"}, lambda t: t.log(force=_earlier(t.force, 80 * (_ramp(t) + 0.5)))),
        "clock drifts by 150 ms": ({"clock"}, lambda t: t.log(force=_earlier(t.force, 150 * (_ramp(t) + 0.5)))),
        "base tilted by 3 deg about x": ({"tilt"}, _tilted(0, 3.0)),
        "base tilted by 3 deg about y": ({"tilt"}, _tilted(1, 3.0)),
        "play of 0.4 deg": ({"play"}, lambda t: t.log(q=_columns(t.motion.q, main, t.motion.q[:, main] + np.radians(
            0.2) * np.sign(t.motion.qd[:, main])))),
        "drift of one force by 5 %": ({"drift"}, _added(main, 0.05, lambda t, k: _ramp(t))),
        "drift of one force by 10 %": ({"drift"}, _added(main, 0.10, lambda t, k: _ramp(t))),
        "friction with the square of speed": ({"friction"}, _added(
            main, 0.05, lambda t, k: _speed(t, k) * np.abs(_speed(t, k)))),
        "friction of one direction": ({"friction"}, _added(main, 0.05, lambda t, k: _speed(t, k) > 0.0)),
        "friction that falls with speed": ({"friction"}, _added(
            main, 0.08, lambda t, k: np.sign(_speed(t, k)) * np.exp(-(3 * _speed(t, k)) ** 2))),
        "friction with the load": ({"friction"}, _added(
            main, 0.05, lambda t, k: np.sign(_speed(t, k)) * np.abs(t.force[:, k]) / _rms(t, k))),
        "pulsation": ({"line"}, _added(main, 0.02, lambda t, k: np.sin(2 * np.pi * 12.3 * t.motion.t))),
        "bodies 35 % heavier": ({"bodies", "gain"}, _heavier(lambda owner: True, 1.35)),
        "links 40 % heavier": ({"bodies", "gain"}, _heavier(lambda owner: "." not in owner, 1.4)),
        "spikes": ({"spikes"}, _spiked),
    }
    if "VISCOUS_FRICTION" not in stated:
        made["viscous friction"] = {"friction"}, _added(main, 0.05, _speed)
    if any("." in owner for owner in model.parameters.bodies):
        made["barrels and rods three times heavier"] = {"bodies"}, _heavier(lambda owner: "." in owner, 3.0)
    for k in turning[:2]:
        made[f"angle of {machine.joints[k]} 4 deg off"] = {"offset"}, lambda t, k=k: t.log(
            q=_columns(t.motion.q, k, t.motion.q[:, k] + np.radians(4.0)))
    for actuator in machine.actuators[:2]:
        for channel in actuator.effort_factors:
            made[f"gain of {channel} 10 % high"] = {"gain"}, _gain(channel, 1.10)
    for k in range(min(2, n)):
        made[f"force of {machine.actuators[k].name} 100 ms late"] = {"delay", "lag"}, lambda t, k=k: t.log(
            force=_columns(t.force, k, _earlier(t.force[:, k], 100)))
    return made


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
    }
