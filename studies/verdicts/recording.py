"""What a machine does and what its instruments record of it, with everything that is not as a model has it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.signal import lfilter

from studies.verdicts.machines import Array, Body, Truth
from studies.verdicts.plant import plant

FINE, GRID, RATE = 1000, 200, 50
"""Samples per second of motion and friction, of forces, and of logs."""
SINES, SLOWEST, FASTEST = 6, 0.03, 0.35
"""A joint's motion: so many sines with frequencies [Hz] in this range."""
MEMORY = 0.3
"""Memory [s] of noise that has one."""
KICK = 0.1
"""Swing of a soft base after a joint's reversal, as a part of its RMS turn."""


@dataclass(frozen=True)
class Effects:
    """What is not as a model has it; zero is nothing. Effects on one part are on the first of the lifting ones."""

    memory: float = 0.0  # noise with memory, σ in parts of the RMS reading
    bits: int = 0  # of pressures over 400 bar and torques over 400 N·m, and of angles over 360°
    jitter: float = 0.0  # samples so irregular [s]; stamps to a fifth of it
    stribeck: float = 0.0  # breakaway beyond Coulomb friction, as a part of it
    presliding: float = 0.0  # way of presliding as a part of that in a second of the RMS speed
    load_friction: float = 0.0  # dry friction as a part of the force
    hose: float = 0.0  # drop as k·v·|v|, as a part of the RMS reading at the RMS speed
    warming: float = 0.0  # change of friction over the log as a part of it
    soft: float = 0.0  # RMS turn of the base [rad] at a natural frequency of 5 Hz
    play: float = 0.0  # of angle sensors [rad]
    stick_slip: float = 0.0  # turn [rad] by which joints stay behind until they break loose
    gain: float = 0.0  # of one pressure or torque
    tilt: float = 0.0  # of the base [rad]
    chamber_late: float = 0.0  # one pressure [s]
    delay: float = 0.0  # all forces [s]
    angle_late: float = 0.0  # one angle [s]
    clock: float = 0.0  # forces run behind by so much at the end [s]
    zero: float = 0.0  # of one angle [rad]
    load: float = 0.0  # picked up at half the log, as a part of the last body
    swap: bool = False  # both chambers of a cylinder
    drift: float = 0.0  # of one pressure over the log, as a part of the RMS force
    quadratic: float = 0.0  # friction v·|v|, as a part of the RMS force at the RMS speed


@dataclass(frozen=True)
class Recording:
    """A log and what is true beside it, at its samples."""

    t: Array
    channels: dict[str, Array]
    force: Array
    """True efforts (N, n) of cylinders and drives, friction included."""
    q: Array
    qd: Array
    qdd: Array


def record(truth: Truth, effects: Effects, seed: int, which: int, seconds: float, motion: int | None = None
           ) -> Recording:
    """The recording of a seed; `which` tells motions of a seed apart, and `motion` is the seed of theirs if given."""
    first = truth.first
    rngs = dict(zip(("motion", "angles", "pressures", "memory", "times"),
                    np.random.default_rng([seed, which]).spawn(5), strict=True))
    if motion is not None:
        rngs["motion"] = np.random.default_rng([motion, which]).spawn(1)[0]
    fine = np.arange(round(seconds * FINE) + FINE) / FINE - 0.5  # half a second before and behind
    q, qd, qdd = _motion(truth, fine, rngs["motion"], effects.stick_slip)
    grid = slice(None, None, FINE // GRID)
    t, part = fine[grid], np.clip(fine[grid] / seconds, 0, 1)[:, None]
    states = q[grid], qd[grid], qdd[grid]
    model = plant(truth, effects.tilt)
    mechanical, levers, moment = model.efforts(*states)
    if effects.soft:
        mechanical, levers, _ = model.efforts(*states, _soft(moment, states[1], effects.soft))
    if effects.load:
        last = truth.joints[-1]
        more = 1 + effects.load
        grown = Body(more * last.body.m, last.body.com, tuple(more * each for each in last.body.inertia))
        loaded, _, _ = plant(truth.with_body(last.name, grown), effects.tilt).efforts(*states)
        mechanical = np.where(part > 0.5, loaded, mechanical)
    speed = states[1] * levers
    usual, size = _rms(speed), _rms(mechanical)
    dry, viscous = np.array([_friction(truth, k) for k in range(len(truth.joints))]).T
    level = 1.0 + effects.warming * (part - 0.5)
    bristles = _bristles(qd, effects)[grid] * np.sign(levers)
    friction = level * bristles * (dry + effects.load_friction * np.abs(mechanical)) + level * viscous * speed
    friction[:, first] += effects.quadratic * size[first] * (speed * np.abs(speed) / usual**2)[:, first]
    force = mechanical + friction

    at = np.arange(round(seconds * RATE)) / RATE
    moved = at + effects.jitter * rngs["times"].uniform(-1, 1, len(at)) if effects.jitter else at
    stamps = moved + effects.jitter / 5 * rngs["times"].uniform(-1, 1, len(at)) if effects.jitter else at
    late = moved - effects.delay - effects.clock * at / seconds

    def sampled(values: Array, when: Array) -> Array:
        return np.interp(when, t, values)

    channels = {}
    gap = _backlash(states[0], effects.play) if effects.play else states[0]
    for k, joint in enumerate(truth.joints):
        own = moved - effects.angle_late * (k == first)
        noise = truth.angle_noise * rngs["angles"].standard_normal(len(at))
        read = sampled(gap[:, k], own) + noise + effects.zero * (k == first)
        channels[f"{joint.name}.q"] = _stepped(read, 2 * np.pi, effects.bits)
    for k, joint in enumerate(truth.joints):
        chambers = _chambers(truth, k, force[:, k], speed[:, k] / usual[k])
        area = size[k] if joint.drive == "torque" else size[k] / _factors(truth, k)[0]
        for j, (name, values) in enumerate(chambers.items()):
            marked = k == first and j == 0
            along = (1 - 2 * j) * np.sign(speed[:, k]) * (speed[:, k] / usual[k]) ** 2
            at_sensor = values + effects.hose * area * along * (joint.drive != "torque")
            if marked:
                at_sensor = at_sensor * (1 + effects.gain) + effects.drift * area * part[:, 0]
            read = sampled(at_sensor, late - effects.chamber_late * marked)
            torque = joint.drive == "torque"
            read = read + (truth.torque_noise if torque else truth.pressure_noise) * rngs["pressures"].standard_normal(
                len(at)) + effects.memory * area * _memory(rngs["memory"], len(at))
            channels[name] = _stepped(read, 400.0 if torque else 4e7, effects.bits)
    if effects.swap:
        one, other = list(_chambers(truth, first, force[:, first], speed[:, first]))
        channels[one], channels[other] = channels[other], channels[one]
    states = tuple(np.stack([sampled(each[:, k], moved) for k in range(each.shape[1])], axis=1) for each in states)
    true = np.stack([sampled(force[:, k], moved) for k in range(force.shape[1])], axis=1)
    return Recording(stamps - stamps[0], channels, true, *states)


def read_forces(truth: Truth, recording: Recording, bore: dict[str, float]) -> Array:
    """Efforts (N, n) as readings and stated areas tell them."""
    columns = []
    for k, joint in enumerate(truth.joints):
        names = list(_chambers(truth, k, np.zeros(1), np.zeros(1)))
        if joint.drive == "torque":
            columns.append(recording.channels[names[0]])
            continue
        head, other = _factors(truth, k, bore)
        columns.append(head * recording.channels[names[0]] - other * recording.channels[names[1]])
    return np.stack(columns, axis=1)


def _rms(values: Array) -> Array:
    return np.asarray(np.sqrt(np.mean(values**2, axis=0)))


def _motion(truth: Truth, t: Array, rng: np.random.Generator, stick: float) -> tuple[Array, Array, Array]:
    """Sums of sines within the joints' ranges and speeds; with `stick` joints that stay behind and break loose."""
    found = np.zeros((3, len(t), len(truth.joints)))
    for k, joint in enumerate(truth.joints):
        omega = 2 * np.pi * rng.uniform(SLOWEST, FASTEST, SINES)
        size, phase = rng.uniform(0.3, 1, SINES) / np.sqrt(omega), rng.uniform(0, 2 * np.pi, SINES)
        angle = omega * t[:, None] + phase
        values = np.stack([np.sin(angle) @ size, np.cos(angle) @ (size * omega), -np.sin(angle) @ (size * omega**2)])
        middle, half = (values[0].max() + values[0].min()) / 2, np.ptp(values[0]) / 2
        wide = (joint.high - joint.low) / 2 * rng.uniform(0.8, 1.0)
        factor = min(wide / half, joint.speed / np.max(np.abs(values[1])))
        room = (joint.high - joint.low) / 2 - factor * half
        found[:, :, k] = factor * values
        found[0, :, k] += (joint.low + joint.high) / 2 - factor * middle + room * rng.uniform(-1, 1)
    return _held_back(found, stick) if stick else tuple(found)


def _held_back(wanted: Array, stick: float) -> tuple[Array, Array, Array]:
    """Joints on oil springs of 3 Hz behind a servo, with friction that holds them until the spring gives `stick`."""
    omega, damping, step = 2 * np.pi * 3, 0.3, 1 / FINE
    slow, way = 0.02, 2e-4
    made = np.empty_like(wanted)
    q, v, z = wanted[0, 0].copy(), wanted[1, 0].copy(), np.zeros(wanted.shape[2])
    for i in range(wanted.shape[1]):
        limit = 1 + 0.5 * np.exp(-(v / slow) ** 2)
        settled = np.sign(v) * limit * way
        z = settled + (z - settled) * np.exp(-np.abs(v) * step / (limit * way))
        spring = omega**2 * (wanted[0, i] - q) + 2 * damping * omega * (wanted[1, i] - v)
        a = spring - omega**2 * stick * z / way - 0.5 * omega * v * (np.abs(v) < slow)
        made[:, i] = q, v, a
        v = v + step * a
        q = q + step * v
    return made[0], made[1], made[2]


def _bristles(qd: Array, effects: Effects) -> Array:
    """Dry friction per Coulomb friction: its sign, or Stribeck's curve behind presliding (Dahl's model)."""
    if not (effects.stribeck or effects.presliding):
        return np.sign(qd)
    usual = _rms(qd)
    level = 1 + effects.stribeck * np.exp(-((qd / (0.1 * usual)) ** 2))
    if not effects.presliding:
        return np.sign(qd) * level
    way = effects.presliding * usual
    decay = np.exp(-np.abs(qd) / FINE / (level * way))
    made, z = np.empty_like(qd), np.zeros(qd.shape[1])
    settled = np.sign(qd) * level
    for i in range(len(qd)):
        z = settled[i] + (z - settled[i]) * decay[i]
        made[i] = z
    return made


def _soft(moment: Array, qd: Array, size: float) -> Array:
    """Turn of a base on a damped spring of 5 Hz, with its derivatives (N, 3); reversals of joints kick it."""
    omega, damping, step = 2 * np.pi * 5, 0.1, 1 / GRID
    wanted = -(moment - moment.mean())
    wanted *= size / np.std(wanted)
    kicks = np.vstack([np.diff(np.sign(qd), axis=0), np.zeros(qd.shape[1])]).sum(axis=1) * KICK * size * omega
    made, q, v = np.empty((len(moment), 3)), wanted[0], 0.0
    for i, goal in enumerate(wanted):
        v += kicks[i]
        a = omega**2 * (goal - q) - 2 * damping * omega * v
        made[i] = q, v, a
        v += step * a
        q += step * v
    return made


def _backlash(q: Array, play: float) -> Array:
    made, own = np.empty_like(q), q[0].copy()
    for i, now in enumerate(q):
        own = np.clip(own, now - play / 2, now + play / 2)
        made[i] = own
    return made


def _memory(rng: np.random.Generator, count: int) -> Array:
    factor = np.exp(-1 / (MEMORY * RATE))
    white = rng.standard_normal(count + 10 * RATE)
    return np.asarray(lfilter([np.sqrt(1 - factor**2)], [1, -factor], white)[10 * RATE:])


def _stepped(values: Array, span: float, bits: int) -> Array:
    return np.round(values / span * 2**bits) / 2**bits * span if bits else values


def _friction(truth: Truth, k: int) -> tuple[float, float]:
    own = next((each for each in truth.cylinders if each.joint == k), truth.joints[k])
    return own.coulomb, own.viscous


def _factors(truth: Truth, k: int, bore: dict[str, float] | None = None) -> tuple[float, float]:
    """Effort per pressure of both chambers, by the bore that a file states if given."""
    own = next((each for each in truth.cylinders if each.joint == k), None)
    if own is None:
        return truth.motor, truth.motor
    stated = own.bore * (bore or {}).get(own.name, 1.0)
    return np.pi / 4 * stated**2, np.pi / 4 * (stated**2 - own.rod**2)


def _chambers(truth: Truth, k: int, force: Array, speed: Array) -> dict[str, Array]:
    """True pressures, or the torque, that make an effort: the lower one is some bar, more in fast motion."""
    joint = truth.joints[k]
    if joint.drive == "torque":
        return {f"{joint.name}.tau": force}
    names = (f"{joint.name}_drive.p_a", f"{joint.name}_drive.p_b") if joint.drive else tuple(
        f"{truth.actuators[k]}.{end}" for end in ("p_head", "p_rod"))
    one, other = _factors(truth, k)
    low = 1e6 + 5e5 * np.abs(speed)
    second = np.maximum(low, (one * low - force) / other)
    return {names[0]: (force + other * second) / one, names[1]: second}
