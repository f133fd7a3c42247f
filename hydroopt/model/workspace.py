"""Frequency, damping and gain of every joint on its oil, over the workspace."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from hydroopt.errors import ProblemError
from hydroopt.model.hanging import Hanging
from hydroopt.model.hydraulics import conductance
from hydroopt.model.plant import Plant, Steady
from hydroopt.spatial.evenly_spread import halton
from hydroopt.spatial.inertia import Array

SHARE = 0.1
"""Part of its greatest speed at which a joint moves where it is linearised, since valves are shut at rest."""


class Mode(NamedTuple):
    """Response of one joint to its valve, with all other joints and the supply pressure held.

    `frequency` [Hz] and `damping` of the joint on its oil, NaN where it does not oscillate; `gain` is the steady speed
    of the joint per unit of command [rad/s or m/s, per V, A or 1]. Valves of several actuators open in proportion to
    these actuators' lever arms, that with the longest one by a unit.
    """

    frequency: float
    damping: float
    gain: float


STILL = Mode(np.nan, np.nan, np.nan)
"""The mode of a posture in which the supply cannot move the joint."""


class Sweep(NamedTuple):
    """One joint over its range in one direction.

    `speed` [rad/s or m/s] is that of the joint, positive if it moves towards its upper limit; `position` (N,) are the
    joint's, `modes` (N, M) the response there with the other joints in M postures, the first in the middle of their
    ranges; `reason` states why the
    joint cannot move steadily in the first posture without a mode, "" if there is none.
    """

    joint: str
    actuators: tuple[str, ...]
    speed: float
    position: Array
    modes: tuple[tuple[Mode, ...], ...]
    reason: str

    def each(self, key: str) -> Array:
        """Values (N, M) of `frequency`, `damping` or `gain`."""
        return np.array([[getattr(found, key) for found in row] for row in self.modes])


def sweeps(plant: Plant, psi: Array, theta: Array, *, positions: int = 9, postures: int = 5) -> list[Sweep]:
    """Responses of all joints that oil moves to their valves over their ranges, in both directions.

    Each is linearised while it moves at a tenth of its greatest speed (see `top_speed`) and the others rest; passive
    joints hang.

    Args:
        plant: the machine.
        psi: dynamic parameters (p,).
        theta: hydraulic ones.
        positions: of each joint, evenly over its range.
        postures: of the other joints, spread over their ranges.

    Raises:
        ProblemError: the machine file states no supply pressure, or no masses.
    """
    supply, joints, hanging = plant.supply, plant.machine.joints, Hanging(plant.model)
    ranges = plant.machine.ranges
    spread = np.vstack([np.full(len(joints), 0.5), halton(len(joints), postures - 1)])
    found = []
    for joint, actuators in plant.drivers.items():
        k = joints.index(joint)
        lower, upper = ranges[k]
        # at the ends of the range chambers may be empty and lever arms short
        places = np.linspace(lower + 0.02 * (upper - lower), upper - 0.02 * (upper - lower), positions)
        top = top_speed(plant, joint)
        for speed in (SHARE * top, -SHARE * top):
            rows, reason = [], ""
            for place in places:
                row = []
                for share in spread:
                    q, qd = ranges[:, 0] + share * (ranges[:, 1] - ranges[:, 0]), np.zeros(len(joints))
                    q[k], qd[k] = place, speed
                    q = hanging.postures(q[None])[0]
                    try:
                        at = plant.steady(q, qd, psi, theta, supply)
                    except ProblemError as error:
                        reason = reason or error.what
                        row.append(STILL)
                    else:
                        row.append(mode(plant, joint, at, psi, theta))
                rows.append(tuple(row))
            names = tuple(plant.actuators[i].actuator.name for i in actuators)
            found.append(Sweep(joint, names, speed, places, tuple(rows), reason))
    return found


def workspace_sweeps(plant: Plant, psi: Array, theta: Array) -> tuple[Sweep, ...]:
    """The sweeps that answers and their reports show, with parameters ψ (p,) and θ.

    They are empty where the machine file states no supply pressure.
    """
    if plant.machine.pump is None or plant.machine.pump.pressure is None:
        return ()
    return tuple(sweeps(plant, psi, theta, positions=7, postures=2))


def top_speed(plant: Plant, joint: str) -> float:
    """The greatest speed [rad/s or m/s] of a joint that oil moves, or what its valve and the pump give it in mid-range.

    The valve fully open, at half of the supply's pressure, by the machine file's numbers; of several actuators' valves
    the one that allows least.

    Raises:
        ProblemError: the machine file states no supply pressure.
    """
    machine = plant.machine
    stated = machine.link(joint).joint.max_speed
    if stated is not None:
        return stated
    k = machine.joints.index(joint)
    middle = machine.ranges.mean(axis=1)
    levers = np.abs(np.asarray(plant.transmission(middle))[:, k])
    swept = [plant.actuators[i].areas[0] * levers[i] for i in plant.drivers[joint]]
    flows = [float(conductance(each.valve, "flow_pa", plant.value(each, plant.parameters.nominal)))
             * (plant.supply[0] / 2)**0.5 for each in (plant.actuators[i] for i in plant.drivers[joint])]
    most = machine.pump.max_flow if machine.pump else None
    return float(min([(most or np.inf) / sum(swept), *(flow / area for flow, area in zip(flows, swept, strict=True))]))


def mode(plant: Plant, joint: str, steady: Steady, psi: Array, theta: Array) -> Mode:
    """Frequency and damping of a joint on its oil, and the steady gain from its valves to its speed, others held.

    The least damped pair of poles of the joint with its chambers is taken, the spool's own poles aside: for these the
    opening is an input. The gain is that of command to speed at frequency zero.

    Args:
        plant: the machine.
        joint: which; oil moves it.
        steady: state about which it is linearised.
        psi: dynamic parameters (p,).
        theta: hydraulic ones.

    Raises:
        ProblemError: nothing that the joint moves has a mass, or the machine file states no supply pressure.
    """
    joints, states = plant.machine.joints, list(plant.states)
    k, n = joints.index(joint), len(joints)
    A, B = (np.array(part) for part in plant.jacobians(steady.x, steady.u, plant.supply, psi, theta))
    # inertia that the actuator moves with the other joints held
    mass = np.asarray(plant.mass(steady.x[:n], psi))
    if mass[k, k] == 0:
        raise ProblemError(f"nothing that '{joint}' moves has a mass or inertia", where=plant.machine.name,
                           remedy="state the bodies of its links in the machine file")
    A[n + k] = mass[k] @ A[n:2 * n] / mass[k, k]
    places = list(plant.drivers[joint])
    owners = tuple(f"{plant.actuators[i].actuator.name}." for i in places)
    moving = [f"{joint}.qd", *(name for name in states if name.startswith(owners))]
    rows = [states.index(name) for name in moving]
    levers = np.asarray(plant.transmission(steady.x[:n]))[places, k] * np.sign(
        [plant.actuators[i].valve.span for i in places])
    opened = levers / levers[np.argmax(np.abs(levers))]
    A, B = A[np.ix_(rows, rows)], (B[rows][:, places] @ opened)[:, None]
    gain = float((-np.linalg.solve(A, B))[0, 0])
    oil = [i for i, name in enumerate(moving) if ".spool" not in name]
    swinging = [pole for pole in np.linalg.eigvals(A[np.ix_(oil, oil)]) if pole.imag > 1e-9 * abs(pole)]
    if not swinging:
        return Mode(np.nan, np.nan, gain)
    pole = min(swinging, key=lambda p: -p.real / abs(p))
    return Mode(float(abs(pole) / (2 * np.pi)), float(-pole.real / abs(pole)), gain)
