"""The same generalised forces from kinetic and potential energy: Lagrange's equations by automatic differentiation.

It uses positions and differentiates them for velocities, accelerations and forces, so that it shares no dynamics with
`regressor`. It is slower and verifies the regressor in tests.
"""

from __future__ import annotations

import casadi as ca

from hydroopt.model.kinematics import Coordinates, gravity_in_base
from hydroopt.model.regressor import Dynamics
from hydroopt.spatial.inertia import NAMES
from hydroopt.spatial.poses import unskew


def energies(dynamics: Dynamics, owner: str, phi: ca.SX) -> tuple[ca.SX, ca.SX]:
    """Kinetic and potential energy [J] of a body with the inertial parameters φ (10,) in its frame."""
    symbols = dynamics.coordinates
    pose = dynamics.body_motion(owner).pose
    velocity = pose.rotation.T @ ca.jtimes(pose.origin, symbols.q, symbols.qd)
    turn = ca.reshape(ca.jtimes(ca.vec(pose.rotation), symbols.q, symbols.qd), 3, 3)
    rotation = unskew(pose.rotation.T @ turn)
    m, mc = phi[0], phi[1:4]
    xx, xy, xz, yy, yz, zz = (phi[k] for k in range(4, len(NAMES)))
    inertia = ca.blockcat([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    kinetic = (m * ca.sumsqr(velocity) / 2 + ca.dot(mc, ca.cross(velocity, rotation))
               + rotation.T @ inertia @ rotation / 2)
    potential = -ca.dot(gravity_in_base(dynamics.machine), m * pose.origin + pose.rotation @ mc)
    return kinetic, potential


def joint_forces(dynamics: Dynamics, owner: str, phi: ca.SX) -> ca.SX:
    """Generalised forces (n,) due to one body: d/dt ∂T/∂q̇ − ∂T/∂q + ∂V/∂q."""
    symbols: Coordinates = dynamics.coordinates
    kinetic, potential = energies(dynamics, owner, phi)
    momentum = ca.gradient(kinetic, symbols.qd)
    state, rate = ca.vertcat(symbols.q, symbols.qd), ca.vertcat(symbols.qd, symbols.qdd)
    return ca.jtimes(momentum, state, rate) - ca.gradient(kinetic, symbols.q) + ca.gradient(potential, symbols.q)
