"""Postures in which a chain is closed: found at random, along a sweep, and recorded as a pose table would be."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from hydroopt.errors import ProblemError
from hydroopt.logs.poses import Poses
from hydroopt.logs.sensors import measure
from hydroopt.machine.calibration_chain import Stage
from hydroopt.model.closed_chain import KinematicModel
from hydroopt.spatial.inertia import Array

CLOSED = 1e-11
"""Largest gap [m] of a closed chain."""
STEPS = 40
"""Steps of Newton's method after which a chain counts as open."""
STEP = 0.3
"""Largest change of an angle [rad] in one step of Newton's method."""


def close(model: KinematicModel, geometry: Array, q: Array, free: Sequence[int], fixture: Array) -> tuple[Array,
                                                                                                        NDArray[np.bool_]]:
    """Close chains by turning some joints, by as little as possible (Newton with the pseudo-inverse).

    Args:
        model: geometry.
        geometry: (p,) its parameters.
        q: (N, n) joint vectors to begin with [rad, m].
        free: positions of the joints that may turn.
        fixture: (3,) or (N, 3) where the tip shall be [m].

    Returns:
        (N, n) joint vectors and (N,) whether the chain closes.
    """
    q, turning = np.array(q, dtype=float), np.array(free, dtype=int)
    goal = np.broadcast_to(fixture, (len(q), 3))
    closed = np.zeros(len(q), dtype=bool)
    for _ in range(STEPS):
        left = np.flatnonzero(~closed)
        if not left.size:
            break
        gap, by_q = model.over(model.closure_jacobian, geometry, q[left], goal[left])
        closed[left] = np.max(np.abs(gap[:, :, 0]), axis=1) < CLOSED
        turn = -(np.linalg.pinv(by_q[:, :, turning], rcond=1e-6) @ gap)[:, :, 0]
        turn *= np.minimum(1, STEP / np.maximum(np.max(np.abs(turn), axis=1, keepdims=True), 1e-300))
        q[np.ix_(left, turning)] += np.where(closed[left, None], 0.0, turn)
    return q, closed


def limits(model: KinematicModel) -> tuple[Array, Array]:
    """Lower and upper limits (n,) [rad, m] of all joints."""
    ranges = np.array([link.joint.range for link in model.links if link.joint.type != "locked"])
    return ranges[:, 0], ranges[:, 1]


def sensed_joints(model: KinematicModel) -> list[int]:
    """Positions of the calibrator's joints that have a sensor."""
    own = {link.name for link in (model.machine.calibrator.links if model.machine.calibrator else ())}
    return [k for k, joint in enumerate(model.joints) if joint in own and model.machine.sensor(f"{joint}.q")]


def random_postures(model: KinematicModel, stage: Stage, count: int, *, geometry: Array, fixture: Array,
                    locked: dict[str, float] | None = None, seed: int = 0) -> Array:
    """Closed postures (count, n) of a stage, spread over the limits of moving and sensed joints.

    Args:
        model: geometry; `geometry` (p,) its values.
        stage: which joints move and where the others are locked.
        count: how many.
        fixture: (3,) [m].
        locked: angles [rad] other than the stage's.
        seed: of the random generator.

    Raises:
        ProblemError: hardly any posture closes within the limits.
    """
    rng = np.random.default_rng(seed)
    low, high = limits(model)
    free = sensed_joints(model)
    held = dict(stage.locked) | (locked or {})
    found: list[Array] = []
    tried = 0
    while sum(map(len, found)) < count:
        if tried >= 100 * count + 1000:
            raise ProblemError(f"only {sum(map(len, found))} of {tried} postures close within the joints' limits",
                               where=f"stage '{stage.name}'",
                               remedy="move the fixture, widen the calibrator's limits or lock the joints elsewhere")
        q = rng.uniform(low, high, (2 * count, len(low)))
        for name, angle in held.items():
            q[:, model.joints.index(name)] = angle
        q, closed = close(model, geometry, q, free, fixture)
        inside = np.all((q >= low) & (q <= high), axis=1, where=_mask(len(low), [
            *free, *(model.joints.index(name) for name in stage.moves)]))
        found.append(q[closed & inside])
        tried += len(q)
    postures: Array = np.concatenate(found)[:count]
    return postures


def _mask(size: int, where: Sequence[int]) -> NDArray[np.bool_]:
    mask = np.zeros(size, dtype=bool)
    mask[list(where)] = True
    return mask


def sweep(model: KinematicModel, stage: Stage, path: Array, *, geometry: Array, fixture: Array,
          locked: dict[str, float] | None = None) -> Array:
    """Closed postures (N, n) along a path (N, number of moving joints) [rad], the calibrator following by itself.

    Raises:
        ProblemError: the chain opens on the way.
    """
    low, high = limits(model)
    moving, free = [model.joints.index(name) for name in stage.moves], sensed_joints(model)
    q = np.clip(np.zeros(len(low)), low, high)
    for name, angle in (dict(stage.locked) | (locked or {})).items():
        q[model.joints.index(name)] = angle
    q[free] = (low + high)[free] / 2
    postures = []
    for k, target in enumerate(np.atleast_2d(path)):
        q = q.copy()
        q[moving] = target
        closed, good = close(model, geometry, q[None], free, fixture)
        if not good[0]:
            raise ProblemError(f"the chain opens at step {k + 1} of the sweep", where=f"stage '{stage.name}'",
                               remedy="shorten the sweep or move the fixture")
        q = closed[0]
        postures.append(q)
    return np.array(postures)


def record(model: KinematicModel, q: Array, stage: Sequence[str], fixture: Sequence[str], *, geometry: Array,
           channels: Sequence[str] | None = None, seed: int | None = 0, name: str = "simulated") -> Poses:
    """The pose table that the machine's sensors would write at joint vectors.

    Args:
        model: geometry; `geometry` (p,) its values.
        q: (N, n) [rad, m].
        stage: N labels.
        fixture: N labels.
        channels: what is read; by default the joints of the calibrator that have a sensor, or all that have one where
            there is no other.
        seed: of the sensors' noise; None for readings without any.
        name: of the table.
    """
    if channels is None:
        free = sensed_joints(model) or [k for k, j in enumerate(model.joints) if model.machine.sensor(f"{j}.q")]
        channels = [f"{model.joints[k]}.q" for k in free]
    known = {each.name: each.position for each in model.machine.fixtures}
    rows = model.over(model.observed, geometry, q, np.array([known.get(label, np.zeros(3)) for label in fixture]))[0]
    true = {f"{joint}.q": q[:, k] for k, joint in enumerate(model.joints)}
    true |= {channel: rows[:, i, 0] for i, channel in enumerate(model.channels)}
    rng = np.random.default_rng(seed)
    read = {}
    for channel in channels:
        sensor = model.machine.sensor(channel)
        read[channel] = true[channel] if seed is None or sensor is None else measure(
            true[channel], sensor.accuracy, sensor.resolution, rng, sensor.distribution)
    units = {channel: unit for channel, unit in model.machine.channel_units.items() if channel in read}
    return Poses(name=name, stage=np.array(stage), fixture=np.array(fixture), channels=read, units=units)
