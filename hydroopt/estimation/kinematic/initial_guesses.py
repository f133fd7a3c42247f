"""Initial guesses of what poses do not read: angles of joints without a sensor, and where instruments stand."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import NamedTuple, TypeVar

import casadi as ca
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from hydroopt.estimation.kinematic.observability import FARTHEST
from hydroopt.estimation.kinematic.pose_equations import PoseEquations
from hydroopt.model.least_squares_by_sample import nearest
from hydroopt.simulation.postures import CLOSED, STEPS
from hydroopt.spatial.inertia import Array

SMALL = 1e-6
"""Change of an unsensed angle [rad, m] that ends these steps."""
GUESSES = 24
"""Angles tried for a joint that moves unsensed, over its range."""


def guess_unsensed(problem: PoseEquations, theta: Array) -> Array:
    """Initial joint vectors (N, n): readings, and for joints that move unsensed the angle that closes best."""
    layout, model = problem.layout, problem.model
    best = problem.angles(theta, layout.reading)
    moving = np.flatnonzero(layout.moving.any(axis=0))
    if not moving.size:
        return best
    g, places = theta[: len(model.parameters)], problem.places(theta)
    unread = layout.moving.any(axis=1)
    loops_only = bool(np.all(layout.held[unread]))  # the gap determines the angle, and is quicker than all rows
    function, count = (model.loop, model.loop_rows) if loops_only else (model.observed, layout.present.shape[1])
    low, high = model.ranges.T
    for joints, rows, shares in _tries(function, moving, np.asarray(layout.present[unread, :count].any(axis=0))):
        before, least = best.copy(), np.full(len(best), np.inf)
        for share in shares:
            trial = before.copy()
            trial[:, joints] = np.where(layout.moving[:, joints], (low + share * (high - low))[joints],
                                        before[:, joints])
            left = model.over(function, g, trial, places)[0][:, :, 0] - layout.target[:, :count]
            size = np.sum(np.where(layout.present[:, :count] & rows, left, 0.0) ** 2, axis=1)
            better = size < least
            best[better], least[better] = trial[better], size[better]
        if not loops_only:  # lengths, inclinations and places determine unsensed angles far better than a guess
            own = np.isin(np.arange(best.shape[1]), joints)
            best = _followed(problem, theta, best, layout.moving & own, layout.present & rows)
    return follow_unsensed(problem, theta, best) if model.measurements or not loops_only else best


def _tries(function: ca.Function, moving: NDArray[np.intp],
           read: NDArray[np.bool_]) -> Iterator[tuple[NDArray[np.intp], NDArray[np.bool_], Array]]:
    """Joints to try together, by which of the rows (m,) that are read, and where (k, n) in their ranges, from 0 to 1.

    Those that a row depends on alone, as a cylinder's length does on its joint, come first and are tried alone: they
    are known then, whatever the others make of the tip.
    """
    n = function.size1_in(1)
    depends = np.array(ca.DM(function.jac_sparsity(0, 1)).full(), dtype=bool) & read[:, None]
    unknown = set(moving.tolist())
    while unknown:
        counts = depends[:, sorted(unknown)].sum(axis=1)
        alone = {k for k in unknown if np.any(depends[:, k] & (counts == 1))}
        joints = np.array(sorted(alone))[:1] if alone else np.array(sorted(unknown))
        rows = depends[:, joints].any(axis=1) & (counts <= len(joints))
        yield joints, rows, ((np.arange(GUESSES)[:, None] + 0.5) / GUESSES * np.ones(n) if len(joints) == 1
                             else np.random.default_rng(0).uniform(size=(GUESSES * len(joints), n)))
        unknown -= set(joints.tolist())


def closed_angles(problem: PoseEquations, theta: Array, q: Array) -> Array:
    """Joint vectors (N, n) with the loops closed by the smallest errors, in standard deviations, of sensed angles."""
    layout, model = problem.layout, problem.model
    strict = layout.present[:, : model.loop_rows] & (problem.row_sigma[:, : model.loop_rows] == 0)
    weight = np.where(layout.sensed, problem.angle_sigma, np.where(layout.moving, 1.0, 0.0))
    if not np.any(strict):
        return q

    def gaps(own: Array, which: NDArray[np.intp]) -> tuple[Array, Array]:
        gap, by_q = model.over(model.loop_by_angles, theta[: len(model.parameters)], own, problem.places(theta)[which])
        return gap[:, :, 0] * strict[which], by_q * strict[which][:, :, None]

    return nearest(gaps, q, steps=STEPS, close=CLOSED, ease=weight, damped=False).x


def follow_unsensed(problem: PoseEquations, theta: Array, q: Array) -> Array:
    """Joint vectors (N, n) whose unsensed angles close the loops as well as they can, the readings taken as exact."""
    return _followed(problem, theta, q, problem.layout.moving, problem.layout.present)


def _followed(problem: PoseEquations, theta: Array, q: Array, moving: NDArray[np.bool_],
              present: NDArray[np.bool_]) -> Array:
    """Joint vectors whose `moving` (N, n) angles make some rows, `present` (N, m), as small as they can."""
    model = problem.model
    g, places = theta[: len(model.parameters)], problem.places(theta)
    if not np.any(moving):
        return q

    def rows(own: Array, which: NDArray[np.intp]) -> tuple[Array, Array]:
        found, by_q = model.over(model.observed_by_angles, g, own, places[which])
        there = present[which]
        return np.where(there, found[:, :, 0] - problem.layout.target[which], 0.0), np.where(
            there[:, :, None], by_q, 0.0)

    return nearest(rows, q, steps=STEPS, longest=FARTHEST, still=SMALL, ease=moving.astype(float)).x


def explained_by_unsensed(by_q: Array, moving: NDArray[np.bool_], rows: Array) -> Array:
    """Change (N, n) of the unsensed angles that explains most of the rows (N, m)."""
    which = np.flatnonzero(moving.any(axis=0))
    change = np.zeros(moving.shape)
    by_unread = by_q[:, :, which] * moving[:, None, which]
    change[:, which] = (np.linalg.pinv(by_unread, rcond=1e-9) @ rows[:, :, None])[:, :, 0]
    return change


APART = 5.0
"""Standard deviations that places must lie off a line to tell how an instrument is turned about it."""

P = TypeVar("P", bound=PoseEquations)


class Sighting(NamedTuple):
    """What an instrument saw in one set-up: positions (K, 3) [m] and orientations (L, 3, 3), each as `read` in its own
    frame and as `expected` in that of its link, by the nominal machine; `turned` (K,) says which orientation was read
    with a position, −1 without one; `sigma` [m] is that of positions."""

    read: Array
    expected: Array
    read_turns: Array
    expected_turns: Array
    turned: Array
    sigma: float

    @property
    def spread(self) -> Array:
        """(3,) standard deviations [m] of the positions along their principal axes; (0,) without any."""
        if not len(self.read):
            return np.zeros(3)
        values = np.linalg.svd(self.read - self.read.mean(axis=0), compute_uv=False) / np.sqrt(len(self.read))
        return np.concatenate([values, np.zeros(3 - len(values))])

    @property
    def complete(self) -> bool:
        """Whether it tells all six freedoms of the instrument."""
        return bool(self.spread[1] > APART * self.sigma) or bool(len(self.read_turns) and len(self.read))

    def pose(self) -> tuple[Array, Array]:
        """Rotation (3, 3) and position (3,) [m] of the instrument that fit best (Kabsch)."""
        read, expected, rotation = self.read, self.expected, np.eye(3)
        if self.spread[1] > APART * self.sigma:
            rotation = Rotation.align_vectors(expected - expected.mean(axis=0), read - read.mean(axis=0))[0].as_matrix()
        elif len(self.read_turns):
            rotation = Rotation.from_matrix(self.expected_turns @ self.read_turns.transpose(0, 2, 1)).mean().as_matrix()
        shift = expected.mean(axis=0) - rotation @ read.mean(axis=0) if len(read) else np.zeros(3)
        return rotation, shift

    def misfit(self) -> tuple[float, float]:
        """RMS of positions as a part of their spread, and of orientations [rad], at the best pose."""
        rotation, shift = self.pose()
        length = angle = 0.0
        if len(self.read):
            left = self.read @ rotation.T + shift - self.expected
            size = np.sqrt(np.sum((self.expected - self.expected.mean(axis=0)) ** 2))
            length = float(np.sqrt(np.sum(left**2)) / max(size, 1e-12))
        if len(self.read_turns):
            off = (rotation @ self.read_turns).transpose(0, 2, 1) @ self.expected_turns
            angle = float(np.sqrt(np.mean(Rotation.from_matrix(off).magnitude() ** 2)))
        return length, angle


def placed(problem: P) -> P:
    """The problem with instruments, whose pose is not known, where the nominal machine sees them."""
    nominal = problem.parameters.nominal.copy()
    for owner, sighting in sightings(problem):
        rotation, shift = sighting.pose()
        at = problem.parameters.index(f"{owner}.x")
        nominal[at : at + 6] = [*shift, *Rotation.from_matrix(rotation).as_rotvec()]
    return replace(problem, parameters=replace(problem.parameters, nominal=nominal))


def sightings(problem: PoseEquations) -> Iterator[tuple[str, Sighting]]:
    """What every instrument whose pose is not known saw in each set-up, by the name that its parameters begin with."""
    model, layout = problem.model, problem.layout
    if not any(layout.present[:, columns].any() for columns in model.instruments.values()):
        return
    own = sorted(row for columns in model.instruments.values() for row in columns)
    others = layout.present.copy()
    others[:, own] = False
    alone = replace(problem, layout=replace(layout, present=others))
    q = follow_unsensed(alone, problem.start, guess_unsensed(alone, problem.start))
    place = problem.places(problem.start)
    place[:, list(model.readings.values())] = 0.0
    for name in model.instruments:
        place[:, model.inputs[f"{name}.pose"]] = 0.0  # as seen from its link
    expected = model.over(model.observed, problem.start[: len(model.parameters)], q, place)[0][:, :, 0]
    for name in model.instruments:
        groups = [(each.unit, [model.channels.index(channel) for channel in each.channels], each.name)
                  for each in model.measurements if each.owner == name]
        firsts = layout.place[:, model.inputs[f"{name}.pose"].start]
        for first in np.unique(firsts[firsts >= 0]):
            rows = firsts == first
            yield (problem.parameters.names[first].removesuffix(".x"),
                   _sighting(problem, expected, groups, rows))


def _sighting(problem: PoseEquations, expected: Array, groups: list[tuple[str, list[int], str]],
              rows: NDArray[np.bool_]) -> Sighting:
    layout, model = problem.layout, problem.model
    read: list[Array] = []
    seen: list[Array] = []
    turns: list[tuple[Array, Array]] = []
    turned: dict[tuple[int, str], int] = {}
    sigma = 0.0
    for unit, columns, name in groups:
        if unit == "rad":
            given = [model.readings[column] for column in columns]
            for row in np.flatnonzero(rows & layout.present[:, columns].all(axis=1)):
                turned[int(row), name.removesuffix(".turn")] = len(turns)
                turns.append((layout.given[row, given], expected[row, columns]))
    which = []
    for unit, columns, name in groups:
        if unit == "m":
            for row in np.flatnonzero(rows & layout.present[:, columns].all(axis=1)):
                read.append(layout.target[row, columns])
                seen.append(expected[row, columns])
                which.append(turned.get((int(row), name), -1))
                sigma = max(sigma, float(problem.row_sigma[row, columns].max()))
    vectors = np.array(turns).reshape(-1, 2, 3)
    matrices = [Rotation.from_rotvec(vectors[:, k]).as_matrix() if len(vectors) else np.zeros((0, 3, 3))
                for k in range(2)]
    return Sighting(np.array(read).reshape(-1, 3), np.array(seen).reshape(-1, 3), matrices[0], matrices[1],
                    np.array(which, dtype=int), sigma)
