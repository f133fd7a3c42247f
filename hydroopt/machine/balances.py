"""Which joint each actuator is there to move, and the equations of motion that are measured.

By virtual work the joints' generalised forces are τ = T_mᵀ·f_m + T_uᵀ·f_u, with the forces f of measured and of
unmeasured actuators and their lever arms T. Each unmeasured force is eliminated by the equation of the joint that its
actuator is there to move. Every other joint keeps its equation: a balance.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np
from scipy.sparse.csgraph import connected_components

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


class UnmeasuredJoint(NamedTuple):
    """A joint without a balance: forces there are neither predicted nor compared with any log.

    Attributes:
        joint: its name.
        actuators: that are there to move it.
        unmeasured: names of those that no log measures.
    """

    joint: str
    actuators: tuple[Actuator, ...]
    unmeasured: tuple[str, ...]

    @property
    def remedy(self) -> str:
        """What to do about it: measure, or state equal cylinders with the same oil as jacks of one."""
        measure = f"measure {' and '.join(self.unmeasured)}"
        sizes = [each.areas for each in self.actuators if isinstance(each, Cylinder)]
        if 1 < len(sizes) == len(self.actuators) and np.ptp(sizes, axis=0).max() <= 1e-6 * np.max(sizes):
            measure += (f", or if these {len(sizes)} cylinders share their oil state one in their place with "
                        f"jacks = {len(sizes)}")
        return measure


def matched(moved: Mapping[str, tuple[str, ...]], driven: Collection[str]) -> dict[str, str]:
    """The joint that each actuator is there to move: the last one, unless nothing else is left to move another one.

    A joint that nothing moves then takes an actuator from a joint that has several, along the shortest chain of
    actuators that change their joints; so do all six cylinders of a platform share six joints. A joint for which there
    is no such chain stays without an actuator.

    Args:
        moved: the joints that each actuator moves, in the order of q.
        driven: the joints that must have an actuator, in the order of q.

    >>> matched({"boom_cylinder": ("boom",), "tilt_cylinder": ("boom", "stick")}, ("boom", "stick"))
    {'boom_cylinder': 'boom', 'tilt_cylinder': 'stick'}
    >>> matched({"left": ("lift", "tilt"), "right": ("lift", "tilt")}, ("lift", "tilt"))
    {'left': 'lift', 'right': 'tilt'}
    """
    mains = {name: joints[-1] for name, joints in moved.items()}
    for joint in driven:
        if joint not in mains.values():
            mains |= _taken(joint, moved, mains, driven)
    return mains


def _taken(joint: str, moved: Mapping[str, tuple[str, ...]], mains: Mapping[str, str],
           driven: Collection[str]) -> dict[str, str]:
    """New joints of the actuators in the shortest chain that gives a joint its actuator; empty if there is none."""
    given = list(mains.values())
    chains: dict[str, dict[str, str]] = {joint: {}}
    for wanting in (waiting := [joint]):
        for name, main in mains.items():
            if wanting not in moved[name] or main in chains or main not in driven:
                continue
            chains[main] = chains[wanting] | {name: wanting}
            if given.count(main) > 1:
                return chains[main]
            waiting.append(main)
    return {}


def entangled(moved: Mapping[str, tuple[str, ...]], mains: Mapping[str, str],
              joints: tuple[str, ...]) -> tuple[tuple[str, ...], ...]:
    """Groups of two and more joints that only all of their actuators move together, in the order of q.

    Where the actuators of each joint move other joints one way only, their equations are solved one after the other,
    and there is no such group.

    >>> entangled({"left": ("lift", "tilt"), "right": ("lift", "tilt")}, {"left": "lift", "right": "tilt"},
    ...           ("lift", "tilt"))
    (('lift', 'tilt'),)
    """
    place = {joint: k for k, joint in enumerate(joints)}
    moves = np.zeros((len(joints), len(joints)), dtype=bool)
    for name, others in moved.items():
        for joint in others:
            moves[place[mains[name]], place[joint]] = True
    of_joint = connected_components(moves, connection="strong")[1]
    groups = (tuple(joints[k] for k in np.flatnonzero(of_joint == group)) for group in dict.fromkeys(of_joint.tolist()))
    return tuple(group for group in groups if len(group) > 1)
