"""IPOPT on the program of a motion."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import casadi as ca
import numpy as np

from hydroopt.excitation.program import BACK_OFF, Program
from hydroopt.inertia import Array

WIDEST = 3.0
"""Bound of a coefficient, in halves of its joint's range."""


def solve(program: Program, start: Array, seconds: float, interrupted: Callable[[], bool],
           heard: Callable[[float], None]) -> Array:
    """IPOPT's best point from a start, whatever ended it."""
    (lower, upper), size = program.bounds, len(start)
    vector, rows, one, nothing = (ca.Sparsity.dense(size), ca.Sparsity.dense(len(lower)), ca.Sparsity.dense(1),
                                  ca.Sparsity(0, 1))
    f = _Called("f", [vector], [one], lambda x: [program.objective(x)[0]])
    g = _Called("g", [vector], [rows], lambda x: [program.constraints(x)])
    slope = _Called("grad_f", [vector, nothing], [one, vector], lambda x, _: list(program.objective(x)))
    slopes = _Called("jac_g", [vector, nothing], [rows, ca.Sparsity.dense(len(lower), size)],
                     lambda x, _: [program.constraints(x), program.constraints_jacobian(x)])
    watch = _Watch(start, lower, upper, interrupted, heard)
    x = ca.MX.sym("x", size)
    solver = ca.nlpsol("excitation", "ipopt", {"x": x, "f": f(x), "g": g(x)}, {
        "grad_f": slope, "jac_g": slopes, "iteration_callback": watch, "no_nlp_grad": True, "print_time": False,
        "ipopt.print_level": 0, "ipopt.sb": "yes", "error_on_fail": False,
        "ipopt.hessian_approximation": "limited-memory", "ipopt.limited_memory_max_history": 6,
        "ipopt.mumps_pivot_order": 6,  # the default order fills the factors: twenty times slower with dense rows
        "ipopt.tol": 1e-5, "ipopt.acceptable_tol": 1e-3, "ipopt.acceptable_iter": 8, "ipopt.max_iter": 300,
        "ipopt.max_wall_time": max(seconds, 0.1), "ipopt.mu_strategy": "adaptive", "ipopt.bound_push": 1e-3})
    solver(x0=start, lbx=-WIDEST, ubx=WIDEST, lbg=lower, ubg=upper)
    return watch.best


class _Called(ca.Callback):  # type: ignore[misc]
    """A NumPy function as a casadi.Function."""

    def __init__(self, name: str, inputs: Sequence[ca.Sparsity], outputs: Sequence[ca.Sparsity],
                 function: Callable[..., list[Array | float]]) -> None:
        ca.Callback.__init__(self)
        self._inputs, self._outputs, self._function = inputs, outputs, function
        self.construct(name, {})

    def get_n_in(self) -> int:
        return len(self._inputs)

    def get_n_out(self) -> int:
        return len(self._outputs)

    def get_sparsity_in(self, i: int) -> ca.Sparsity:
        return self._inputs[i]

    def get_sparsity_out(self, i: int) -> ca.Sparsity:
        return self._outputs[i]

    def eval(self, arguments: list[ca.DM]) -> list[Array | float]:
        return self._function(*(np.asarray(a).ravel() for a in arguments))


class _Watch(ca.Callback):  # type: ignore[misc]
    """Keeps the best point that fulfils the constraints, tells of it, and stops when asked to."""

    def __init__(self, start: Array, lower: Array, upper: Array, interrupted: Callable[[], bool],
                 heard: Callable[[float], None]) -> None:
        ca.Callback.__init__(self)
        size, rows = len(start), len(lower)
        self._sizes = (size, 1, rows, size, rows, 0)
        self._bounds, self._interrupted, self._heard = (lower, upper), interrupted, heard
        self.best, self._value = start, np.inf
        self.construct("watch", {})

    def get_n_in(self) -> int:
        return len(self._sizes)

    def get_n_out(self) -> int:
        return 1

    def get_sparsity_in(self, i: int) -> ca.Sparsity:
        return ca.Sparsity.dense(self._sizes[i])

    def eval(self, arguments: list[ca.DM]) -> list[int]:
        x, value, g = (np.asarray(a).ravel() for a in arguments[:3])
        over = max(float(np.max(self._bounds[0] - g)), float(np.max(g - self._bounds[1])))
        if over < BACK_OFF / 2 and value[0] < self._value:
            self.best, self._value = x.copy(), float(value[0])
            self._heard(self._value)
        return [int(self._interrupted())]
