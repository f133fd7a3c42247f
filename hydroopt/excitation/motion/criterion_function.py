"""A criterion computed by NumPy, as a CasADi function with a gradient."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from hydroopt.estimation.inference.program import NonlinearProgram
from hydroopt.spatial.inertia import Array


class CriterionFunction(ca.Callback):  # type: ignore[misc]
    """A function (k, 1) → (1, 1) with an exact gradient; it has no second derivatives."""

    def __init__(self, value: Callable[[Array], float], gradient: Callable[[Array], Array], size: int) -> None:
        ca.Callback.__init__(self)
        self._value, self._gradient, self._size = value, _Gradient(gradient, size), size
        self.construct("criterion", {})

    def get_sparsity_in(self, _: int) -> ca.Sparsity:
        """Sparsity of x."""
        return ca.Sparsity.dense(self._size, 1)

    def eval(self, arguments: list[Any]) -> list[Any]:
        """The criterion."""
        return [self._value(np.asarray(arguments[0]).ravel())]

    def has_jacobian(self) -> bool:
        """True: the gradient is exact."""
        return True

    def get_jacobian(self, *_: Any) -> ca.Function:
        """The gradient as a row."""
        return self._gradient


class _Gradient(ca.Callback):  # type: ignore[misc]
    """(x, value) → (1, k)."""

    def __init__(self, gradient: Callable[[Array], Array], size: int) -> None:
        ca.Callback.__init__(self)
        self._function, self._size = gradient, size
        self.construct("criterion_gradient", {})

    def get_n_in(self) -> int:
        return 2

    def get_sparsity_in(self, i: int) -> ca.Sparsity:
        return ca.Sparsity.dense(1 if i else self._size, 1)

    def get_sparsity_out(self, _: int) -> ca.Sparsity:
        return ca.Sparsity.dense(1, self._size)

    def eval(self, arguments: list[Any]) -> list[Any]:
        return [ca.DM(self._function(np.asarray(arguments[0]).ravel())).T]


@dataclass(frozen=True, eq=False, repr=False)
class ExcitationProgram(NonlinearProgram):
    """The program of a motion; it must live as long as a solver uses its criterion.

    Attributes:
        criterion: the Python function in `f`.
    """

    criterion: CriterionFunction | None = None
