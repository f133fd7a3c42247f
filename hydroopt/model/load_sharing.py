"""How the actuators of a machine share the load of its joints: the rule of simulations and limits.

Of all forces that carry the load, those have the least sum of (force/capacity)²: actuators side by side have the same
pressure difference where their lever arms are the same, and one at its dead point carries nothing. Where each joint has
one actuator there is nothing to share.
"""

from __future__ import annotations

import casadi as ca

from hydroopt.machine.machine import Machine


def shared_load(machine: Machine, transmission: ca.SX, load: ca.SX) -> ca.SX:
    """Forces (a,) of all actuators that carry generalised forces (n,) at the joints; passive joints carry themselves.

    Args:
        machine: whose actuators.
        transmission: (a, n) their lever arms.
        load: (n,) generalised forces [N·m or N].
    """
    driven = [k for k, drivers in enumerate(machine.drivers.values()) if drivers]
    arms, carried = ca.sparsify(transmission[:, driven].T), load[driven]
    square = ca.DM([each.capacity**2 for each in machine.actuators])
    force = ca.SX.zeros(len(machine.actuators))
    count, order, first = (arms @ arms.T).sparsity().scc()
    for joints in (order[first[i] : first[i + 1]] for i in range(count)):  # that share no actuator with others
        there = sorted(set(arms[joints, :].sparsity().get_triplet()[1]))
        force[there] = _shared(arms[joints, there], square[there], carried[joints])
    return force


def lever_arms(machine: Machine, transmission: ca.SX) -> list[ca.SX]:
    """Lever arm [m or 1] of the actuators that are there to move each driven joint, all together: where one is zero the
    load cannot be shared.

    It is the root of the pivot of the equations for the least squares, joints behind it eliminated, over the greatest
    capacity: the lever arm itself where one actuator is there.
    """
    found: list[ca.SX] = []
    driven = [k for k, drivers in enumerate(machine.drivers.values()) if drivers]
    parts = transmission[:, driven].T @ ca.diag(ca.DM([each.capacity for each in machine.actuators]))
    gram = parts @ parts.T
    for k in reversed(range(len(driven))):
        most = max(each.capacity for each in machine.drivers[machine.joints[driven[k]]])
        found.insert(0, ca.sqrt(gram[k, k]) / most)
        gram = gram[:k, :k] - gram[:k, k] @ gram[k, :k] / gram[k, k]
    return found


def _shared(arms: ca.SX, square: ca.DM, load: ca.SX) -> ca.SX:
    """Forces (a,) that make a load (n,) by arms (n, a): the only ones, or those of least squares over `square` (a,)."""
    if arms.size1() == arms.size2():  # the general equations would square the condition of these
        return _solved(arms, load)
    given = ca.diag(square) @ arms.T
    return given @ _solved(arms @ given, load)


def _solved(matrix: ca.SX, right: ca.SX) -> ca.SX:
    return right / ca.diag(matrix) if matrix.sparsity().is_diag() else ca.solve(matrix, right)
