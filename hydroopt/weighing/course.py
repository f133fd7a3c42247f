"""The load over time: taring, weighing each load, and waiting while it changes."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from hydroopt.spatial.inertia import Array
from hydroopt.weighing.equations import Equations
from hydroopt.weighing.recursion import Recursion, Weighed
from hydroopt.weighing.scale import Gaussian

THRESHOLD = 30.0
"""Likelihood ratio (twice its logarithm) from which the load has changed."""
SETTLED = 5.0
"""How often samples would have shown a further change, and did not, before a new load is weighed; several that show
little count as one, by the squares of what each shows."""
RESTING = 5
"""Number of samples that do not show the load after which it counts as not weighed any more."""
FORGOTTEN = 1 / RESTING
"""Part of what samples have shown that each further one leaves out."""
FEWEST = 6
"""Number of equations of moving joints that a load needs at least."""
CONTRADICTED = 3.0
"""Misfit from which readings contradict the model."""
NEGATIVE = 4.0
"""Number of standard deviations below zero from which a mass is impossible."""
LASTS = 11
"""Number of samples that a change may last: a pick-up of 2 s, as far as it shows, and the smoothing."""
GOES_ON = 10.0
"""Likelihood ratio from which a change goes on, or may have begun, so that no mass is shown."""
NOTICED = 0.02
"""Change of the mass, as a part of the full scale, below which it is none."""
EMPTY = 0.005
"""Standard deviation, as a part of the full scale, of the mass of a machine that was tared and has not been loaded."""
OVERLOAD = 2.0
"""Mass, as a part of the full scale, from which it is impossible."""


class Weighable(StrEnum):
    """Whether a load can be weighed at a time, or why not."""

    OK = "ok"
    TARING = "taring"
    CHANGING = "the load is changing"
    STANDSTILL = "no joint that shows the load moves"
    UNCERTAIN = "too uncertain"
    CONTRADICTED = "readings contradict the model"
    IMPOSSIBLE = "impossible mass"


@dataclass(frozen=True, eq=False)
class Reading:
    """What the scale shows at a time.

    Attributes:
        sample: of the smoothed log.
        weighed: the load.
        load: number of the load, 0 while it is empty.
        status: whether it can be believed.
        noticeable: change of the mass that the sample shows [kg], see `Recursion.take`.
    """

    sample: int
    weighed: Weighed
    load: int
    status: Weighable
    noticeable: float


def course(equations: Equations, *, tare: float, needed: float) -> Iterator[Reading]:
    """What the scale shows at each smoothed sample of a log.

    Args:
        equations: of the log.
        tare: how long the machine is empty at the beginning [s]; 0 weighs without a tare.
        needed: half of the 95 % interval [kg] from which a mass is too uncertain.
    """
    kernel, full_scale = equations.smoothed.kernel, equations.scale.load.full_scale
    taring = round(tare / (kernel.stride * kernel.step))
    number = start = calm = 0
    settled = shown = 0.0
    changing, contradicted, resting = not taring, False, RESTING
    known = equations.scale.own
    tared, sought = known, Recursion(equations, known)
    found = sought.solved()
    for i in range(len(equations.t)):
        if i < taring:
            sought.take(i, empty=True)
            found = sought.solved_empty()
            if i == taring - 1:
                found = _tared(equations, known, i + 1, sought.own)
            tared, contradicted, start = found.own, found.misfit > CONTRADICTED, i + 1
            yield Reading(i, found, 0, Weighable.CONTRADICTED if contradicted else Weighable.TARING, np.inf)
            continue
        if i == start:
            sought = Recursion(equations, tared, found.mass + found.change.size * changing)
        noticeable = np.inf
        if i >= start:
            noticeable = sought.take(i)
            found = sought.solved((0.0, EMPTY * full_scale) if taring and number == 0 else None)
        shows = min(1.0, (NOTICED * full_scale / noticeable) ** 2)
        shown = min(1.0, (1 - FORGOTTEN) * shown + shows)
        resting, settled, calm = 0 if shown >= 1 else resting + 1, settled + shows, calm + (i >= start)
        change = found.change
        another = i >= start and change.ratio > THRESHOLD and abs(change.size) > NOTICED * full_scale
        if another and (not changing or calm > LASTS):
            start = i + 1 if changing else i + max(1, LASTS - change.ago)
            number, changing, settled, calm = number + 1, True, 0.0, 0
        elif i >= start and changing and calm <= LASTS and change.ratio > GOES_ON:
            start, settled, calm = i + 1, 0.0, 0
        changing = changing and settled < SETTLED
        status = _status(found, sought.rows, full_scale, needed)
        if changing:
            status = Weighable.CHANGING
        elif contradicted:
            status = Weighable.CONTRADICTED
        elif resting >= RESTING:
            status = Weighable.STANDSTILL
        elif status is Weighable.OK and (
                change.ratio > GOES_ON or (taring and number == 0 and _against_empty(found, full_scale) > GOES_ON)):
            status = Weighable.CHANGING
        yield Reading(i, found, number, status, noticeable)


def _tared(equations: Equations, known: Gaussian, count: int, at: Array) -> Weighed:
    """What the first samples say about the scale, linearised where they led: slope times bodies is no small product."""
    sought = Recursion(equations, known)
    for i in range(count):
        sought.own = at
        sought.take(i, empty=True)
    return sought.solved_empty()


def _against_empty(found: Weighed, full_scale: float) -> float:
    """Likelihood ratio of a load against the empty machine by all samples since the tare, without what is assumed."""
    information, variance = 1 / found.mass_std**2, (EMPTY * full_scale) ** 2
    shown = information - 1 / variance
    return (found.mass * information) ** 2 / shown if shown > 0 else 0.0


def _status(found: Weighed, rows: int, full_scale: float, needed: float) -> Weighable:
    if rows < FEWEST:
        return Weighable.UNCERTAIN
    if found.misfit > CONTRADICTED:
        return Weighable.CONTRADICTED
    if found.mass < -NEGATIVE * found.mass_std - 0.01 * full_scale or found.mass > OVERLOAD * full_scale:
        return Weighable.IMPOSSIBLE
    return Weighable.OK if 1.96 * found.mass_std <= needed else Weighable.UNCERTAIN
