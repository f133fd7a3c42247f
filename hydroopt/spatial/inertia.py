"""The ten inertial parameters of a rigid body, in one order, defined here once (Eq. 4.12 and 4.14).

Every vector φ is ``(m, mc_x, mc_y, mc_z, I_xx, I_xy, I_xz, I_yy, I_yz, I_zz)`` [kg, kg·m, kg·m²]: mass, first
moment and moments of inertia about the origin of the body's frame, in that frame.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

NAMES = ("m", "mc_x", "mc_y", "mc_z", "I_xx", "I_xy", "I_xz", "I_yy", "I_yz", "I_zz")
UNITS = ("kg", *["kg*m"] * 3, *["kg*m^2"] * 6)


UPPER = np.triu_indices(3)
"""Rows and columns of ``xx…zz`` in a tensor."""


def tensor(six: Any) -> Any:
    """Symmetric matrix (3, 3) of ``(xx, xy, xz, yy, yz, zz)`` (Eq. 4.13)."""
    xx, xy, xz, yy, yz, zz = six
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


def from_centre_of_mass(m: Any, com: Any, inertia: Any) -> Any:
    """φ (10,) from mass [kg], centre of mass (3,) [m] and ``xx…zz`` (6,) [kg·m²] about it (Eq. 4.9).

    Works on complex numbers too, so that its derivatives can be taken by a complex step.
    """
    c = np.asarray(com)
    about_origin = tensor(inertia) + m * ((c @ c) * np.eye(3) - np.outer(c, c))
    return np.concatenate([[m], m * c, about_origin[UPPER]])


def pseudo_inertia(phi: Any) -> Array:
    """Pseudo-inertia matrix (4, 4) ``[[½tr(I)·1 − I, mc], [mcᵀ, m]]``; linear in φ.

    A body made of positive masses exists if and only if it is positive semidefinite
    (Wensing, Kim, Slotine 2018, "Linear matrix inequalities for physically consistent inertial
    parameter identification").
    """
    phi = np.asarray(phi)
    inertia = tensor(phi[4:])
    matrix = np.empty((4, 4), dtype=phi.dtype)
    matrix[:3, :3] = 0.5 * np.trace(inertia) * np.eye(3) - inertia
    matrix[:3, 3] = matrix[3, :3] = phi[1:4]
    matrix[3, 3] = phi[0]
    return matrix


def from_pseudo_inertia(matrix: Array) -> Array:
    """φ (10,) of a pseudo-inertia matrix (4, 4); the inverse of `pseudo_inertia`."""
    second = matrix[:3, :3]
    inertia = np.trace(second) * np.eye(3) - second
    return np.concatenate([[matrix[3, 3]], matrix[:3, 3], inertia[UPPER]])


ODD_MOMENTS = {"xy": (3, 6, 8), "xz": (2, 5, 8), "yz": (1, 5, 6)}
"""Positions in φ of what vanishes where mass is symmetric about a plane of the frame: for xy mc_z, I_xz and I_yz."""

PSEUDO_BASIS: Array = np.stack([pseudo_inertia(e) for e in np.eye(10)])
"""(10, 4, 4): ``pseudo_inertia(φ) == Σ φ_k·PSEUDO_BASIS[k]``."""


def smallest_eigenvalue(phi: Any) -> float:
    """Smallest eigenvalue of the pseudo-inertia; negative means that no such body can exist."""
    return float(np.linalg.eigvalsh(pseudo_inertia(phi))[0])


def centre_of_mass(phi: Array) -> Array | None:
    """Centre of mass (3,) [m] in the body's frame, or None for a massless body."""
    return phi[1:4] / phi[0] if phi[0] != 0 else None
