"""Kernels of expressions that clamp, as valves do: native code against CasADi's virtual machine."""

from __future__ import annotations

import casadi as ca
import numpy as np

from hydroopt.kernels.native import Kernel, kernel


def test_a_clamp_and_a_negative_number_used_twice_are_compiled():
    x, u = ca.SX.sym("x"), ca.SX.sym("u")
    clamped = ca.fmax(-1.0, ca.fmin(1.0, u))
    function = ca.Function("clamped", [x, u], [ca.vertcat(clamped * x, ca.fmin(x, clamped), ca.fmax(-1.0, x))],
                           ["x", "u"], ["y"])
    compiled = kernel(function)
    assert isinstance(compiled, Kernel)
    values = np.linspace(-2.0, 2.0, 33)[:, None]
    [found] = compiled([values, values[::-1].copy()], len(values))
    expected = np.asarray(function.map(len(values))(values.T, values[::-1].T)).T
    np.testing.assert_allclose(found[:, :, 0], expected, atol=1e-15)
