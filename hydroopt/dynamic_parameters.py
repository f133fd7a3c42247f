"""The dynamic parameters of a machine: their order, nominal values, bounds and prior (Eq. 4.53, 4.54)."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from hydroopt import inertia
from hydroopt.inertia import Array
from hydroopt.machine import Machine
from hydroopt.parameters import ParameterSet
from hydroopt.parts import Body, Cylinder, Drive, Motor, Note

DEFAULT_CONFIDENCE = 1.0
"""Prior σ of a body's numbers when the file states none, as a part of their size."""


class Owned(NamedTuple):
    """A body with the name of its owner and the path of its entry in the machine file."""

    body: Body
    path: str


class Scalar(NamedTuple):
    """A parameter that is not inertial: nominal value, unit, file path, and whether it may be negative."""

    value: float
    unit: str
    path: str
    signed: bool


def bodies(machine: Machine, *, actuator_inertia: bool = True) -> dict[str, Owned]:
    """Bodies that the machine states, by owner: ``boom``, ``boom_cylinder.rod``, ``boom_cylinder.barrel``.

    Each link is followed by the rod and barrel of the cylinder that drives its joint (Eq. 4.54).
    """
    found: dict[str, Owned] = {}
    for link in machine.links:
        if link.body is not None:
            found[link.name] = Owned(link.body, f"{link.name}.body")
        driver = _driver(machine, link.name)
        if actuator_inertia and isinstance(driver, Cylinder):
            for end, attachment in (("rod", driver.rod), ("barrel", driver.barrel)):
                if attachment.body is not None:
                    found[f"{driver.name}.{end}"] = Owned(attachment.body, f"{driver.name}.{end}.body")
    return found


def scalars(machine: Machine, joint: str) -> dict[str, Scalar]:
    """Friction, offset and rotor parameters of one moving joint and its actuator, in the order of Eq. 4.53, 4.54."""
    torque, viscosity = machine.effort_units(joint)
    own, at = machine.link(joint).joint.friction, f"{joint}.joint.friction"
    stated = {f"{joint}.tau_coulomb": (own.coulomb, torque, f"{at}.coulomb", False),
              f"{joint}.tau_viscous": (own.viscous, viscosity, f"{at}.viscous", False)}
    driver = _driver(machine, joint)
    assert driver is not None
    friction, at, name = driver.friction, f"{driver.name}.friction", driver.name
    if isinstance(driver, Cylinder):
        stated |= {f"{name}.f_offset": (friction.offset, "N", f"{at}.offset", True),
                   f"{name}.f_coulomb": (friction.coulomb, "N", f"{at}.coulomb", False),
                   f"{name}.f_viscous": (friction.viscous, "N*s/m", f"{at}.viscous", False),
                   f"{name}.n_barrel": (driver.friction.barrel_pin, "N*m", f"{at}.barrel_pin", False),
                   f"{name}.n_rod": (driver.friction.rod_pin, "N*m", f"{at}.rod_pin", False)}
    else:
        stated |= {f"{name}.tau_offset": (friction.offset, torque, f"{at}.offset", True),
                   f"{name}.tau_coulomb": (friction.coulomb, torque, f"{at}.coulomb", False),
                   f"{name}.tau_viscous": (friction.viscous, viscosity, f"{at}.viscous", False)}
        if not isinstance(driver, Motor):
            stated[f"{name}.rotor_inertia"] = (driver.rotor_inertia, "kg*m^2", f"{name}.rotor_inertia", False)
    return {key: Scalar(value, unit, path, signed) for key, (value, unit, path, signed) in stated.items()
            if value is not None}


def passive_scalars(machine: Machine) -> dict[str, Scalar]:
    """The pressures of gas-charged cylinders."""
    return {f"{gas.name}.precharge": Scalar(gas.precharge, "Pa", f"{gas.name}.precharge", False)
            for gas in machine.gas_cylinders}


def parameter_set(machine: Machine, *, actuator_inertia: bool = True) -> ParameterSet:
    """All dynamic parameters ψ of a machine, joint after joint (Eq. 4.55).

    Args:
        machine: where nominal values and confidences come from.
        actuator_inertia: whether barrels and rods belong to the model (the thesis's complete model).
    """
    found = bodies(machine, actuator_inertia=actuator_inertia)
    names: list[str] = []
    units: list[str] = []
    blocks: list[tuple[Array, Array, Array, Array]] = []  # nominal, lower, upper, information
    for link in machine.links:
        driver = _driver(machine, link.name)
        owners = [link.name, *([f"{driver.name}.rod", f"{driver.name}.barrel"] if driver else [])]
        for owner in owners:
            if owner in found:
                names += [f"{owner}.{element}" for element in inertia.NAMES]
                units += inertia.UNITS
                blocks.append(_body_block(found[owner], machine.notes))
        if link.name in machine.joints:
            for name, scalar in scalars(machine, link.name).items():
                names.append(name)
                units.append(scalar.unit)
                blocks.append(_scalar_block(scalar, machine.notes))
    for name, scalar in passive_scalars(machine).items():
        names.append(name)
        units.append(scalar.unit)
        blocks.append(_scalar_block(scalar, machine.notes))
    nominal, lower, upper = (np.concatenate([np.zeros(0), *(block[k] for block in blocks)]) for k in range(3))
    information = np.zeros((len(names), len(names)))
    start = 0
    for block in blocks:
        stop = start + len(block[0])
        information[start:stop, start:stop] = block[3]
        start = stop
    known = np.diag(information) > 0
    sigma = np.sqrt(np.diag(np.linalg.inv(information + np.diag(~known * 1.0))))
    scale = np.where(known, sigma, np.maximum(np.abs(nominal), 1.0))
    return ParameterSet(tuple(names), tuple(units), nominal, lower, upper, scale, information)


def _driver(machine: Machine, joint: str) -> Cylinder | Motor | Drive | None:
    return machine.actuators[machine.joints.index(joint)] if joint in machine.joints else None


def _body_block(owned: Owned, notes: dict[str, Note]) -> tuple[Array, Array, Array, Array]:
    phi = owned.body.phi
    lower: Array = np.full(10, -np.inf)
    upper: Array = np.full(10, np.inf)
    note = notes.get(f"{owned.path}.m", Note())
    lower[0] = note.lower if note.lower is not None else 0.0
    if note.upper is not None:
        upper[0] = note.upper
    covariance = _body_covariance(owned, notes)
    information = np.zeros((10, 10)) if covariance is None else np.asarray(np.linalg.inv(covariance), dtype=float)
    return phi, lower, upper, information


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


def _scalar_block(scalar: Scalar, notes: dict[str, Note]) -> tuple[Array, Array, Array, Array]:
    note = notes.get(scalar.path, Note())
    low = note.lower if note.lower is not None else -np.inf if scalar.signed else 0.0
    high = note.upper if note.upper is not None else np.inf
    information = 0.0
    if note.sigma is not None:
        information = 1 / (note.sigma * (abs(scalar.value) or 1.0) if note.relative else note.sigma) ** 2
    return np.array([scalar.value]), np.array([low]), np.array([high]), np.array([[information]])
