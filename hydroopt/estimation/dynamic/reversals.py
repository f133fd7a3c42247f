"""Reversals at which dry friction turns before the velocity does: positions that are read late.

Samples about a reversal do not take part in an identification, since the sign of their friction is not known. Yet
friction turns with the velocity, and a step of friction that noise alone blurs shows when to a sample or two. Friction
that turns first shows that positions are read late. Friction that turns later shows nothing: before seals slip they
give, so that the friction of sound real machines turns up to 45 ms late (`studies/panda_gaz2019`).
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hydroopt.estimation.dynamic.experiment import Experiment
from hydroopt.estimation.dynamic.friction_sign import DRY
from hydroopt.estimation.dynamic.identification import Identification
from hydroopt.results.diagnostic import Diagnostic, Meaning
from hydroopt.spatial.inertia import Array

WINDOW, NARROW = 0.4, 0.15
"""Half the time [s] about a reversal that is compared, and the least where another reversal or a hold is near."""
FEWEST = 4
"""Reversals without which nothing is said."""
STEEP = 3.0
"""Step of friction, in standard deviations of the force's noise, from which on a reversal counts."""
EVIDENCE, EXPLAINED = 25.0, 1.5
"""Least fall of χ² by a shift for each reversal, and largest χ² per sample that it may leave."""
ALIKE = 0.75
"""Share of the reversals that have to be shifted the same way, by half to one and a half times the common shift."""


class LatePositions(NamedTuple):
    """How much earlier [s] than the velocity of `joint` the friction of `actuator` turns, at so many `reversals`."""

    actuator: str
    joint: str
    late: float
    std: float
    reversals: int


class _Reversal(NamedTuple):
    """χ² (s,) of a reversal's samples by the shift of its step, and how many there are."""

    chi2: Array
    samples: int


def diagnose(found: Identification) -> Iterator[Diagnostic]:
    """Joints whose positions are read late."""
    for each in late_positions(found):
        yield Diagnostic.of("friction turns before the velocity", (each.joint,), {
            "joint": each.joint, "actuator": each.actuator, "count": each.reversals, "late": 1e3 * each.late,
            "std": 1e3 * each.std},
            "The positions of {joint} are read {late:.0f} ± {std:.0f} ms late: so much earlier than its velocity the "
            "dry friction of {actuator} turns, at {count} reversals.",
            "Correct the times of {joint} in the log.", Meaning.CONTRADICTION)


def late_positions(found: Identification) -> Iterator[LatePositions]:
    """Actuators, alone at their joints, whose friction turns before the velocity of their joints does."""
    model = found.problem.model
    dry = np.isin(np.array(model.parameters.kinds), DRY)
    steps = [float(np.median(np.diff(data.plotted.motion.t))) for data in found.problem.experiments]
    shifts = np.arange(-WINDOW + NARROW / 2, WINDOW - NARROW / 2, max(min(steps), 0.002) / 2)
    reversals: dict[str, list[_Reversal]] = {}
    for data in found.problem.experiments:
        part = data.plotted
        free = part.predicted(np.where(dry, 0.0, found.psi))
        friction = part.predicted(found.psi) - free
        for k, balance in enumerate(model.machine.balances):
            if balance.alone is not None and found.sigma[k] > 0:
                j = model.machine.joints.index(balance.joint)
                reversals.setdefault(balance.name, []).extend(_reversals(
                    part, j, k, part.force[:, k] - free[:, k], friction[:, k], float(found.sigma[k]), shifts))
    joints = {balance.name: balance.joint for balance in model.machine.balances}
    for name, some in reversals.items():
        if (one := _late(name, joints[name], some, shifts, min(steps))) is not None:
            yield one


def _late(name: str, joint: str, some: list[_Reversal], shifts: Array, step: float) -> LatePositions | None:
    if len(some) < FEWEST:
        return None
    total, samples = np.sum([each.chi2 for each in some], axis=0), sum(each.samples for each in some)
    best, none = int(np.argmin(total)), int(np.argmin(np.abs(shifts)))
    single = np.array([_middle(each.chi2, shifts) for each in some])
    late = _middle(total, shifts)
    alike = np.mean(np.abs(single - late) <= max(abs(late) / 2, step))
    if (late > -1.5 * step or total[none] - total[best] < EVIDENCE * len(some)
            or total[best] > EXPLAINED * samples or alike < ALIKE):
        return None
    spread = max(1.5 * float(np.median(np.abs(single - late))), step / np.sqrt(12))
    return LatePositions(name, joint, -late, spread / np.sqrt(len(some)), len(some))


def _middle(chi2: Array, shifts: Array) -> float:
    """The middle of the shifts with the least χ², which is flat between two samples."""
    return float(np.mean(shifts[chi2 <= np.min(chi2) + 1e-6]))


def _reversals(data: Experiment, j: int, k: int, measured: Array, friction: Array, sigma: float,
               shifts: Array) -> Iterator[_Reversal]:
    """Those of joint `j`, by what is measured of the dry friction in balance `k` (N,), and by the model's (N,)."""
    motion = data.motion
    t, v = motion.t, motion.qd[:, j]
    same = np.diff(motion.segment) == 0
    at = np.flatnonzero(same & (np.sign(v[1:]) != np.sign(v[:-1])) & (v[:-1] != 0))
    turns = t[at] - v[at] * (t[at + 1] - t[at]) / (v[at + 1] - v[at])
    held = np.zeros(len(t), dtype=bool) if data.calm is None else data.calm[:, k]
    usable: NDArray[np.bool_] = data.inside & np.isfinite(measured) & ~held
    for turn, before, after in zip(turns, np.diff(turns, prepend=-np.inf), np.diff(turns, append=np.inf), strict=True):
        half = min(WINDOW, before / 2, after / 2)
        rows = np.arange(*np.searchsorted(t, [turn - half, turn + half]))
        if half < NARROW or len(rows) < 6 or not np.all(usable[rows]) or len({*motion.segment[rows].tolist()}) > 1:
            continue
        early = t[rows] < turn
        low, high = (float(np.median(friction[rows[side]])) for side in (early, ~early))
        if abs(high - low) < STEEP * sigma:
            continue
        expected = np.where(t[rows] < turn + shifts[:, None], low, high)
        off = measured[rows] - expected
        off -= off.mean(axis=1, keepdims=True)  # what gravity and inertia lack is not the step's
        yield _Reversal(np.where(np.abs(shifts) < half - NARROW / 2, np.sum(off**2, axis=1) / sigma**2, np.inf),
                        len(rows))
