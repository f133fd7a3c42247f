"""The sampled linear plant about an operating point.

Commands are held between samples and delayed by the valves; both are exact.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple, Protocol

import numpy as np

from hydroopt.control.linear_system import LinearSystem
from hydroopt.model.plant import Plant, Steady
from hydroopt.spatial.inertia import Array


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
    """An operating point: a posture with speeds at which the machine moves steadily.

    Attributes:
        name: such as ``motion at 2.0 s``.
        q, qd: of the joints (n,).
        length, speed: of the actuators (a,).
        pressure: of their chambers (a, 2) [Pa].
        lever_arm: (a, n) speeds of the actuators per speeds of the joints.
        supply: pressures (2,) [Pa].
        steady: state and commands.
    """

    name: str
    q: Array
    qd: Array
    length: Array
    speed: Array
    pressure: Array
    lever_arm: Array
    supply: Array
    steady: Steady


class Linear(Protocol):
    """A controller that can be linearised."""

    def linear(self, point: Point) -> LinearSystem:
        """The linear system from q, forces and supply pressure to commands."""


def point(plant: Plant, name: str, q: Array, qd: Array, psi: Array, theta: Array) -> Point:
    """A point of steady motion.

    Raises:
        ProblemError: the supply cannot move the machine at these speeds.
    """
    steady = plant.steady(q, qd, psi, theta)
    outputs = plant.outputs.call({"x": steady.x, "u": steady.u, "supply": plant.supply, "psi": psi, "theta": theta})
    lever_arm = np.asarray(plant.transmission(q).full())
    length, speed = (np.asarray(outputs[key]).ravel() for key in ("length", "speed"))
    return Point(name, q, qd, length, speed, np.asarray(outputs["pressure"]), lever_arm, plant.supply, steady)


def linearised(plant: Plant, operating_point: Point, psi: Array, theta: Array) -> LinearSystem:
    """From commands to q, forces of the actuators and the supply's pressure; states are divided by `plant.scale`.

    States are deviations from the motion. The change of lever arms along the motion is left out: it only changes the
    ratio between errors of lengths and of angles and amplifies none. A base does not move, and has no states.
    """
    n, scale, names, at = len(plant.machine.joints), plant.scale, plant.states, operating_point.steady
    A, B = (np.asarray(part) for part in plant.jacobians(at.x, at.u, operating_point.supply, psi, theta))
    A[[".p_" in name for name in names], :n] = 0.0
    C = np.zeros((n + len(plant.actuators) + 1, len(names)))
    C[:n, :n] = np.eye(n)
    for k, each in enumerate(plant.actuators):
        C[n + k, [names.index(name) for name in each.chambers]] = each.areas[0], -each.areas[1]
    C[-1] = [name == "pump.p_supply" for name in names]
    base = {f"{joint}.{kind}" for joint in plant.machine.base_joints for kind in ("q", "qd")}
    kept = [k for k, name in enumerate(names) if name not in base]
    A, B, C = A * scale / scale[:, None], B / scale[:, None], C * scale
    return LinearSystem(A[np.ix_(kept, kept)], B[kept], C[:, kept], np.zeros((len(C), B.shape[1])), 0.0,
                        tuple(names[k] for k in kept), plant.inputs, readings(plant))


def readings(plant: Plant) -> tuple[str, ...]:
    """Names of what linear controllers read: positions of the joints, forces of the actuators, the supply's pressure.
    """
    names = (*(f"{joint}.q" for joint in plant.machine.joints),
             *(f"{each.actuator.name}.force" for each in plant.actuators), "pump.p_supply")
    return tuple(f"{name}_measured" for name in names)


def sampled(system: LinearSystem, delays: Array, period: float) -> LinearSystem:
    """A system whose commands are held from sample to sample and arrive later by `delays` (n,) [s].

    Commands that do not act yet are additional states (Åström and Wittenmark 1997).
    """
    from scipy.linalg import expm  # noqa: PLC0415 — it takes longer to load than C to be written

    A, B = system.A, system.B
    whole = np.floor(delays / period * (1 + 1e-12)).astype(int)
    part = np.round(np.maximum(delays - whole * period, 0.0), 12)
    size, n = len(A), B.shape[1]

    def over(seconds: float) -> tuple[Array, Array]:
        if seconds <= 0:
            return np.eye(size), np.zeros_like(B)
        both = expm(seconds * np.block([[A, B], [np.zeros((n, size + n))]]))
        return both[:size, :size], both[:size, size:]

    count = whole + (part > 0)
    waiting = [(k, j) for k in range(n) for j in range(count[k], 0, -1)]
    place = {entry: size + i for i, entry in enumerate(waiting)}
    new_A, new_B = np.zeros((size + len(waiting),) * 2), np.zeros((size + len(waiting), n))
    new_A[:size, :size] = over(period)[0]

    def enter(k: int, ago: int, effect: Array) -> None:
        if ago:
            new_A[:size, place[k, ago]] = effect
        else:
            new_B[:size, k] = effect

    for k in range(n):
        rest, late = over(period - part[k])
        enter(k, whole[k], late[:, k])
        if part[k] > 0:
            enter(k, count[k], rest @ over(part[k])[1][:, k])
        for j in range(1, count[k] + 1):
            if j == 1:
                new_B[place[k, j], k] = 1.0
            else:
                new_A[place[k, j], place[k, j - 1]] = 1.0
    names = [f"{system.inputs[k]}_{j}_samples_ago" for k, j in waiting] if system.inputs else []
    return LinearSystem(
        new_A, new_B, np.hstack([system.C, np.zeros((len(system.C), len(waiting)))]), system.D, period,
        (*system.states, *names), system.inputs, system.outputs)
