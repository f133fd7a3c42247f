"""Inverse kinematics: all postures that bring the tip to a place, each with what keeps the machine from taking it.

Least squares from many starts over the whole turn of every joint, all of them at once.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hydroopt.errors import ProblemError
from hydroopt.machine.machine_file import GivenMachine
from hydroopt.model.cylinder_motion import SHORTEST_LEVER
from hydroopt.model.least_squares_by_sample import nearest
from hydroopt.model.model import Model, model_of
from hydroopt.spatial.evenly_spread import halton
from hydroopt.spatial.inertia import Array

STARTS = 256
"""Postures from which the search starts."""
STEPS = 100
"""Steps of the search from each of them."""
CLOSE = 1e-10
"""Largest error [m or rad] of a posture that counts as found."""
ALIKE = 1e-4
"""Angle or distance [rad or m] within which two postures count as one."""
STILL = 1e-9
"""Step [rad or m] below which the search has come to its end."""
SINGULAR = 1e-4
"""Slowest motion of the tip as a part of its fastest, per motion of the joints, below which a posture is singular."""
CONTINUUM = 32
"""Number of singular postures from which there are infinitely many."""


@dataclass(frozen=True, eq=False)
class Posture:
    """A posture that brings the tip to its target.

    Attributes:
        q: (n,) joint positions [rad or m], angles within half a turn of the middle of each joint's range.
        outside: how far joints are outside their limits [rad or m], by name.
        beyond_stroke: how much cylinders would have to be longer than they can be, or shorter (negative) [m], by name.
        dead_points: cylinders that have no lever arm there.
        past_dead_points: cylinders whose lever arm has the other sign than in the middle of the ranges: a dead point
            lies on the way.
        singular: whether the joints cannot move the tip in all directions that they move it in elsewhere.

    Example:
        See `inverse_kinematics`.
    """

    q: Array
    outside: Mapping[str, float]
    beyond_stroke: Mapping[str, float]
    dead_points: tuple[str, ...]
    past_dead_points: tuple[str, ...]
    singular: bool

    @property
    def reachable(self) -> bool:
        """Whether limits, strokes and dead points let the machine take this posture."""
        return not (self.outside or self.beyond_stroke or self.dead_points or self.past_dead_points)


def inverse_kinematics(model: Model | GivenMachine, position: ArrayLike, rotation: ArrayLike | None = None, *,
                       held: Mapping[str, float] | None = None, starts: int = STARTS) -> tuple[Posture, ...]:
    """All postures that bring the tip, the far end of the machine's last link, to a place.

    Args:
        model: the machine.
        position: (3,) [m] where the tip shall be, in the base frame.
        rotation: (3, 3) orientation of the last link's far end in the base frame; any if None.
        held: positions [rad or m] of joints that do not move, by name. At most three joints may move the tip to a
            position, six with a rotation. Joints that do not move the tip need not be named.
        starts: number of postures from which the search starts.

    Returns:
        Postures that the machine can take first, each group by its distance from the middle of the ranges.

    Raises:
        ProblemError: no posture brings the tip there: the sentence states how near it comes; infinitely many do; or
            a joint is unknown.

    >>> from hydroopt.machine.machine_file import load_machine
    >>> model = Model(load_machine("cat215b"))
    >>> postures = inverse_kinematics(model, [4.0, 1.0, -1.0])
    >>> [(one.q.round(3).tolist(), one.reachable) for one in postures][0]
    ([0.272, -0.026, 2.485], True)
    >>> len(postures), dict(postures[-1].outside).keys()
    (4, dict_keys(['boom', 'stick']))
    """
    model = model_of(model, "inverse kinematics")
    machine, fixed = model.machine, dict(held or {})
    target = _target(position, rotation)
    for joint in fixed:
        if joint not in machine.joints:
            raise ProblemError(f"'{joint}' is not a moving joint of {machine.name}", where="inverse kinematics",
                               remedy=f"hold some of {', '.join(machine.joints)}")
    followed = machine.followed
    onto = {moving for link in machine.ancestry(machine.tip) for moving in followed.get(link, ())}
    free = [k for k, joint in enumerate(machine.joints) if joint in onto and joint not in fixed]
    if not 0 < len(free) <= len(target):
        what = f"{len(free)} joints move the tip, and {len(target)} numbers state where it shall be"
        raise ProblemError(f"{what}: infinitely many postures" if free else "no joint is free to move the tip",
                           where="inverse kinematics",
                           remedy=f"hold {len(free) - len(target)} of {', '.join(machine.joints[k] for k in free)}"
                           + (", or state a rotation" if rotation is None else "") if free else "hold fewer joints")
    q = _starts(model, free, fixed, starts)
    q, error = _search(model, q, free, target)
    found = _distinct(model, q[error < CLOSE], free)
    if not len(found):
        k = int(np.argmin(error))
        place = model.over(model.forward_kinematics, q[k:k + 1])[-1][0, :3, 3]
        away = float(np.linalg.norm(place - target[:3]))
        turned = "" if rotation is None else " with this rotation"
        raise ProblemError(f"no posture brings the tip to {_said(target[:3])}{turned}: the nearest found place, "
                           f"{_said(place)}, is {away:.3g} m away", where="inverse kinematics",
                           remedy="choose a target within reach, or hold joints elsewhere")
    postures = [_posture(model, each, free) for each in found]
    if sum(each.singular for each in postures) >= CONTINUUM:
        raise ProblemError(f"infinitely many postures bring the tip to {_said(target[:3])}, such as where it lies on "
                           "the axis of a joint", where="inverse kinematics",
                           remedy="hold the joint that does not move the tip there, or choose another target")
    middle = model.machine.ranges.mean(axis=1)
    return tuple(sorted(postures, key=lambda each: (not each.reachable, float(np.linalg.norm(each.q - middle)))))


def _target(position: ArrayLike, rotation: ArrayLike | None) -> Array:
    """The numbers that the tip shall have: place (3,), and the rotation's entries row by row, if it is stated."""
    place = np.asarray(position, dtype=float)
    turn = np.zeros((0, 3)) if rotation is None else np.asarray(rotation, dtype=float)
    if place.shape != (3,) or not np.all(np.isfinite(place)):
        raise ProblemError(f"a position has three finite coordinates, not {place.tolist()}", where="inverse kinematics",
                           remedy="give x, y, z of the tip in the base frame")
    if rotation is not None and (turn.shape != (3, 3) or not np.allclose(turn @ turn.T, np.eye(3), atol=1e-9)
                                 or np.linalg.det(turn) < 0):
        raise ProblemError("this is no rotation matrix", where="inverse kinematics",
                           remedy="give a matrix (3, 3) with orthonormal columns and determinant 1")
    return np.concatenate([place, turn.ravel()])


def _starts(model: Model, free: list[int], fixed: Mapping[str, float], count: int) -> Array:
    """Postures (count, n) spread over whole turns and the ranges of sliding joints, the first in mid-range."""
    machine, middle = model.machine, model.machine.ranges.mean(axis=1)
    q = np.tile(middle, (count, 1))
    for name, value in fixed.items():
        q[:, machine.joints.index(name)] = value
    spread = halton(len(free), count) - 0.5
    for column, k in enumerate(free):
        joint = machine.link(machine.joints[k]).joint
        width = 2 * np.pi if joint.type == "revolute" else joint.range[1] - joint.range[0]
        q[1:, k] += width * spread[1:, column]
    return q


def _search(model: Model, q: Array, free: list[int], target: Array) -> tuple[Array, Array]:
    """Postures (N, n) at which the error is least, from others, and that error (N,)."""
    def rows(own: Array, which: NDArray[np.intp]) -> tuple[Array, Array]:
        tried = q[which]
        tried[:, free] = own
        return _error(model, tried, free, target)

    found = nearest(rows, q[:, free], steps=STEPS, close=CLOSE / 100, still=STILL)
    closed = np.isfinite(found.size)  # where all linkages can close
    if not closed.any():
        raise ProblemError("a linkage of the machine cannot close where its joints are held",
                           where="inverse kinematics", remedy="hold them within their limits")
    q = q.copy()
    q[:, free] = found.x
    return q[closed], found.size[closed]


def _error(model: Model, q: Array, free: list[int], target: Array) -> tuple[Array, Array]:
    """Errors (N, 3 or 6) of the tip's place [m] and rotation [rad], and their slopes by the free joints."""
    pose = model.over(model.forward_kinematics, q)[-1]
    J = model.over(model.tip_jacobian, q)[0][:, :, free]
    place = pose[:, :3, 3] - target[:3]
    if len(target) == 3:
        return place, J[:, :3]
    # the cross products of the axes are the sine of the turn between them, which is small after half a turn, too
    turn, want = pose[:, :3, :3], target[3:].reshape(3, 3)
    off = np.sum(np.cross(want.T[None], turn.transpose(0, 2, 1)), axis=1) / 2
    cosine, sine = (np.einsum("nij,ij->n", turn, want) - 1) / 2, np.linalg.norm(off, axis=1)
    off *= (np.arctan2(sine, cosine) / np.maximum(sine, 1e-300))[:, None]
    off[sine == 0] = 0.0
    off[(sine < CLOSE) & (cosine < 0)] = np.pi, 0.0, 0.0
    return np.hstack([place, off]), J


def _distinct(model: Model, q: Array, free: list[int]) -> Array:
    """Postures that differ by more than rounding, angles within half a turn of the middle of each range."""
    machine, middle, q = model.machine, model.machine.ranges.mean(axis=1), q.copy()
    turning = [k for k in free if machine.link(machine.joints[k]).joint.type == "revolute"]
    q[:, turning] = middle[turning] + _wrapped(q[:, turning] - middle[turning])
    kept: list[Array] = []
    for each in q:
        apart = [each - other for other in kept]
        for off in apart:
            off[turning] = _wrapped(off[turning])
        if all(np.max(np.abs(off)) > ALIKE for off in apart):
            kept.append(each)
    return np.array(kept)


def _wrapped(angle: Array) -> Array:
    return np.arctan2(np.sin(angle), np.cos(angle))


def _posture(model: Model, q: Array, free: list[int]) -> Posture:
    machine, outside, beyond = model.machine, {}, {}
    for joint, value in zip(machine.joints, q.tolist(), strict=True):
        lower, upper = machine.link(joint).joint.range
        if not lower - CLOSE <= value <= upper + CLOSE:
            outside[joint] = max(lower - value, value - upper)
    both = np.stack([q, model.machine.ranges.mean(axis=1)])
    lengths, _, _, levers, _ = model.over(model.cylinder_kinematics, both, 0 * both, 0 * both)
    dead, past = [], []
    for row, cylinder in enumerate(machine.cylinders):
        length, shortest = float(lengths[0, row, 0]), cylinder.dead_length
        excess = max(length - shortest - cylinder.stroke, 0.0) - max(shortest - length, 0.0)
        if abs(excess) > CLOSE:
            beyond[cylinder.name] = excess
        lever, usual = levers[:, row, machine.joints.index(machine.main_joint(cylinder))]
        if abs(lever) < SHORTEST_LEVER:
            dead.append(cylinder.name)
        elif lever * usual < 0:
            past.append(cylinder.name)
    J = model.over(model.tip_jacobian, q[None])[0][0][:, free]
    sizes = np.linalg.svd(J[:3] if len(free) <= 3 else J, compute_uv=False)
    return Posture(q, outside, beyond, tuple(dead), tuple(past), bool(sizes[-1] < SINGULAR * sizes[0]))


def _said(place: Array) -> str:
    return f"({', '.join(f'{value:.4g}' for value in place)}) m"
