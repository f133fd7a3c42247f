"""A problem as CasADi's nonlinear program with names and units, which a user extends and solves in tools of his own."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from hydroopt.errors import ProblemError
from hydroopt.estimation.inference.listing import named_row, table
from hydroopt.spatial.inertia import Array


@dataclass(frozen=True, eq=False)
class NonlinearProgram:
    """Minimise ``f(x, p)`` over x subject to ``lbx ≤ x ≤ ubx`` and ``lbg ≤ g(x, p) ≤ ubg``.

    `as_dict` is the program and `arguments` the numbers that `casadi.nlpsol` takes. An expression of the user's own
    takes symbols by name, ``program["boom.m"]``; it is appended to g in plain CasADi.

    Attributes:
        x, p: symbols of the variables (n, 1) and of the fixed numbers (k, 1), CasADi SX or MX.
        f: the objective (1, 1); `objective` describes its terms.
        g: the constraints (m, 1).
        x_names, x_units, x0, lbx, ubx: of each variable its name, unit, initial guess and bounds.
        p_names, p_value: of each fixed number its name and value.
        g_names, lbg, ubg: of each row of g its name and bounds; rows of one constraint share its name.
        g_units, p_units: units of g and of p; empty where they are without unit.

    Raises:
        ProblemError: sizes of symbols, names and numbers differ.

    >>> import casadi as ca, numpy as np
    >>> from hydroopt.estimation.inference.ipopt import OPTIONS
    >>> x = ca.SX.sym("x", 2)
    >>> program = NonlinearProgram(x=x, f=(x[0] - 1) ** 2 + x[1] ** 2, g=x[0] + x[1], x_names=("a", "b"),
    ...                            x_units=("m", "m"), x0=np.zeros(2), lbx=np.full(2, -5.0), ubx=np.full(2, 5.0),
    ...                            g_names=("sum",), lbg=np.array([2.0]), ubg=np.array([2.0]))
    >>> program
    NonlinearProgram(2 variables, 0 fixed numbers, 1 constraint)
    >>> answer = ca.nlpsol("solver", "ipopt", program.as_dict(), dict(OPTIONS))(**program.arguments())
    >>> {name: round(value, 6) for name, value in program.values(answer["x"]).items()}
    {'a': 1.5, 'b': 0.5}
    """

    x: Any
    f: Any
    x_names: tuple[str, ...]
    x_units: tuple[str, ...]
    x0: Array
    lbx: Array
    ubx: Array
    g: Any = None
    g_names: tuple[str, ...] = ()
    lbg: Array = field(default_factory=lambda: np.zeros(0))
    ubg: Array = field(default_factory=lambda: np.zeros(0))
    p: Any = None
    p_names: tuple[str, ...] = ()
    p_value: Array = field(default_factory=lambda: np.zeros(0))
    g_units: tuple[str, ...] = ()
    p_units: tuple[str, ...] = ()
    objective: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        for symbol in ("g", "p"):
            if getattr(self, symbol) is None:  # none, of the type that x has: SX or MX
                object.__setattr__(self, symbol, type(self.x)(0, 1))
        sizes = {
            "x": (self.x.numel(), self.x_names, self.x_units, self.x0, self.lbx, self.ubx),
            "p": (self.p.numel(), self.p_names, self.p_units or self.p_names, self.p_value),
            "g": (self.g.numel(), self.g_names, self.g_units or self.g_names, self.lbg, self.ubg)}
        for symbol, (size, *some) in sizes.items():
            if any(len(one) != size for one in some):
                raise ProblemError(f"{symbol} has {size} rows, its names and numbers {[len(one) for one in some]}",
                                   where="nonlinear program", remedy="give one name and number for each row")

    def __getitem__(self, name: str) -> Any:
        """The symbol (1, 1) of a variable or a fixed number.

        Raises:
            ProblemError: there is no such name.
        """
        for names, symbols in ((self.x_names, self.x), (self.p_names, self.p)):
            if name in names:
                return symbols[names.index(name)]
        raise ProblemError("the program has no such variable", where=f"'{name}'",
                           remedy=f"choose one of {', '.join((*self.x_names, *self.p_names)[:8])}, …")

    def as_dict(self) -> dict[str, Any]:
        """x, p, f and g as `casadi.nlpsol` takes them."""
        return {"x": self.x, "p": self.p, "f": self.f, "g": self.g}

    def arguments(self) -> dict[str, Array]:
        """Initial guess, bounds and the values of p, as the function made by `casadi.nlpsol` takes them."""
        return {"x0": self.x0, "p": self.p_value, "lbx": self.lbx, "ubx": self.ubx, "lbg": self.lbg, "ubg": self.ubg}

    def values(self, x: Any) -> dict[str, float]:
        """Numbers (n,) of the variables by name."""
        return dict(zip(self.x_names, np.asarray(x, dtype=float).ravel().tolist(), strict=True))

    def __repr__(self) -> str:
        sizes = (f"{len(names)} {what}{'s' * (len(names) != 1)}" for names, what in (
            (self.x_names, "variable"), (self.p_names, "fixed number"), (dict.fromkeys(self.g_names), "constraint")))
        return f"NonlinearProgram({', '.join(sizes)})"

    def __str__(self) -> str:
        variables = [named_row(*row) for row in zip(self.x_names, self.x_units, self.x0, self.lbx, self.ubx,
                                                    strict=True)]
        lines = ["variables x", *table(("name", "unit", "initial guess", "lower bound", "upper bound"), variables)]
        if self.p_names:
            fixed = [named_row(*row) for row in zip(self.p_names, self.p_units or [""] * len(self.p_names),
                                                    self.p_value, strict=True)]
            lines += ["fixed numbers p", *table(("name", "unit", "value"), fixed)]
        lines += ["minimise f", *(f"  {term}" for term in self.objective or (f"{len(self.x_names)} variables",))]
        return "\n".join([*lines, "subject to g", *table(("name", "unit", "rows", "lower bound", "upper bound"),
                                                         self._constraint_rows())])

    def _constraint_rows(self) -> list[Sequence[str]]:
        rows: dict[str, list[int]] = {}
        for k, name in enumerate(self.g_names):
            rows.setdefault(name, []).append(k)
        return [named_row(name, self.g_units[some[0]] if self.g_units else "", str(len(some)),
                          float(np.min(self.lbg[some])), float(np.max(self.ubg[some]))) for name, some in rows.items()]
