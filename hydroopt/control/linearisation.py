"""The plant near an operating point as a linear system of python-control."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from hydroopt.control.linear_system import LinearSystem
from hydroopt.model.plant import Plant, Steady
from hydroopt.spatial.inertia import Array

if TYPE_CHECKING:
    from hydroopt.control.python_control import control


def state_space(plant: Plant, steady: Steady, psi: Array, theta: Array, *, supply: Array | None = None,
                outputs: Sequence[str] | None = None) -> control.StateSpace:
    """The machine near a state as δẋ = A·δx + B·δu, y = C·δx, with named states, inputs and outputs, see
    `linear_system.signal`.

    Positions change in a steady motion: the linear model holds while the posture has hardly changed.

    Args:
        plant: the machine.
        steady: state and commands about which it is linearised, such as those of `Plant.steady`.
        psi: dynamic parameters (p,).
        theta: hydraulic ones.
        supply: pressures (2,) of supply and tank; those of the machine file if None.
        outputs: names of the states that are outputs; the joints' positions if None.

    Raises:
        ProblemError: the machine file states no supply pressure, or python-control is not installed.
    """
    A, B = plant.jacobians(steady.x, steady.u, plant.supply if supply is None else supply, psi, theta)
    names = plant.states
    chosen = tuple(outputs or names[:len(plant.machine.joints)])
    C = np.eye(len(names))[[names.index(name) for name in chosen]]
    return LinearSystem(np.asarray(A), np.asarray(B), C, np.zeros((len(C), len(plant.inputs))), 0.0, names,
                        plant.inputs, chosen).python_control(plant.machine.name)
