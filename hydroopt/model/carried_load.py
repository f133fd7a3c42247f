"""What a body carried by a link adds to a machine's parameters."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from hydroopt.errors import ProblemError
from hydroopt.machine.machine import BASE
from hydroopt.model.model import Model
from hydroopt.parameters.dynamic import bodies
from hydroopt.spatial import inertia
from hydroopt.spatial.inertia import Array


def carried_load(model: Model, link: str, centre: ArrayLike = (0.0, 0.0, 0.0)) -> Array:
    """(p, 10): what a body adds to ψ, whose ten numbers stand in the frame of a link, moved to `centre` (3,) [m].

    A locked link's load is one of the link it is fixed to.

    Raises:
        ProblemError: there is no such link, or no body stands in for it.

    >>> from hydroopt.machine.machine_file import load_machine
    >>> model = Model(load_machine("cat215b"))
    >>> columns = carried_load(model, "stick", [1.8, 0.0, 0.0])
    >>> columns[model.parameters.select(["stick.m", "stick.mc_x", "stick.I_zz"]), 0].round(2).tolist()
    [1.0, 1.8, 3.24]
    """
    machine, stated = model.machine, bodies(model.machine)
    known = [one.name for one in machine.links]
    if link not in known:
        raise ProblemError(f"there is no link '{link}'", where="link", remedy=f"use one of {', '.join(known)}")
    holder = link
    while holder not in stated and holder != BASE and machine.link(holder).joint.type == "locked":
        holder = machine.link(holder).parent
    if holder not in stated:
        able = [name for name in known if name in stated]
        raise ProblemError(f"the link '{holder}' has no body in the machine file, to which a load could be added",
                           where="link", remedy=f"state one{', or use one of ' * bool(able)}{', '.join(able)}")
    at, moved = np.eye(4), np.eye(4)
    moved[:3, 3] = centre
    if holder != link:
        pose = model.geometry.far_end(holder) @ model.geometry.relative_pose(holder, link, {})
        at = pose.matrix()
    at = at @ moved
    columns = np.zeros((len(model.parameters), 10))
    columns[model.parameters.bodies[holder]] = np.stack([inertia.from_pseudo_inertia(at @ one @ at.T)
                                                         for one in inertia.PSEUDO_BASIS]).T
    return columns
