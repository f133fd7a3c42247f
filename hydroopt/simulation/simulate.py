"""Simulated logs: parameters, motion and sensors in, a `Log` out."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from hydroopt.errors import IdentifiabilityError, ProblemError
from hydroopt.logs.lag import lagged
from hydroopt.logs.log import Log
from hydroopt.logs.smoothing import STANDSTILL
from hydroopt.machine.actuators import Cylinder, Drive
from hydroopt.machine.description import WRENCH
from hydroopt.machine.machine import Machine
from hydroopt.machine.machine_file import GivenMachine
from hydroopt.machine.sensors import ACCELEROMETER, GYROSCOPE, INCLINATION
from hydroopt.model.model import Model, model_of
from hydroopt.parameters.dynamic import bodies
from hydroopt.simulation.calibrator_motion import CalibratorMotion
from hydroopt.simulation.passive_joints import passive_motion
from hydroopt.spatial import inertia
from hydroopt.spatial.inertia import Array

USED = 0.9
"""Part of the tightest limit of a joint that a random motion uses."""

PASSES, SETTLED = 500, 1e-13
"""How often the pressures on seals are found again, until they change by less than this part of the largest."""

ROUNDS = 10
"""Times that a body is drawn anew where none of the draws is possible."""
BACK_PRESSURE = 5e5
"""Pressure [Pa] in the chamber that a simulated actuator does not push with."""


@dataclass(frozen=True, eq=False)
class Trajectory:
    """Joint positions, velocities and accelerations (N, n) at the times t (N,), in SI.

    `wrench` (N, 6) is what the surroundings exert on the machine at its tip, see `Model.wrench_forces`; None without
    contact. `calibrator` is how the calibrator moves along, if it is attached.
    """

    t: Array
    q: Array
    qd: Array
    qdd: Array
    wrench: Array | None = None
    calibrator: CalibratorMotion | None = None

    def __repr__(self) -> str:
        return (f"Trajectory({len(self.t)} samples, {self.t[-1] - self.t[0]:.4g} s, {self.q.shape[1]} joints"
                f"{', with a wrench at the tip' * (self.wrench is not None)})")


def random_trajectory(model: Model | GivenMachine, *, duration: float, rate: float, seed: int, harmonics: int = 5,
                      slowest: float = 0.02, fastest: float = 0.3) -> Trajectory:
    """A smooth motion of all joints within 90 % of the machine's limits, periodic over its duration.

    Each joint moves about the middle of its range by sines of random phase at multiples of 1/duration, drawn between
    `slowest` and `fastest` [Hz] (or the nearest that there are); amplitudes are the largest that position, speed and
    acceleration limits admit. A joint that may turn by more than half a turn keeps within ±60 degrees of its middle.

    Raises:
        ProblemError: duration or rate is not positive, or the log would not fit in memory.

    >>> from hydroopt.machine.machine_file import load_machine
    >>> motion = random_trajectory(Model(load_machine("cat215b")), duration=10.0, rate=50.0, seed=1)
    >>> motion.q.shape
    (500, 3)
    """
    model = model_of(model, "random_trajectory")
    if not (duration > 0 and rate > 0 and duration * rate >= 2):
        raise ProblemError(f"a motion of {duration} s at {rate} Hz has no samples", where="simulation",
                           remedy="give a positive duration and rate")
    if duration * rate > 1e7 or duration > 1e6:
        raise ProblemError(f"{duration * rate:.1e} samples do not fit in memory", where="simulation",
                           remedy="shorten the duration or lower the rate")
    rng = np.random.default_rng(seed)
    multiples = np.arange(1, max(1, int(fastest * duration)) + 1)
    multiples = multiples[multiples >= min(slowest * duration, multiples[-1])]
    harmonics = min(harmonics, len(multiples))
    t = np.arange(round(duration * rate)) / rate
    fine = np.linspace(0, duration, 40 * int(multiples[-1]))  # to find crests between the samples
    n = len(model.machine.joints)
    q, qd, qdd = (np.empty((len(t), n)) for _ in range(3))
    for k, name in enumerate(model.machine.joints):
        joint = model.machine.link(name).joint
        lower, upper = joint.range
        omega = 2 * np.pi / duration * np.sort(rng.choice(multiples, harmonics, replace=False))
        phase, size = rng.uniform(0, 2 * np.pi, harmonics), rng.uniform(0.3, 1.0, harmonics) / omega
        room = min((upper - lower) / 2, np.pi / 3) if joint.type == "revolute" else (upper - lower) / 2
        limits = (room, joint.max_speed or np.inf, joint.max_acceleration or np.inf)
        crests = (np.max(np.abs(values)) for values in _sines(fine, omega, phase, size))
        scale = USED * min(limit / crest for limit, crest in zip(limits, crests, strict=True))
        q[:, k], qd[:, k], qdd[:, k] = _sines(t, omega, phase, scale * size)
        q[:, k] += (upper + lower) / 2
    return Trajectory(t, q, qd, qdd)


def _sines(t: Array, omega: Array, phase: Array, size: Array) -> tuple[Array, Array, Array]:
    """A sum of sines with its first and second derivative, (N,) each."""
    angle = np.outer(t, omega) + phase
    return np.sin(angle) @ size, np.cos(angle) @ (size * omega), -np.sin(angle) @ (size * omega**2)


def sampling_rate(machine: Machine) -> float:
    """The highest rate [Hz] that the file states for a joint's sensor or an IMU, or 50."""
    sensors = [machine.sensor(f"{joint}.q") for joint in machine.joints]
    rates = [sensor.rate for sensor in sensors if sensor and sensor.rate] + [imu.rate for imu in machine.imus]
    return max(rates, default=50.0)


def random_truth(model: Model | GivenMachine, seed: int, *, tries: int = 20000) -> Array:
    """Parameters ψ (p,) drawn from the machine file's confidences, with physically consistent bodies.

    Identical parts are drawn together, with the confidence that all that is stated of them gives.

    Raises:
        IdentifiabilityError: a body's confidences leave practically no possible body.
        ProblemError: the file states shapes, symmetries or total masses, which draws do not satisfy.

    >>> from hydroopt.machine.machine_file import load_machine
    >>> model = Model(load_machine("cat215b"))
    >>> psi = random_truth(model, seed=1)
    >>> psi.shape == model.parameters.nominal.shape
    True
    """
    model = model_of(model, "random_truth")
    machine = model.machine
    stated = [*(one.name for one in machine.total_masses),
              *(f"the shape or symmetry of {owner}" for owner, owned in bodies(machine).items()
                if owned.body.shape is not None or owned.body.symmetric)]
    if stated:
        raise ProblemError(f"random parameters do not satisfy what the file states: {', '.join(stated)}",
                           where=machine.name, remedy="draw them from a file without these statements")
    rng = np.random.default_rng(seed)
    parameters = model.parameters
    psi = parameters.nominal.copy()
    whole = {block.start: block for block in parameters.bodies.values()}
    alike = _alike(model)
    for k, kind in enumerate(parameters.kinds):
        body, block = k in whole, whole.get(k, slice(k, k + 1))
        if (kind.is_inertial and not body) or any(k in others for others in alike.values()):
            continue
        blocks = [block, *(slice(start, start + block.stop - block.start) for start in alike.get(k, ()))]
        information = sum(parameters.information[each, each] for each in blocks)
        if not np.any(information):
            continue
        root = np.linalg.cholesky(np.linalg.inv(information))
        centre = np.linalg.solve(information, sum(
            parameters.information[each, each] @ parameters.nominal[each] for each in blocks))
        for _ in range(ROUNDS):
            draws = centre + rng.standard_normal((tries if body else 200, len(root))) @ root.T
            good = draws[np.all((draws >= parameters.lower[block]) & (draws <= parameters.upper[block]), axis=1)]
            first = next((draw for draw in good if not body or inertia.smallest_eigenvalue(draw) > 0), None)
            if first is not None:
                break
        else:
            raise IdentifiabilityError(f"no possible body within the confidences of '{parameters.names[block.start]}'",
                                       where=model.machine.name, remedy="correct its inertia or widen its sigma")
        for each in blocks:
            psi[each] = first
    return psi


def _alike(model: Model) -> dict[int, list[int]]:
    """Where bodies and terms of friction of identical parts begin in ψ: the first of them, and the others."""
    parameters, found = model.parameters, dict[int, list[int]]()
    for one in model.machine.identical:
        owners = [owner for owner in one.bodies if owner in parameters.bodies]
        starts = [[parameters.bodies[owner].start] for owner in owners]
        rubbing = [[k for k, kind in enumerate(parameters.kinds) if kind.is_friction
                    and parameters.owner(parameters.names[k]) == owner] for owner in one.friction]
        for group in (starts, rubbing):
            found |= {first: list(others) for first, *others in zip(*group, strict=True)}
    return found


def forces(model: Model, motion: Trajectory, psi: Array) -> Array:
    """Noise-free forces (N, a) of all actuators, measured or not, in a motion with the parameters ψ.

    The friction of seals depends on pressures and these on the force, so that one is found from the other by turns.
    Actuators of one joint share its load by the rule of `shared_load`. A joint slower than `STANDSTILL` stands still:
    its speed would be rounding, whose sign dry friction would follow.
    """
    motion = replace(motion, qd=np.where(np.abs(motion.qd) < STANDSTILL, 0.0, motion.qd))
    if own := set(model.pressed) - set(model.machine.sealed):
        raise ProblemError(f"own terms of {', '.join(own)} depend on pressures, which follow from forces",
                           where="simulation", remedy="simulate without these terms")
    machine, state = model.machine, (motion.q, motion.qd, motion.qdd)
    load = np.zeros_like(motion.q)
    if motion.wrench is not None:
        load -= np.einsum("nij,ni->nj", model.over(model.tip_jacobian, motion.q)[0], motion.wrench)
    if motion.calibrator is not None:
        load += motion.calibrator.at_joints(*state) @ psi
    if not model.needs_pressure:
        return model.over(model.actuator_forces, *state, load, psi)[0][:, :, 0]
    sealed = {k: each for k, each in enumerate(machine.actuators)
              if isinstance(each, Cylinder) and each.name in machine.sealed}
    pressure = np.zeros((len(motion.t), len(machine.actuators)))
    for _ in range(PASSES):
        force = model.over(model.actuator_forces, *state, pressure, load, psi)[0][:, :, 0]
        before = pressure.copy()
        for k, each in sealed.items():
            pressure[:, k] = sum(_chambers(force[:, k], *each.areas, *each.chambers).values())
        if np.max(np.abs(pressure - before)) <= SETTLED * np.max(np.abs(pressure)):
            return np.asarray(force)
    raise ProblemError(f"the seals of {', '.join(machine.sealed)} would hold them against any pressure",
                       where="simulation", remedy="keep the seals well below the rod sides' areas")


def simulate(model: Model | GivenMachine, motion: Trajectory, psi: Array | None = None, *, noise: bool = True,
             seed: int = 0, name: str = "simulated") -> Log:
    """The log that the machine's sensors would record. Passive joints start as `motion` states and follow the others.

    Args:
        model: the machine.
        motion: what it does.
        psi: its true parameters (p,); the nominal ones if None.
        noise: whether sensors err and quantise as the machine file states; they lag as it states in either case.
        seed: of the errors.
        name: of the log.

    >>> from hydroopt.machine.machine_file import load_machine
    >>> model = Model(load_machine("cat215b"))
    >>> motion = random_trajectory(model, duration=10.0, rate=50.0, seed=1)
    >>> simulate(model, motion, seed=2)
    Log('simulated': 500 samples, 9.98 s, 11 channels)
    """
    model = model_of(model, "simulate")
    if not isinstance(motion, Trajectory):
        raise ProblemError(f"this is a {type(motion).__name__}, not a motion", where="simulation",
                           remedy="give a Trajectory, such as random_trajectory(model, duration=30, rate=50, seed=1)")
    psi = model.parameters.nominal if psi is None else psi
    machine = model.machine
    q, qd, qdd = passive_motion(model, motion.t, (motion.q, motion.qd, motion.qdd), psi, motion.wrench)
    motion = replace(motion, q=q, qd=qd, qdd=qdd)
    force = forces(model, motion, psi)
    channels = _positions(model, motion.q)
    for k, actuator in enumerate(machine.actuators):
        if actuator not in machine.measured_actuators:
            continue
        if isinstance(actuator, Drive):
            channels[f"{actuator.joint}.tau"] = force[:, k]
        else:
            channels |= _chambers(force[:, k], *actuator.areas, *actuator.chambers)
    if machine.cylinders:
        lengths = model.over(model.cylinder_kinematics, motion.q, motion.qd, motion.qdd)[0][:, :, 0]
        channels |= {f"{c.name}.length": lengths[:, k] for k, c in enumerate(machine.cylinders)
                     if not machine.imus or machine.sensor(f"{c.name}.length")}
    channels |= _imus(model, motion)
    if motion.wrench is not None:
        channels |= dict(zip(WRENCH, motion.wrench.T, strict=True))
    if motion.calibrator is not None:
        joints = motion.calibrator.attached.joints
        channels |= {f"{joint}.q": angle for joint, angle in zip(joints, motion.calibrator.q.T, strict=True)
                     if machine.sensor(f"{joint}.q")}
    channels = recorded(machine, motion.t, channels, noise=noise, seed=seed)
    return Log(name, motion.t, channels, units={c: machine.channel_units[c] for c in channels})


def recorded(machine: Machine, t: Array, true: Mapping[str, Array], *, noise: bool, seed: int) -> dict[str, Array]:
    """What sensors record of channels with true values (N,) at the times t (N,): they lag, and err if there is `noise`.

    IMUs have a constant bias in each channel, and end where their range ends.
    """
    channels = {channel: lagged(t, values, machine.lag(channel).value) for channel, values in true.items()}
    if not noise:
        return channels
    rng = np.random.default_rng(seed)
    for channel, values in channels.items():
        if sensor := machine.sensor(channel):
            channels[channel] = sensor.read(values, rng)
    for imu in machine.imus:
        for channel in imu.channels:
            part = imu.part(channel)
            assert part is not None
            limit = np.inf if part.range is None else part.range
            channels[channel] = np.clip(channels[channel] + rng.normal(0.0, part.bias), -limit, limit)
    return channels


def _imus(model: Model, motion: Trajectory) -> dict[str, Array]:
    """What IMUs read: their own channels, and inclinations that a sensor is stated for."""
    machine = model.machine
    if not machine.imus:
        return {}
    readings = model.over(model.imu_readings, motion.q, motion.qd, motion.qdd)[0]
    every = {f"{imu.name}.{axis}": readings[:, row, k] for k, imu in enumerate(machine.imus)
             for row, axis in enumerate((*GYROSCOPE, *ACCELEROMETER, *INCLINATION))}
    return {channel: values for channel, values in every.items() if machine.sensor(channel)}


def _positions(model: Model, q: Array) -> dict[str, Array]:
    """Positions that are read: of dependent joints with a sensor, and of all others but those that follow from these
    alone, and those of a machine with IMUs that no sensor reads."""
    machine = model.machine
    read = {joint for joint in machine.dependent_joints if machine.sensor(f"{joint}.q")}
    computed = {joint for each in read for joint in machine.followed[each] if not machine.sensor(f"{joint}.q")}
    found = {f"{joint}.q": q[:, k] for k, joint in enumerate(machine.joints)
             if joint not in computed and (not machine.imus or machine.sensor(f"{joint}.q"))}
    if read:
        positions = model.over(model.dependent_positions, q)[0]
        found |= {f"{joint}.q": positions[:, k, 0] for k, joint in enumerate(machine.dependent_joints) if joint in read}
    return found


def _chambers(force: Array, area: float, other_area: float, pushing: str, pulling: str) -> dict[str, Array]:
    """Chamber pressures that make a force, the one not pushing at back pressure."""
    forward = force + other_area * BACK_PRESSURE > area * BACK_PRESSURE
    p = np.where(forward, (force + other_area * BACK_PRESSURE) / area, BACK_PRESSURE)
    q = np.where(forward, BACK_PRESSURE, (area * BACK_PRESSURE - force) / other_area)
    return {pushing: p, pulling: q}
