"""What motions and poses leave unused of a machine's limits: one number by kind of limit."""

from __future__ import annotations

from collections.abc import Sequence
from statistics import NormalDist
from typing import NamedTuple

from hydroopt.errors import ProblemError
from hydroopt.units import to_si

LENGTHS = ("clearance", "between", "people")
"""Reserves that are lengths; the others are parts."""


class Reserves(NamedTuple):
    """Reserves that a designed motion and planned poses keep.

    Attributes:
        flow: part of the pump's flow, and of each valve's opening, for leaks and a controller that catches up.
        pressure: part of relief pressures and largest torques.
        tipping: part of the moment with which the machine's weight, acting in the middle of its footprint, would hold
            it against tipping over an edge.
        clearance: distance of links, cylinders and rods from ground and obstacles [m].
        between: distance of the machine's own parts from each other [m].
        tracking: tracking error that a plan assumes, as a part of each joint's range. A plan keeps `MARGIN` times what
            it makes of positions, strokes, heights and distances; there a motion is stopped.
        people: distance that people keep beyond the machine's largest reach [m].
        certainty: probability with which pressures, valves and tipping keep them, whatever the uncertain parameters
            are: each pressure and valve alone, all edges of the footprint together.

    Raises:
        ProblemError: a reserve leaves nothing, or is negative.

    >>> Reserves().flow, round(Reserves().deviations(), 3), round(Reserves().deviations(4), 3)
    (0.1, 2.326, 2.807)
    >>> Reserves.none().deviations()
    0.0
    """

    flow: float = 0.1
    pressure: float = 0.1
    tipping: float = 0.1
    clearance: float = 0.3
    between: float = 0.1
    tracking: float = 0.005
    people: float = 2.0
    certainty: float = 0.99

    @classmethod
    def none(cls) -> Reserves:
        """None at all: the limits themselves, at the nominal parameters."""
        return cls(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.5)

    @classmethod
    def stated(cls, texts: Sequence[str]) -> Reserves:
        """The default ones but for what texts state: ``15 %`` of flow, pressure and tipping, or ``KIND=AMOUNT``.

        Raises:
            ProblemError: there is no such kind, or a reserve leaves nothing.
            UnitError: an amount has no unit, or one of another kind.

        >>> Reserves.stated(["20 %", "clearance=0.5 m"])[:4]
        (0.2, 0.2, 0.2, 0.5)
        """
        found: dict[str, float] = {}
        for text in texts:
            kind, named, amount = (part.strip() for part in text.partition("="))
            if named and kind not in cls._fields:
                raise ProblemError(f"there is no reserve '{kind}'", where="--reserve",
                                   remedy=f"give a part for all, such as '15 %', or KIND=AMOUNT with one of "
                                          f"{', '.join(cls._fields)}")
            unit = "m" if kind in LENGTHS else "1"
            value = to_si(amount if named else text, unit, where="--reserve")
            found |= {kind: value} if named else dict.fromkeys(("flow", "pressure", "tipping"), value)
        return cls(**found).checked()

    def deviations(self, together: int = 1) -> float:
        """Standard deviations that leave this certainty, of so many limits together (Bonferroni's inequality)."""
        return NormalDist().inv_cdf(1 - (1 - self.certainty) / together) if self.certainty != 0.5 else 0.0

    def checked(self) -> Reserves:
        """Itself.

        Raises:
            ProblemError: see the class.
        """
        for name in ("flow", "pressure", "tipping"):
            if not 0 <= (part := getattr(self, name)) < 1:
                raise ProblemError(f"a reserve of {100 * part:.4g} % of {name} " + (
                    "leaves nothing to use" if part >= 1 else "is not possible"), where="--reserve",
                    remedy="give a part from 0 up to less than 100 %, such as 10 %")
        for name in LENGTHS:
            if not 0 <= (size := getattr(self, name)) < float("inf"):
                raise ProblemError(f"a distance of {size:.4g} m cannot be kept", where="--reserve",
                                   remedy="give a length that is not negative, such as 0.3 m")
        if not 0 <= self.tracking < 0.1:
            raise ProblemError(f"a tracking error of {100 * self.tracking:.4g} % of the joints' ranges cannot be kept",
                               where="--reserve", remedy="give less than 10 %, such as 0.5 %")
        if not 0.5 <= self.certainty < 1:
            raise ProblemError(f"a certainty of {100 * self.certainty:.6g} % cannot be kept", where="--reserve",
                               remedy="give 50 % or more, and less than 100 %, such as 99 %")
        return self


DEFAULT = Reserves()
"""The reserves that are kept unless others are stated."""
