"""What a pose's squared error costs: Gaussian errors, or losses that limit the influence of wild poses."""

from __future__ import annotations

import casadi as ca
import numpy as np

from hydroopt.spatial.inertia import Array

HUBER = 3.0
"""Error of a pose, in units of what is expected, beyond which Huber's loss grows linearly."""
FREEDOM = 4.0
"""Degrees of freedom of Student's t."""


def robust_loss(square: ca.SX, loss: str, expected: ca.SX) -> ca.SX:
    """Cost of a squared error in standard deviations, of which `expected` are usual; near zero it is the square.

    >>> robust_loss(ca.SX(4.0), "squares", ca.SX(1.0))
    SX(4)
    >>> robust_loss(ca.SX(36.0), "huber", ca.SX(1.0))
    SX(27)
    """
    if loss == "huber":
        limit = HUBER**2 * expected
        return ca.if_else(square <= limit, square, 2 * ca.sqrt(limit * ca.fmax(square, limit)) - limit)
    if loss == "student_t":
        return (FREEDOM + expected) * ca.log1p(square / (FREEDOM + expected))
    return square


def costs_and_weights(square: Array, loss: str, expected: Array) -> tuple[Array, Array]:
    """Costs (N,) of squared errors (N,), and their derivatives (N,): the weights of a reweighted least squares."""
    s, e = ca.SX.sym("s"), ca.SX.sym("e")
    cost = robust_loss(s, loss, e)
    both = ca.Function("loss", [s, e], [cost, ca.gradient(cost, s)])
    found = both(square[None, :], expected[None, :].astype(float))
    return np.asarray(found[0]).ravel(), np.asarray(found[1]).ravel()
