"""Springs between two pins, and all parts that two pins hold."""

from __future__ import annotations

from typing import Self

from pydantic import Field, model_validator

from hydroopt.machine.actuators import Cylinder, GasCylinder
from hydroopt.machine.links import Attachment
from hydroopt.machine.quantity import Force, ImpossibleError, Length, LinearStiffness, Name, Noun


class Spring(Noun):
    """A linear spring between two links, such as a counterbalance; its ends are called as those of cylinders.

    It pulls its pins together with `preload` + `stiffness`·(length − `reference_length`), and pushes them apart where
    this is negative. The ends carry no body.
    """

    name: Name
    """Name of the spring."""
    barrel: Attachment
    """One pin."""
    rod: Attachment
    """The other pin."""
    stiffness: LinearStiffness = Field(ge=0)
    """Force per length."""
    reference_length: Length = Field(gt=0)
    """Distance of the pins at which it pulls with `preload`; the free length without one."""
    preload: Force | None = None
    """Force at the reference length; not modelled if not stated."""

    @model_validator(mode="after")
    def _no_bodies(self) -> Self:
        for end, attachment in (("barrel", self.barrel), ("rod", self.rod)):
            if attachment.body is not None:
                raise ImpossibleError("the ends of a spring carry no body",
                                      "remove it or add its mass to the link it is pinned to", f"{end}.body")
        return self


Pinned = Cylinder | GasCylinder | Spring
"""A part between two pins."""
