"""A problem in plain text, as an optimisation model: tables of variables and constraints; long ones are shortened."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import casadi as ca
import numpy as np

from hydroopt.errors import ProblemError
from hydroopt.estimation.inference.conditions import Condition
from hydroopt.estimation.inference.constraints import Constraint, Named, relation_in_casadi
from hydroopt.estimation.inference.priors import Prior
from hydroopt.parameters.parameter_set import ParameterSet
from hydroopt.spatial.inertia import Array

MOST = 40
"""Rows of a table at most."""


def table(header: Sequence[str], rows: Sequence[Sequence[str]], *, most: int = MOST) -> list[str]:
    """Lines of a table whose columns are aligned; beyond `most` rows the last line states how many are left out.

    >>> print("\\n".join(table(("name", "unit"), [("boom.m", "kg"), ("boom.mc_x", "kg*m"), ("boom.mc_y", "kg*m")],
    ...                        most=2)))
      name    unit
      boom.m  kg
      … 2 more
    """
    if not rows:
        return ["  none"]
    shown = list(rows) if len(rows) <= most else list(rows[: most - 1])
    widths = [max(len(row[k]) for row in (header, *shown)) for k in range(len(header))]
    lines = ["  " + "  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip()
             for row in (header, *shown)]
    return [*lines, *([f"  … {len(rows) - len(shown)} more"] if len(shown) < len(rows) else [])]


def counted(count: int, noun: str) -> str:
    """A number with its noun.

    >>> counted(2, "constraint")
    '2 constraints'
    """
    return f"{count} {noun}{'s' * (count != 1)}"


def named_row(*cells: str | float) -> tuple[str, ...]:
    """Cells of a row as text: numbers to six digits, infinite ones as a dash.

    >>> named_row("boom.m", "kg", 1560.0, 0.0, float("inf"))
    ('boom.m', 'kg', '1560', '0', '–')
    """
    return tuple(cell if isinstance(cell, str) else number(cell) for cell in cells)


def number(value: float) -> str:
    """Six digits, or a dash for a number that is infinite or unknown."""
    return f"{value:.6g}" if abs(value) < float("inf") else "–"


def variables(parameters: ParameterSet, fixed: Mapping[str, float]) -> list[str]:
    """Table of the parameters: name, unit, nominal value, standard deviation of the prior, and bounds, all in SI."""
    known = np.diag(parameters.information) > 0
    covariance = np.linalg.inv(parameters.information + np.diag(~known * 1.0))
    sigma = np.where(known, np.sqrt(np.maximum(np.diag(covariance), 0.0)), np.inf)
    rows = []
    for k, name in enumerate(parameters.names):
        low, high = (fixed.get(name, bound[k]) for bound in (parameters.lower, parameters.upper))
        rows.append(named_row(name, parameters.units[k], parameters.nominal[k], sigma[k], low, high))
    return table(("name", "unit", "nominal", "prior sigma", "lower bound", "upper bound"), rows)


def constraints(parameters: ParameterSet, conditions: Sequence[Condition], users: Sequence[Constraint]) -> list[str]:
    """Table of the constraints that are more than a bound: name, relation in SI, and the units of its parameters."""
    rows = [(c.name, _relation(parameters, c), _units(parameters, np.any(c.rows != 0, axis=0))) for c in conditions]
    return table(("name", "relation", "unit"), [*rows, *(_user_row(parameters, one) for one in users)])


def prior(parameters: ParameterSet, one: Prior) -> str:
    """A prior in one line: ``boom.m + stick.m = 2518 ± 25 kg``."""
    unit = _units(parameters, one.row != 0)
    return f"prior {one.name}: {_sum(parameters, one.row)} = {number(one.value)} ± {number(one.sigma)} {unit}"


def _relation(parameters: ParameterSet, condition: Condition) -> str:
    if condition.kind == "semidefinite":
        return "matrix (4, 4) positive semidefinite"
    sign = {"zero": "=", "nonnegative": "≥"}[condition.kind]
    if len(condition.rows) > 1:
        return f"{len(condition.rows)} linear sums {sign} 0"
    row, right = condition.rows[0], condition.right[0]
    if sign == "≥" and np.all(row <= 0):
        row, right, sign = -row, -right, "≤"
    size = float(np.min(np.abs(row[row != 0]), initial=np.inf))  # conditions are scaled
    return f"{_sum(parameters, row / size)} {sign} {number(right / size)}"


def _sum(parameters: ParameterSet, row: Array) -> str:
    terms: list[str] = []
    for k in np.flatnonzero(row):
        size = "" if abs(abs(row[k]) - 1) < 1e-9 else f"{number(abs(row[k]))}·"
        sign = ("− " if row[k] < 0 else "") if not terms else ("− " if row[k] < 0 else "+ ")
        terms.append(f"{sign}{size}{parameters.names[k]}")
    return " ".join(terms if len(terms) <= 6 else [*terms[:5], f"… {len(terms) - 5} more terms"])


def _user_row(parameters: ParameterSet, constraint: Constraint) -> tuple[str, str, str]:
    symbols = [ca.SX.sym(name) for name in parameters.names]
    try:
        relation = relation_in_casadi(constraint, Named(parameters, symbols.__getitem__))
    except ProblemError:
        return constraint.name, "stated in cvxpy", ""
    used = np.array(ca.which_depends(relation.dep(0) - relation.dep(1), ca.vertcat(*symbols), 1, False))
    text = str(relation)
    return constraint.name, text if len(text) <= 80 else f"{text[:77]}…", _units(parameters, used)


def _units(parameters: ParameterSet, used: Array | np.ndarray) -> str:
    return ", ".join(dict.fromkeys(parameters.units[k] for k in np.flatnonzero(used)))
