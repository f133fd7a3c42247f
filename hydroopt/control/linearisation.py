"""The plant near an operating point as a linear system of python-control."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hydroopt.control.python_control import control
from hydroopt.model.plant import Plant, Steady
from hydroopt.spatial.inertia import Array


def state_space(plant: Plant, steady: Steady, psi: Array, theta: Array, *, supply: Array | None = None,
                outputs: Sequence[str] | None = None) -> control.StateSpace:
    """The machine near a state as δẋ = A·δx + B·δu, y = C·δx, with named states, inputs and outputs, see `signal`.

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
    A, B = plant.jacobians(steady.x, steady.u, plant.supply if supply is None else supply, psi, theta)
    names = list(plant.states)
    chosen = list(outputs or names[:len(plant.machine.joints)])
    C = np.eye(len(names))[[names.index(name) for name in chosen]]
    labels = [[signal(name) for name in group] for group in (names, plant.inputs, chosen)]
    return control.ss(np.asarray(A), np.asarray(B), C, 0, states=labels[0], inputs=labels[1], outputs=labels[2],
                      name=plant.machine.name)


def signal(name: str) -> str:
    """Name of a state, command or output in python-control, which allows no dots."""
    return name.replace(".", "_")
