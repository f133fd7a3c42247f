"""Measured equations of motion: what is left of one equation a joint when unmeasured actuators are eliminated.

By virtual work the joints' generalised forces are τ = T_mᵀ·f_m + T_uᵀ·f_u, with the forces f of measured and of
unmeasured actuators and their lever arms T. Each unmeasured force is eliminated by the equation of the joint that its
actuator is there to move. Every other joint keeps its equation: a balance.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

from hydroopt.machine.actuators import Actuator, Cylinder


@dataclass(frozen=True)
class Balance:
    """The measured equation of motion of one joint.

    Where a single actuator is there to move the joint, it states the force of this actuator. Where several are, or
    where more actuators than joints move several joints together, it states what they do at the joint together, and of
    a passive joint that nothing acts there.

    Attributes:
        joint: whose equation it is.
        actuators: that are there to move the joint; all are measured.
        unit: of what is measured.
    """

    joint: str
    actuators: tuple[Actuator, ...]
    unit: Literal["N", "N*m"]

    @property
    def alone(self) -> Actuator | None:
        """The actuator whose force is measured, where a single one is there to move the joint."""
        return self.actuators[0] if len(self.actuators) == 1 else None

    @property
    def name(self) -> str:
        """The actuator's name or, where there is not one actuator, the joint's."""
        return self.actuators[0].name if len(self.actuators) == 1 else self.joint


def balance(joint: str, actuators: tuple[Actuator, ...], *, prismatic: bool) -> Balance | None:
    """The measured equation of a joint; None if an unmeasured actuator is there to move it.

    Args:
        joint: its name.
        actuators: that are there to move it.
        prismatic: whether it slides.
    """
    if not all(each.measured for each in actuators):
        return None
    force = prismatic or (len(actuators) == 1 and isinstance(actuators[0], Cylinder))
    return Balance(joint, actuators, "N" if force else "N*m")


def undriven(balances: Sequence[Balance]) -> tuple[int, ...]:
    """Which are those of passive joints, where no force is measured."""
    return tuple(k for k, each in enumerate(balances) if not each.actuators)
