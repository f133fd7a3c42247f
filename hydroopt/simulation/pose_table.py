"""The pose table that a machine's sensors and instruments would record at planned postures, with what is true."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hydroopt.errors import ProblemError
from hydroopt.logs.poses import Poses
from hydroopt.model.closed_chain import KinematicModel
from hydroopt.simulation import postures
from hydroopt.spatial.inertia import Array

FARTHEST, NEAREST, HEIGHT = 2.0, 1.2, 1.5
"""How far instruments of unknown pose stand away, in reaches of the machine, and how high [m]."""
LEVEL = 0.01
"""Standard deviation [rad] of their tilt."""
AXES = ("x", "y", "z", "rx", "ry", "rz")


class SimulatedPoses(NamedTuple):
    """Poses as read, and the true values of parameters [SI] by the names that a calibration gives them."""

    poses: Poses
    truth: dict[str, float]


def simulate_poses(model: KinematicModel, planned: Poses, *, random: bool = False, noise: bool = True, seed: int = 0,
                   truth_seed: int | None = None) -> SimulatedPoses:
    """Simulate what is read at planned postures.

    The true machine closes its loops, and touches datums, by turning the joints that are read: it stands a little
    beside the plan. Instruments whose pose is not known stand around the machine, in every set-up elsewhere.

    Args:
        model: geometry.
        planned: positions of all joints, with stages, fixtures and set-ups; datums whose channels are stated are
            touched.
        random: whether geometry and biases are drawn with the file's confidences, or nominal.
        noise: whether sensors err.
        seed: of noise and set-ups; `truth_seed` of the truth, by default the same.

    Raises:
        ProblemError: a joint has no position, or a posture does not close.

    >>> import hydroopt
    >>> machine = hydroopt.load_machine("panda_mukca")
    >>> plan = hydroopt.solve(hydroopt.pose_problem(machine, 10), candidates=50)
    >>> simulate_poses(hydroopt.KinematicModel(machine), plan.postures, random=True).poses
    Poses('simulated': 20 poses, 7 channels)
    """
    q = _angles(model, planned)
    rng, drawn = np.random.default_rng(seed), np.random.default_rng(seed if truth_seed is None else truth_seed)
    parameters = model.parameters
    offset = drawn.standard_normal(len(parameters)) * parameters.scale if random else np.zeros(len(parameters))
    geometry = np.clip(parameters.nominal + offset, parameters.lower, parameters.upper)
    touch = touches(model, planned)
    q = _standing(model, geometry, q, planned, touch)
    machine, reach = model.machine, sum(abs(link.joint.a) + abs(link.joint.d) for link in model.links) + 1.0
    setups = list(dict.fromkeys(map(str, planned.setup)))
    standing = {(name, setup): _around(rng, reach) for name in model.instruments for setup in setups}
    biases = {imu.name: drawn.normal(0.0, imu.accelerometer.bias, 3) * random
              for imu in machine.imus if imu.accelerometer}
    poses = postures.record(
        model, q, planned.stage.tolist(), planned.fixture.tolist(), geometry=geometry, tape=planned.tape.tolist(),
        setup=planned.setup.tolist(), standing=standing, biases=biases, touch=touch.tolist(),
        channels=postures.measured_channels(model), seed=seed if noise else None)
    truth = dict(zip(parameters.names, geometry.tolist(), strict=True))
    for (name, setup), stands in standing.items():
        owner = ".".join(filter(None, (name, setup)))
        truth |= {f"{owner}.{axis}": float(value) for axis, value in zip(AXES, stands, strict=True)}
    truth |= {f"{name}.bias_{axis}": float(value) for name, bias in biases.items()
              for axis, value in zip("xyz", bias, strict=True)}
    return SimulatedPoses(poses, truth)


def _angles(model: KinematicModel, planned: Poses) -> Array:
    """Positions (N, n) of all joints [rad, m]."""
    columns = []
    for joint in model.joints:
        values = planned.channels.get(f"{joint}.q", np.full(len(planned), np.nan))
        if np.any(lost := ~np.isfinite(values)):
            row = int(np.argmax(lost))
            raise ProblemError(f"'{joint}.q' is not stated", remedy="take postures.csv of plan-poses, or state the "
                               "positions of all joints", where=f"{planned.file[row] or planned.name}, data row "
                               f"{planned.row[row]}")
        columns.append(values)
    return np.stack(columns, axis=1)


def touches(model: KinematicModel, poses: Poses) -> NDArray[np.str_]:
    """(N,) datum and target that meet in the poses of a table, ``floor.tooth``; '' where none do."""
    touch = np.full(len(poses), "", dtype=object)
    for each in model.measurements:
        if each.tool == "datum" and each.channels[0] in poses.channels:
            touch[np.isfinite(poses.channels[each.channels[0]])] = each.name
    return touch.astype(np.str_)


def _standing(model: KinematicModel, geometry: Array, q: Array, planned: Poses, touch: NDArray[np.str_]) -> Array:
    """The planned joint vectors (N, n) as the true machine stands, its loops closed and its datums touched."""
    still = {model.joints.index(joint) for joint in model.machine.base_joints}
    free = [k for k in postures.sensed_joints(model) or range(q.shape[1]) if k not in still]
    for fixture in model.machine.fixtures:
        there = planned.fixture == fixture.name
        q[there] = _met(planned, there, *postures.close(model, geometry, q[there], free, fixture))
    drive = [k for k in range(q.shape[1]) if k not in still]
    for each in [one for one in model.measurements if one.name in touch]:
        there = touch == each.name
        q[there] = _met(planned, there, *postures.close(model, geometry, q[there], drive, each))
    return q


def _met(planned: Poses, rows: NDArray[np.bool_], q: Array, good: NDArray[np.bool_]) -> Array:
    if not np.all(good):
        row = int(np.flatnonzero(rows)[np.argmin(good)])
        raise ProblemError("the true machine does not reach this posture", remedy="plan it elsewhere, or take another "
                           "seed of the truth",
                           where=f"{planned.file[row] or planned.name}, data row {planned.row[row]}")
    return q


def _around(rng: np.random.Generator, reach: float) -> Array:
    """Where an instrument stands (6,): somewhere around the machine, level but for a small tilt."""
    angle, away = rng.uniform(-np.pi, np.pi), reach * rng.uniform(NEAREST, FARTHEST)
    return np.array([away * np.cos(angle), away * np.sin(angle), HEIGHT, *rng.normal(0.0, LEVEL, 2),
                     rng.uniform(-3.0, 3.0)])
