"""Measured forces of a machine from the pressures in a log (Eq. 4.33, 4.61), and their noise."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from hydroopt.logs.lag import slowed
from hydroopt.logs.log import Log, missing
from hydroopt.logs.readings import reading
from hydroopt.machine.actuators import Actuator, Cylinder
from hydroopt.model.model import Model
from hydroopt.spatial.inertia import Array

POSTURES = 200
"""Number of postures over which lever arms are averaged."""


def _force_channels(model: Model, log: Log | None, actuator: Actuator) -> Mapping[str, float]:
    """The channels that an actuator's force is read from, with their factors; pressures where there is no log."""
    # where several drive a joint, its torque is that of all together
    direct = (f"{actuator.name}.force" if isinstance(actuator, Cylinder) else f"{actuator.joint}.tau"
              if len(model.machine.drivers[actuator.joint]) == 1 else "")
    parts = model.force_from_pressure[actuator.name]
    if log is not None and direct in log.channels and not set(parts) <= set(log.channels):
        return {direct: 1.0}
    return parts


def absent_forces(model: Model, log: Log) -> dict[str, tuple[str, ...]]:
    """The channels that a log lacks of each measured actuator whose force it therefore does not tell.

    >>> from hydroopt.machine.machine_file import load_machine
    >>> model = Model(load_machine("cat215b"))
    >>> torque, pressure = {"swing.tau": [0.0, 0.0]}, {"boom_cylinder.p_head": [0.0, 0.0]}
    >>> log = Log("run", [0.0, 0.1], {**torque, **pressure, "stick_cylinder.force": [0.0, 0.0]})
    >>> absent_forces(model, log)
    {'boom_cylinder': ('boom_cylinder.p_rod',)}
    """
    sealing = _sealing_channels(model)
    needed = {each.name: dict.fromkeys((*_force_channels(model, log, each), *sealing.get(each.name, ())))
              for each in model.machine.measured_actuators}
    return {name: lacking for name, channels in needed.items()
            if (lacking := tuple(channel for channel in channels if channel not in log.channels))}


def _measured_parts(model: Model, log: Log) -> list[Mapping[str, float]]:
    """Of each actuator the channels that its force is read from, with their factors; none of an unmeasured one."""
    measured = model.machine.measured_actuators
    return [_force_channels(model, log, actuator) if actuator in measured else {}
            for actuator in model.machine.actuators]


def _lags(model: Model, log: Log) -> Array:
    """Time constants (a,) [s] of the actuators' forces, where several share the load of a joint one for all."""
    found = np.array([max((model.machine.lag(channel).value for channel in parts), default=0.0)
                      for parts in _measured_parts(model, log)])
    return found if model.machine.one_each else np.full_like(found, found.max())


def force_lags(model: Model, log: Log) -> Array:
    """Time constants (r,) [s] with which the balances' measured forces lag, by the sensors of the machine file: for
    each the longest of the channels that it is read from."""
    found = _lags(model, log)
    return found if model.machine.one_each else np.full(len(model.machine.balances), found[0])


def actuator_forces(model: Model, log: Log) -> Array:
    """Forces (N, a) of all actuators [N or N·m], in the order of ``machine.actuators``; zero for unmeasured ones.

    They lag as `force_lags` says: readings that lag less are slowed. NaN where the log does not tell the force of a
    measured actuator.
    """
    machine, absent = model.machine, absent_forces(model, log)
    return np.column_stack([np.full(log.size, np.nan) if actuator.name in absent else sum(
        (factor * slowed(log.t, reading(machine, log, channel), machine.lag(channel).value, lag, log.segment)
         for channel, factor in parts.items()), np.zeros(log.size))
        for actuator, parts, lag in zip(machine.actuators, _measured_parts(model, log), _lags(model, log).tolist(),
                                        strict=True)])


def forces(model: Model, log: Log, q: Array) -> Array:
    """Measured forces (N, r) of the balances at joint positions q (N, n).

    NaN where the log does not tell the force of an actuator that has a share in the balance.

    Raises:
        LogError: the log tells no force at all.
    """
    absent = absent_forces(model, log)
    if absent and len(absent) == len(model.machine.measured_actuators):
        raise missing(next(iter(absent.values()))[0], log.channels, log.path or log.name)
    found = actuator_forces(model, log)
    if model.machine.one_each:
        return found
    shares = model.over(model.shares, q)[0]
    made = np.einsum("nra,na->nr", shares, np.nan_to_num(found))
    made[np.any((shares != 0) & ~np.isfinite(found)[:, None, :], axis=2)] = np.nan
    return np.asarray(made)


def force_noise(model: Model, log: Log | None = None) -> Array:
    """Standard deviation (r,) of each measured force from its sensors' accuracy; NaN where the file states none, and of
    passive joints, whose force is known exactly.

    The sensors are those of the channels that `log` has, as in `experiment`; those of the pressures without a log.
    Lever arms count by their mean square over postures within the joints' limits.
    """
    machine, stds = model.machine, []
    for actuator in machine.measured_actuators:
        parts = _force_channels(model, log, actuator)
        sensors = [(machine.sensor(channel), factor) for channel, factor in parts.items()]
        stds.append(np.sqrt(sum((s.std * factor) ** 2 if s else np.nan for s, factor in sensors)))
    if machine.one_each:
        return np.array(stds)
    low, high = machine.ranges.T
    postures = np.random.default_rng(0).uniform(low, high, (POSTURES, len(low)))
    places = [machine.actuators.index(each) for each in machine.measured_actuators]
    squares = np.nanmean(model.over(model.shares, postures)[0][:, :, places] ** 2, axis=0)
    # one without a share in a balance does not count in it, also if its sensors are not stated
    made = np.sqrt(np.sum(np.where(squares > 0, squares * np.array(stds) ** 2, 0.0), axis=1))
    return np.where(made > 0, made, np.nan)


def _sealing_channels(model: Model) -> Mapping[str, tuple[str, str]]:
    return {cylinder.name: cylinder.chambers for cylinder in model.machine.cylinders
            if cylinder.name in model.pressed}


def pressures(model: Model, log: Log) -> Array | None:
    """The pressures (N, a) [Pa] that the friction of seals depends on; None where none does.

    Where the log does not tell them it does not tell the force either; they are 0 there.
    """
    machine, pressed = model.machine, _sealing_channels(model)
    there = {name: channels for name, channels in pressed.items() if set(channels) <= set(log.channels)}
    return np.column_stack([sum((np.nan_to_num(reading(machine, log, channel)) for channel in
                                 there.get(actuator.name, ())), np.zeros(log.t.size))
                            for actuator in machine.actuators]) if pressed else None


def force_channels(model: Model, log: Log) -> set[str]:
    """The channels that forces, and the pressures on seals, are read from."""
    parts = (*(_force_channels(model, log, each) for each in model.machine.measured_actuators),
             *_sealing_channels(model).values())
    return {channel for part in parts for channel in part if channel in log.channels}
