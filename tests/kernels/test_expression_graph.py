"""What the expression graph makes of a function's operations."""

import casadi as ca
import numpy as np
import pytest

from hydroopt.kernels.expression_graph import program


@pytest.mark.parametrize("angle", [
    lambda a, b, q: a, lambda a, b, q: -a, lambda a, b, q: a + 0.3, lambda a, b, q: q - a,
    lambda a, b, q: a - b + q - 2.0, lambda a, b, q: a + a, lambda a, b, q: 2.0 * a])
@pytest.mark.parametrize("op", [ca.sin, ca.cos])
def test_sine_and_cosine_of_a_vectors_angle_come_from_the_vector(op, angle):
    x = ca.SX.sym("x", 5)
    bent = op(angle(ca.atan2(x[0], x[1]), ca.atan2(x[2], x[3]), x[4]))
    function = ca.Function("f", [x], [bent])
    found = program(function).function()
    for value in np.random.default_rng(1).uniform(-2, 2, (50, 5)):
        assert float(found(value)) == pytest.approx(float(function(value)), abs=1e-14)


def test_an_angle_that_nothing_else_needs_is_not_computed():
    x = ca.SX.sym("x", 2)
    angle = ca.atan2(x[0], x[1])
    both = [ca.sin(angle + 0.3), ca.cos(angle + 0.3)]
    assert "atan2" not in program(ca.Function("f", [x], both)).operations
    assert "atan2" in program(ca.Function("f", [x], [*both, angle])).operations
