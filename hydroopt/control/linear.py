"""The plant near an operating point as a linear system, and what it tells: frequency, damping, gain."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import control
import numpy as np

from hydroopt.errors import ProblemError
from hydroopt.inertia import Array
from hydroopt.model.plant import Plant, Steady


def state_space(plant: Plant, at: Steady, psi: Array, theta: Array, *, supply: Array | None = None,
                outputs: Sequence[str] | None = None) -> control.StateSpace:
    """The machine near a state as δẋ = A·δx + B·δu, y = C·δx, with named states, inputs and outputs, see `signal`.

    A machine that moves steadily does not rest in q: the linear model holds as long as the posture has hardly changed.

    Args:
        plant: the machine.
        at: state and commands about which it is linearised, such as those of `Plant.steady`.
        psi: dynamic parameters (p,).
        theta: hydraulic ones.
        supply: pressures (2,) of supply and tank; those of the machine file if None.
        outputs: names of the states that are outputs; the joints' positions if None.

    Raises:
        ProblemError: the machine file states no supply pressure.
    """
    A, B = plant.jacobians(at.x, at.u, plant.supply if supply is None else supply, psi, theta)
    names = list(plant.states)
    chosen = list(outputs or names[:len(plant.machine.joints)])
    C = np.eye(len(names))[[names.index(name) for name in chosen]]
    labels = [[signal(name) for name in group] for group in (names, plant.inputs, chosen)]
    return control.ss(np.asarray(A), np.asarray(B), C, 0, states=labels[0], inputs=labels[1], outputs=labels[2],
                      name=plant.machine.name)


def signal(name: str) -> str:
    """What python-control, which allows no dots, calls a state, command or output."""
    return name.replace(".", "_")


class Mode(NamedTuple):
    """How one joint answers its own valve, all other joints and the supply's pressure held.

    `frequency` [Hz] and `damping` of the joint on its oil, NaN where it does not swing; `gain` is the steady speed of
    the joint per unit of command [rad/s or m/s, per V, A or 1].
    """

    frequency: float
    damping: float
    gain: float


def mode(plant: Plant, joint: str, at: Steady, psi: Array, theta: Array) -> Mode:
    """Frequency and damping of a joint on its oil, and the steady gain from its valve to its speed, others held.

    The least damped pair of poles of the joint with its chambers is taken, the spool's own poles aside: for these the
    opening is an input. The gain is that of command to speed at frequency zero.

    Args:
        plant: the machine.
        joint: which.
        at: state about which it is linearised.
        psi: dynamic parameters (p,).
        theta: hydraulic ones.

    Raises:
        ProblemError: nothing that the joint moves has a mass, or the machine file states no supply pressure.
    """
    joints, states = plant.machine.joints, list(plant.states)
    k, n = joints.index(joint), len(joints)
    A, B = (np.array(part) for part in plant.jacobians(at.x, at.u, plant.supply, psi, theta))
    # what the actuator has to push if the other joints cannot give way
    mass = np.asarray(plant.mass(at.x[:n], psi))
    if mass[k, k] == 0:
        raise ProblemError(f"nothing that '{joint}' moves has a mass or inertia", where=plant.machine.name,
                           remedy="state the bodies of its links in the machine file")
    A[n + k] = mass[k] @ A[n:2 * n] / mass[k, k]
    moving = [f"{joint}.qd", *(name for name in states if name.startswith(f"{plant.actuators[k].actuator.name}."))]
    rows = [states.index(name) for name in moving]
    A, B = A[np.ix_(rows, rows)], B[rows][:, [k]]
    gain = float((-np.linalg.solve(A, B))[0, 0])
    oil = [i for i, name in enumerate(moving) if ".spool" not in name]
    swinging = [pole for pole in np.linalg.eigvals(A[np.ix_(oil, oil)]) if pole.imag > 1e-9 * abs(pole)]
    if not swinging:
        return Mode(np.nan, np.nan, gain)
    pole = min(swinging, key=lambda p: -p.real / abs(p))
    return Mode(float(abs(pole) / (2 * np.pi)), float(-pole.real / abs(pole)), gain)
