"""The machine's side of the closed chain against the calibrator's: Tables 8 and 10 and Figure 19 of the thesis.

The distance from the far end of a link to the fixture follows from the angles of the joints before it (the machine's
side), and from those behind it, since the ball is in the fixture (the calibrator's side); a tape may have measured it.
Angles stand as read, those of locked joints as calibrated, so that the sides are not made to agree.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hydroopt.estimation.kinematic.problem import CalibrationProblem
from hydroopt.results.fit import Fit
from hydroopt.results.tables import number
from hydroopt.spatial.inertia import Array

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
