"""Least squares over motions that fulfil the dynamics: Levenberg and Marquardt's steps in θ and the first states.

From a poor guess a long motion runs away. Records are therefore divided into windows with first states of their own,
short ones first; what they say of θ and of the states is where longer ones start (multiple shooting, Bock 1987).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from scipy.optimize import lsq_linear

from hydroopt.errors import SolverError
from hydroopt.estimation.hydraulic.collocation import Collocation, Condensed
from hydroopt.estimation.hydraulic.dynamics import POINTS, Record
from hydroopt.spatial.inertia import Array

WINDOWS = (0.5, 2.0, 8.0)
"""Durations [s] of windows, one after the other; then whole records."""
AROUND = 0.1
"""Standard deviation of a window's first states about their guess, in units of their scales."""
ROUGH = 2e-3
"""Part of the number of readings by which half the sum of squares falls in a step that makes windows longer."""
CONVERGED, STALLED, SMALL = 1e-8, 0.05, 1e-3
"""Fall of half the sum of squares that the next step promises, and that of two damped steps in a row, also as a part
of the squares, at which steps end. The second, times the mean square of the residuals if that is more than one, is a
third of a standard deviation at most: dry friction's corners keep steps from doing as they promise."""
STEPS, ROUGH_STEPS = 100, 8
"""Greatest number of steps over whole records, and over windows."""
FIRST, LAST = 1e-6, 1e8
"""Smallest and largest damping, in parts of the squares of the derivatives."""


@dataclass(frozen=True, eq=False)
class Motion:
    """z (p,), states (K, nx) of each record that follow from it, in units of their scales, and half their squares."""

    z: Array
    points: tuple[Array, ...]
    cost: float


def fitted_motion(collocation: Collocation, z: Array, points: Sequence[Array]) -> Motion:
    """From a poor guess of z (p,) and of states (K, nx) of each record: over windows of growing duration.

    Raises:
        SolverError: the dynamics cannot be simulated, or the steps do not converge.
    """
    records, readings = collocation.problem.records, sum(int(here.sum()) for here in collocation.present)
    for duration in WINDOWS:
        if duration < max(record.t[-1] - record.t[0] for record in records):
            windows, inner = _windows(collocation, points, duration)
            found = least_squares(windows, z, inner, ROUGH * readings, ROUGH_STEPS)
            z, points = found.z, _joined(records, found.points)
    return least_squares(collocation, z, points)


def least_squares(collocation: Collocation, z: Array, points: Sequence[Array], enough: float = 0.0,
                  most: int = STEPS) -> Motion:
    """From a guess nearby.

    Args:
        collocation: the dynamics of the records.
        z: (p,) θ from its nominal value in units of its scale.
        points: states (K, nx) of each record.
        enough: fall of half the sum of squares in a step after which it ends.
        most: steps after which it ends; where `enough` is zero, it must converge before.

    Raises:
        SolverError: the dynamics cannot be simulated from the guess, or the steps do not converge.
    """
    damping, slow, half = 0.0, 0, sum(int(present.sum()) for present in collocation.present) / 2
    points = collocation.run(z, [states[0] for states in points], points)
    here = Motion(z, points, collocation.cost(z, points))
    for _ in range(most):
        linear, promised, there = collocation.condensed(here.z, here.points), np.inf, None
        while there is None:
            step = _step(collocation, linear, here.z, damping)
            promised = here.cost - step.cost
            if promised <= max(CONVERGED, enough if damping == 0 else 0) or damping > LAST:
                return here
            there = _taken(collocation, here, step)
            if there is None:
                damping = max(FIRST, 100 * damping)
        fall, here = here.cost - there.cost, there
        slow = slow + 1 if damping > 0 and fall < min(
            STALLED * max(1.0, here.cost / half), SMALL * here.cost) else 0
        if slow == 2 or fall < enough:
            return here
        if fall > promised / 2:
            damping = damping / 10 if damping > FIRST else 0.0
    if enough:
        return here
    raise SolverError(f"the squares still fall after {most} steps",
                      where=f"identification of {collocation.problem.name}", remedy=(
                          "identify bodies, too (--bodies), and correct numbers of the machine file that are far off"))


@dataclass(frozen=True, eq=False)
class _Step:
    """Changes of z (p,) and of the records' first states (nx,), and half the squares that they promise."""

    z: Array
    first: list[Array]
    cost: float


def _step(collocation: Collocation, linear: Sequence[Condensed], z: Array, damping: float) -> _Step:
    """The bounded least squares of the linear residuals; `damping` times the squares of the derivatives hold it back.

    Each record's first state is eliminated, so that only z remains.
    """
    parameters, nx = collocation.problem.parameters, collocation.nx
    tops: list[Array] = []
    rest = [np.column_stack([collocation.prior, collocation.prior @ z])]
    for each in linear:
        held: Array = np.zeros((nx, each.triangle.shape[1]))
        np.fill_diagonal(held, np.sqrt(damping) * np.linalg.norm(each.triangle[:, :nx], axis=0))
        triangle = np.asarray(np.linalg.qr(np.vstack([each.triangle, held]), mode="r"))
        tops.append(triangle[:nx])
        rest.append(triangle[nx:, nx:])
    both = np.vstack(rest)
    held = np.zeros((collocation.p, both.shape[1]))
    np.fill_diagonal(held, np.sqrt(damping) * np.linalg.norm(both[:, :-1], axis=0))
    both = np.asarray(np.linalg.qr(np.vstack([both, held]), mode="r"))
    lower = (parameters.lower - parameters.nominal) / parameters.scale - z
    upper = (parameters.upper - parameters.nominal) / parameters.scale - z
    free, change = np.flatnonzero(upper > lower), np.zeros(collocation.p)
    if free.size:
        change[free] = lsq_linear(both[:, free], -both[:, -1], (np.minimum(lower, 0)[free], np.maximum(upper, 0)[free]),
                                  method="bvls").x
    first = [np.linalg.lstsq(top[:, :nx], -top[:, nx:] @ np.append(change, 1.0), rcond=1e-13)[0] for top in tops]
    left = [collocation.prior @ (z + change), *(each.triangle @ np.concatenate([begin, change, [1.0]])
                                                for each, begin in zip(linear, first, strict=True))]
    return _Step(change, first, float(sum(part @ part for part in left)) / 2)


def _taken(collocation: Collocation, here: Motion, step: _Step) -> Motion | None:
    """The motion after a step, or None if it does not lower the squares by a tenth of what was promised."""
    z = here.z + step.z
    try:
        points = collocation.run(z, [states[0] + change for states, change in zip(here.points, step.first,
                                                                                   strict=True)], here.points)
    except SolverError:
        return None
    cost = collocation.cost(z, points)
    return Motion(z, points, cost) if here.cost - cost > (here.cost - step.cost) / 10 else None


def _windows(collocation: Collocation, points: Sequence[Array],
             duration: float) -> tuple[Collocation, list[Array]]:
    """Records of about a duration [s], each with first states near those (K, nx) of a guess; and their states."""
    scale, records, inner = collocation.problem.dynamics.scale, [], []
    for record, states in zip(collocation.problem.records, points, strict=True):
        count = max(1, round((record.t[-1] - record.t[0]) / duration))
        edges = np.unique(np.linspace(0, len(record.t) - 1, count + 1).astype(int)).tolist()
        for a, b in pairwise(edges):
            part = states[a * POINTS * record.steps : b * POINTS * record.steps + 1]
            guess = record.guess[a : b + 1].copy()
            guess[0] = part[0] * scale
            records.append(replace(record, t=record.t[a : b + 1], u=record.u[a : b + 1], y=record.y[a : b + 1],
                                   guess=guess, initial_sigma=AROUND * scale))
            inner.append(part)
    return collocation.of(records), inner


def _joined(records: Sequence[Record], points: Sequence[Array]) -> list[Array]:
    """States (K, nx) of whole records from those of their windows."""
    found, left = [], list(points)
    for record in records:
        states = left.pop(0)
        while len(states) < len(record.time):
            states = np.vstack([states, left.pop(0)[1:]])
        found.append(states)
    return found
