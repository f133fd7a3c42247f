"""Where targets and instruments are at a pose, and the rows that compare a measurement with it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import casadi as ca

from hydroopt.machine.geometry import Geometry
from hydroopt.machine.machine import BASE
from hydroopt.machine.survey import TIP
from hydroopt.spatial.poses import Pose, identity, roll_pitch_yaw
from hydroopt.spatial.rotation_vectors import rotation_of


class PoseRows(NamedTuple):
    """Predicted readings of one measurement.

    Attributes:
        name: what residuals and fits call it, ``station.prism``.
        channels: of its readings, all in the SI unit `unit`.
        rows: (number of channels,) predictions, less the readings where the rows take these as an input.
        reading: name of that input, '' where the reading is subtracted.
    """

    name: str
    channels: tuple[str, ...]
    unit: str
    rows: ca.SX
    reading: str = ""


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
