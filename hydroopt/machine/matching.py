"""Which joint each actuator is there to move: a matching of actuators to joints, where a cylinder moves several."""

from __future__ import annotations

from collections.abc import Collection, Mapping

import numpy as np


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
    moves = np.eye(len(joints), dtype=bool)
    for name, others in moved.items():
        for joint in others:
            moves[place[mains[name]], place[joint]] = True
    for _ in joints:  # in as many steps as it takes
        moves = moves @ moves
    each_other = moves & moves.T
    groups = dict.fromkeys(tuple(joints[k] for k in np.flatnonzero(row)) for row in each_other)
    return tuple(group for group in groups if len(group) > 1)
