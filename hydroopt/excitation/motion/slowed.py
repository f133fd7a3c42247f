"""A motion at another pace: the same path, its time stretched."""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca

from hydroopt.excitation.motion.basis import Basis


@dataclass(frozen=True)
class Slowed(Basis):
    """The functions of another basis, run through at a part of their `pace`, above 0 and at most 1.

    >>> from hydroopt.excitation.motion.basis import Spline
    >>> half = Slowed(Spline(10.0, 4), 0.5)
    >>> half.duration, half.fastest
    (20.0, 0.1)
    """

    own: Basis
    pace: float

    @property
    def duration(self) -> float:
        """Of the whole motion [s]."""
        return self.own.duration / self.pace

    @property
    def fastest(self) -> float:
        """The highest frequency [Hz]."""
        return self.own.fastest * self.pace

    @property
    def names(self) -> tuple[str, ...]:
        """Of the coefficients of a joint."""
        return self.own.names

    @property
    def text(self) -> str:
        """What it is, in a few words."""
        return f"{self.own.text}, at {100 * self.pace:.4g} % of its pace"

    def expressions(self, t: ca.SX) -> tuple[ca.SX, ca.SX, ca.SX]:
        """As in `Basis`."""
        first, second, third = self.own.expressions(self.pace * t)
        return first, self.pace * second, self.pace**2 * third

    def as_dict(self) -> dict[str, float]:
        """What it is made by."""
        return {**self.own.as_dict(), "pace": self.pace}
