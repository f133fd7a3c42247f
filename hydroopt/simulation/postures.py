"""Postures in which a chain is closed: random ones, those along a sweep, and the pose tables of their readings."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from hydroopt.errors import ProblemError
from hydroopt.logs.poses import Poses
from hydroopt.machine.calibration_chain import CLOSES, Fixture, Stage
from hydroopt.model.closed_chain import Held, KinematicModel
from hydroopt.model.least_squares_by_sample import nearest
from hydroopt.model.pose_rows import PoseRows
from hydroopt.spatial.inertia import Array

CLOSED = 1e-11
"""Largest gap [m] of a closed chain."""
STEPS = 40
"""Steps of Newton's method after which a chain counts as open."""
STEP = 0.3
"""Largest change of an angle [rad] in one step of Newton's method."""
REACHED, RESERVE = 3.0, 0.1
"""How far from the ends of a stroke planned postures stay, so that the machine reaches them: so many standard
deviations that the stated geometry leaves to the stroke there, and at most this part of the stroke."""


def close(model: KinematicModel, geometry: Array, q: Array, free: Sequence[int], held: Held,
          weight: Array | float = 1.0) -> tuple[Array, NDArray[np.bool_]]:
    """Close chains, or bring a datum and a target together, by turning some joints, by as little as possible.

    Args:
        model: geometry.
        geometry: (p,) its parameters.
        q: (N, n) initial joint vectors [rad, m].
        free: positions of the joints that may turn.
        held: what holds the tip, or what touches.
        weight: (number of free joints,) how easily each of them turns; all alike by default.

    Returns:
        (N, n) joint vectors and (N,) whether the chain closes.
    """
    if isinstance(held, PoseRows):
        function, rows = model.observed_by_angles, [model.channels.index(channel) for channel in held.channels]
    else:
        function, rows = model.loop_by_angles, list(held.closes if isinstance(held, Fixture) else CLOSES["ball"])
    found, turning, place = np.array(q, dtype=float), np.array(free, dtype=int), model.place_of(held, len(q))

    def gaps(own: Array, which: NDArray[np.intp]) -> tuple[Array, Array]:
        tried = found[which]
        tried[:, turning] = own
        gap, by_q = model.over(function, geometry, tried, place[which])
        return gap[:, rows, 0], by_q[:, rows][:, :, turning]

    found[:, turning], size, _ = nearest(gaps, found[:, turning], steps=STEPS, longest=STEP, close=CLOSED, ease=weight,
                                         damped=False)
    return found, size <= CLOSED


def sensed_joints(model: KinematicModel) -> list[int]:
    """Positions of the calibrator's joints that have a sensor."""
    own = {link.name for link in (model.machine.calibrator.links if model.machine.calibrator else ())}
    return [k for k, joint in enumerate(model.joints) if joint in own and model.machine.sensor(f"{joint}.q")]


def read_joints(model: KinematicModel, stage: Stage | None = None) -> list[int]:
    """Positions of the joints that are read, by the machine file.

    Those of the calibrator that have a sensor, and of the machine those that the stage does not name, without one those
    that no stage names; all with a sensor where the calibrator has none or the machine has no stages.
    """
    sensed = [k for k, joint in enumerate(model.joints) if model.machine.sensor(f"{joint}.q")]
    own = sensed_joints(model)
    if not own or not model.machine.stages:
        return sensed
    named = {joint for each in (model.machine.stages if stage is None else (stage,))
             for joint in (*each.moves, *each.locked)}
    return [k for k in sensed if k in own or model.joints[k] not in named]


def measured_channels(model: KinematicModel) -> tuple[str, ...]:
    """Channels that are read in each pose: joints, cylinders' lengths, the tip where a tracker sees it, and all other
    measurements that a sensor is stated for.

    Raises:
        ProblemError: nothing is read.
    """
    tips = [f"tip.{axis}" for axis in "xyz"] if model.machine.tracker else []
    joints = [f"{model.joints[k]}.q" for k in read_joints(model)]
    # with a calibrator, a length determines the joints that it depends on, if the poses know them otherwise
    known = {*(link.name for link in model.machine.chain), *(joint.removesuffix(".q") for joint in joints)}
    lengths = [f"{cylinder.name}.length" for cylinder in model.machine.cylinders
               if model.machine.calibrator is None or known.issuperset(model.machine.moved_by(cylinder))]
    more = [channel for each in model.measurements for channel in each.channels]
    channels = (*joints, *(channel for channel in (*lengths, *tips, *more) if model.machine.sensor(channel)))
    if not channels:
        raise ProblemError("no sensor reads a joint, a cylinder's length, the tip or a target",
                           where=f"machine '{model.machine.name}'",
                           remedy="state sensors with their accuracy in the machine file")
    return channels


def closed_postures(model: KinematicModel, count: int, rng: np.random.Generator, *, geometry: Array,
                    turning: Sequence[int], within_limits: Sequence[int], locked: Mapping[str, float],
                    held: Held | None, batch: int, give_up: Callable[[int, int], bool],
                    within_strokes: Array | None = None, sieve: Callable[[Array, Array], Array] | None = None
                    ) -> tuple[Array, int]:
    """Random closed postures (K, n) [rad, m], K ≤ count, uniform over the joints' limits before they are closed.

    Args:
        model: geometry; `geometry` (p,) its values.
        count: how many at most.
        rng: random generator.
        turning: positions of the joints that close the chain.
        within_limits: positions of the joints that must be within their limits when it is closed.
        locked: angles [rad] of joints at rest.
        held: what holds the tip, or what touches; None for an open chain.
        batch: postures tried at once.
        give_up: whether to stop, by the number of postures found and tried.
        within_strokes: (p,) standard deviations of the geometry, if the cylinders must be within their strokes also
            where it is `REACHED` of them off, but never more than `RESERVE` of a stroke away from its ends.
        sieve: leaves of closed postures (N, n) at the geometry (p,) those that are wanted (K, n).

    Returns:
        The postures and how many were tried.
    """
    low, high = model.ranges.T
    stroke = np.array([cylinder.stroke for cylinder in model.machine.cylinders])
    found, tried = np.zeros((0, len(low))), 0
    while len(found) < count and not (tried and give_up(len(found), tried)):
        q = rng.uniform(low, high, (batch, len(low)))
        for joint, angle in locked.items():
            q[:, model.joints.index(joint)] = angle
        usable = np.ones(batch, dtype=bool)
        if held is not None:
            q, usable = close(model, geometry, q, turning, held)
        usable &= np.all(((q >= low) & (q <= high))[:, list(within_limits)], axis=1)
        if within_strokes is not None:
            out, _, by_geometry = model.over(model.strokes_by_geometry, geometry, q)
            spread = np.sqrt(np.sum((by_geometry * within_strokes) ** 2, axis=2))
            reserve = np.minimum(REACHED * spread, RESERVE * stroke)
            usable &= np.all((out[:, :, 0] >= reserve) & (out[:, :, 0] <= stroke - reserve), axis=1)
        q = q[usable]
        found, tried = np.concatenate([found, q if sieve is None else sieve(q, geometry)]), tried + batch
    return found[:count], tried


def record(model: KinematicModel, q: Array, stage: Sequence[str], fixture: Sequence[str], *, geometry: Array,
           tape: Sequence[str] = (), setup: Sequence[str] = (), standing: Mapping[tuple[str, str], Array] | None = None,
           biases: Mapping[str, Array] | None = None, touch: Sequence[str] = (),
           channels: Sequence[str] | None = None, seed: int | None = 0, name: str = "simulated") -> Poses:
    """The pose table that the machine's sensors would record at joint vectors.

    Args:
        model: geometry; `geometry` (p,) its values.
        q: (N, n) [rad, m].
        stage: N labels.
        fixture: N labels.
        tape: N labels of the fixtures at which tapes end; by default those of `fixture`.
        setup: N labels of the set-ups of instruments whose pose is not known.
        standing: where these stand (6,) by instrument and set-up: position [m] and rotation vector [rad] in the frame
            of their link; by default in that frame itself.
        biases: of accelerometers (3,) [m/s²] by unit; zero by default.
        touch: N names of datum and target that meet, ``floor.tooth``; others are not read. By default all are.
        channels: what is read; by default the joints of `read_joints`.
        seed: of the sensors' noise; None for readings without any.
        name: of the table.
    """
    if channels is None:
        channels = [f"{model.joints[k]}.q" for k in read_joints(model)]
    place = np.zeros((len(q), model.place_size))
    known = {each.name: each for each in model.machine.fixtures}
    for label in set(fixture) & known.keys():
        there = np.array(fixture) == label
        place[there] = model.place_of(known[label], int(there.sum()))
    for label in set(tape) & known.keys() if model.taped else ():
        place[np.array(tape) == label, model.tape_end] = known[label].position
    for (instrument, label), stands in (standing or {}).items():
        there = np.array(setup) == label if len(setup) else np.full(len(q), not label)
        place[there, model.inputs[f"{instrument}.pose"]] = stands
    for imu, bias in (biases or {}).items():
        place[:, model.inputs[f"{imu}.bias"]] = bias
    rows = model.over(model.observed, geometry, q, place)[0]
    true = {f"{joint}.q": q[:, k] for k, joint in enumerate(model.joints)}
    true |= {channel: rows[:, i, 0] for i, channel in enumerate(model.channels)}
    rng = None if seed is None else np.random.default_rng(seed)
    read = {}
    for channel in channels:
        sensor = model.machine.sensor(channel)
        read[channel] = true[channel] if sensor is None else sensor.read(true[channel], rng)
    for each in model.measurements if len(touch) else ():
        for channel in each.channels if each.tool == "datum" else ():
            if channel in read:
                read[channel] = np.where(np.array(touch) == each.name, read[channel], np.nan)
    units = {channel: unit for channel, unit in model.machine.channel_units.items() if channel in read}
    return Poses(name=name, stage=np.array(stage), fixture=np.array(fixture), tape=np.array(tape),
                 setup=np.array(setup), channels=read, units=units)
