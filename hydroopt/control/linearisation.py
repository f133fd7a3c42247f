"""The plant near an operating point as a linear system of python-control."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING

import numpy as np

from hydroopt.model.plant import Plant, Steady
from hydroopt.spatial.inertia import Array

if TYPE_CHECKING:
    from control import StateSpace


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
