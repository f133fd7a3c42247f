"""What a user adds to a problem: relations between named parameters, in any solver's own symbols."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import casadi as ca

from hydroopt.errors import ProblemError
from hydroopt.parameters.parameter_set import ParameterSet


class Named(Mapping[str, Any]):
    """Parameters by name, as the solver at hand writes them: ``p["boom.m"]`` in CasADi or cvxpy."""

    def __init__(self, parameters: ParameterSet, symbols: Callable[[int], Any]) -> None:
        self._parameters, self._symbols = parameters, symbols

    def __getitem__(self, name: str) -> Any:
        return self._symbols(self._parameters.index(name))

    def __iter__(self) -> Iterator[str]:
        return iter(self._parameters.names)

    def __len__(self) -> int:
        return len(self._parameters)


Expression = Callable[[Named], Any]


def relation_in_casadi(constraint: Constraint, named: Named) -> ca.SX:
    """A constraint in CasADi, ``left == right`` or ``left <= right``.

    Raises:
        ProblemError: it is not one relation, or its function takes no symbols of CasADi.
    """
    relation = constraint.evaluated(named)
    if not isinstance(relation, ca.SX) or not relation.is_scalar() or relation.n_dep() != 2 \
            or relation.op() not in (ca.OP_EQ, ca.OP_LE, ca.OP_LT):
        raise no_relation(constraint)
    return relation


def as_casadi(constraint: Constraint, named: Named) -> tuple[ca.SX, bool]:
    """Left minus right side of a constraint in CasADi, and whether the two must be equal (else left ≤ right).

    Raises:
        ProblemError: as `relation_in_casadi`.
    """
    relation = relation_in_casadi(constraint, named)
    return relation.dep(0) - relation.dep(1), relation.op() == ca.OP_EQ


def no_relation(constraint: Constraint) -> ProblemError:
    """The error of a constraint that returns something else than a relation."""
    return ProblemError("it does not return a relation", where=f"constraint '{constraint.name}'",
                        remedy="return left == right, left <= right or left >= right")


@dataclass(frozen=True)
class Constraint:
    """A relation between parameters that must hold: `relation` returns ``left == right``, ``<=`` or ``>=``."""

    name: str
    relation: Expression

    def evaluated(self, named: Named, *, convex: bool = False) -> Any:
        """The relation in a solver's own symbols, those of cvxpy where the method is `convex`.

        Raises:
            ProblemError: the function failed, for instance at a chain such as ``1 <= x <= 2``.
        """
        remedy = "state one relation, left == right, left <= right or left >= right"
        return result_of(self.relation, named, f"constraint '{self.name}'", remedy + (
            "; if it has functions of casadi, solve with method 'nlp', since the convex methods pass cvxpy expressions"
            if convex else ""))


def result_of(expression: Expression, named: Named, where: str, remedy: str) -> Any:
    """What a user's function returns.

    Raises:
        ProblemError: it failed.
    """
    try:
        return expression(named)
    except ProblemError:
        raise
    except Exception as error:
        reason = (str(error).splitlines() or [type(error).__name__])[0].rstrip(". ")
        raise ProblemError(f"its function failed ({reason})", where=where, remedy=remedy) from error
