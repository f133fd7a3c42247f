"""Kinds of machines that a guided start knows, each with the numbers of a typical one, from which defaults are scaled.

Points are complex numbers [m]: on a link in its own line from its first pin to its last, on the ground relative to the
first moving link's first pin, forward and up.
"""

from __future__ import annotations

from typing import NamedTuple


class CylinderPart(NamedTuple):
    """A typical cylinder: its pins, its piston, which way it turns its link by extending, and, where a linkage stands
    between, its lengths pin to pin."""

    name: str
    jacks: int
    bore: float
    rod: float
    barrel: complex
    rod_pin: complex
    extends: float
    on_ground: bool = False
    lengths: tuple[float, float] | None = None


class LinkagePart(NamedTuple):
    """A typical rocker and coupler between a cylinder and its link.

    The rocker turns on the link before, `pin`; at `rocker` along its line it holds the coupler, at `rod` the cylinder.
    `turns` is the sign by which extending turns the rocker, `branch` on which side of the diagonal the coupler lies.
    """

    rocker_name: str
    coupler_name: str
    pin: complex
    rocker: float
    rod: complex
    coupler: float
    coupler_pin: complex
    turns: float
    branch: float


class Member(NamedTuple):
    """A typical moving link: length between its pins, mass, range [deg] to the line of the link before."""

    name: str
    length: float
    first: str
    last: str
    mass: float
    range: tuple[float, float]
    cylinder: CylinderPart | None
    linkage: LinkagePart | None = None
    torque: float = 0.0


class Telescope(NamedTuple):
    """Typical sections that slide out of the last link, for a link of one metre: how far each slides, where the
    cylinder's barrel is pinned to that link, its length retracted, bore and rod, and the mass of a section."""

    name: str
    travel: float
    barrel: complex
    retracted: float
    bore: float
    rod: float
    mass: float


class Kind(NamedTuple):
    """A kind of machine; `slew` is the name of the body that turns about the vertical, if there is one."""

    name: str
    typical: str
    members: tuple[Member, ...]
    slew: str = ""
    slew_height: float = 0.0
    slew_mass: float = 0.0
    counted: bool = False
    telescope: Telescope | None = None


_BOOM = Member("boom", 6.2354, "boom foot pin", "stick pin", 2900.0, (-35, 45), CylinderPart(
    "boom_cylinder", 2, 0.150, 0.105, 0.9 - 0.225j, 2.7148 + 1.9747j, 1, on_ground=True))
_STICK = Member("stick", 2.9732, "stick pin", "bucket pin", 1500.0, (-150, -30), CylinderPart(
    "stick_cylinder", 1, 0.170, 0.120, 3.0382 + 2.4022j, -0.8242 + 0.6335j, -1))
_BUCKET = Member("bucket", 1.9724, "bucket pin", "teeth", 1600.0, (-130, 5), CylinderPart(
    "bucket_cylinder", 1, 0.150, 0.105, 0.1580 + 0.8447j, 0.9029, -1, lengths=(1.95, 3.05)), LinkagePart(
    "rocker", "coupler", 2.2331 + 0.1470j, 0.9029, 0.9029, 0.7156, -0.1638 + 0.6641j, -1, -1))
_LIFT = Member("lift", 2.55, "lift arm pivot", "bucket pin", 1050.0, (-40, 45), CylinderPart(
    "lift_cylinder", 2, 0.110, 0.065, -0.05 - 0.55j, 1.15 - 0.1j, 1, on_ground=True))
_LOADER_BUCKET = Member("bucket", 1.15, "bucket pin", "cutting edge", 920.0, (-70, 55), CylinderPart(
    "tilt_cylinder", 1, 0.130, 0.070, 0.3 + 0.08j, -0.714 + 0.094j, 1, on_ground=True,
    lengths=(0.975, 1.72)), LinkagePart(
    "bellcrank", "link", 1.27 + 0.55j, 0.745, -0.714 + 0.094j, 0.945, -0.01 + 0.28j, -1, -1))
_MAIN = Member("main_boom", 1.6, "main boom pivot", "outer boom pivot", 118.0, (-9, 85), CylinderPart(
    "main_cylinder", 1, 0.080, 0.045, 0.3743 - 0.935j, 0.3697 - 0.069j, 1, on_ground=True))
_OUTER = Member("outer_boom", 2.0, "outer boom pivot", "hook", 120.0, (-120, -25), CylinderPart(
    "outer_cylinder", 1, 0.080, 0.045, 0.4699 - 0.069j, 0.2962 - 0.0881j, 1))
_AXIS = Member("axis", 0.4, "axis", "next axis", 8.0, (-120, 120), None, torque=150.0)

KINDS = {kind.name: kind for kind in (
    Kind("excavator", "excavator_bucket", (_BOOM, _STICK, _BUCKET), "swing", 0.7, 17000.0),
    Kind("loader", "wheel_loader", (_LIFT, _LOADER_BUCKET)),
    Kind("crane", "tampere_manipulator, on a slewing column", (_MAIN, _OUTER), "slew", 1.5, 250.0,
         telescope=Telescope("telescope", 0.5, 0.14 + 0.14j, 0.61, 0.027, 0.018, 50.0)),
    Kind("arm", "a small arm with a drive on each axis", (_AXIS,), counted=True),
    Kind("empty", "tampere_manipulator", (_MAIN._replace(name="link1", first="first pivot", last="next pivot"),
                                          _OUTER._replace(name="link2", first="pivot", last="end")), counted=True))}
"""Kinds by name. Of a `counted` one, the number of moving links is asked; the last member stands for all further ones.
"""
