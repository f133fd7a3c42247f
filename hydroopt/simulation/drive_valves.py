"""Logs of machines driven by their valves: commands and supply in, what the sensors would record out."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hydroopt.errors import ProblemError
from hydroopt.kernels.integrator import IntegrationError
from hydroopt.logs.log import Log
from hydroopt.machine.actuators import Cylinder
from hydroopt.machine.machine_file import GivenMachine
from hydroopt.model.model import Model
from hydroopt.model.plant import Plant
from hydroopt.simulation.simulate import Trajectory, recorded
from hydroopt.spatial.inertia import Array

ACCURACY = 1e-9
"""Relative error of the simulation's steps: well below what sensors show, and what identification leaves of its own."""

TOGETHER = 1e-9
"""Times [s] that lie closer together count as one."""

REST = 1e-9
"""Speed [rad/s or m/s] and change of place [rad or m] of a base that stands still, but for rounding."""


def commands_for(plant: Plant | Model | GivenMachine, motion: Trajectory, psi: Array | None = None,
                 theta: Array | None = None) -> Array:
    """Commands (N, a) that would hold the speeds of a motion if each were steady, in the unit of each valve.

    Args:
        plant: the machine.
        motion: what it should do, roughly.
        psi, theta: its dynamic and hydraulic parameters; the nominal ones if None.

    Raises:
        ProblemError: the supply cannot move the machine so, the file states no supply pressure, the base moves, or
            the motion has a wrench at the tip, which a machine driven by its valves does not take.

    Example:
        >>> import hydroopt as ho
        >>> plant = ho.Plant(ho.Model(ho.load_machine("patu655_lift")))
        >>> t, q = np.arange(3) / 50, np.full((3, 1), 0.3)
        >>> commands_for(plant, Trajectory(t, q, 0 * q, 0 * q)).shape
        (3, 1)
    """
    plant = plant if isinstance(plant, Plant) else Plant(plant)
    if motion.wrench is not None:
        raise ProblemError("the motion has a wrench at the tip, which a machine driven by its valves does not take",
                           where="drive", remedy="leave out the channels of the tip's wrench, or do not drive valves")
    refuse_moving_base(plant, motion, "drive")
    psi, theta = _numbers(plant, psi, theta)
    return np.array([plant.steady(q, qd, psi, theta).u for q, qd in zip(motion.q, motion.qd, strict=True)])


def drive(plant: Plant | Model | GivenMachine, t: Array, commands: Array, start: Array, *, supply: Array | None = None,
          psi: Array | None = None, theta: Array | None = None, noise: bool = True, seed: int = 0,
          name: str = "driven") -> Log:
    """The log that the sensors of a machine driven by its valves would record.

    Args:
        plant: the machine.
        t: (N,) times [s], evenly spaced; between them supply and commands keep their values, these from when they
            arrive, which may be between two samples.
        commands: (N, a) in the unit of each valve.
        start: (nx,) states at the beginning, or (n,) the posture in which the machine stands still.
        supply: (2,) or (N, 2) pressures of supply and tank [Pa]; as the machine file states if None.
        psi, theta: true dynamic and hydraulic parameters; the nominal ones if None.
        noise: whether sensors err and quantise as the machine file states. Commands do not err.
        seed: of the errors.
        name: of the log.

    Raises:
        ProblemError: times are uneven, no supply pressure is known, or the machine leaves its range.

    Example:
        >>> import hydroopt as ho
        >>> plant = ho.Plant(ho.Model(ho.load_machine("patu655_lift")))
        >>> t = np.arange(100) / 50
        >>> drive(plant, t, 5.7 + np.cos(2 * t)[:, None], np.array([0.2])).size
        100
    """
    plant = plant if isinstance(plant, Plant) else Plant(plant)
    if not np.allclose(np.diff(t), t[1] - t[0], rtol=1e-6):
        raise ProblemError("the times are not evenly spaced", where="drive", remedy="give commands at a steady rate")
    psi, theta = _numbers(plant, psi, theta)
    given = np.broadcast_to(plant.supply if supply is None else supply, (len(t), 2))
    n = len(plant.machine.joints)
    if len(start) == n:
        start = plant.steady(start, np.zeros(n), psi, theta, given[0]).x
    delays = delays_at(plant, theta)
    at, samples = changes(t, delays)
    late = np.column_stack([arrived(t, commands[:, k], delay, at) for k, delay in enumerate(delays)])
    integrator = plant.integrator(psi, theta, tolerance=ACCURACY)
    try:
        after = integrator.along(start, np.diff(at), late[:-1], arrived(t, given, 0.0, at)[:-1])
    except IntegrationError:
        raise ProblemError("the simulation did not converge", where=name,
                           remedy="give commands that keep the machine within its range") from None
    states, late = np.vstack([start, after])[samples], late[samples]
    _refuse_far(plant, t, states, name)
    channels = recorded(plant.machine, t, _channels(plant, states, late, given, psi, theta), noise=noise, seed=seed)
    channels |= {channel: commands[:, k] for k, channel in enumerate(plant.inputs)}
    units = plant.machine.channel_units
    return Log(name, t, channels, units={channel: units[channel] for channel in channels})


def refuse_moving_base(plant: Plant, motion: Trajectory, where: str) -> None:
    """Refuse a motion in which the base moves.

    Raises:
        ProblemError: it does.
    """
    base = [plant.machine.joints.index(joint) for joint in plant.machine.base_joints]
    if np.any(np.abs(motion.qd[:, base]) > REST) or np.any(np.ptp(motion.q[:, base], axis=0) > REST):
        raise ProblemError("the base moves in this motion", where=where, remedy="let it stand still, at any slope: "
                           "what the ground does to it is not simulated")


def random_numbers(plant: Plant, seed: int) -> Array:
    """Hydraulic parameters θ (h,) drawn from the machine file's confidences, within their bounds."""
    known, rng = plant.parameters, np.random.default_rng(seed)
    theta = known.nominal.copy()
    for k in np.flatnonzero(np.diag(known.information) > 0):
        while True:
            theta[k] = known.nominal[k] + known.scale[k] * rng.standard_normal()
            if known.lower[k] <= theta[k] <= known.upper[k]:
                break
    return theta


def _refuse_far(plant: Plant, t: Array, states: Array, name: str) -> None:
    for k, joint in enumerate(plant.machine.joints):
        lower, upper = plant.machine.link(joint).joint.range
        beyond = np.flatnonzero(~((states[:, k] >= lower) & (states[:, k] <= upper)))
        if beyond.size:
            raise ProblemError(f"the commands drive {joint} out of its range after {t[beyond[0]] - t[0]:.2f} s",
                               where=name, remedy="give others, for a shorter time, or start elsewhere")


def delays_at(plant: Plant, theta: Array) -> Array:
    """Delays of the valves (a,) [s] at hydraulic parameters θ; none where the file states none."""
    places = [plant.parameters.positions.get(f"{each.actuator.name}.delay") for each in plant.actuators]
    return np.array([0.0 if place is None else theta[place] for place in places])


def changes(t: Array, delays: Array) -> tuple[Array, NDArray[np.intp]]:
    """Times (M,) of all samples t (N,) and of what arrives between them, late by (a,), and the places (N,) of samples.
    """
    found = np.unique(np.concatenate([t[:0], *(t[:-1] + delay for delay in delays.tolist())]))
    found = found[(found > t[0]) & (found < t[-1])]
    after = np.searchsorted(t, found)
    alone = (np.minimum(found - t[after - 1], t[after] - found) > TOGETHER) & (
        np.diff(found, prepend=-np.inf) > TOGETHER)
    moments = np.sort(np.concatenate([t, found[alone]]))
    return moments, np.searchsorted(moments, t)


def arrived(t: Array, command: Array, delay: float, at: Array | None = None) -> Array:
    """The commands of the times t (N,) that act `at` other times (…), those themselves if None, late by `delay` [s].

    At first the first one.
    """
    return command[np.maximum(np.searchsorted(t, (t if at is None else at) - delay + TOGETHER, side="right") - 1, 0)]


def _numbers(plant: Plant, psi: Array | None, theta: Array | None) -> tuple[Array, Array]:
    return (plant.model.parameters.nominal if psi is None else psi,
            plant.parameters.nominal if theta is None else theta)


def _channels(plant: Plant, states: Array, u: Array, supply: Array, psi: Array, theta: Array) -> dict[str, Array]:
    """True values (N,) of all channels but the commands."""
    machine, count = plant.machine, len(states)
    found = plant.outputs.map(count)(states.T, u.T, supply.T, np.tile(psi[:, None], count),
                                     np.tile(theta[:, None], count))
    outputs = {name: np.asarray(values).reshape(len(np.asarray(values)), count, -1)
               for name, values in zip(plant.outputs.name_out(), found, strict=True)}
    channels = {f"{joint}.q": outputs["q"][k, :, 0] for k, joint in enumerate(machine.joints)}
    for k, each in enumerate(plant.actuators):
        if isinstance(each.actuator, Cylinder):
            channels[f"{each.actuator.name}.length"] = outputs["length"][k, :, 0]
        channels |= {name: outputs["pressure"][k, :, side] for side, name in enumerate(each.chambers)}
    if machine.pump:
        channels |= {"pump.p_supply": outputs["p_supply"][0, :, 0], "pump.p_tank": supply[:, 1].copy()}
    return channels
