"""Where instruments stand whose pose is not known: initial guesses from what they see, and what they cannot see."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from hydroopt.errors import ProblemError
from hydroopt.estimation.kinematic.pose_equations import PoseEquations
from hydroopt.estimation.kinematic.unsensed_angles import follow_unsensed, guess_unsensed
from hydroopt.spatial.inertia import Array

if TYPE_CHECKING:
    from scipy.spatial.transform import Rotation

APART = 5.0
"""Standard deviations that places must lie off a line to tell how an instrument is turned about it."""
LARGE = 0.1
"""Misfit, as a part of the size of what was seen, from which on a mistake in the readings is looked for."""
TURNED = 0.5
"""Misfit of orientations [rad] from which on a mistake is looked for."""
BETTER = 0.2
"""Part of the misfit that must be left with other readings to say that they should be read so."""
UNITS = {"mm given as m": 1e-3, "cm given as m": 1e-2, "m given as mm": 1e3, "ft given as m": 0.3048}
"""Factors that correct mistaken units of positions."""
FLIP = np.diag([1.0, -1.0, -1.0])
"""Half a turn about x: from a camera's axes with y down and z ahead to those with y up and z behind."""

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
            angle = float(np.sqrt(np.mean(_rotations().from_matrix(off).magnitude() ** 2)))
        return length, angle


def placed(problem: P) -> P:
    """The problem with instruments, whose pose is not known, where the nominal machine sees them."""
    nominal = problem.parameters.nominal.copy()
    for owner, sighting in sightings(problem):
        rotation, shift = sighting.pose()
        at = problem.parameters.index(f"{owner}.x")
        nominal[at : at + 6] = [*shift, *_rotations().from_matrix(rotation).as_rotvec()]
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
    matrices = [_rotations().from_rotvec(vectors[:, k]).as_matrix() if len(vectors) else np.zeros((0, 3, 3))
                for k in range(2)]
    return Sighting(np.array(read).reshape(-1, 3), np.array(seen).reshape(-1, 3), matrices[0], matrices[1],
                    np.array(which, dtype=int), sigma)


def refuse_unseen(problem: PoseEquations) -> None:
    """Refuse set-ups that see too little, and readings of instruments that the nominal machine contradicts.

    A mistake is named only if the nominal machine agrees far better with readings in another unit or convention.

    Raises:
        ProblemError: which instrument, why, and what to do.
    """
    for owner, sighting in sightings(problem):
        name, _, setup = owner.partition(".")
        called = f"'{name}' in set-up '{setup}'" if setup else f"'{name}'"
        where = f"poses of {problem.poses.name}"
        if problem.free[problem.parameters.index(f"{owner}.x")] and not sighting.complete:
            count = len(np.unique(np.round(sighting.read, 3), axis=0))
            raise ProblemError(
                f"{called} sees targets at {count} place{'s' * (count != 1)} only, all on a line: where it stands is "
                "not determined", where=where, remedy="measure targets at three places or more that are not on a line, "
                "those of the ground too, or leave the set-up out")
        usual, angle = sighting.misfit()
        if max(usual / LARGE, angle / TURNED) < 1:
            continue
        best, words, remedy = min(((max(length / LARGE, turn / TURNED), words, remedy)
                                   for (length, turn), words, remedy in _other_readings(sighting)),
                                  default=(np.inf, "", ""))
        if best < BETTER * max(usual / LARGE, angle / TURNED):
            raise ProblemError(f"{words}: as they stand, the nominal machine contradicts what {called} reads",
                               where=where, remedy=remedy)


def _other_readings(sighting: Sighting) -> Iterator[tuple[tuple[float, float], str, str]]:
    """Misfits with the readings taken otherwise, with what that means and its remedy."""
    if len(sighting.read) > 3:
        for mirror in 1 - 2 * np.eye(3):
            yield (sighting._replace(read=mirror * sighting.read).misfit(), "the positions seem to be mirrored, as in "
                   "left-handed axes", "reverse one axis, or exchange two columns back")
        for words, factor in UNITS.items():
            yield (sighting._replace(read=factor * sighting.read).misfit(), f"the positions seem to be {words}",
                   "correct the map or the header")
    if not len(sighting.read_turns):
        return
    read = sighting.read_turns
    order = "state the marker in the camera's frame, with the camera's axes for position and orientation alike"
    back = read.transpose(0, 2, 1)
    other = sighting._replace(read_turns=back)
    if len(sighting.read) and np.all(sighting.turned >= 0):
        own = back[sighting.turned]
        other = other._replace(read=-np.einsum("kij,kj->ki", own, sighting.read))
    yield (other.misfit(), "the poses seem to be those of the instrument in the target's frame", "invert them")
    yield (sighting._replace(read_turns=FLIP @ read).misfit(), "the orientations seem to be in other axes of the "
           "instrument than the positions, with y and z reversed", order)
    yield (sighting._replace(read_turns=read @ FLIP).misfit(), "the target's axes seem to be flipped, with y and z "
           "reversed", "turn the orientations, or state the target's 'orientation' in the machine file")
    scalar_last = _rotations().from_quat(np.roll(_rotations().from_matrix(read).as_quat(), 1, axis=1)).as_matrix()
    yield (sighting._replace(read_turns=scalar_last).misfit(), "the quaternions seem to have their scalar last, not "
           "first", "give the columns the headers qx, qy, qz, qw in that order")


def _rotations() -> type[Rotation]:
    """SciPy's rotations, which take longer to load than a calibration without instruments."""
    from scipy.spatial.transform import Rotation  # noqa: PLC0415

    return Rotation
