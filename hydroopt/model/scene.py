"""A machine's joints, pins and centres of mass as points of the vertical plane that it mainly moves in."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from hydroopt.machine.machine import BASE
from hydroopt.model.model import Model
from hydroopt.spatial import inertia
from hydroopt.spatial.inertia import Array
from hydroopt.spatial.poses import Pose, roll_pitch_yaw

UP = np.array([0.0, 0.0, 1.0])


class Plane(NamedTuple):
    """A vertical plane by its horizontal direction in the world.

    `zeroed` joints turn the whole plane and are set to zero; `moving` ones move the machine within it.
    """

    across: Array
    zeroed: tuple[int, ...]
    moving: tuple[int, ...]


class Scene(NamedTuple):
    """One pose, every point (2,) [m] in the plane: joints' start and end by link, pins by cylinder and by loop."""

    start: dict[str, Array]
    axis: dict[str, Array]
    end: dict[str, Array]
    mass: dict[str, Array]
    barrel: dict[str, Array]
    rod: dict[str, Array]
    length: dict[str, float]
    closing: dict[str, Array]


def range_scenes(model: Model, q: Array) -> list[Scene]:
    """The machine at the mean of joint positions (N, n), then at the extremes that each joint reaches in the plane."""
    plane = vertical_plane(model, np.mean(q, axis=0))
    extremes = [int(f(q[:, k])) for k in plane.moving for f in (np.argmin, np.argmax)]
    poses = np.vstack([np.mean(q, axis=0), q[list(dict.fromkeys(extremes))]])
    poses[:, list(plane.zeroed)] = 0.0
    return scenes(model, poses, plane)


def limit_scenes(model: Model) -> list[Scene]:
    """The machine in the middle of all ranges, then at both limits of each joint that moves it in the plane."""
    limits = np.array([model.machine.link(joint).joint.range for joint in model.machine.joints])
    middle = limits.mean(axis=1)
    q = np.tile(middle, (2 * len(middle), 1))
    for k, limit in enumerate(limits):
        q[2 * k : 2 * k + 2, k] = limit
    return range_scenes(model, q)


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
    return {name: end @ np.linalg.inv(_matrix(model.geometry.far_end(name)))
            for name, end in _ends(model, poses).items()}


def _matrix(pose: Pose) -> Array:
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = np.asarray(pose.rotation), np.asarray(pose.origin).ravel()
    return matrix


def scenes(model: Model, poses: Array, plane: Plane) -> list[Scene]:
    """The machine in joint positions (k, n), projected on a plane."""
    machine = model.machine
    look = np.array([plane.across, UP])
    frames, ends = _frames(model, poses), _ends(model, poses)
    base = np.tile(np.eye(4), (len(poses), 1, 1))
    base[:, :3, :3] = np.asarray(roll_pitch_yaw(machine.orientation))
    frames[BASE] = ends[BASE] = base
    found = []
    for i in range(len(poses)):
        def place(link: str, point: Sequence[float], i: int = i) -> Array:
            return np.asarray(frames[link][i, :3, :3] @ np.asarray(point) + frames[link][i, :3, 3])
        mass = {}
        for link in machine.links:
            centre = None if link.body is None else inertia.centre_of_mass(link.body.phi)
            if centre is not None:
                mass[link.name] = look @ place(link.name, centre.tolist())
        pins = {one.name: [place(end.link, end.pin) for end in (one.barrel, one.rod)] for one in machine.pinned}
        found.append(Scene(
            {link.name: look @ (ends[link.parent][i, :3, 3] if link.pin is None else place(link.parent, link.pin))
             for link in machine.links},
            {link.name: look @ frames[link.name][i, :3, 3] for link in machine.links},
            {link.name: look @ ends[link.name][i, :3, 3] for link in machine.links}, mass,
            {name: look @ pin[0] for name, pin in pins.items()}, {name: look @ pin[1] for name, pin in pins.items()},
            {name: float(np.linalg.norm(pin[1] - pin[0])) for name, pin in pins.items()},
            {loop.name: look @ place(loop.to.link, loop.to.pin) for loop in machine.loops}))
    return found
