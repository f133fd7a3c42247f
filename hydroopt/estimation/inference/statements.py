"""Constraints and priors as text: ``boom.m + stick.m == 2518 kg``, ``boom.m = 1520 +- 20 kg``; read, never executed."""

from __future__ import annotations

import ast
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from math import isfinite

import casadi as ca
import numpy as np

from hydroopt.errors import ProblemError
from hydroopt.estimation.inference import conditions
from hydroopt.estimation.inference.conditions import Condition
from hydroopt.estimation.inference.constraints import Constraint, Expression, Named, as_casadi
from hydroopt.estimation.inference.priors import Prior, linear_prior
from hydroopt.parameters.parameter_set import ParameterSet
from hydroopt.spatial.inertia import Array
from hydroopt.units import base_unit, factor, same_kind, to_si

CONSTRAINT, PRIOR = "'boom.m + stick.m == 2518 kg'", "'boom.m = 1520 +- 20 kg'"
"""How statements are written."""
LONGEST = 500
"""Characters of a statement at most."""
_NUMBER = r"(?<![\w.])((?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)"
_WORD = r"[^\W\d][\w.]*"


@dataclass(frozen=True)
class _Sum:
    """Parameters times `factors` by their positions, plus a constant, in one unit; "1" is that of plain numbers."""

    factors: Mapping[int, float] = field(default_factory=dict)
    constant: float = 0.0
    unit: str = "1"

    def times(self, size: float, unit: str = "1") -> _Sum:
        """The multiple by a quantity."""
        units = [each for each in (self.unit, unit) if each != "1"]
        return _Sum({k: size * value for k, value in self.factors.items()}, size * self.constant,
                    "*".join(f"({each})" for each in units) if len(units) > 1 else (units or ["1"])[0])

    def plus(self, other: _Sum, where: str) -> _Sum:
        """The sum, in the unit of the first; a plain zero has any unit.

        Raises:
            ProblemError: one of them lacks a unit.
            UnitError: the units are of different kinds.
        """
        if self == _Sum():
            return other
        if other == _Sum():
            return self
        for one, unit in ((self, other.unit), (other, self.unit)):
            if one.unit == "1" != unit:
                raise ProblemError(f"{abs(one.constant):g} has no unit", where=where,
                                   remedy=f"add one of the kind of '{unit}'")
        other = other.times(factor(other.unit, self.unit, where=where) if other.unit != self.unit else 1.0)
        joined = dict(self.factors)
        for k, value in other.factors.items():
            joined[k] = joined.get(k, 0.0) + value
        return replace(self, factors=joined, constant=self.constant + other.constant)


def read_constraint(parameters: ParameterSet, name: str, text: str) -> Condition:
    """The constraint that a text states: two linear sums of parameters with ``==``, ``<=`` or ``>=`` in between.

    Terms are parameters, their multiples (``0.5*boom.m``, ``1.2 m*boom.m``) and quantities; they must be of one kind
    of unit.

    Raises:
        ProblemError: the text is not such a relation, is not linear, or names an unknown parameter.
        UnitError: units do not fit together.

    >>> import hydroopt as ho
    >>> parameters = ho.Model(ho.load_machine("cat215b")).parameters
    >>> scales = read_constraint(parameters, "scales", "boom.m + stick.m == 2.518 t")
    >>> scales.kind, round(scales.right[0] / scales.rows[0].max())
    ('zero', 2518)
    """
    where = f"constraint '{name}'"
    sides = re.split("(==|<=|>=)", text)
    if len(sides) != 3:
        raise ProblemError("this is not one relation with ==, <= or >=", where=where, remedy=f"write e.g. {CONSTRAINT}")
    left, right = (_sum(parameters, side, where) for side in sides[::2])
    row, value, _ = _row(parameters, left.plus(right.times(-1.0), where), where)
    if sides[1] == "==":
        return conditions.equal(name, parameters, row, value)
    sign = 1.0 if sides[1] == ">=" else -1.0
    return conditions.at_least(name, parameters, sign * row, sign * value)


def linear_relation(parameters: ParameterSet, constraint: Constraint) -> Condition | None:
    """The condition that a function states; None if it is not one linear relation between parameters.

    >>> import hydroopt as ho
    >>> parameters = ho.Model(ho.load_machine("cat215b")).parameters
    >>> linear_relation(parameters, Constraint("scales", lambda p: p["boom.m"] + p["stick.m"] <= 2518.0)).kind
    'nonnegative'
    >>> linear_relation(parameters, Constraint("product", lambda p: p["boom.m"] * p["stick.m"] <= 1e6))
    """
    psi = ca.SX.sym("psi", len(parameters))
    try:
        body, equal = as_casadi(constraint, Named(parameters, lambda k: psi[k]))
    except ProblemError:  # solvers refuse it, unless it is one of cvxpy
        return None
    slope = ca.jacobian(body, psi)
    if ca.depends_on(slope, psi):
        return None
    at_zero = ca.Function("relation", [psi], [slope, body])(ca.DM.zeros(psi.shape))
    row, value = np.asarray(ca.DM(at_zero[0])).ravel(), -float(at_zero[1])
    if not (np.any(row) and np.all(np.isfinite(row)) and isfinite(value)):
        return None
    return (conditions.equal(constraint.name, parameters, row, value) if equal
            else conditions.at_least(constraint.name, parameters, -row, -value))


def read_prior(parameters: ParameterSet, name: str, text: str) -> Prior:
    """The prior that a text states: a linear sum of parameters ``= value +- standard deviation``, with the unit last.

    Raises:
        ProblemError, UnitError: as of `read_constraint`.

    >>> import hydroopt as ho
    >>> parameters = ho.Model(ho.load_machine("cat215b")).parameters
    >>> prior = read_prior(parameters, "scales", "boom.m = 1520 +- 20 kg")
    >>> prior.value, prior.sigma
    (1520.0, 20.0)
    """
    where = f"prior '{name}'"
    stated = re.fullmatch(r"([^=]+)=([^=]+?)(?:\+-|\+/-|±)([^=]+)", text)
    if stated is None:
        raise ProblemError("this is not a sum of parameters = value +- standard deviation", where=where,
                           remedy=f"write e.g. {PRIOR}")
    row, value, unit = _row(parameters, _sum(parameters, stated[1], where), where)
    mean, spread = stated[2].strip(), stated[3].strip()
    if " " not in mean:
        mean = f"{mean} {spread.partition(' ')[2]}"
    mean_si, sigma = (to_si(each, unit, where=where) for each in (mean, spread))
    return linear_prior(parameters, name, _expression(parameters, row), mean_si + value, sigma)


def sum_of(parameters: ParameterSet, name: str, given: str | Expression) -> Expression:
    """The linear sum of parameters [SI] that a text such as ``"boom.m + 0.5*stick.m"`` states; a function as it is.

    Raises:
        ProblemError, UnitError: as of `read_constraint`.

    >>> import hydroopt as ho
    >>> parameters = ho.Model(ho.load_machine("cat215b")).parameters
    >>> sum_of(parameters, "scales", "boom.m + 2*stick.m")({"boom.m": 1000.0, "stick.m": 300.0})
    1600.0
    """
    if not isinstance(given, str):
        return given
    where = f"prior '{name}'"
    row, right, _ = _row(parameters, _sum(parameters, given, where), where)
    return _expression(parameters, row, -right)


def _expression(parameters: ParameterSet, row: Array, constant: float = 0.0) -> Expression:
    sizes = {parameters.names[k]: float(row[k]) for k in np.flatnonzero(row)}
    return lambda p: sum(size * p[each] for each, size in sizes.items()) + constant


def _row(parameters: ParameterSet, total: _Sum, where: str) -> tuple[Array, float, str]:
    """Row (p,) and right side [SI] of a sum that is zero, and their unit.

    Raises:
        ProblemError: it has no parameter, or a number that is not finite.
    """
    unit = total.unit if total.unit in parameters.units else base_unit(total.unit, where=where)
    size = factor(total.unit, unit, where=where) if unit != total.unit else 1.0
    row = np.zeros(len(parameters))
    row[list(total.factors)] = [size * value for value in total.factors.values()]
    if not np.any(row):
        raise ProblemError("it says nothing about any parameter", where=where, remedy=f"write e.g. {CONSTRAINT}")
    if not (np.all(np.isfinite(row)) and isfinite(total.constant)):
        raise ProblemError("it has a number that is not finite", where=where, remedy="correct it")
    return row, -size * total.constant, unit


def _sum(parameters: ParameterSet, text: str, where: str) -> _Sum:
    """What a text adds up. Words are parameters or units; a number is multiplied by the word behind it.

    Raises:
        ProblemError: it cannot be read, is not linear, or a word is neither parameter nor unit.
    """
    words: list[str] = []

    def numbered(found: re.Match[str]) -> str:
        words.append(found[0])
        return f"_{len(words) - 1}"

    text = text.replace("·", "*").replace("−", "-")
    plain = re.sub(rf"{_NUMBER}\s*(?={_WORD})({_WORD})", r"(\1*\2)", text).replace("^", "**")
    plain = re.sub(rf"(?<![\w.]){_WORD}", numbered, plain)
    try:
        if len(text) > LONGEST or re.search(r"[^\w\s.*/+()-]", plain):
            raise SyntaxError
        return _value(ast.parse(plain.strip(), mode="eval").body, parameters, words, where)
    except (SyntaxError, ValueError, RecursionError, MemoryError, OverflowError):
        raise ProblemError(f"'{text.strip():.60}' is not a sum of multiples of parameters and quantities",
                           where=where, remedy=f"write e.g. {CONSTRAINT}") from None


def _value(node: ast.expr, parameters: ParameterSet, words: Sequence[str], where: str) -> _Sum:
    """The sum of a syntax tree whose words are numbered: ``_0``, ``_1``, ...

    Raises:
        SyntaxError: something else than arithmetic.
        ProblemError: it is not linear, or a word is neither parameter nor unit.
    """
    match node:
        case ast.Constant(value=int() | float() as number):
            return _Sum(constant=float(number))
        case ast.Name(id=numbered):
            word = words[int(numbered[1:])]
            if word not in parameters.positions and same_kind(word, word):
                return _Sum(constant=1.0, unit=word)
            k = parameters.index(word)
            return _Sum({k: 1.0}, unit=parameters.units[k])
        case ast.UnaryOp(operand=inner, op=ast.UAdd() | ast.USub() as sign):
            return _value(inner, parameters, words, where).times(-1.0 if isinstance(sign, ast.USub) else 1.0)
        case ast.BinOp(left=first, op=operator, right=second):
            left, right = (_value(side, parameters, words, where) for side in (first, second))
            return _combined(left, operator, right, where)
    raise SyntaxError


def _combined(left: _Sum, operator: ast.operator, right: _Sum, where: str) -> _Sum:
    """A sum, a multiple, or a power of a unit."""
    match operator:
        case ast.Add():
            return left.plus(right, where)
        case ast.Sub():
            return left.plus(right.times(-1.0), where)
        case ast.Mult() if not left.factors:
            return right.times(left.constant, left.unit)
        case ast.Mult() if not right.factors:
            return left.times(right.constant, right.unit)
        case ast.Div() if not right.factors and right.constant:
            return left.times(1 / right.constant, "1" if right.unit == "1" else f"1/({right.unit})")
        case ast.Pow() if not left.factors and right == _Sum(constant=right.constant) and abs(right.constant) <= 4:
            return _Sum(constant=left.constant**right.constant, unit=f"({left.unit})**{right.constant:g}")
    raise ProblemError("it is not linear in the parameters", where=where, remedy=(
        "state a sum of multiples of parameters, or a function in Python for method 'nlp'"))
