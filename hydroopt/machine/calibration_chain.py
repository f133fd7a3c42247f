"""The closed chain of kinematic calibration: calibrator, fixtures, tracker, distances, stages (chapter 3)."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Literal

from pydantic import Field, StrictBool

from hydroopt.machine.links import JointFriction, Link
from hydroopt.machine.quantity import Angle, ImpossibleError, Length, Lengths, Name, Noun, Part

CLOSES = {"ball": (0, 1, 2), "hinge": (0, 1, 2, 3, 4), "rigid": (0, 1, 2, 3, 4, 5), "plane": (2,)}
"""Which of the tip's place (0, 1, 2) and the tool's turn (3, 4, 5) a fixture holds, along x, y, z of its frame."""


class Calibrator(Noun):
    """A sensed linkage from the far end of a machine's link to a ball that sits in a fixture (Section 3.5.1).

    Its links form a serial chain. Without links of its own it is a rigid tool with a ball. Its joints have no actuators
    and turn without friction; bodies of its links load the machine's actuators while it is attached.
    """

    parent: Name
    """Link of the machine that carries it."""
    links: tuple[Link, ...] = ()
    """Its own links, in order."""
    tip: Lengths = (0.0, 0.0, 0.0)
    """The ball's centre (3,) in the frame at the far end of the last link, which is the tool's frame."""

    def _mistakes(self) -> Iterator[ImpossibleError]:
        before = self.parent
        for link in self.links:
            if link.parent != before:
                yield ImpossibleError(f"link '{link.name}' is attached to '{link.parent}', not to '{before}'",
                                      "list a calibrator's links in their order, each on the one before")
            if link.joint.friction != JointFriction():
                yield ImpossibleError(f"the joint of '{link.name}' states friction, which a calibrator's joints do not "
                                      "have", "leave it out")
            before = link.name

class Fixture(Part):
    """What holds the tip in the base frame without a sensor (the task of Section 3.3.2).

    The tip stands in the origin of its frame, and by `kind` the tool

    - ``ball`` turns freely (3 freedoms, the thesis's),
    - ``hinge`` turns about its own z axis, which lies along the fixture's (1),
    - ``rigid`` stands as the fixture's frame does (0),
    - ``plane`` turns freely, while the tip slides in the fixture's x-y plane (5).
    """

    kind: Literal["ball", "hinge", "rigid", "plane"] = "ball"
    """How it holds the tool."""
    position: Lengths
    """Place (3,) of its frame in the base frame."""
    orientation: tuple[Angle, Angle, Angle] = (0.0, 0.0, 0.0)
    """Roll, pitch, yaw of its frame; a ball has none."""
    play: Length = Field(0.0, ge=0)
    """Standard deviation of the tip in each held direction."""
    tilt: Angle = Field(0.0, ge=0)
    """Standard deviation of held turns."""
    moves: StrictBool = False
    """Whether it has another place in every stage; the stated one is then the initial guess of all of them."""

    @property
    def closes(self) -> tuple[int, ...]:
        """Held directions, see `CLOSES`."""
        return CLOSES[self.kind]

    @property
    def freedoms(self) -> int:
        """Freedoms t of Eq. 3.1."""
        return 6 - len(self.closes)

    def _mistakes(self) -> Iterator[ImpossibleError]:
        if self.kind == "ball" and any(self.orientation):
            yield ImpossibleError(f"'{self.name}' is a ball, which has no orientation",
                                  "leave the orientation out, or state the kind hinge, rigid or plane")
        if self.tilt and self.kind in ("ball", "plane"):
            yield ImpossibleError(f"'{self.name}' is a {self.kind}, which holds no turn that could have a tilt",
                                  "leave the tilt out, or state the kind hinge or rigid")

class Stage(Part):
    """Poses measured one after another.

    A locked joint keeps its unknown angle in the following stages until one of them moves it. Joints with readings in
    the pose table need not be named.
    """

    moves: tuple[Name, ...] = ()
    """Joints that move without a sensor."""
    locked: dict[Name, Angle] = Field(default_factory=dict)
    """Approximate angles of locked joints, by joint."""
    drift: Angle = Field(0.0, ge=0)
    """Standard deviation of the angle by which leaking cylinders let a locked joint drift, linearly over the stage."""

    def _mistakes(self) -> Iterator[ImpossibleError]:
        both = sorted(set(self.moves) & set(self.locked))
        if both:
            yield ImpossibleError(f"'{both[0]}' both moves and is locked", "name it once")
