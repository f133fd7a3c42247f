"""The estimate as cvxpy's convex program, for users who extend it, and for constraints that only cvxpy understands."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from hydroopt.errors import ProblemError
from hydroopt.estimation.inference import clarabel
from hydroopt.estimation.inference.conditions import MARGIN, Condition, square
from hydroopt.estimation.inference.constraints import Named, no_relation
from hydroopt.estimation.inference.nearest_point import cones, nearest_point
from hydroopt.estimation.inference.problem import InferenceProblem, names_of
from hydroopt.estimation.inference.whitening import WIDEST, GaussianPosterior, gaussian_posterior
from hydroopt.extras import Lazy
from hydroopt.spatial import inertia
from hydroopt.spatial.inertia import Array

if TYPE_CHECKING:
    import cvxpy as cp
else:  # takes long to load, and most problems do without it
    cp = Lazy("cvxpy", "constraints of one's own, log-det distances and contradictions are stated with cvxpy",
              where="constraints")

NamedConstraints = list[tuple[str, list[Any]]]


@dataclass(frozen=True, eq=False)
class ConvexProgram:
    """A problem as cvxpy's convex program, which a user extends and solves with cvxpy.

    Its variables are the whitened coordinates z of the posterior, ψ = offset + slope·z, because convex solvers need
    variables of one size; an expression of the user's own takes parameters by name, ``program["boom.m"]``.

    Attributes:
        problem: objective and constraints; equalities hold by the choice of z.
        psi: (p,) expression of the parameters ψ in SI.
        variables: the same by name.
        constraints: each inequality and matrix by name.
    """

    problem: cp.Problem
    psi: cp.Expression
    variables: Mapping[str, cp.Expression]
    constraints: Mapping[str, list[Any]]

    def __getitem__(self, name: str) -> cp.Expression:
        """The expression of a parameter.

        Raises:
            ProblemError: there is no such parameter.
        """
        if name not in self.variables:
            raise ProblemError("no parameter has this name", where=f"parameter '{name}'",
                               remedy=f"choose one of {', '.join(list(self.variables)[:8])}, …")
        return self.variables[name]

    def __repr__(self) -> str:
        return f"ConvexProgram({len(self.variables)} parameters, {len(self.constraints)} constraints)"


def most_probable(problem: InferenceProblem, unconstrained: GaussianPosterior, *,
              consistent: bool) -> tuple[Array, frozenset[str]]:
    """The most probable ψ (p,) and the names of the active inequalities.

    Raises:
        ProblemError: constraints contradict each other; the smallest contradicting set is named.
        SolverError: the solver's answer is not to be trusted.
    """
    posterior, z, cost, named = _program(problem, unconstrained, consistent=consistent)
    everything = [c for _, group in named for c in group]
    z.value = np.zeros(z.shape)
    if not _distant(problem) and all(np.all(c.violation() <= 0) for c in everything):
        return posterior.offset, frozenset()
    if not clarabel.solve_convex(cp.Problem(cp.Minimize(cost), everything), problem.where):
        raise contradiction(problem, unconstrained, consistent=consistent)
    value = np.asarray(z.value, dtype=float)
    clarabel.certify_convex(z, _gradient(problem, posterior, value), everything).trust(problem.where)
    return (posterior.offset + posterior.slope @ value,
            frozenset(name for name, group in named if _is_active(group)))


def convex_program(problem: InferenceProblem, R: Array, r: Array, rest: float = 0.0) -> ConvexProgram:
    """The program that `semidefinite_program` solves, with residuals ``‖R·ψ − r‖² + rest``.

    Raises:
        ProblemError: a constraint is not convex; or constraints contradict each other, and the smallest contradicting
            set is named.
    """
    unconstrained = gaussian_posterior(problem, R, r)
    posterior, z, cost, named = _program(problem, unconstrained, consistent=problem.consistent)
    curved = [name for name, group in named if not all(c.is_dcp() for c in group)]
    if curved:
        raise ProblemError(f"not convex: {', '.join(curved)}", where=problem.where,
                           remedy="use problem.nlp(), whose constraints need not be convex")
    parameters, offset = problem.parameters, posterior.offset
    squares, right = problem.square_rows
    wide = (offset - parameters.nominal) / (WIDEST * parameters.scale)
    # the cost at z = 0, which whitened coordinates leave out
    rest += float(np.sum((R @ offset - r) ** 2) + np.sum((squares @ offset - right) ** 2) + np.sum(wide**2))
    rest -= float(np.sum(posterior.right**2)) if _distant(problem) else 0.0
    psi = posterior.offset + posterior.slope @ z
    return ConvexProgram(cp.Problem(cp.Minimize(cost + rest), [c for _, group in named for c in group]), psi,
                         {name: psi[k] for k, name in enumerate(parameters.names)}, dict(named))


def _program(problem: InferenceProblem, unconstrained: GaussianPosterior, *,
             consistent: bool) -> tuple[GaussianPosterior, cp.Variable, Any, NamedConstraints]:
    """The posterior where equalities hold, its coordinates z, the cost, and the constraints by name.

    Raises:
        ProblemError: constraints contradict each other; the smallest contradicting set is named.
    """
    posterior = unconstrained.conditioned_on(problem.requirements(consistent=consistent))
    if posterior is None:
        raise contradiction(problem, unconstrained, consistent=consistent)
    z = cp.Variable(posterior.slope.shape[1], name="z")
    named = constraints_of(problem, posterior, z, consistent=consistent)
    cost = cp.sum_squares(z) if not _distant(problem) else (
        cp.sum_squares(posterior.root @ z - posterior.right) + sum(_distances(problem, posterior, z)))
    return posterior, z, cost, named


def constraints_of(problem: InferenceProblem, posterior: GaussianPosterior, z: cp.Variable, *, consistent: bool,
                   without: Collection[str] = ()) -> NamedConstraints:
    """Constraints by name but some, in terms of the Gaussian's coordinates z, which hold equalities by themselves."""
    named: dict[str, list[Any]] = {}
    for condition in problem.requirements(consistent=consistent):
        if condition.kind != "zero" and condition.name not in without:
            named.setdefault(condition.name, []).append(_constraint(condition, posterior, z))
    view = Named(problem.parameters, lambda k: posterior.offset[k] + posterior.slope[k] @ z)
    for constraint in problem.constraints:
        if constraint.name in without:
            continue
        relation = constraint.evaluated(view, convex=True)
        if not isinstance(relation, cp.Constraint):
            raise no_relation(constraint)
        named[constraint.name] = [relation]
    return list(named.items())


def refuse_contradiction(problem: InferenceProblem, posterior: GaussianPosterior, *, consistent: bool) -> None:
    """Name the contradicting constraints after a solver failed; nothing if a constraint is not convex.

    Raises:
        ProblemError: constraints contradict each other; the smallest contradicting set is named.
    """
    try:
        named = constraints_of(problem, posterior, cp.Variable(posterior.slope.shape[1]), consistent=consistent)
    except ProblemError:  # one that only CasADi understands
        return
    convex = all(c.is_dcp() for _, group in named for c in group)
    if convex and not _compatible(problem, posterior, consistent=consistent):
        raise contradiction(problem, posterior, consistent=consistent)


def _constraint(condition: Condition, posterior: GaussianPosterior, z: cp.Variable) -> Any:
    at_mean, slope = condition.evaluate(posterior.offset), condition.rows @ posterior.slope
    if condition.kind == "semidefinite":
        return _matrix(at_mean, slope, z) - MARGIN * np.eye(4) >> 0
    return slope @ z >= -at_mean


def _matrix(constant: Array, slope: Array, z: cp.Variable) -> Any:
    """Symmetric matrix (4, 4) whose upper triangle is linear in z."""
    full = np.array([square(entry).ravel() for entry in np.eye(10)]).T
    matrix = cp.reshape(full @ slope @ z, (4, 4), order="C") + square(constant)
    return (matrix + matrix.T) / 2


def _distant(problem: InferenceProblem) -> bool:
    return problem.distance == "log-det"


def _distances(problem: InferenceProblem, posterior: GaussianPosterior, z: cp.Variable) -> list[Any]:
    found = []
    for body in problem.bodies:
        W = _matrix(body.basis @ posterior.offset[body.columns], body.basis @ posterior.slope[body.columns], z)
        found.append(body.weight * (cp.trace(W) - cp.log_det(W) - 4))
    return found


def _gradient(problem: InferenceProblem, posterior: GaussianPosterior, z: Array) -> Array:
    """Gradient (k,) of the cost, for a check without cvxpy."""
    gradient: Array = 2 * posterior.root.T @ (posterior.root @ z - posterior.right)
    for body in problem.bodies if _distant(problem) else ():
        J = inertia.pseudo_inertia((posterior.offset + posterior.slope @ z)[body.columns])
        along = body.scaling.T @ body.scaling - np.linalg.inv(J)
        gradient += body.weight * posterior.slope[body.columns].T @ np.einsum("kij,ji", inertia.PSEUDO_BASIS, along)
    return gradient


def _is_active(group: Sequence[Any]) -> bool:
    return any(np.max(np.abs(np.asarray(c.dual_value, dtype=float))) > 1e-6 for c in group)


def _compatible(problem: InferenceProblem, posterior: GaussianPosterior, *, consistent: bool,
                without: Collection[str] = ()) -> bool:
    conditions = [c for c in problem.requirements(consistent=consistent) if c.name not in without]
    left = posterior.conditioned_on(conditions)
    if left is None:
        return False
    if not problem.constraints:
        return nearest_point(np.zeros(left.slope.shape[1]), cones(conditions, left), problem.where) is not None
    z = cp.Variable(left.slope.shape[1])
    named = constraints_of(problem, left, z, consistent=consistent, without=without)
    program = cp.Problem(cp.Minimize(cp.sum_squares(z)), [c for _, group in named for c in group])
    return clarabel.solve_convex(program, problem.where)


def contradiction(problem: InferenceProblem, posterior: GaussianPosterior, *, consistent: bool) -> ProblemError:
    """A smallest set of contradicting constraints: each is left out that the contradiction does not need."""
    names, without = names_of(problem, consistent=consistent), set[str]()
    for name in names:
        if not _compatible(problem, posterior, consistent=consistent, without=without | {name}):
            without.add(name)
    return ProblemError(f"these cannot hold together: {'; '.join(n for n in names if n not in without)}",
                        where=problem.where, remedy="drop or loosen one of them")
