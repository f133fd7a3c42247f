"""Residuals of poses, their fit, both sides of a closed chain, and the prediction of held-out poses."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hydroopt.estimation.kinematic.initial_guesses import explained_by_unsensed, guess_unsensed
from hydroopt.estimation.kinematic.maximum_likelihood import maximum_likelihood
from hydroopt.estimation.kinematic.problem import CalibrationProblem, calibration_problem
from hydroopt.logs.poses import Poses
from hydroopt.results.fit import Fit
from hydroopt.results.tables import number
from hydroopt.spatial.inertia import Array

LOOP = ("gap", "turn")
"""Residuals of closed loops: of the tip's place [m] and, where the fixture is no ball, of the tool's turn [rad]."""


class PoseResiduals(NamedTuple):
    """Residuals of one role's poses, (N,) by channel, and their SI units.

    `before` stands at the nominal, `after` at the calibrated geometry.
    """

    role: str
    poses: Poses
    before: dict[str, Array]
    after: dict[str, Array]
    units: dict[str, str]


def groups(problem: CalibrationProblem) -> dict[str, tuple[list[int], str]]:
    """Rows of the model whose residuals are stated together, by name, and their SI unit: gap and turn of loops, the
    tip, lengths, distances, and what instruments, datums and inclinometers read."""
    model, found = problem.model, dict[str, tuple[list[int], str]]()
    measured = {channel: each for each in model.measurements for channel in each.channels}
    for i, channel in enumerate(model.channels):
        kind = channel.partition(".")[0]
        own = kind if kind in (*LOOP, "tip") and not channel.endswith(".distance") else channel
        name = measured[channel].name if channel in measured else own
        found.setdefault(name, ([], model.units[i]))[0].append(i)
    return found


def residual_sizes(problem: CalibrationProblem, theta: Array, q: Array) -> dict[str, Array]:
    """Size (N,) of every pose's residual, by `groups`; NaN where a pose does not have it."""
    left, sizes = gaps(problem, theta, q), {}
    for name, (some, _) in groups(problem).items():
        there = _there(problem, name, some)
        if np.any(there):
            sizes[name] = np.where(there, np.linalg.norm(left[:, some], axis=1), np.nan)
    return sizes


def _there(problem: CalibrationProblem, name: str, rows: list[int]) -> NDArray[np.bool_]:
    """(N,) which poses have all rows of a group; of loops, any: a plane holds the tip in one direction only."""
    present = problem.layout.present[:, rows]
    return np.asarray(present.any(axis=1) if name in LOOP else present.all(axis=1))


def gaps(problem: CalibrationProblem, theta: Array, q: Array) -> Array:
    """(N, m) [m] residuals of every row: sensed angles as read, unsensed ones as they close best."""
    layout, model = problem.layout, problem.model
    rows, by_q = model.over(model.observed_by_angles, theta[: len(model.parameters)], q, problem.places(theta))
    by_q = np.where(layout.present[:, :, None], by_q, 0.0)
    rows = np.where(layout.present, rows[:, :, 0] - layout.target, 0.0)
    rows = rows + np.einsum("nij,nj->ni", by_q, np.where(layout.sensed, layout.reading - q, 0.0))
    left: Array = rows - np.einsum("nij,nj->ni", by_q, explained_by_unsensed(by_q, layout.moving, rows))
    return left


def loop_fit(problem: CalibrationProblem, theta: Array, q: Array) -> dict[str, Fit]:
    """RMS [m] and VAF of the loops' gaps and of all other readings (Eq. 3.44-3.46).

    A gap is compared with how far the link that carries the calibrator travels over the poses.
    """
    left, layout, model = gaps(problem, theta, q), problem.layout, problem.model
    touches, table = {each.name for each in model.measurements if each.tool == "datum"}, dict[str, Fit]()
    for name, (some, unit) in groups(problem).items():
        there = _there(problem, name, some)
        if not np.any(there):
            continue
        signal = layout.given[:, [model.readings[i] for i in some]] if some[0] in model.readings else (
            layout.target[:, some])
        if name == "gap":
            chain = [link.name for link in model.machine.chain]
            assert model.machine.calibrator is not None
            ends = model.over(model.far_ends, theta[: len(model.parameters)], q)[0]
            signal = ends[:, :, chain.index(model.machine.calibrator.parent)]
        fit = Fit.of(left[there][:, some], signal[there], unit)
        # all readings of a datum are zero, or the radius of a ball
        alike = name == "turn" or name in touches
        table[name] = Fit(fit.rms, float("nan"), float("nan"), unit) if alike else fit
    return table


def predicted(problem: CalibrationProblem, theta: Array, poses: Poses) -> tuple[CalibrationProblem, Array, Array]:
    """Held-out poses under calibrated geometry: only what is new in them is fitted, such as where a fixture stood.

    Returns:
        Their problem, its parameters and joint vectors.
    """
    calibrated = dict(zip(problem.parameters.names, theta.tolist(), strict=True))
    fresh = calibration_problem(problem.model.machine, poses, priors=False)
    held = {name: calibrated[name] for name in fresh.parameters.names if name in calibrated and not (
        any(fixture.moves and name.startswith(f"{fixture.name}.") for fixture in problem.model.machine.fixtures))}
    trained = problem.angles(theta, problem.layout.reading)
    for name in fresh.parameters.names:
        joint_name, locked, stage = name.partition(".locked.")
        rows = problem.poses.stage == stage
        if locked and name not in held and np.any(rows):
            # held back here under the name of a later stage than in the poses that were fitted
            held[name] = float(trained[rows, problem.model.joints.index(joint_name)].mean())
    fresh = fresh.fixing(**held)
    start = fresh.start
    own = guess_unsensed(fresh, start)
    if np.any(fresh.free) or np.any(fresh.layout.moving):
        found, own = maximum_likelihood(fresh, start, own)
        return fresh, found, own
    return fresh, start, fresh.angles(start, fresh.layout.reading)


COMPARISONS = (("machine", "tape"), ("calibrator", "tape"), ("machine", "calibrator"))
"""What is compared with what."""


class ChainSides(NamedTuple):
    """Distances (N,) [m] from the far end of a link to the fixture in N poses; NaN where joints were not read.

    Attributes:
        geometry: ``nominal`` or ``calibrated``.
        role: of the poses, ``train`` or ``validation``.
        link: from whose far end the distance is.
        machine: by the joints before it, and the fixture's place.
        calibrator: by the joints behind it, while the ball is in the fixture.
        tape: as measured.
    """

    geometry: str
    role: str
    link: str
    machine: Array
    calibrator: Array
    tape: Array

    @property
    def fits(self) -> dict[tuple[str, str], Fit]:
        """RMS [m] and VAF of a side against tape or other side (Eqs. 3.44, 3.46), where some pose has both."""
        found = {}
        for pair in COMPARISONS:
            one, other = (getattr(self, side) for side in pair)
            both = np.isfinite(one) & np.isfinite(other)
            if np.any(both):
                found[pair] = Fit.of((one - other)[both], other[both], "m")
        return found

    def __str__(self) -> str:
        what = f"{self.link} to the fixture ({self.geometry}, {self.role})"
        return "; ".join(f"{what}, {one} against {other}: RMS {1e3 * fit.rms:.3f} mm, VAF {100 * fit.vaf:.3f} %"
                         for (one, other), fit in self.fits.items())

    def entries(self) -> Iterator[dict[str, Any]]:
        """The entries of a JSON file."""
        for (one, other), fit in self.fits.items():
            yield {"geometry": self.geometry, "data": self.role, "link": self.link, "side": one, "against": other,
                   **fit.as_dict()}


def chain_sides(problem: CalibrationProblem, theta: Array, geometry: str, role: str) -> tuple[ChainSides, ...]:
    """Both sides at parameters (P,), for every link whose distance two of machine, calibrator and tape tell.

    Listed are the link that carries the calibrator, and those from which a tape was read.
    """
    model, layout = problem.model, problem.layout
    machine = model.machine
    if machine.calibrator is None or not machine.fixtures:
        return ()
    q = problem.angles(theta, layout.reading)
    known = layout.sensed.copy()
    known.ravel()[layout.locked[0]] = True
    g = theta[: len(model.parameters)]
    ends = model.over(model.far_ends, g, q)[0].transpose(0, 2, 1)
    tip = model.over(model.tip, g, q)[0][:, None, :, 0]
    places = problem.places(theta)
    held = layout.held & layout.present[:, :3].all(axis=1)
    columns = {name.removesuffix(".distance"): i for i, name in enumerate(model.channels) if name.endswith(".distance")}
    chain = [link.name for link in machine.chain]
    found = []
    for k, link in enumerate(chain):
        taped = layout.present[:, columns[link]]
        if link != machine.calibrator.parent and not np.any(taped):
            continue
        before, behind = ([model.joints.index(name) for name in part if name in model.joints]
                          for part in (chain[: k + 1], chain[k + 1 :]))
        goal = np.where(taped[:, None], places[:, model.tape_end], places[:, :3])
        from_base = known[:, before].all(axis=1) & (held | taped) & bool(before)
        there = held & known[:, behind].all(axis=1) & bool(behind) & (
            ~taped | np.all(goal == places[:, :3], axis=1))
        sides = ChainSides(
            geometry, role, link, np.where(from_base, np.linalg.norm(ends[:, k] - goal, axis=1), np.nan),
            np.where(there, np.linalg.norm(tip[:, 0] - ends[:, k], axis=1), np.nan),
            np.where(taped, layout.target[:, columns[link]], np.nan))
        if sides.fits:
            found.append(sides)
    return tuple(found)


def table_of(sides: tuple[ChainSides, ...], rows: dict[str, NDArray[np.int64]]) -> list[dict[str, Any]]:
    """One row a pose and link, with both sides by both geometries; `rows` (N,) are the files' data rows by role."""
    table: list[dict[str, Any]] = []
    for role, link in dict.fromkeys((each.role, each.link) for each in sides):
        by = {each.geometry: each for each in sides if (each.role, each.link) == (role, link)}
        for k, row in enumerate(rows[role]):
            entry = {"data": role, "row": int(row), "link": link,
                     "tape [m]": number(next(iter(by.values())).tape[k])}
            for geometry in ("nominal", "calibrated"):
                for side in ("machine", "calibrator"):
                    entry[f"{side}_{geometry} [m]"] = number(getattr(by[geometry], side)[k]) if geometry in by else None
            table.append(entry)
    return table
