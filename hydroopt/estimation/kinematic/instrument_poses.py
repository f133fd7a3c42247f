"""Where instruments stand whose pose is not known: initial guesses from what they see."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from hydroopt.estimation.kinematic.pose_equations import PoseEquations
from hydroopt.estimation.kinematic.unsensed_angles import follow_unsensed, guess_unsensed
from hydroopt.spatial.inertia import Array

if TYPE_CHECKING:
    from scipy.spatial.transform import Rotation

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
        read, expected = self.read, self.expected
        if self.spread[1] > APART * self.sigma:
            u, _, vt = np.linalg.svd((read - read.mean(axis=0)).T @ (expected - expected.mean(axis=0)))
            rotation = (u @ np.diag([1.0, 1.0, np.sign(np.linalg.det(u @ vt))]) @ vt).T
        elif len(self.read_turns):
            u, _, vt = np.linalg.svd(np.sum(self.expected_turns @ self.read_turns.transpose(0, 2, 1), axis=0))
            rotation = u @ np.diag([1.0, 1.0, np.sign(np.linalg.det(u @ vt))]) @ vt
        else:
            rotation = np.eye(3)
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
            angle = float(np.sqrt(np.mean(rotations().from_matrix(off).magnitude() ** 2)))
        return length, angle


def placed(problem: P) -> P:
    """The problem with instruments, whose pose is not known, where the nominal machine sees them."""
    nominal = problem.parameters.nominal.copy()
    for owner, sighting in sightings(problem):
        rotation, shift = sighting.pose()
        at = problem.parameters.index(f"{owner}.x")
        nominal[at : at + 6] = [*shift, *rotations().from_matrix(rotation).as_rotvec()]
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
                  for each in model.measurements if each.name.partition(".")[0] == name]
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
    matrices = [rotations().from_rotvec(vectors[:, k]).as_matrix() if len(vectors) else np.zeros((0, 3, 3))
                for k in range(2)]
    return Sighting(np.array(read).reshape(-1, 3), np.array(seen).reshape(-1, 3), matrices[0], matrices[1],
                    np.array(which, dtype=int), sigma)


def rotations() -> type[Rotation]:
    """SciPy's rotations, which take longer to load than a calibration without instruments."""
    from scipy.spatial.transform import Rotation  # noqa: PLC0415

    return Rotation
