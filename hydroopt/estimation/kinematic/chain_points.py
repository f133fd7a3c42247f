"""The closed chain as points, for pictures of measured poses."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from hydroopt.estimation.kinematic.solution import KinematicSolution
from hydroopt.machine.geometry import Geometry
from hydroopt.machine.machine import BASE
from hydroopt.machine.mechanism import Mechanism
from hydroopt.model.closed_chain import KinematicModel
from hydroopt.spatial.inertia import Array


class ChainPoints(NamedTuple):
    """The closed chain in N poses [m].

    Attributes:
        points: (N, k, 3) from base to tip; the first `machine_links` links are the machine's.
        fixture: (N, 3); NaN where the tip is not held.
        pins: (N, c, 2, 3) of the cylinders, at the nominal geometry.
        carrier: (c, 2) number of the link that carries each pin; −1 for those beside the chain.
    """

    points: Array
    machine_links: int
    fixture: Array
    pins: Array
    carrier: NDArray[np.int64]


def chain_points(solution: KinematicSolution, rows: Sequence[int]) -> ChainPoints:
    """The calibrated chain in some of the training poses."""
    problem, model, some = solution.problem, solution.problem.model, list(rows)
    q, geometry = solution.q[some], solution.theta[: len(model.parameters)]
    ends = model.over(model.far_ends, geometry, q)[0].transpose(0, 2, 1)
    tip = model.over(model.tip, geometry, q)[0].transpose(0, 2, 1)
    held = problem.layout.held[some, None]
    chain = [link.name for link in model.machine.chain]
    own = sum(name in {link.name for link in model.machine.links} for name in chain)
    carrier = [[chain.index(end.link) if end.link in chain else -1 for end in (cylinder.barrel, cylinder.rod)]
               for cylinder in model.machine.pinned]
    return ChainPoints(np.concatenate([np.zeros_like(tip), ends, tip], axis=1), own,
                       np.where(held, problem.places(solution.theta)[some, :3], np.nan), _pins(model, q),
                       np.array(carrier, dtype=int).reshape(-1, 2))


def _pins(model: KinematicModel, q: Array) -> Array:
    """Pins (N, c, 2, 3) [m] of the cylinders in the base frame, at the nominal geometry."""
    machine, geometry = model.machine, Geometry(model.machine)
    symbols = ca.SX.sym("q", len(model.joints))
    angles = Mechanism(machine).positions(geometry, {joint: symbols[k] for k, joint in enumerate(model.joints)})
    places = [geometry.relative_pose(BASE, getattr(cylinder, end).link, angles).point(
        geometry.point(f"{cylinder.name}.{end}")) for cylinder in machine.pinned for end in ("barrel", "rod")]
    if not places:
        return np.zeros((len(q), 0, 2, 3))
    function = ca.Function("pins", [symbols], [ca.horzcat(*places)])
    values = np.asarray(function.map(len(q))(q.T))
    return values.T.reshape(len(q), len(machine.pinned), 2, 3)
