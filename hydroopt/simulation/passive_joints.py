"""Motion of passive joints: what a motion of all other joints makes them do, by integrating their balances."""

from __future__ import annotations

import numpy as np

from hydroopt.errors import ProblemError, SolverError
from hydroopt.model.model import Model
from hydroopt.spatial.inertia import Array

TOLERANCE = 1e-10
"""Relative and absolute error of positions [rad, m] and speeds."""
SLOW = 1e-4
"""Speed [rad/s, m/s] within which dry friction of a passive joint grows to its full size instead of jumping."""


def passive_motion(model: Model, t: Array, motion: tuple[Array, Array, Array], psi: Array,
                   wrench: Array | None = None) -> tuple[Array, Array, Array]:
    """Positions, speeds and accelerations (N, n) of all joints, of which the passive ones follow the others.

    They start as `motion` states; the others move as it states, between samples by quintic polynomials.

    Args:
        model: the machine.
        t: (N,) times [s].
        motion: positions, speeds and accelerations (N, n); of passive joints only the first sample counts.
        psi: (p,) parameters.
        wrench: (N, 6) on the tip.

    Raises:
        ProblemError: a passive joint leaves its range, or friction of seals acts on it.
        SolverError: the motion cannot be integrated.
    """
    machine = model.machine
    passive = [machine.joints.index(each.joint) for each in machine.balances if not each.actuators]
    if not passive:
        return motion
    from scipy.integrate import solve_ivp  # noqa: PLC0415 — most machines have no passive joints
    from scipy.interpolate import BPoly  # noqa: PLC0415 (as above)

    driven = [k for k in range(len(machine.joints)) if k not in passive]
    path = BPoly.from_derivatives(t, np.stack([each[:, driven] for each in motion], axis=1))
    courses = [path.derivative(order) if order else path for order in range(3)]
    force = BPoly.from_derivatives(t, wrench[:, None]) if wrench is not None else None
    model.refuse_seals("simulate")
    dry, without = _dry_friction(model, passive, psi)

    def state(time: float, y: Array) -> tuple[Array, Array, Array]:
        q, qd, qdd = (np.empty(len(machine.joints)) for _ in range(3))
        for whole, course in zip((q, qd, qdd), courses, strict=True):
            whole[driven] = course(time)
        q[passive], qd[passive] = np.split(y, 2)
        qdd[passive] = 0.0
        at = np.zeros(6) if force is None else force(time)
        load = np.zeros(len(machine.joints))
        load[passive] = dry * np.tanh(qd[passive] / SLOW)
        qdd[passive] = np.asarray(model.passive_accelerations(q, qd, qdd, at, load, without)).ravel()
        return q, qd, qdd

    start = np.concatenate([motion[0][0, passive], motion[1][0, passive]])
    found = solve_ivp(lambda time, y: np.concatenate([y[len(passive):], state(time, y)[2][passive]]),
                      (t[0], t[-1]), start, "Radau" if np.any(dry) else "DOP853", t, rtol=TOLERANCE, atol=TOLERANCE)
    if not found.success:
        raise SolverError(f"the motion of {', '.join(machine.joints[k] for k in passive)} cannot be integrated beyond "
                          f"{found.t[-1]:.2f} s", where="simulation", remedy="choose a slower motion")
    for k, values in zip(passive, found.y, strict=False):
        lower, upper = machine.link(machine.joints[k]).joint.range
        if np.min(values) < lower or np.max(values) > upper:
            raise ProblemError(f"the passive joint '{machine.joints[k]}' leaves its range", where="simulation",
                               remedy="choose a slower motion, or widen its range")
    made = [state(time, y) for time, y in zip(t, found.y.T, strict=True)]
    q, qd, qdd = (np.array([one[order] for one in made]) for order in range(3))
    return q, qd, qdd


def _dry_friction(model: Model, passive: list[int], psi: Array) -> tuple[Array, Array]:
    """Coulomb friction of the passive joints, and ψ without it."""
    place, without = model.parameters.positions, np.array(psi, dtype=float)
    names = [f"{model.machine.joints[k]}.tau_coulomb" for k in passive]
    dry = np.array([psi[place[name]] if name in place else 0.0 for name in names])
    for name in names:
        if name in place:
            without[place[name]] = 0.0
    return dry, without
