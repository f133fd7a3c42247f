"""The physically consistent estimate: a semidefinite program, and the bounded quadratic program inside it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hydroopt.errors import SolverError
from hydroopt.estimation.inference import convex_program
from hydroopt.estimation.inference.conditions import Condition
from hydroopt.estimation.inference.nearest_point import cones, nearest_point
from hydroopt.estimation.inference.problem import InferenceProblem, names_of
from hydroopt.estimation.inference.whitening import GaussianPosterior
from hydroopt.spatial.inertia import Array


@dataclass(frozen=True, eq=False)
class Optimum:
    """ψ (p,) and the names of the active constraints."""

    psi: Array
    active: tuple[str, ...]


def semidefinite_program(problem: InferenceProblem, posterior: GaussianPosterior, *, consistent: bool) -> Optimum:
    """The most probable ψ under bounds, constraints and, if asked, physical consistency.

    Raises:
        ProblemError: constraints contradict each other; the smallest contradicting set is named.
        SolverError: the solver's answer is not to be trusted.
    """
    conditions = problem.requirements(consistent=consistent)
    if problem.constraints or problem.distance == "log-det":  # cvxpy knows these
        psi, held = convex_program.most_probable(problem, posterior, consistent=consistent)
    elif found := _nearest(problem, posterior, conditions):
        psi, held = found
    else:
        raise convex_program.contradiction(problem, posterior, consistent=consistent)
    for body in problem.bodies if consistent else ():
        smallest = np.linalg.eigvalsh(body.pseudo_inertia(psi[body.columns]))[0]
        if smallest <= 0:
            raise SolverError(f"the body '{body.owner}' came out physically inconsistent (smallest eigenvalue "
                              f"{smallest:.1e})", where=problem.where,
                              remedy="widen its prior or the constraints on it")
    active = held | {c.name for c in conditions if c.kind == "zero"}
    return Optimum(psi, tuple(name for name in names_of(problem, consistent=consistent) if name in active))


def _nearest(problem: InferenceProblem, posterior: GaussianPosterior,
             conditions: Sequence[Condition]) -> tuple[Array, frozenset[str]] | None:
    """ψ and the active inequalities under conditions alone; None if they contradict each other."""
    conditioned = posterior.conditioned_on(conditions)
    if conditioned is None:
        return None
    origin, within = np.zeros(conditioned.slope.shape[1]), cones(conditions, conditioned)
    if all(cone.least(origin) >= 0 for cone in within):
        return conditioned.offset, frozenset()  # the least possible ‖z‖, without a solver's rounding
    found = nearest_point(origin, within, problem.where)
    return None if found is None else (conditioned.offset + conditioned.slope @ found.z, found.active)


def inner_point(problem: InferenceProblem, posterior: GaussianPosterior, z: Array, *, consistent: bool,
                margin: float) -> Array | None:
    """The point (k,) nearest to z that fulfils every inequality and matrix with a margin; None if none is found.

    The user's own constraints are ignored.
    """
    within = cones(problem.requirements(consistent=consistent), posterior, margin)
    try:
        found = nearest_point(z, within, problem.where)
    except SolverError:  # the estimate holds; without a start there are no intervals, which a note states
        return None
    return None if found is None else found.z
