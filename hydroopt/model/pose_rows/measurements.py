"""All measurements of a machine's poses beside its joints, loops, cylinders, tapes and the tracked tip."""

from __future__ import annotations

from hydroopt.machine.machine import Machine
from hydroopt.model.pose_rows import datum_offset, dependent_position, distance, inclination, orientation, position
from hydroopt.model.pose_rows.frames import Frames, PoseRows


def inputs(machine: Machine) -> dict[str, int]:
    """What the rows need of each pose, with its size: where an instrument stands of which the file does not say it,
    (6,) position and rotation vector; readings that rows take; and biases."""
    moving = {f"{instrument.name}.pose": 6 for instrument in machine.instruments if not instrument.stands}
    turns = {f"{name}.turn": 3 for name, _, _ in orientation.measured(machine)}
    return moving | turns | inclination.inputs(machine) | dependent_position.inputs(machine)


def measurements(frames: Frames) -> tuple[PoseRows, ...]:
    """The rows of all measurements that a sensor is stated for."""
    kinds = (position, orientation, datum_offset, distance, inclination, dependent_position)
    return tuple(rows for kind in kinds for rows in kind.rows(frames))
