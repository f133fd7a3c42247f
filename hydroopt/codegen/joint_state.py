"""The routine that computes joints from the cylinders' lengths: by triangles, slides, or several lengths together."""

from __future__ import annotations

import casadi as ca

from hydroopt.codegen.symbols import COINCIDENT, Field, Guard, Routine, Symbols
from hydroopt.machine.geometry import Geometry
from hydroopt.model.cylinder_motion import SHORTEST_LEVER
from hydroopt.model.joint_from_length import joint_from_length
from hydroopt.model.joints_from_readings import back

SETTLED = 1e-5
"""Last of Newton's steps [rad or m] from which on no posture counts as having the lengths."""


def no_lengths(api: Symbols) -> str:
    """Why a machine's lengths determine no joint; "" if they determine one."""
    by_triangle = any(joint_from_length(Geometry(api.machine), c) for c in api.machine.cylinders)
    found = by_triangle or api.slides or api.together
    return "" if found else "no hydraulic cylinder of the machine moves a single joint"


def joint_state(api: Symbols) -> Routine:
    """Positions and speeds of the joints that the cylinders' lengths tell."""
    machine, count = api.machine, len(api.machine.cylinders)
    length, speed = api.symbol("length", count), api.symbol("speed", count)
    q, qd = ca.SX(len(machine.joints), 1), ca.SX(len(machine.joints), 1)
    guards: list[Guard] = []
    covered: list[str] = []
    grouped = {machine.joints[k] for group in api.together for k in group.joints}
    for k, cylinder in enumerate(machine.cylinders):
        found = joint_from_length(api.dynamics.geometry, cylinder)
        if found is None or found.joint in {*covered, *grouped}:
            continue
        sides, turn = found.sides, ca.SX.sym("turn")
        angle = found.angle(length[k])
        # through a linkage the joint turns faster or slower than the one of the triangle
        ratio = ca.substitute(ca.jacobian(found.driven(turn), turn), turn, found.turn(length[k]))
        both = sides.fixed * sides.moving
        cosine = (sides.fixed**2 + sides.moving**2 + sides.lateral**2 - length[k]**2) / (2 * both)
        lever = found.branch * both * ca.sqrt(1 - cosine**2) / length[k]
        guards += [Guard(length[k], ">", COINCIDENT, "OPEN_TRIANGLE"),
                   Guard(cosine, "<=", 1.0, "OPEN_TRIANGLE", absolute=True),
                   Guard(lever, ">", SHORTEST_LEVER, "DEAD_POINT", absolute=True),
                   *api.straight(found.sines(found.turn(length[k])))]
        index = machine.joints.index(found.joint)
        q[index], qd[index] = angle, speed[k] / lever * ratio
        covered.append(found.joint)
    for slide in api.slides:
        at, under = slide.solved(api.dynamics.geometry, length[slide.cylinder])
        lever = slide.sign * ca.sqrt(under) / length[slide.cylinder]
        guards += [Guard(length[slide.cylinder], ">", COINCIDENT, "OPEN_TRIANGLE"),
                   Guard(under, ">=", 0.0, "OPEN_TRIANGLE"),
                   Guard(lever, ">", SHORTEST_LEVER, "DEAD_POINT", absolute=True)]
        q[slide.joint], qd[slide.joint] = at, speed[slide.cylinder] / lever
        covered.append(machine.joints[slide.joint])
    for group in api.together:
        own, read = list(group.joints), list(group.cylinders)
        at, step, arms = group.solved(api.dynamics, q, length[read])
        guards += [Guard(length[k], ">", COINCIDENT, "OPEN_TRIANGLE") for k in read]
        guards += [Guard(each, "<", SETTLED, "OPEN_TRIANGLE", absolute=True) for each in ca.vertsplit(step)]
        guards += [Guard(bar, ">", SHORTEST_LEVER, "DEAD_POINT") for bar in _bars(arms[:, own])]
        q[own], qd[own] = at, back(arms[:, own], speed[read] - arms[:, list(group.given)] @ qd[list(group.given), 0])
        covered += [machine.joints[k] for k in own]
    takes = api.struct("lengths", "Readings of the cylinders' length transducers.",
                       Field("length", ("cylinder",), "m", "distance between the pins"),
                       Field("speed", ("cylinder",), "m/s", "its rate"))
    others = [joint for joint in machine.joints if joint not in covered]
    missing = f"; 0 for {', '.join(others)}, which no single cylinder moves" if others else ""
    if api.slides or api.together:
        gives = api.struct("joints", "State of the joints that cylinders move.",
                           Field("q", ("joint",), "rad or m", f"position of each joint{missing}"),
                           Field("qd", ("joint",), "rad/s or m/s", "its speed"))
        text = "Joint positions and speeds from the cylinders' lengths."
    else:
        gives = api.struct("joints", "State of the joints that one cylinder each moves.",
                           Field("q", ("joint",), "rad", f"angle of each joint{missing}"),
                           Field("qd", ("joint",), "rad/s", "its speed"))
        text = "Joint angles and speeds from the cylinders' lengths."
    return Routine("joint_state", text, takes, ("length", "speed"), gives, {"q": q, "qd": qd}, tuple(guards), length)


def _bars(arms: ca.SX) -> list[ca.SX]:
    """Lever arms [m or 1] of cylinders at each of the joints that they move together, while those before follow: all
    above zero where the lengths tell the joints."""
    gram, found = ca.densify(arms.T @ arms), []
    while gram.size1():
        found.append(ca.sqrt(gram[0, 0]))
        gram = gram[1:, 1:] - gram[1:, 0] @ gram[0, 1:] / gram[0, 0]
    return found
