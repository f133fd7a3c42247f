"""Whitened rows of one pose as a function of geometry and angles: what linearised poses tell, differentiable.

It is the symbolic twin of `hydroopt.estimation.kinematic.observability.linearise`, see there.
"""

from __future__ import annotations

import casadi as ca
import numpy as np

from hydroopt.estimation.kinematic.problem import CalibrationProblem


def whitened_rows(problem: CalibrationProblem, pose: int) -> ca.Function:
    """(theta (P,), q (n,)) -> transposed Jacobian (f, u) of one pose's white rows by the free parameters.

    Rows are those that the pose has; joints are sensed, locked or moving as they are in it.
    """
    layout, model = problem.layout, problem.model
    theta, q = ca.SX.sym("theta", len(problem.parameters)), ca.SX.sym("q", len(model.joints))
    place = ca.vertcat(*(theta[int(which)] if which >= 0 else ca.SX(given)
                         for which, given in zip(layout.place[pose], layout.given[pose], strict=True)))
    _, by_g, by_q, by_place = model.observed_jacobians(theta[: len(model.parameters)], q, place)
    rows = np.flatnonzero(layout.present[pose]).tolist()
    by_q = ca.densify(by_q[rows, :])
    columns = ca.SX(len(rows), len(problem.parameters))
    columns[:, : len(model.parameters)] = by_g[rows, :]
    where, which, factor = layout.locked
    n = len(model.joints)
    for at, parameter, part in zip(where.tolist(), which.tolist(), factor.tolist(), strict=True):
        if at // n == pose:
            columns[:, parameter] += part * by_q[:, at % n]
    for axis, parameter in enumerate(layout.place[pose].tolist()):
        if parameter >= 0:
            columns[:, parameter] += by_place[rows, axis]
    spread = by_q @ ca.diag(ca.DM(np.where(layout.sensed[pose], problem.angle_sigma, 0.0)))
    lower = ca.chol(spread @ spread.T + ca.diag(ca.DM(problem.row_sigma[pose, rows] ** 2))).T
    moving = np.flatnonzero(layout.moving[pose]).tolist()
    white = _solved(lower, ca.horzcat(columns, by_q[:, moving]))
    for k in range(len(moving)):  # Gram-Schmidt: what each unsensed angle explains
        blind = white[:, len(problem.parameters) + k]
        blind = blind / ca.sqrt(ca.sumsqr(blind))
        white = white - blind @ (blind.T @ white)
    free = np.flatnonzero(problem.free).tolist()
    return ca.Function("whitened_rows", [theta, q], [ca.densify(white[:, free]).T], ["theta", "q"], ["rows"])


def _solved(lower: ca.SX, right: ca.SX) -> ca.SX:
    """L⁻¹·R of a lower triangular L."""
    done: list[ca.SX] = []
    for k in range(lower.shape[0]):
        row = right[k, :]
        for j, before in enumerate(done):
            row = row - lower[k, j] * before
        done.append(row / lower[k, k])
    return ca.vertcat(*done)
