"""The vertical plane that a machine mainly moves in, and the postures that show it from the side."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from hydroopt.model.hanging import Hanging
from hydroopt.model.model import Model
from hydroopt.spatial.inertia import Array
from hydroopt.spatial.poses import roll_pitch_yaw

UP = np.array([0.0, 0.0, 1.0])


class Plane(NamedTuple):
    """A vertical plane by its horizontal direction in the world.

    `zeroed` joints turn the whole plane and are set to zero; `moving` ones move the machine within it.
    """

    across: Array
    zeroed: tuple[int, ...]
    moving: tuple[int, ...]


class SidePostures(NamedTuple):
    """Joint positions (k, n) [rad or m] that show a machine from the side: the first as it mainly stands, then its
    extremes."""

    plane: Plane
    q: Array


def range_postures(model: Model, q: Array) -> SidePostures:
    """The mean of joint positions (N, n), then the extremes that each joint reaches in the plane."""
    plane = vertical_plane(model, np.mean(q, axis=0))
    extremes = [int(f(q[:, k])) for k in plane.moving for f in (np.argmin, np.argmax)]
    found = np.vstack([np.mean(q, axis=0), q[list(dict.fromkeys(extremes))]])
    found[:, list(plane.zeroed)] = 0.0
    return SidePostures(plane, found)


def limit_postures(model: Model) -> SidePostures:
    """The middle of all ranges, then both limits of each joint that moves the machine in the plane.

    Passive joints hang.
    """
    middle = model.machine.ranges.mean(axis=1)
    q = np.tile(middle, (2 * len(middle), 1))
    for k, limit in enumerate(model.machine.ranges):
        q[2 * k : 2 * k + 2, k] = limit
    found = range_postures(model, q)
    return found._replace(q=Hanging(model).postures(found.q))


def vertical_plane(model: Model, mean: Array) -> Plane:
    """The vertical plane perpendicular to the horizontal axis that most joints share.

    Joints that turn and stand before the first of those turn the whole plane; they stand at zero.
    """
    machine = model.machine
    axes = {joint: pose[0, :3, 2] for joint, pose in _frames(model, np.zeros((1, len(machine.joints)))).items()}
    revolute = [j for j in machine.joints if machine.link(j).joint.type == "revolute" and abs(axes[j] @ UP) < 0.7]
    alike = [[j for j in revolute if abs(axes[j] @ axes[other]) > 0.999] for other in revolute]
    group = max(alike, key=len, default=[])
    before = [j for j in (machine.ancestry(group[0])[1:] if group else ())
              if j in machine.joints and machine.link(j).joint.type == "revolute"]
    zeroed = tuple(machine.joints.index(j) for j in before)
    sliding = [j for j in machine.joints if machine.link(j).joint.type == "prismatic"]
    moving = tuple(machine.joints.index(j) for j in (*group, *sliding)) or tuple(range(len(machine.joints)))
    pose = np.array(mean)
    pose[list(zeroed)] = 0.0
    frames = _frames(model, pose[None])
    reach = np.mean([f[0, :3, 3] for f in _ends(model, pose[None]).values()], axis=0) * [1, 1, 0]
    if group:
        across = np.cross(UP, frames[group[0]][0, :3, 2])
    else:
        across = reach if np.linalg.norm(reach) > 1e-6 else np.array([1.0, 0.0, 0.0])
    across = across / np.linalg.norm(across)
    return Plane(across * (1.0 if across @ reach >= 0 else -1.0), zeroed, moving)


def _ends(model: Model, poses: Array) -> dict[str, Array]:
    """Pose in the world (k, 4, 4) of every link's far end at the joint positions (k, n)."""
    world = np.eye(4)
    world[:3, :3] = np.asarray(roll_pitch_yaw(model.machine.orientation))
    ends = model.over(model.forward_kinematics, poses)
    return {link.name: world @ end for link, end in zip(model.machine.links, ends, strict=True)}


def _frames(model: Model, poses: Array) -> dict[str, Array]:
    """Pose in the world (k, 4, 4) of every link's frame P_i."""
    return {name: end @ model.geometry.far_end(name).inverse().matrix()
            for name, end in _ends(model, poses).items()}
