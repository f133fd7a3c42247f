"""A stiff wall that the tip of a machine may touch."""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca

from hydroopt.errors import ProblemError

SLIDING = 0.01
"""Sliding speed [m/s] over which dry friction on a wall is smoothed: v/|v| becomes v/√(v² + SLIDING²)."""


@dataclass(frozen=True)
class Wall:
    """A flat wall that pushes on the tip where the tip has pressed into it, and never pulls.

    The normal force is k·δ·(1 + 3/2·α·δ̇) at a depth δ (Hunt and Crossley 1975, with the exponent of flat contact): it
    starts at zero on impact, unlike a damper beside the spring, and α is how much less than one the coefficient of
    restitution is per speed of the impact. Dry friction opposes sliding.

    Attributes:
        point: of its surface (3,) [m] in the base frame.
        normal: (3,) out of the wall, of any length.
        stiffness: k [N/m].
        damping: α [s/m].
        friction: coefficient of dry friction.

    Raises:
        ProblemError: a number cannot be that of a wall.

    >>> floor = Wall((0.0, 0.0, -1.0), (0.0, 0.0, 1.0), stiffness=1e6)
    >>> floor.force(ca.SX([5.0, 0.0, -1.01]), ca.SX([0.0, 0.0, 0.0]))
    SX(@1=0, [@1, @1, 10000])
    """

    point: tuple[float, float, float]
    normal: tuple[float, float, float]
    stiffness: float
    damping: float = 0.0
    friction: float = 0.0

    def __post_init__(self) -> None:
        if not (self.stiffness > 0 and self.damping >= 0 and self.friction >= 0 and any(self.normal)):
            raise ProblemError("a wall needs a normal, a positive stiffness, and damping and friction that are not "
                               "negative", where="wall", remedy="correct its numbers")

    def force(self, place: ca.SX, velocity: ca.SX) -> ca.SX:
        """Force (3,) [N] on a tip at a place (3,) [m] with a velocity (3,) [m/s] in the base frame."""
        normal = ca.DM(self.normal) / ca.norm_2(ca.DM(self.normal))
        depth, speed = ca.dot(normal, ca.DM(self.point) - place), -ca.dot(normal, velocity)
        push = ca.fmax(self.stiffness * ca.fmax(depth, 0) * (1 + 1.5 * self.damping * speed), 0)
        sliding = velocity + normal * speed
        return push * (normal - self.friction * sliding / ca.sqrt(ca.sumsqr(sliding) + SLIDING**2))
