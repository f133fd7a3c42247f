"""Logs that were recorded with the calibrator attached to the machine: in which fixture, and how it moved along."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np

from hydroopt.errors import ProblemError
from hydroopt.logs.calibrator_angles import calibrator_channels
from hydroopt.logs.log import Log
from hydroopt.logs.smoothing import Motion, Smoothing, condition
from hydroopt.machine.calibration_chain import Fixture
from hydroopt.model.attached_calibrator import AttachedCalibrator
from hydroopt.model.closed_chain import KinematicModel
from hydroopt.model.model import Model
from hydroopt.simulation.calibrator_motion import CalibratorMotion, follow
from hydroopt.spatial.inertia import Array


def attached_calibrator(model: Model, log: Log, motion: Motion, smoothing: Smoothing) -> CalibratorMotion | None:
    """The calibrator's motion in a log; None where it was not attached or its bodies are no parameters of the model.

    A log with the angle of at least one of the calibrator's joints was recorded with the calibrator attached. The tip
    stands in the fixture nearest to where these angles place it. Rates of joints that the machine's motion does not
    determine come from their angles, smoothed like the machine's.

    Raises:
        ProblemError: there is no fixture, or the calibrator cannot have moved as the log says.
    """
    machine = model.machine
    channels = calibrator_channels(machine, log) if model.calibrator else set()
    if not channels:
        return None
    where = log.path or log.name
    kinematics, n = KinematicModel(machine), len(machine.joints)
    joints = kinematics.joints[n:]
    sensed = np.array([f"{joint}.q" in channels for joint in joints])
    names = [joint for joint, there in zip(joints, sensed, strict=True) if there]
    noise = np.array([sensor.std if (sensor := machine.sensor(f"{joint}.q")) else np.nan for joint in names])
    smooth = condition(log.t, np.column_stack([log.channel(f"{joint}.q") for joint in names]), log.segment, smoothing,
                       noise, names=names, where=where)
    read = np.zeros((3, log.size, len(joints)))
    read[0] = kinematics.ranges.mean(axis=1)[n:]
    read[:, :, sensed] = smooth.q, smooth.qd, smooth.qdd
    known = dict(zip((*machine.joints, *names), (*motion.q.T, *smooth.q.T), strict=True))
    attached = AttachedCalibrator(model, fixture_of(kinematics, known, where))
    try:
        return follow(attached, motion.q, motion.qd, motion.qdd, (read[0], read[1], read[2]), sensed)
    except ProblemError as error:
        raise ProblemError(error.what, where=where, remedy=error.remedy) from None


def fixture_of(kinematics: KinematicModel, known: Mapping[str, Array], where: str) -> Fixture:
    """The fixture nearest to the tip (median over N samples) by `known` positions (N,) of joints; all others stand in
    the middle of their ranges.

    Raises:
        ProblemError: there is no fixture.
    """
    if not kinematics.machine.fixtures:
        own = [f"{joint}.q" for joint in kinematics.joints[len(kinematics.machine.joints):] if joint in known]
        raise ProblemError("the calibrator was attached, but the machine file states no fixture that holds its tip",
                           where=where, remedy=f"state the fixture, or leave out {', '.join(sorted(own))}")
    q = np.tile(kinematics.ranges.mean(axis=1), (len(next(iter(known.values()))), 1))
    for joint, values in known.items():
        q[:, kinematics.joints.index(joint)] = values
    tip = np.nanmedian(kinematics.over(kinematics.tip, kinematics.parameters.nominal, q)[0][:, :, 0], axis=0)
    return min(kinematics.machine.fixtures, key=lambda fixture: float(np.linalg.norm(tip - fixture.position)))


def calibrator_remark(found: CalibratorMotion | None) -> Iterator[str]:
    """What a reader should know of an attached calibrator."""
    if found is not None:
        yield (f"the calibrator was attached, its tip in '{found.attached.fixture.name}': its bodies are part of the "
               "forces")
