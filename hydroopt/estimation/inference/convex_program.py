"""The estimate as a convex program: cones that go to Clarabel, or to cvxpy where a user's own function is not affine.

Clarabel solves either (`hydroopt.estimation.inference.clarabel`). Conditions of physics and of the machine file need no
modelling language, which takes longer to load, and to translate a program, than Clarabel takes to solve it.
"""

from __future__ import annotations

import warnings
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from scipy.sparse import csc_matrix, triu

from hydroopt.errors import ProblemError, SolverError
from hydroopt.estimation.inference import clarabel
from hydroopt.estimation.inference.conditions import MARGIN, SYMMETRIC, UPPER, Condition, square
from hydroopt.estimation.inference.constraints import Named, no_relation
from hydroopt.estimation.inference.problem import StatedProblem, names_of
from hydroopt.estimation.inference.whitening import WIDEST, GaussianPosterior, gaussian_posterior
from hydroopt.spatial.inertia import Array

if TYPE_CHECKING:
    import cvxpy as cp

ACTIVE = 1e-6
"""Multiplier from which on a condition counts as active."""
DIAGONAL = UPPER[0] == UPPER[1]
BY_COLUMN = np.lexsort(UPPER)
"""Entries of an upper triangle, which we have row by row, in Clarabel's order: column by column."""
LENGTH = np.where(DIAGONAL, 1.0, np.sqrt(2.0))
"""What gives the triangle the length of the matrix."""


class Optimum(NamedTuple):
    """ψ (p,) and the names of the active constraints."""

    psi: Array
    active: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class Cone:
    """A condition on z (k,): constant + slope·z is not negative, or the upper triangle (10,) of a possible matrix."""

    name: str
    matrix: bool
    constant: Array
    slope: Array

    def least(self, z: Array) -> float:
        """The smallest value or eigenvalue at z."""
        values = self.constant + self.slope @ z
        return float(np.min(np.linalg.eigvalsh(square(values)) if self.matrix else values, initial=np.inf))

    def rows(self) -> tuple[Array, Array]:
        """Slope (m, k) and constant (m,) as Clarabel orders and scales them."""
        if not self.matrix:
            return self.slope, self.constant
        return (LENGTH[:, None] * self.slope)[BY_COLUMN], (LENGTH * self.constant)[BY_COLUMN]

    def in_cvxpy(self, z: cp.Variable) -> Any:
        """The same as cvxpy's constraint."""
        return _matrix(self.constant, self.slope, z) >> 0 if self.matrix else self.slope @ z >= -self.constant


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


def semidefinite_program(problem: StatedProblem, posterior: GaussianPosterior, *, consistent: bool) -> Optimum:
    """The most probable ψ under bounds, constraints and, if asked, physical consistency.

    Raises:
        ProblemError: constraints contradict each other; the smallest contradicting set is named.
        SolverError: the solver's answer is not to be trusted.
    """
    found = _most_probable(problem, posterior, consistent=consistent)
    if found is None:
        raise contradiction(problem, posterior, consistent=consistent)
    psi, held = found
    for body in problem.bodies if consistent else ():
        smallest = np.linalg.eigvalsh(body.pseudo_inertia(psi[body.columns]))[0]
        if smallest <= 0:
            raise SolverError(f"the body '{body.owner}' came out physically inconsistent (smallest eigenvalue "
                              f"{smallest:.1e})", where=problem.where,
                              remedy="widen its prior or the constraints on it")
    active = held | {c.name for c in problem.requirements(consistent=consistent) if c.kind == "zero"}
    return Optimum(psi, tuple(name for name in names_of(problem, consistent=consistent) if name in active))


def inner_point(problem: StatedProblem, posterior: GaussianPosterior, z: Array, *, consistent: bool,
                margin: float) -> Array | None:
    """The point (k,) nearest to z that fulfils every inequality and matrix with a margin; None if none is found.

    Functions of the user's own are ignored.
    """
    within = cones(problem.requirements(consistent=consistent), posterior, margin)
    try:
        found = nearest_point(z, within, problem.where)
    except SolverError:  # the estimate holds; without a start there are no intervals, which a note states
        return None
    return None if found is None else found[0]


def cones(conditions: Sequence[Condition], posterior: GaussianPosterior, margin: float = 0.0) -> tuple[Cone, ...]:
    """Inequalities and matrices with a margin, on the posterior's coordinates; equalities hold by their choice."""
    found = []
    for condition in conditions:
        if condition.kind != "zero":
            matrix = condition.kind == "semidefinite"
            away = (MARGIN + margin) * DIAGONAL if matrix else margin
            found.append(Cone(condition.name, matrix, condition.evaluate(posterior.offset) - away,
                              condition.rows @ posterior.slope))
    return tuple(found)


def nearest_point(target: Array, within: Sequence[Cone], where: str) -> tuple[Array, frozenset[str]] | None:
    """The point (k,) nearest to a target within cones, and the names of those that hold it back; None if they
    contradict each other.

    Raises:
        SolverError: no answer, or one that fails the check of its optimality.

    >>> positive = Cone("positive", False, np.zeros(1), np.array([[1.0, 0.0]]))
    >>> nearest_point(np.array([-1.0, 2.0]), [positive], "example")[0].round(6)
    array([0., 2.])
    """
    import clarabel as conic  # noqa: PLC0415 — loaded when it is used

    slopes, constants = zip((np.zeros((0, len(target))), np.zeros(0)), *(cone.rows() for cone in within), strict=True)
    kinds = [conic.PSDTriangleConeT(4) if cone.matrix else conic.NonnegativeConeT(len(cone.constant))
             for cone in within]
    found = clarabel.solve(csc_matrix(np.eye(len(target))), -target, csc_matrix(-np.vstack(slopes)),
                           np.concatenate(constants), kinds, where)
    if found is None:
        return None
    multipliers = np.split(np.abs(found.z), np.cumsum([len(part) for part in constants[1:]]))
    return np.array(found.x), frozenset(cone.name for cone, size in zip(within, multipliers, strict=False)
                                        if np.max(size, initial=0.0) > ACTIVE)


def convex_program(problem: StatedProblem, R: Array, r: Array, rest: float = 0.0) -> ConvexProgram:
    """The program that `semidefinite_program` solves, with residuals ``‖R·ψ − r‖² + rest``.

    Raises:
        ProblemError: a constraint is not convex; or constraints contradict each other, and the smallest contradicting
            set is named.
    """
    import cvxpy as cp  # noqa: PLC0415 — loaded when it is used

    unconstrained = gaussian_posterior(problem, R, r)
    posterior = unconstrained.conditioned_on(problem.requirements(consistent=problem.consistent))
    if posterior is None:
        raise contradiction(problem, unconstrained, consistent=problem.consistent)
    z, cost, named = _in_cvxpy(problem, posterior, consistent=problem.consistent)
    if curved := [name for name, group in named.items() if not all(c.is_dcp() for c in group)]:
        raise ProblemError(f"not convex: {', '.join(curved)}", where=problem.where,
                           remedy="use problem.nlp(), whose constraints need not be convex")
    parameters, offset = problem.parameters, posterior.offset
    squares, right = problem.square_rows
    wide = (offset - parameters.nominal) / (WIDEST * parameters.scale)
    # the cost at z = 0, which whitened coordinates leave out
    rest += float(np.sum((R @ offset - r) ** 2) + np.sum((squares @ offset - right) ** 2) + np.sum(wide**2))
    rest -= float(np.sum(posterior.right**2)) if _distant(problem) else 0.0
    psi = posterior.offset + posterior.slope @ z
    return ConvexProgram(cp.Problem(cp.Minimize(cost + rest), [c for group in named.values() for c in group]), psi,
                         {name: psi[k] for k, name in enumerate(parameters.names)}, named)


def refuse_contradiction(problem: StatedProblem, posterior: GaussianPosterior, *, consistent: bool) -> None:
    """Name the contradicting constraints after a solver failed; nothing if a constraint is not convex.

    Raises:
        ProblemError: constraints contradict each other; the smallest contradicting set is named.
    """
    try:
        if _most_probable(problem, posterior, consistent=consistent) is not None:
            return
        found = contradiction(problem, posterior, consistent=consistent)
    except (ProblemError, SolverError):  # one that only CasADi understands, or that is not convex
        return
    raise found


def contradiction(problem: StatedProblem, posterior: GaussianPosterior, *, consistent: bool) -> ProblemError:
    """A smallest set of contradicting constraints: each is left out that the contradiction does not need."""
    names, without = names_of(problem, consistent=consistent), set[str]()
    for name in names:
        if _most_probable(problem, posterior, consistent=consistent, without=without | {name}) is None:
            without.add(name)
    return ProblemError(f"these cannot hold together: {'; '.join(n for n in names if n not in without)}",
                        where=problem.where, remedy="drop or loosen one of them")


def _most_probable(problem: StatedProblem, posterior: GaussianPosterior, *, consistent: bool,
                   without: Collection[str] = ()) -> tuple[Array, frozenset[str]] | None:
    """The most probable ψ (p,) and the names of active inequalities; None if constraints contradict each other.

    Raises:
        ProblemError: a constraint does not return a relation.
        SolverError: a constraint is not convex, or the solver's answer is not to be trusted.
    """
    conditions = [c for c in problem.requirements(consistent=consistent) if c.name not in without]
    left = posterior.conditioned_on(conditions)
    if left is None:
        return None
    within, origin = cones(conditions, left), np.zeros(left.slope.shape[1])
    if problem.constraints or _distant(problem):
        found = _by_cvxpy(*_in_cvxpy(problem, left, consistent=consistent, without=without), problem.where)
    elif all(cone.least(origin) >= 0 for cone in within):
        found = origin, frozenset()  # the least possible ‖z‖, without a solver's rounding
    else:
        found = nearest_point(origin, within, problem.where)
    return None if found is None else (left.offset + left.slope @ found[0], found[1])


def _by_cvxpy(z: cp.Variable, cost: Any, named: Mapping[str, list[Any]],
              where: str) -> tuple[Array, frozenset[str]] | None:
    """What `nearest_point` finds, of a program that cvxpy translates for Clarabel.

    Raises:
        SolverError: a constraint is not convex; and as of `nearest_point`.
    """
    import cvxpy as cp  # noqa: PLC0415 — loaded when it is used
    from cvxpy.reductions.solvers.conic_solvers.clarabel_conif import dims_to_solver_cones  # noqa: PLC0415

    program = cp.Problem(cp.Minimize(cost), [c for group in named.values() for c in group])
    if not program.is_dcp():
        raise SolverError("a constraint is not convex", where=where, remedy="use method 'nlp'")
    data, chain, inverse = program.get_problem_data(cp.CLARABEL, solver_opts={})
    found = clarabel.solve(csc_matrix(triu(data["P"])), data["c"], data["A"], data["b"],
                           dims_to_solver_cones(data["dims"]), where)
    if found is None:
        return None
    with warnings.catch_warnings():  # the certificate has decided about an inaccurate answer
        warnings.simplefilter("ignore", UserWarning)
        program.unpack_results(found, chain, inverse)
    return np.asarray(z.value, dtype=float), frozenset(name for name, group in named.items() if any(
        np.max(np.abs(np.asarray(c.dual_value, dtype=float))) > ACTIVE for c in group))


def _in_cvxpy(problem: StatedProblem, posterior: GaussianPosterior, *, consistent: bool,
              without: Collection[str] = ()) -> tuple[cp.Variable, Any, dict[str, list[Any]]]:
    """The Gaussian's coordinates z, which hold equalities by themselves, the cost, and constraints by name but some.

    Raises:
        ProblemError: a constraint does not return a relation.
    """
    import cvxpy as cp  # noqa: PLC0415 — loaded when it is used

    z = cp.Variable(posterior.slope.shape[1], name="z")
    named: dict[str, list[Any]] = {}
    for cone in cones(problem.requirements(consistent=consistent), posterior):
        if cone.name not in without:
            named.setdefault(cone.name, []).append(cone.in_cvxpy(z))
    view = Named(problem.parameters, lambda k: posterior.offset[k] + posterior.slope[k] @ z)
    for constraint in problem.constraints:
        if constraint.name not in without:
            relation = constraint.evaluated(view, convex=True)
            if not isinstance(relation, cp.Constraint):
                raise no_relation(constraint)
            named[constraint.name] = [relation]
    if not _distant(problem):
        return z, cp.sum_squares(z), named
    cost = cp.sum_squares(posterior.root @ z - posterior.right)
    for body in problem.bodies:
        W = _matrix(body.basis @ posterior.offset[body.columns], body.basis @ posterior.slope[body.columns], z)
        cost += body.weight * (cp.trace(W) - cp.log_det(W) - 4)
    return z, cost, named


def _matrix(constant: Array, slope: Array, z: cp.Variable) -> Any:
    """Symmetric matrix (4, 4) whose upper triangle is linear in z, in cvxpy."""
    import cvxpy as cp  # noqa: PLC0415 — loaded when it is used

    matrix = cp.reshape(SYMMETRIC @ slope @ z, (4, 4), order="C") + square(constant)
    return (matrix + matrix.T) / 2


def _distant(problem: StatedProblem) -> bool:
    return problem.distance == "log-det"
