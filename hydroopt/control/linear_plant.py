"""The plant about an operating point as a linear system of python-control, in continuous time and sampled.

Sampled, commands are held between samples and delayed by the valves; both are exact.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hydroopt.model.plant import Plant, Steady
from hydroopt.spatial.inertia import Array

if TYPE_CHECKING:
    from control import StateSpace

SHORTEST = 1e-9
"""Time constant [s] of a low pass or a lag that passes everything."""


class Reading(NamedTuple):
    """The input of a controller at a sample: lengths and forces (a,) of the actuators, pressures (a, 2) of their
    chambers and (2,) of supply and tank.

    Lengths are computed from the joint positions `q` (n,), forces from pressures.
    """

    q: Array
    length: Array
    force: Array
    pressure: Array
    supply: Array


@dataclass(frozen=True, eq=False)
class Point:
    """An operating point: a posture with speeds at which the machine moves steadily, and its linear model there.

    Attributes:
        name: such as ``motion at 2.0 s``.
        q, qd: of the joints (n,).
        length, speed: of the actuators (a,).
        pressure: of their chambers (a, 2) [Pa].
        lever_arm: (a, n) speeds of the actuators per speeds of the joints.
        supply: pressures (2,) [Pa].
        system: the machine as a controller meets it, see `linearised` and `sampled`.
        on_motion: whether a motion to follow leads through it.
    """

    name: str
    q: Array
    qd: Array
    length: Array
    speed: Array
    pressure: Array
    lever_arm: Array
    supply: Array
    system: StateSpace
    on_motion: bool = True


def point(plant: Plant, name: str, q: Array, qd: Array, psi: Array, theta: Array, period: float, *,
          on_motion: bool = True) -> Point:
    """A point of steady motion, for a controller with this sampling period [s].

    Raises:
        ProblemError: the supply cannot move the machine at these speeds.
    """
    steady = plant.steady(q, qd, psi, theta)
    outputs = plant.outputs.call({"x": steady.x, "u": steady.u, "supply": plant.supply, "psi": psi, "theta": theta})
    length, speed = (np.asarray(outputs[key]).ravel() for key in ("length", "speed"))
    return Point(name, q, qd, length, speed, np.asarray(outputs["pressure"]), np.asarray(plant.transmission(q).full()),
                 plant.supply, sampled(linearised(plant, steady, psi, theta), plant.delays, period), on_motion)


def linearised(plant: Plant, steady: Steady, psi: Array, theta: Array) -> StateSpace:
    """From commands to q, forces of the actuators and the supply's pressure; states are divided by `plant.scale`.

    States are deviations from the motion. The change of lever arms along the motion is left out: it only changes the
    ratio between errors of lengths and of angles and amplifies none. A base does not move, and has no states.
    """
    import control  # noqa: PLC0415 — codegen reaches this module, and needs no linear systems

    n, scale, names = len(plant.machine.joints), plant.scale, plant.states
    A, B = (np.asarray(part) for part in plant.jacobians(steady.x, steady.u, plant.supply, psi, theta))
    A[[".p_" in name for name in names], :n] = 0.0
    C = np.zeros((n + len(plant.actuators) + 1, len(names)))
    C[:n, :n] = np.eye(n)
    for k, each in enumerate(plant.actuators):
        C[n + k, [names.index(name) for name in each.chambers]] = each.areas[0], -each.areas[1]
    C[-1] = [name == "pump.p_supply" for name in names]
    base = {f"{joint}.{kind}" for joint in plant.machine.base_joints for kind in ("q", "qd")}
    kept = [k for k, name in enumerate(names) if name not in base]
    A, B, C = A * scale / scale[:, None], B / scale[:, None], C * scale
    return control.ss(A[np.ix_(kept, kept)], B[kept], C[:, kept], 0, states=signals(names[k] for k in kept),
                      inputs=signals(plant.inputs), outputs=readings(plant))


def readings(plant: Plant) -> list[str]:
    """Names of what linear controllers read: positions of the joints, forces of the actuators, the supply's pressure.
    """
    names = (*(f"{joint}.q" for joint in plant.machine.joints),
             *(f"{each.actuator.name}.force" for each in plant.actuators), "pump.p_supply")
    return signals(f"{name}_measured" for name in names)


def sampled(system: StateSpace, delays: Array, period: float) -> StateSpace:
    """A system whose commands are held from sample to sample and arrive later by `delays` (n,) [s].

    Commands wait in shift registers, whose entries are additional states (Åström and Wittenmark 1997).

    Args:
        system: in continuous time, without direct feedthrough.
        delays: of its commands (n,) [s].
        period: of the samples [s].
    """
    import control  # noqa: PLC0415 — codegen reaches this module, and needs no linear systems

    whole, part = in_samples(delays, period)
    held = control.sample_system(system, period, "zoh")
    # by those of two successive commands that act in a period, the later one first
    by_command = np.stack([held.B, np.zeros_like(held.B)], axis=2)
    for k in np.flatnonzero(part).tolist():
        first, rest = (control.sample_system(system, seconds, "zoh") for seconds in (part[k], period - part[k]))
        by_command[:, k] = np.column_stack([rest.B[:, k], rest.A @ first.B[:, k]])
    registers, names = [], []
    for k, count in enumerate((whole + (part > 0)).tolist()):
        entries = np.eye(count + 1)[[whole[k], count]]
        registers.append(control.ss(np.eye(count, k=-1), np.eye(count, 1), entries[:, 1:], entries[:, :1], period))
        names += [f"{system.input_labels[k]}_{j}_samples_ago" for j in range(1, count + 1)]
    acting = control.ss(held.A, by_command.reshape(len(held.A), -1), held.C, 0, period)
    return control.ss(acting * control.append(*registers), states=[*names, *system.state_labels],
                      inputs=system.input_labels, outputs=system.output_labels)


def in_samples(delays: Array, period: float) -> tuple[NDArray[np.intp], Array]:
    """Delays (n,) [s] as whole sampling periods and the rest [s] beyond them, without their rounding."""
    whole = np.floor(delays / period * (1 + 1e-12)).astype(np.intp)
    rest: Array = np.round(np.maximum(delays - whole * period, 0.0), 12).astype(float)
    return whole, rest


def signals(names: Iterable[str]) -> list[str]:
    """Names of states, commands or outputs in python-control, which allows no dots: underscores stand for them.

    >>> signals(["boom.q", "pump.p_supply"])
    ['boom_q', 'pump_p_supply']
    """
    return [name.replace(".", "_") for name in names]


def state_space(plant: Plant, steady: Steady, psi: Array, theta: Array, *, supply: Array | None = None,
                outputs: Sequence[str] | None = None) -> StateSpace:
    """The machine near a state as δẋ = A·δx + B·δu, y = C·δx, with named states, inputs and outputs, see `signals`.

    Positions change in a steady motion: the linear model holds while the posture has hardly changed.

    Args:
        plant: the machine.
        steady: state and commands about which it is linearised, such as those of `Plant.steady`.
        psi: dynamic parameters (p,).
        theta: hydraulic ones.
        supply: pressures (2,) of supply and tank; those of the machine file if None.
        outputs: names of the states that are outputs; the joints' positions if None.

    Raises:
        ProblemError: the machine file states no supply pressure.
    """
    import control  # noqa: PLC0415 — codegen reaches this module, and needs no linear systems

    A, B = plant.jacobians(steady.x, steady.u, plant.supply if supply is None else supply, psi, theta)
    names = plant.states
    chosen = tuple(outputs or names[:len(plant.machine.joints)])
    C = np.eye(len(names))[[names.index(name) for name in chosen]]
    return control.ss(A, B, C, 0, name=plant.machine.name, states=signals(names), inputs=signals(plant.inputs),
                      outputs=signals(chosen))
