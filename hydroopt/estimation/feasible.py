"""The physically consistent estimate: a semidefinite program, and the bounded quadratic program inside it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import cvxpy as cp
import numpy as np

from hydroopt import inertia, solvers
from hydroopt.errors import ProblemError, SolverError
from hydroopt.estimation.gaussian import Gaussian
from hydroopt.estimation.problem import Named, Problem, no_relation
from hydroopt.inertia import Array

MARGIN = 1e-7
"""Smallest eigenvalue allowed to a scaled pseudo-inertia: keeps bodies strictly possible despite rounding."""


@dataclass(frozen=True, eq=False)
class Solution:
    """ψ (p,) and the names of the constraints that hold it back."""

    psi: Array
    active: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class ScaledBody:
    """A body's place in ψ and the scaling that makes its pseudo-inertia about the identity's size."""

    owner: str
    columns: slice
    scaling: Array

    def pseudo_inertia(self, phi: Array) -> Array:
        """D·J(φ)·D (4, 4)."""
        return self.scaling @ inertia.pseudo_inertia(phi) @ self.scaling


def scaled_bodies(problem: Problem) -> tuple[ScaledBody, ...]:
    """All bodies of the problem, scaled by the mass and the radius of gyration of their nominal values."""
    found = []
    for k, name in enumerate(problem.parameters.names):
        if name.endswith(".m"):
            phi = problem.parameters.nominal[k : k + 10]
            mass = max(phi[0], 1e-3)
            second = max(np.trace(inertia.pseudo_inertia(phi)[:3, :3]) / 3, 1e-6 * mass)
            scaling = np.diag([*[1 / np.sqrt(second)] * 3, 1 / np.sqrt(mass)])
            found.append(ScaledBody(name.removesuffix(".m"), slice(k, k + 10), scaling))
    return tuple(found)


def solve(problem: Problem, belief: Gaussian, *, consistent: bool) -> Solution:
    """The most probable ψ under bounds, the user's constraints and, if asked, physical consistency.

    Raises:
        ProblemError: constraints contradict each other; the smallest contradicting set is named.
        SolverError: the solver's answer is not to be trusted.
    """
    where = f"identification of {problem.model.machine.name}"
    z = cp.Variable(belief.slope.shape[1])
    named = constraints_of(problem, belief, z, consistent=consistent)
    everything = [c for _, group in named for c in group]
    z.value = np.zeros(z.shape)
    if all(np.all(c.violation() <= 0) for c in everything):
        return Solution(belief.offset, ())  # the least possible ‖z‖, without a solver's rounding
    program = cp.Problem(cp.Minimize(cp.sum_squares(z)), everything)
    if not solvers.solve_convex(program, where):
        culprits = _contradiction(named, z, where)
        raise ProblemError(f"these cannot hold together: {'; '.join(culprits)}", where=where,
                           remedy="drop or loosen one of them")
    value = np.asarray(z.value, dtype=float)
    solvers.certify_convex(z, 2 * value, everything).trust(where)
    psi = belief.offset + belief.slope @ value
    for body in scaled_bodies(problem) if consistent else ():
        smallest = np.linalg.eigvalsh(body.pseudo_inertia(psi[body.columns]))[0]
        if smallest <= 0:
            raise SolverError(f"the body '{body.owner}' came out impossible (eigenvalue {smallest:.1e})", where=where,
                              remedy="widen its prior or the constraints on it")
    return Solution(psi, tuple(name for name, group in named if _is_active(group)))


def constraints_of(problem: Problem, belief: Gaussian, z: cp.Variable, *,
                   consistent: bool) -> list[tuple[str, list[Any]]]:
    """All constraints by name, in terms of the Gaussian's coordinates z."""
    parameters = problem.parameters
    step = belief.slope / parameters.scale[:, None]  # so that bounds of all units are of the same size
    named: list[tuple[str, list[Any]]] = []
    for k, name in enumerate(parameters.names):
        at, size = belief.offset[k], parameters.scale[k]
        if name in problem.fixed:
            named.append((f"{name} fixed", [step[k] @ z == (problem.fixed[name] - at) / size]))
            continue
        # a body's mass is positive anyway where bodies must be possible
        if np.isfinite(parameters.lower[k]) and not (consistent and name.endswith(".m") and parameters.lower[k] == 0):
            named.append((f"lower bound of {name}", [step[k] @ z >= (parameters.lower[k] - at) / size]))
        if np.isfinite(parameters.upper[k]):
            named.append((f"upper bound of {name}", [step[k] @ z <= (parameters.upper[k] - at) / size]))
    if consistent:
        named += [(f"physical consistency of {body.owner}", [_consistency(body, belief, z)])
                  for body in scaled_bodies(problem)]
    view = Named(parameters, lambda k: belief.offset[k] + belief.slope[k] @ z)
    for constraint in problem.constraints:
        relation = constraint.evaluated(view)
        if not isinstance(relation, cp.Constraint):
            raise no_relation(constraint)
        named.append((constraint.name, [relation]))
    return named


def _consistency(body: ScaledBody, belief: Gaussian, z: cp.Variable) -> Any:
    at_mean = body.pseudo_inertia(belief.offset[body.columns])
    basis = (body.scaling @ inertia.PSEUDO_BASIS @ body.scaling).reshape(10, 16)
    matrix = cp.reshape((basis.T @ belief.slope[body.columns]) @ z, (4, 4), order="C") + at_mean
    return (matrix + matrix.T) / 2 - MARGIN * np.eye(4) >> 0


def _is_active(group: Sequence[Any]) -> bool:
    return any(np.max(np.abs(np.asarray(c.dual_value, dtype=float))) > 1e-6 for c in group)


def _contradiction(named: list[tuple[str, list[Any]]], z: cp.Variable, where: str) -> list[str]:
    """A smallest set of constraints that cannot hold together: leave out one after the other what is not needed."""
    kept = list(named)
    for candidate in named:
        rest = [c for item in kept if item is not candidate for c in item[1]]
        if not solvers.solve_convex(cp.Problem(cp.Minimize(cp.sum_squares(z)), rest), where):
            kept.remove(candidate)
    return [name for name, _ in kept]
