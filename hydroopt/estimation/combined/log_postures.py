"""The samples of a log as postures of the closed chain: what was read of the geometry while forces were read."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hydroopt.errors import ProblemError
from hydroopt.estimation.dynamic.experiment import Experiment
from hydroopt.estimation.kinematic.problem import CalibrationProblem, calibration_problem
from hydroopt.logs.log import Log
from hydroopt.logs.poses import Poses, joined
from hydroopt.machine.calibration_chain import Stage
from hydroopt.machine.machine import Machine
from hydroopt.model.closed_chain import KinematicModel
from hydroopt.spatial.inertia import Array

STAGE = "log"
"""Stage that the samples of all logs belong to."""


def postures(machine: Machine, experiments: Sequence[Experiment]) -> CalibrationProblem:
    """The kinematic calibration from every sample of some logs: angles, lengths, places of the tip, and the loop that a
    calibrator closes whose angles were read.

    A joint of the calibrator without readings is at rest if a stage of the machine file locks it and none moves it: its
    angle is unknown, and drifts as the stage says. Otherwise it moves.

    Raises:
        ProblemError: a log reads nothing of the geometry.
    """
    chain = KinematicModel(machine)
    every = [_of_log(chain, data.log) for data in experiments]
    return calibration_problem(_with_stage(machine, chain, every), joined(every))


def _of_log(chain: KinematicModel, log: Log) -> Poses:
    """The readings of a log that poses may have; where the calibrator's joints were read, its tip is in the fixture
    nearest to where they place it."""
    machine = chain.machine
    accurate = {name for name in log.channels if (sensor := machine.sensor(name)) is not None and sensor.std > 0}
    angles = {f"{joint}.q" for joint in chain.joints}
    units = {f"{imu.name}.{axis}" for imu in machine.imus for axis in ("accel_x", "accel_y", "accel_z")}
    rows = set(chain.channels) - units  # at rest they tell inclinations, in motion they do not
    read = {name: values for name, values in log.channels.items()
            if name in angles or (name in rows and name in accurate)}
    own = {f"{joint}.q" for joint in chain.joints[len(machine.joints):]}
    where = log.path or log.name
    if not (own | rows) & read.keys():
        raise ProblemError("the log reads nothing of the geometry but the joints' angles", where=where,
                           remedy="record the calibrator's angles or lengths of cylinders, and state their accuracy")
    fixture = ""
    if own & read.keys():
        if not machine.fixtures:
            raise ProblemError("the calibrator was attached, but the machine file states no fixture that holds its tip",
                               where=where, remedy=f"state it, or leave out {', '.join(sorted(own & read.keys()))}")
        fixture = _nearest(chain, read)
    count = log.size
    return Poses(log.name, np.full(count, STAGE), np.full(count, fixture), t=log.t, channels=read,
                 units={name: log.units[name] for name in read}, file=np.full(count, where), sha256={where: log.sha256})


def _nearest(chain: KinematicModel, read: dict[str, Array]) -> str:
    """The fixture nearest to the tip (median over the samples); joints that were not read stand in their middle."""
    middle = [np.mean(link.joint.range) for link in chain.links if link.name in chain.joints]
    q = np.column_stack([np.broadcast_to(read.get(f"{joint}.q", at), len(next(iter(read.values()))))
                         for joint, at in zip(chain.joints, middle, strict=True)])
    tip = np.nanmedian(chain.over(chain.tip, chain.parameters.nominal, q)[0][:, :, 0], axis=0)
    return min(chain.machine.fixtures, key=lambda fixture: float(np.linalg.norm(tip - fixture.position))).name


def _with_stage(machine: Machine, chain: KinematicModel, every: Sequence[Poses]) -> Machine:
    """The machine with a stage that says what the calibrator's joints without readings did, if it was attached."""
    if not any(np.any(poses.fixture != "") for poses in every):
        return machine.model_copy(update={"stages": (*machine.stages, Stage(name=STAGE))})
    unread = [joint for joint in chain.joints if not any(f"{joint}.q" in poses.channels for poses in every)]
    moved = {joint for stage in machine.stages for joint in stage.moves}
    locked = {joint: angle for stage in machine.stages for joint, angle in stage.locked.items()
              if joint in unread and joint not in moved}
    moves = tuple(joint for joint in unread if joint not in locked and joint not in machine.joints)
    drift = max((stage.drift for stage in machine.stages if stage.locked.keys() & locked.keys()), default=0.0)
    stage = Stage(name=STAGE, moves=moves, locked=locked, drift=drift)
    return machine.model_copy(update={"stages": (*machine.stages, stage)})
