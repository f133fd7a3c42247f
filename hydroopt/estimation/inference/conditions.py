"""Conditions on ψ from physics and the machine file, of three kinds that every solver supports.

A condition is linear in ψ and zero, non-negative, or a positive semidefinite matrix; the convex solver, IPOPT and the
sampler support these.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations, pairwise
from typing import Literal

import numpy as np

from hydroopt.errors import ProblemError
from hydroopt.machine.links import Shape
from hydroopt.machine.machine import Machine
from hydroopt.parameters.dynamic import bodies
from hydroopt.parameters.parameter_set import ParameterSet
from hydroopt.spatial import inertia
from hydroopt.spatial.inertia import Array

UPPER = np.triu_indices(4)
"""Indices of the ten entries of a symmetric 4-by-4 matrix, row by row."""

MARGIN = 1e-7
"""Smallest eigenvalue allowed to a semidefinite condition, so that bodies are possible despite rounding."""


@dataclass(frozen=True, eq=False)
class Condition:
    """`rows`·ψ − `right` is zero, not negative, or the upper triangle of a positive semidefinite matrix (4, 4).

    `rows` (k, p) and `right` (k,) are scaled to be of size one about the nominal values; k is 10 for a matrix.
    Conditions of one name are one constraint to the user.
    """

    name: str
    kind: Literal["zero", "nonnegative", "semidefinite"]
    rows: Array
    right: Array

    def evaluate(self, psi: Array) -> Array:
        """The values (k,) that are to be zero, non-negative, or a matrix."""
        return self.rows @ psi - self.right

    def margin(self, psi: Array) -> float:
        """How far ψ is inside: the smallest value or eigenvalue, or minus the largest deviation from zero."""
        value = self.evaluate(psi)
        if self.kind == "zero":
            return -float(np.max(np.abs(value), initial=0.0))
        return float(np.min(value if self.kind == "nonnegative" else np.linalg.eigvalsh(square(value)), initial=np.inf))


def square(upper: Array) -> Array:
    """Symmetric matrix (4, 4) of its upper triangle (10,)."""
    matrix = np.zeros((4, 4))
    matrix[UPPER] = upper
    return matrix + np.triu(matrix, 1).T


SYMMETRIC = np.array([square(entry).ravel() for entry in np.eye(10)]).T
"""(16, 10) the entries of a symmetric matrix of its upper triangle."""


@dataclass(frozen=True, eq=False)
class ScaledBody:
    """A body's place in ψ and the scaling S that makes its pseudo-inertia S·J·Sᵀ about the identity's size.

    `weight` κ is that of its log-det distance ``κ·(tr W − log det W − 4)`` with W = S·J·Sᵀ, zero without such a one;
    then S is the inverse of the nominal pseudo-inertia's Cholesky factor.
    """

    owner: str
    columns: slice
    scaling: Array
    weight: float = 0.0

    @property
    def consistency(self) -> str:
        """Name of the constraint that this body can exist."""
        return f"physical consistency of {self.owner}"

    @property
    def basis(self) -> Array:
        """(10, 10) upper triangle of the scaled pseudo-inertia, row by row, for each of the ten parameters."""
        return np.asarray((self.scaling @ inertia.PSEUDO_BASIS @ self.scaling.T)[:, UPPER[0], UPPER[1]].T)

    @property
    def spread(self) -> float:
        """The mean of the density ``exp(−½κ·(tr W − log det W))`` is this multiple of the identity: W is Wishart."""
        return 1 + 5 / self.weight

    @property
    def information(self) -> Array:
        """(10, 10) inverse covariance of φ in the Gaussian that has this density's spread: ½κγ·‖W − mean‖²."""
        twice = np.where(UPPER[0] == UPPER[1], 1.0, 2.0)  # entries beside the diagonal stand there two times
        return 0.5 * self.weight / self.spread * self.basis.T @ (twice[:, None] * self.basis)

    def pseudo_inertia(self, phi: Array) -> Array:
        """S·J(φ)·Sᵀ (4, 4)."""
        return np.asarray(self.scaling @ inertia.pseudo_inertia(phi) @ self.scaling.T)

    def distance(self, phi: Array) -> float:
        """The weighted log-det distance of φ (10,) from the nominal body; infinite for one that cannot exist."""
        W = self.pseudo_inertia(phi)
        if np.linalg.eigvalsh(W)[0] <= 0:
            return np.inf
        return float(self.weight * (np.trace(W) - np.linalg.slogdet(W)[1] - 4))


def scaled_bodies(parameters: ParameterSet, *, distances: bool = False) -> tuple[ScaledBody, ...]:
    """All bodies, scaled by the mass and the radius of gyration of their nominal values.

    With `distances` they are scaled to the identity at their nominal values J0, and carry the weight of their log-det
    distance D(J‖J0) (Lee, Wensing, Park 2020, "Geometric robot dynamic identification: a convex programming approach").
    A body's density changed as a whole, J = (1 + ε)·J0, has D = 4·(ε − log(1 + ε)) ≈ 2·ε²; so that this costs
    (ε/σ)² with the relative confidence σ of its mass, as in the Gaussian, κ = 1/(2·σ²).

    Raises:
        ProblemError: there is no log-det distance to a nominal body that could not exist, or is flat.
    """
    found = []
    for owner, columns in parameters.bodies.items():
        phi = parameters.nominal[columns]
        mass = max(phi[0], 1e-3)
        second = max(np.trace(inertia.pseudo_inertia(phi)[:3, :3]) / 3, 1e-6 * mass)
        body = ScaledBody(owner, columns, np.diag([*[1 / np.sqrt(second)] * 3, 1 / np.sqrt(mass)]))
        if distances:
            nominal = body.pseudo_inertia(phi)
            if np.linalg.eigvalsh(nominal)[0] < 1e-6:
                raise ProblemError("its nominal numbers are of no body that can exist, or of a flat one: nothing has "
                                   "a log-det distance to it", where=f"body '{owner}'",
                                   remedy="correct its inertia, or keep the distance 'gaussian'")
            whiten = np.asarray(np.linalg.inv(np.linalg.cholesky(nominal)) @ body.scaling)
            body = ScaledBody(owner, body.columns, whiten, 0.5 * (phi[0] / parameters.scale[columns.start]) ** 2)
        found.append(body)
    return tuple(found)


def bounds(parameters: ParameterSet, fixed: Mapping[str, float],
           consistent: Sequence[ScaledBody] = ()) -> list[Condition]:
    """Lower and upper bounds of single parameters, and those that are held.

    The mass of a body that must be physically consistent is positive anyway.
    """
    masses = {body.columns.start for body in consistent}
    found = []
    for k, name in enumerate(parameters.names):
        size = parameters.scale[k]
        row = np.eye(1, len(parameters), k) / size
        if name in fixed:
            found.append(Condition(f"{name} fixed", "zero", row, np.array([fixed[name] / size])))
            continue
        low, high = parameters.lower[k], parameters.upper[k]
        if np.isfinite(low) and not (k in masses and low == 0):
            found.append(Condition(f"lower bound of {name}", "nonnegative", row, np.array([low / size])))
        if np.isfinite(high):
            found.append(Condition(f"upper bound of {name}", "nonnegative", -row, np.array([-high / size])))
    return found


def consistency(body: ScaledBody, p: int) -> Condition:
    """A body made of positive masses exists (Wensing, Kim, Slotine 2018)."""
    rows = np.zeros((10, p))
    rows[:, body.columns] = body.basis
    return Condition(body.consistency, "semidefinite", rows, np.zeros(10))


def symmetry(parameters: ParameterSet, owner: str, plane: str) -> Condition:
    """A body's odd moments about a plane of its frame vanish.

    Raises:
        ProblemError: there is no such body or plane.
    """
    name = f"symmetry of {owner} about {plane}"
    if plane not in inertia.ODD_MOMENTS:
        raise ProblemError(f"'{plane}' is not a plane", where=name, remedy=f"use {', '.join(inertia.ODD_MOMENTS)}")
    start = _body(parameters, owner, name)
    return _zero(name, parameters, np.eye(len(parameters))[[start + k for k in inertia.ODD_MOMENTS[plane]]])


def likeness(parameters: ParameterSet, name: str, owners: Sequence[str]) -> Condition:
    """Equal inertial parameters of several bodies, or equal friction of several actuators.

    Raises:
        ProblemError: fewer than two owners, an unknown one, or some with other parameters than the rest.
    """
    own = [_shared(parameters, owner) for owner in owners]
    elements = [[name.removeprefix(f"{owner}.") for name in names] for owner, names in zip(owners, own, strict=True)]
    if len(set(owners)) < 2 or not all(own) or any(one != elements[0] for one in elements):
        raise ProblemError(f"{', '.join(owners) or 'nothing'} cannot be identical", where=f"'{name}'",
                           remedy="name two or more bodies, or actuators with the same terms of friction")
    unit = np.eye(len(parameters))
    return _zero(name, parameters, np.array([unit[parameters.index(one)] - unit[parameters.index(other)]
                                             for pair in pairwise(own) for one, other in zip(*pair, strict=True)]))


def _shared(parameters: ParameterSet, owner: str) -> list[str]:
    """Parameters that identical owners share: a body's ten, an actuator's friction; an offset belongs to a sensor."""
    if owner in parameters.bodies:  # friction in a link's joint is no part of its body
        return list(parameters.names[parameters.bodies[owner]])
    return [name for name, kind in zip(parameters.names, parameters.kinds, strict=True)
            if kind.is_friction and parameters.owner(name) == owner]


def total_mass(parameters: ParameterSet, name: str, owners: Sequence[str]) -> Array:
    """The row (p,) that sums the masses of several bodies.

    Raises:
        ProblemError: no body, an unknown one, or one twice.
    """
    if not owners or len(set(owners)) < len(owners):
        raise ProblemError("the sum has no bodies, or one of them twice", where=f"'{name}'",
                           remedy="name each body once")
    return np.asarray(np.eye(len(parameters))[[_body(parameters, owner, name) for owner in owners]].sum(axis=0))


def equal(name: str, parameters: ParameterSet, row: Array, value: float) -> Condition:
    """One linear sum of parameters (p,) has a value."""
    return _zero(name, parameters, row[None], np.array([value]))


def at_least(name: str, parameters: ParameterSet, row: Array, value: float) -> Condition:
    """One linear sum of parameters (p,) has a value or more."""
    size = float(np.max(np.abs(row) * parameters.scale))
    return Condition(name, "nonnegative", row[None] / size, np.array([value / size]))


def inside(parameters: ParameterSet, owner: str, shape: Shape) -> tuple[Condition, ...]:
    """A body's mass lies inside a shape: two constraints, on its centre of mass and on its density.

    The centre of mass of mass inside a convex shape is inside it: necessary. As second moments have to fit too, each
    product of two functions that are non-negative inside must have a non-negative integral over the mass: linear
    inequalities ``tr(Q·J) ≥ 0`` (Wensing, Kim, Slotine 2018; Traversaro et al. 2016). For an ellipsoid the one with
    its own quadric is, for a possible body, also sufficient: some density inside has these ten parameters. For a box
    (all pairs of its faces: three slabs and twelve edges) and a cylinder (its round part and its slab) they are
    necessary only: no density inside is ruled out, but some parameters pass that none has.
    """
    start = parameters.bodies[owner].start
    p, mass = len(parameters), max(parameters.nominal[start], 1e-3)
    J = np.zeros((4, 4, p))  # pseudo-inertia for each parameter: the integral of [x; 1]·[x; 1]ᵀ
    J[:, :, start : start + 10] = inertia.PSEUDO_BASIS.transpose(1, 2, 0) / mass
    com, density = f"centre of mass of {owner} inside its shape", f"density of {owner} inside its shape"
    faces, ball = shape.faces, shape.ball
    found, products = [], [np.einsum("i,ijp,j", a, J, b) for a, b in combinations(faces, 2)]
    if len(faces):
        found.append(Condition(com, "nonnegative", faces @ J[:, 3], np.zeros(len(faces))))
    if ball is not None:
        arrow = np.zeros((4, 4, p))  # ‖B·[mc; m]‖ ≤ m as a matrix
        arrow[range(4), range(4)] = J[3, 3]
        arrow[:3, 3] = ball @ J[:, 3]
        found.append(Condition(com, "semidefinite", arrow[UPPER], np.zeros(10)))
        products.append(J[3, 3] - np.einsum("ki,ijp,kj", ball, J, ball))
    return (*found, Condition(density, "nonnegative", np.array(products), np.zeros(len(products))))


def stated(machine: Machine, parameters: ParameterSet, *, actuator_inertia: bool) -> tuple[Condition, ...]:
    """What the machine file states: shapes, symmetries, total masses without confidence, identical parts.

    In the reduced model links stand for barrels and rods too: what is stated of these leaves with them, and what is
    stated of links binds the bodies that stand for both.

    Raises:
        ProblemError: the reduced model lacks a body of a total mass.
    """
    found: list[Condition] = []
    modelled = {owner: owned for owner, owned in bodies(machine, actuator_inertia=actuator_inertia,
                                                        calibrator=True).items() if owner in parameters.bodies}
    for owner, owned in modelled.items():
        found += inside(parameters, owner, owned.body.shape) if owned.body.shape else ()
        found += [symmetry(parameters, owner, plane) for plane in dict.fromkeys(owned.body.symmetric)]
    for one in machine.identical:
        rubbing = [name for name in one.friction if _shared(parameters, name)]
        for owners in ([owner for owner in one.bodies if owner in modelled], rubbing):
            found += [likeness(parameters, one.name, owners)] if len(owners) > 1 else []
    for total in machine.total_masses:
        if (note := machine.notes.get(f"{total.name}.value")) is None or note.sigma is None:
            found.append(equal(total.name, parameters, total_mass(parameters, total.name, total.bodies), total.value))
    return tuple(found)


def _zero(name: str, parameters: ParameterSet, rows: Array, right: Array | None = None) -> Condition:
    size = np.max(np.abs(rows) * parameters.scale, axis=1)
    return Condition(name, "zero", rows / size[:, None], np.zeros(len(rows)) if right is None else right / size)


def _body(parameters: ParameterSet, owner: str, name: str) -> int:
    if owner not in parameters.bodies:
        raise ProblemError(f"'{owner}' is not a body of this model", where=f"'{name}'",
                           remedy=f"name one of {', '.join(parameters.bodies)}")
    return int(parameters.bodies[owner].start)
