"""The dynamic parameters of a machine: their order, nominal values, bounds and prior (Eq. 4.53, 4.54)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import chain
from typing import NamedTuple

import numpy as np
from scipy.linalg import block_diag

from hydroopt.machine.actuators import Cylinder
from hydroopt.machine.addresses import Number
from hydroopt.machine.links import Body, Note
from hydroopt.machine.machine import Machine
from hydroopt.machine.parameter_kind import INERTIAL_KINDS, ParameterKind
from hydroopt.parameters.force_terms import ForceTerm
from hydroopt.parameters.parameter_set import ParameterSet
from hydroopt.spatial import inertia
from hydroopt.spatial.inertia import Array

SPEED_RANGE = 20.0
"""Factor by which a Stribeck speed may be off where the file states no bounds: beyond, it is another effect."""
LEAST = 1e-6
"""What is positive by nature is at least this part of its typical size, whatever lower bound the file states."""
DEFAULT_CONFIDENCE = 1.0
"""Prior σ of a body's numbers when the file states none, as a part of their size."""


Block = tuple[Array, Array, Array, Array, Array]
"""Nominal values, bounds, sizes (k,) and information (k, k) of parameters that stand together."""


class Owned(NamedTuple):
    """A body with the name of its owner and the path of its entry in the machine file."""

    body: Body
    path: str


class Scalar(NamedTuple):
    """A parameter of no body: the number, its bounds by nature, and a typical size."""

    number: Number
    lower: float = 0.0
    upper: float = np.inf
    size: float = 1.0


def bodies(machine: Machine, *, actuator_inertia: bool = True, calibrator: bool = False) -> dict[str, Owned]:
    """Bodies that the machine states, by owner: ``boom``, ``boom_cylinder.rod``, ``boom_cylinder.barrel``.

    Each link is followed by the rods and barrels of the cylinders that drive its joint (Eq. 4.54). On request the links
    of the calibrator come last.
    """
    found: dict[str, Owned] = {}
    drivers = machine.drivers
    for link in machine.links:
        if link.body is not None:
            found[link.name] = Owned(link.body, f"{link.name}.body")
        for driver in drivers.get(link.name, ()):
            if actuator_inertia and isinstance(driver, Cylinder):
                for end, attachment in (("rod", driver.rod), ("barrel", driver.barrel)):
                    if attachment.body is not None:
                        found[f"{driver.name}.{end}"] = Owned(attachment.body, f"{driver.name}.{end}.body")
    for link in machine.calibrator.links if calibrator and machine.calibrator else ():
        if link.body is not None:
            found[link.name] = Owned(link.body, f"{link.name}.body")
    return found


def carried(machine: Machine, *, actuator_inertia: bool = True) -> dict[str, tuple[str, ...]]:
    """Owners of the bodies that make up each link: its own, and the ends of cylinders that are pinned to it."""
    found = bodies(machine, actuator_inertia=actuator_inertia)
    ends = [(f"{cylinder.name}.{end}", attachment.link) for cylinder in machine.cylinders
            for end, attachment in (("barrel", cylinder.barrel), ("rod", cylinder.rod))]
    made = {link.name: tuple(owner for owner in (link.name, *(end for end, pinned in ends if pinned == link.name))
                             if owner in found) for link in machine.links}
    return {link: owners for link, owners in made.items() if owners}


def scalars(machine: Machine, joint: str) -> dict[str, Scalar]:
    """Friction, offset and rotor parameters of one moving joint and its actuators, in the order of Eq. 4.53, 4.54."""
    sealed = {f"{each.name}.f_seal": each for each in machine.drivers.get(joint, ()) if isinstance(each, Cylinder)}
    found = {}
    for number in machine.effort_numbers(joint):
        scalar = Scalar(number)
        if number.kind in (ParameterKind.FORCE_OFFSET, ParameterKind.PRELOAD):
            scalar = Scalar(number, -np.inf)
        elif number.kind is ParameterKind.STRIBECK_SPEED:
            scalar = Scalar(number, number.value / SPEED_RANGE, number.value * SPEED_RANGE, number.value)
        elif number.kind is ParameterKind.SEAL_FRICTION:
            areas = sealed[number.name].areas
            scalar = Scalar(number, 0.0, areas[1], 0.01 * areas[0])
        found[number.name] = scalar
    return found


def owners_with_confidence(machine: Machine, found: Mapping[str, Owned]) -> frozenset[str]:
    """Owners of bodies of which the machine file states how well a number is known; for others it is assumed.

    >>> from hydroopt.machine.machine_file import load_machine
    >>> machine = load_machine("panda_mukca")
    >>> sorted(owners_with_confidence(machine, bodies(machine)))
    []
    """
    return frozenset(owner for owner, owned in found.items()
                     if any(note.sigma for path, note in machine.notes.items() if path.startswith(f"{owned.path}.")))


def passive_scalars(machine: Machine) -> dict[str, Scalar]:
    """The pressures of gas-charged cylinders, stiffness and preload of springs."""
    return {number.name: Scalar(number, -np.inf if number.kind is ParameterKind.PRELOAD else 0.0)
            for number in machine.passive_numbers}


def parameter_set(machine: Machine, *, actuator_inertia: bool = True, calibrator: bool = False,
                  terms: Sequence[ForceTerm] = ()) -> ParameterSet:
    """All dynamic parameters ψ of a machine, joint after joint (Eq. 4.55).

    Args:
        machine: where nominal values and confidences come from.
        actuator_inertia: whether barrels and rods belong to the model (the thesis's complete model).
        calibrator: whether the bodies of the calibrator belong to it; they come last.
        terms: force terms of the user's own, whose coefficients come before those.
    """
    found = bodies(machine, actuator_inertia=actuator_inertia, calibrator=calibrator)
    rows: list[tuple[Sequence[str], Sequence[ParameterKind], Sequence[str], Block]] = []

    def add_body(owner: str) -> None:
        if owner in found:
            rows.append(([f"{owner}.{element}" for element in inertia.NAMES], INERTIAL_KINDS, inertia.UNITS,
                         _body_block(found[owner], machine.notes)))

    def add_scalars(stated: Mapping[str, Scalar]) -> None:
        rows.extend(([name], [each.number.kind], [each.number.unit], scalar_block(each, machine.notes))
                    for name, each in stated.items())

    for link in machine.links:
        ends = [f"{driver.name}.{end}" for driver in machine.drivers.get(link.name, ()) for end in ("rod", "barrel")]
        for owner in (link.name, *ends):
            add_body(owner)
        if link.joint.moving:
            add_scalars(scalars(machine, link.name))
    add_scalars(passive_scalars(machine))
    for address, each in chain.from_iterable(term.addresses.items() for term in terms):
        numbers = np.array([[each.nominal], [each.lower], [each.upper], [abs(each.nominal) or 1.0]])
        rows.append(([address], [ParameterKind.COEFFICIENT], [each.unit],
                     (*numbers, np.array([[0.0 if each.sigma is None else 1 / each.sigma**2]]))))
    for link in machine.calibrator.links if machine.calibrator else ():
        add_body(link.name)
    names, kinds, units = (chain.from_iterable(row[0] for row in rows), chain.from_iterable(row[1] for row in rows),
                           chain.from_iterable(row[2] for row in rows))
    blocks = [row[3] for row in rows]
    nominal, lower, upper, size = (np.concatenate([np.zeros(0), *(block[k] for block in blocks)]) for k in range(4))
    information = block_diag(np.zeros((0, 0)), *(block[4] for block in blocks))
    known = np.diag(information) > 0
    sigma = np.sqrt(np.diag(np.linalg.inv(information + np.diag(~known * 1.0))))
    scale = np.where(known, sigma, np.maximum(np.abs(nominal), size))
    return ParameterSet(tuple(names), tuple(kinds), tuple(units), nominal, lower, upper, scale, information)


def _body_block(owned: Owned, notes: dict[str, Note]) -> Block:
    phi = owned.body.phi
    lower: Array = np.full(10, -np.inf)
    upper: Array = np.full(10, np.inf)
    note = notes.get(f"{owned.path}.m", Note())
    lower[0] = note.lower if note.lower is not None else 0.0
    if note.upper is not None:
        upper[0] = note.upper
    covariance = _body_covariance(owned, notes)
    information = np.zeros((10, 10)) if covariance is None else np.asarray(np.linalg.inv(covariance), dtype=float)
    return phi, lower, upper, np.ones(10), information


def _body_covariance(owned: Owned, notes: dict[str, Note]) -> Array | None:
    """Covariance (10, 10) of φ from the confidences of the numbers as the file states them."""
    body = owned.body
    if body.m == 0:
        return None
    by_com = body.com is not None
    first = np.array(body.com if by_com else body.mc)
    second = np.array(body.inertia_com if by_com else body.inertia)
    # the size of the body stands in for the size of a number that happens to be zero
    trace = second[0] + second[3] + second[5]
    length = max(float(np.linalg.norm(first)) / (1.0 if by_com else body.m),
                 float(np.sqrt(max(trace, 0.0) / (2 * body.m))), 1e-3)
    keys = ("m", "com", "inertia_com") if by_com else ("m", "mc", "inertia")
    sizes = (body.m, length * (1.0 if by_com else body.m), body.m * length**2)
    values = (np.array([body.m]), first, second)
    sigmas = [_sigma(notes.get(f"{owned.path}.{key}"), value, size)
              for key, value, size in zip(keys, values, sizes, strict=True)]
    stated = np.concatenate([np.full(len(value), sigma) for value, sigma in zip(values, sigmas, strict=True)])
    if not by_com:
        return np.diag(stated**2)
    jacobian = np.empty((10, 10))
    at, step = np.concatenate(values).astype(complex), 1e-30
    for k in range(10):  # a complex step is exact for these polynomials
        moved = at.copy()
        moved[k] += 1j * step
        jacobian[:, k] = inertia.from_centre_of_mass(moved[0], moved[1:4], moved[4:]).imag / step
    return jacobian @ np.diag(stated**2) @ jacobian.T


def _sigma(note: Note | None, value: Array, size: float) -> float:
    largest = float(np.max(np.abs(value))) or size
    if note is None or note.sigma is None:
        return DEFAULT_CONFIDENCE * max(largest, size)
    return note.sigma * largest if note.relative else note.sigma


def scalar_block(scalar: Scalar, notes: dict[str, Note]) -> Block:
    """Nominal value, bounds, size and information, (1,) and (1, 1), of a parameter and what is noted of it."""
    note = notes.get(scalar.number.path, Note())
    low = scalar.lower if note.lower is None else note.lower
    if scalar.lower > 0:  # forces divide by it
        low = max(low, LEAST * scalar.size)
    high = scalar.upper if note.upper is None else note.upper
    information = 0.0
    if note.sigma is not None:
        information = 1 / (note.sigma * (abs(scalar.number.value) or scalar.size) if note.relative else note.sigma) ** 2
    return (*np.array([[scalar.number.value], [low], [high], [scalar.size]]), np.array([[information]]))
