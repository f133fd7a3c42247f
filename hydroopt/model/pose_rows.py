"""What instruments, tapes, datums and sensors read at a pose, as rows of a kinematic calibration.

Each kind of measurement has one function that gives its rows where a sensor is stated for it, and its inputs of a pose,
if it has any, in `inputs`. Where targets and instruments are, `Frames` gives.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Literal, NamedTuple

import casadi as ca

from hydroopt.machine.geometry import Geometry
from hydroopt.machine.machine import BASE, Machine
from hydroopt.machine.sensors import ACCELEROMETER, INCLINATION, Imu
from hydroopt.machine.survey import TIP
from hydroopt.spatial.poses import Pose, identity, roll_pitch_yaw
from hydroopt.spatial.rotation_vectors import rotation_of, vector_of

TRACKER = "tracker"
"""The instrument that reads the channels of the tip without a name of its own before them."""
TINY = 1e-9
"""Length [m] that keeps a distance differentiable at zero."""


Tool = Literal["instrument", "datum", "tape", "imu", "transducer"]
"""What a measurement is taken with; a transducer is mounted, and reads by itself."""


class PoseRows(NamedTuple):
    """Predicted readings of one measurement.

    Attributes:
        name: what residuals and fits call it, ``station.prism``.
        tool: what it is taken with.
        channels: of its readings, all in the SI unit `unit`.
        rows: (number of channels,) predictions, less the readings where the rows take these as an input.
        reading: name of that input, '' where the reading is subtracted.
    """

    name: str
    tool: Tool
    channels: tuple[str, ...]
    unit: str
    rows: ca.SX
    reading: str = ""

    @property
    def owner(self) -> str:
        """The part that it is taken with."""
        return self.name.partition(".")[0]


class Frames(NamedTuple):
    """Frames at a pose, in the frame of what rests.

    Attributes:
        geometry: of the machine.
        links: P_i of all links, and `base`.
        joints: positions [rad or m] of all moving joints, dependent ones too.
        inputs: of a pose, by name: where instruments stand whose pose is not known, and readings that rows take.
    """

    geometry: Geometry
    links: Mapping[str, Pose]
    joints: Mapping[str, ca.SX]
    inputs: Mapping[str, ca.SX]

    def link(self, name: str | None) -> Pose:
        """The frame in which points of a link are stated; without a name that of the ground."""
        return self.links[name or BASE]

    def target(self, name: str) -> Pose:
        """The frame of a target."""
        machine = self.geometry.machine
        if name == TIP and machine.calibrator:
            last = machine.chain[-1].name
            return self.links[last] @ self.geometry.far_end(last) @ Pose(identity().rotation,
                                                                         self.geometry.point(TIP))
        own = next(target for target in machine.targets if target.name == name)
        return self.link(own.link) @ self._stated(name)

    def instrument(self, name: str) -> Pose:
        """The frame of an instrument: as stated, or six inputs of the pose, position and rotation vector."""
        own = next(each for each in self.geometry.machine.instruments if each.name == name)
        if own.stands:
            return self.link(own.link) @ self._stated(name)
        stands = self.inputs[f"{name}.pose"]
        return self.link(own.link) @ Pose(rotation_of(stands[3:]), stands[:3])

    def datum(self, name: str) -> Pose:
        """The frame of a datum."""
        own = next(datum for datum in self.geometry.machine.datums if datum.name == name)
        value = self.geometry.value
        shift = ca.vertcat(*(value.get(f"{name}.{axis}", own.offset[k]) for k, axis in enumerate("xyz")))
        roll, pitch, yaw = (value.get(f"{name}.{turn}", own.tilt[k])
                            for k, turn in enumerate(("roll", "pitch", "yaw")))
        stated = Pose(roll_pitch_yaw(own.orientation), ca.DM(own.position))
        return stated @ Pose(roll_pitch_yaw((roll, pitch, yaw)), shift)

    def _stated(self, name: str) -> Pose:
        return Pose(roll_pitch_yaw(self.geometry.turn(name)), self.geometry.point(name))


def inputs(machine: Machine) -> dict[str, int]:
    """What the rows need of each pose, with its size: where an instrument stands of which the file does not say it,
    (6,) position and rotation vector; readings that rows take; and biases of accelerometers."""
    moving = {f"{instrument.name}.pose": 6 for instrument in machine.instruments if not instrument.stands}
    turns = {f"{name}.turn": 3 for name, _, _ in _turned(machine)}
    inclined = {f"{imu.name}.inclination": len(_inclined(machine, imu)) for imu in machine.imus
                if _inclined(machine, imu)}
    biases = {f"{imu.name}.bias": 3 for imu in machine.imus if imu.accelerometer}
    return moving | turns | inclined | biases | dict.fromkeys(_following(machine), 1)


def measurements(frames: Frames) -> tuple[PoseRows, ...]:
    """The rows of all measurements that a sensor is stated for, beside joints, loops, cylinders and the tracked tip."""
    kinds = (_positions, _orientations, _datum_offsets, _distances, _inclinations, _dependent_positions,
             _beams)
    return tuple(rows for kind in kinds for rows in kind(frames))


def _sensed(machine: Machine, *channels: str) -> bool:
    return any(machine.sensor(channel) for channel in channels)


def _pairs(machine: Machine) -> list[tuple[str, str]]:
    return [(instrument.name, target) for instrument in machine.instruments for target in machine.target_names]


def _positions(frames: Frames) -> Iterator[PoseRows]:
    """Rᵀ·(p − o): a target at p as an instrument sees it that stands at o, turned by R."""
    for instrument, target in _pairs(frames.geometry.machine):
        channels = tuple(f"{instrument}.{target}.{axis}" for axis in "xyz")
        if _sensed(frames.geometry.machine, *channels):
            seen = frames.instrument(instrument).inverse() @ frames.target(target)
            yield PoseRows(f"{instrument}.{target}", "instrument", channels, "m", ca.SX(seen.origin))


def _rotation_vector(name: str) -> tuple[str, ...]:
    """Channels of an orientation as a rotation vector [rad]."""
    return tuple(f"{name}.{axis}" for axis in ("rx", "ry", "rz"))


def _turned(machine: Machine) -> Iterator[tuple[str, str, str]]:
    """What channels begin with, instrument and target of the orientations that a sensor is stated for."""
    pairs = [(f"{instrument}.{target}", instrument, target) for instrument, target in _pairs(machine)]
    for name, instrument, target in [*pairs, *([(TIP, TRACKER, TIP)] if machine.tracker else [])]:
        if _sensed(machine, *_rotation_vector(name)):
            yield name, instrument, target


def _orientations(frames: Frames) -> Iterator[PoseRows]:
    """log(Mᵀ·Rᵀ·T): the turn, about the target's own axes, from a reading M to a target turned by T as an instrument
    sees it that is turned by R. With M = 1 it is what the instrument reads."""
    geometry = frames.geometry
    for name, instrument, target in _turned(geometry.machine):
        turn = (roll_pitch_yaw(geometry.turn(TRACKER)) if instrument == TRACKER and name == TIP
                else frames.instrument(instrument).rotation)
        reading = rotation_of(frames.inputs[f"{name}.turn"])
        yield PoseRows(f"{name}.turn", "instrument", _rotation_vector(name), "rad",
                       ca.SX(vector_of(reading.T @ turn.T @ frames.target(target).rotation)), f"{name}.turn")


def _datum_offsets(frames: Frames) -> Iterator[PoseRows]:
    """Coordinates of a target in a datum's frame, across the datum: zero where it touches."""
    machine = frames.geometry.machine
    for datum in machine.datums:
        for target in machine.target_names:
            channels = tuple(f"{datum.name}.{target}.{axis}" for axis in datum.axes)
            if _sensed(machine, *channels):
                seen = (frames.datum(datum.name).inverse() @ frames.target(target)).origin
                yield PoseRows(f"{datum.name}.{target}", "datum", channels, "m",
                               ca.SX(ca.vertcat(*(seen["xyz".index(axis)] for axis in datum.axes))))


def _distances(frames: Frames) -> Iterator[PoseRows]:
    """|p − q| of the targets at p and q."""
    machine = frames.geometry.machine
    for distance in machine.distances:
        channel = f"{distance.name}.length"
        if distance.measured and _sensed(machine, channel):
            one, other = (frames.target(name).origin for name in distance.between)
            yield PoseRows(channel, "tape", (channel,), "m", ca.SX(ca.sqrt(ca.sumsqr(one - other) + TINY**2)))


def _inclined(machine: Machine, imu: Imu) -> tuple[str, ...]:
    """Channels of a unit's roll and pitch [rad] that a sensor is stated for."""
    return tuple(name for angle in INCLINATION if _sensed(machine, name := f"{imu.name}.{angle}"))


def _inclinations(frames: Frames) -> Iterator[PoseRows]:
    """Roll and pitch of a unit's axes less those that it reads, within half a turn; and g·Rᵀ·up + bias, what it feels
    at rest."""
    machine = frames.geometry.machine
    up = roll_pitch_yaw(machine.orientation).T @ ca.DM([0.0, 0.0, 1.0])
    for imu in machine.imus:
        turn = frames.link(imu.link).rotation @ roll_pitch_yaw(frames.geometry.turn(imu.name))
        x, y, z = ca.vertsplit(ca.SX(turn.T @ up))
        if channels := _inclined(machine, imu):
            both = {"roll": ca.atan2(y, z), "pitch": ca.atan2(-x, ca.sqrt(y**2 + z**2))}
            name = f"{imu.name}.inclination"
            off = ca.vertcat(*(both[each.rpartition(".")[2]] for each in channels)) - frames.inputs[name]
            yield PoseRows(name, "imu", channels, "rad", ca.atan2(ca.sin(off), ca.cos(off)), name)
        if imu.accelerometer:
            yield PoseRows(f"{imu.name}.accel", "imu", tuple(f"{imu.name}.{axis}" for axis in ACCELEROMETER),
                           "m/s^2", machine.gravity * ca.vertcat(x, y, z) + frames.inputs[f"{imu.name}.bias"])


def _following(machine: Machine) -> tuple[str, ...]:
    """Channels of the dependent joints that a sensor is stated for, such as that of a linkage's rocker."""
    return tuple(f"{joint}.q" for joint in machine.dependent_joints if _sensed(machine, f"{joint}.q"))


def _dependent_positions(frames: Frames) -> Iterator[PoseRows]:
    """Position of a dependent joint less its reading [rad or m]; of one that turns within half a turn."""
    machine = frames.geometry.machine
    for channel in _following(machine):
        joint, unit = channel.removesuffix(".q"), machine.channel_units[channel]
        off = ca.SX(frames.joints[joint] - frames.inputs[channel])
        yield PoseRows(channel, "transducer", (channel,), unit,
                       ca.atan2(ca.sin(off), ca.cos(off)) if unit == "rad" else off, channel)


def _beams(frames: Frames) -> Iterator[PoseRows]:
    """(p − ground)·e_z / (−u·e_z): from a rangefinder's place p along its beam, a unit vector u, to the ground."""
    machine, value = frames.geometry.machine, frames.geometry.value
    for laser in machine.rangefinders:
        pose, beam = frames.link(laser.link), ca.vertcat(*(
            value.get(f"{laser.name}.direction.{axis}", laser.direction[k]) for k, axis in enumerate("xyz")))
        height = pose.point(frames.geometry.point(laser.name))[2] - machine.ground
        yield PoseRows(laser.channel, "transducer", (laser.channel,), "m",
                       ca.SX(-height * ca.norm_2(beam) / (pose.rotation @ beam)[2]))
