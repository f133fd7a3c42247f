"""The load over time: taring, weighing each load, and waiting while it changes."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from enum import StrEnum

import numpy as np

from hydroopt.weighing.equations import Equations
from hydroopt.weighing.least_squares import Weighed, weighed
from hydroopt.weighing.load_change import RECENT, THRESHOLD, anything, load_change

WINDOW = 50
"""Largest number of samples that are weighed together."""
SETTLED = 5
"""Number of samples that would show a further change, and do not, after which a new load is weighed."""
RESTING = 5
"""Number of samples that do not show the load after which it counts as not weighed any more."""
FEWEST = 6
"""Number of equations of moving joints that a load needs at least."""
CONTRADICTED = 3.0
"""Misfit from which readings contradict the model."""
NEGATIVE = 4.0
"""Number of standard deviations below zero from which a mass is impossible."""
LASTS = 8
"""Number of samples that a change may last."""
GOES_ON = 12.0
"""Likelihood ratio from which a change goes on."""
NOTICED = 0.02
"""Change of the mass, as a part of the full scale, below which it is none."""
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
    """

    sample: int
    weighed: Weighed
    load: int
    status: Weighable


def course(equations: Equations, *, tare: float, needed: float) -> Iterator[Reading]:
    """What the scale shows at each smoothed sample of a log.

    Args:
        equations: of the log.
        tare: how long the machine is empty at the beginning [s]; 0 weighs without a tare.
        needed: half of the 95 % interval [kg] from which a mass is too uncertain.
    """
    t, number, start, since = equations.t, 0, 0, 0
    scale = equations.scale
    empty = t < t[0] + tare
    tared = weighed(equations, np.flatnonzero(empty), empty=True)
    here = replace(equations, scale=replace(scale, own=tared.own))
    blank, changing, mass = anything(here, tared), not tare, 0.0
    before: dict[int, Weighed] = {}
    contradicted = tared.misfit > CONTRADICTED
    telling = equations.telling(NOTICED * scale.load.full_scale)
    for i in range(len(t)):
        if empty[i]:
            yield Reading(i, tared, 0, Weighable.CONTRADICTED if contradicted else Weighable.TARING)
            before[i], start = tared, i + 1
            continue
        recent = np.arange(start if changing else max(start, i - RECENT), i + 1)[-WINDOW:]
        change = load_change(here, recent, before.get(int(recent[0]), blank)) if len(recent) > 1 else None
        if change and not changing and change.ratio > THRESHOLD and abs(change.size) > NOTICED * scale.load.full_scale:
            number, changing, start, since, before = number + 1, True, change.sample + LASTS, i, {}
        elif change and changing and change.ratio > GOES_ON:
            start = since = change.sample
        changing = changing and telling[max(start, since + 1) : i + 1].sum() < SETTLED
        window = np.arange(max(start, i - WINDOW + 1), i + 1) if start <= i else np.array([i])
        found = weighed(here, window, start=mass)
        mass = found.mass
        if not changing:
            before[i] = found
        status = _status(found, scale.load.full_scale, needed)
        if changing:
            status = Weighable.CHANGING
        elif contradicted:
            status = Weighable.CONTRADICTED
        elif not telling[max(0, i - RESTING + 1) : i + 1].any():
            status = Weighable.STANDSTILL
        yield Reading(i, found, number, status)


def _status(found: Weighed, full_scale: float, needed: float) -> Weighable:
    if found.moving < FEWEST:
        return Weighable.UNCERTAIN
    if found.misfit > CONTRADICTED:
        return Weighable.CONTRADICTED
    if found.mass < -NEGATIVE * found.mass_std - 0.01 * full_scale or found.mass > OVERLOAD * full_scale:
        return Weighable.IMPOSSIBLE
    return Weighable.OK if 1.96 * found.mass_std <= needed else Weighable.UNCERTAIN
