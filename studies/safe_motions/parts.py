"""Cheap designs for random machines and sites, and what an independent look says of them."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from hydroopt.errors import ProblemError
from hydroopt.excitation.motion.design import excitation_problem
from hydroopt.excitation.motion.excitation import Excitation
from hydroopt.excitation.motion.problem import ExcitationProblem
from hydroopt.excitation.motion.random_motion import random_motion, resting_posture, shrunk
from hydroopt.excitation.motion.sqp import Search, sequential_quadratic_programming
from hydroopt.kernels import native
from studies.safe_motions.sites import random_basis, random_site
from studies.safe_motions.witness import Witness

RATE, STEPS, BACK_OFF = 20.0, 12, 0.001
NEAR = 0.05
"""Room of a limit, as a part of its scale, below which a motion comes near it."""


class Outcome(NamedTuple):
    """What became of a setting.

    `broken` is the part of draws under which any limit itself is broken, `used` the part under which a reserve of one
    limit is at one instant, for the worst of all limits and instants; `short` [m] is by how much a clearance misses.
    """

    refused: str
    moves: bool = False
    broken: float = 0.0
    tipped: float = 0.0
    used: float = 0.0
    used_at_all: float = 0.0
    short: float = 0.0
    nearest: str = ""
    tips: bool = False
    touches: bool = False
    presses: bool = False


def outcomes(seeds: range) -> list[Outcome]:
    """Of the settings of some seeds."""
    native.FEW = 10**9  # every setting is another function; CasADi's own machine is quicker for so few samples
    return [outcome(seed) for seed in seeds]


def outcome(seed: int) -> Outcome:
    """Design a short motion for a random machine on a random site, then look at it under drawn masses."""
    rng = np.random.default_rng(seed)
    machine, basis = random_site(rng), random_basis(rng)
    try:
        problem = excitation_problem(machine, basis, rate=RATE)
        found = cheap_design(problem, rng)
    except ProblemError as error:
        return Outcome(str(error))
    witness = Witness(problem.information.model, found, rng)
    holding, reserve = witness.tipping()
    pressures, allowed = witness.pressures()
    clearances = witness.clearances()
    nearest = min(clearances, key=clearances.__getitem__, default="")
    tipped = np.any(holding < 0, axis=(1, 2))
    used = holding < reserve, pressures > allowed
    courses = found.courses.values()
    return Outcome(
        "", bool(np.max(np.abs(found.trajectory.qd)) > 1e-3),
        float(np.mean(tipped | np.any(pressures > 1, axis=(1, 2)))), float(np.mean(tipped)),
        float(max(np.max(np.mean(each, axis=0), initial=0.0) for each in used)),
        float(np.mean(np.any(used[0], axis=(1, 2)) | np.any(used[1], axis=(1, 2)))),
        max(0.0, -clearances[nearest]) if nearest else 0.0, nearest,
        *(any(word in course.use.name and course.use.room < NEAR * _scale(problem, course.use.name)
              for course in courses) for word in ("tipping", "distance", " p_")))


def cheap_design(problem: ExcitationProblem, rng: np.random.Generator) -> Excitation:
    """A random motion, improved by few steps and scaled until it keeps all limits, as every design is."""
    rest = resting_posture(problem, rng)
    start = random_motion(problem, rest, rng)
    search = sequential_quadratic_programming(problem, Search.at(start), BACK_OFF, lambda: False, lambda _: None, STEPS)
    return Excitation(problem, min(start, shrunk(problem, search.best, rest), key=problem.value))


def _scale(problem: ExcitationProblem, name: str) -> float:
    return next(row.scale for row in problem.limits.rows if row.name == name)
