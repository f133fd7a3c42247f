"""Zeros of pressures, which drift after the calibration: each moves the offset of one actuator's force."""

from __future__ import annotations

import numpy as np

from hydroopt.machine.actuators import Cylinder, Motor
from hydroopt.machine.machine import Machine
from hydroopt.model.model import Model
from hydroopt.spatial.inertia import Array


def with_offsets(model: Model) -> Model:
    """The same model with an offset of each actuator that pressures measure, zero where the machine file states none.

    >>> import hydroopt as ho
    >>> crane = ho.Model("forestry_crane")
    >>> sorted(set(with_offsets(crane).parameters.names) - set(crane.parameters.names))
    ['rotator_motor.tau_offset', 'slewing_racks.tau_offset']
    """
    machine = model.machine
    if all(each.friction.offset is not None for each in _read_by_pressures(machine)):
        return model
    stated = machine.model_copy(update={"cylinders": tuple(map(_with_offset, machine.cylinders)),
                                        "motors": tuple(map(_with_offset, machine.motors))})
    return Model(stated, actuator_inertia=model.actuator_inertia, calibrator=model.calibrator, terms=model.terms)


def drifts(model: Model, std: float) -> Array:
    """(p, a): what drifts of the pressures' zeros [Pa] do to the parameters of a model `with_offsets`, one column an
    actuator, per standard deviation of each zero."""
    read = _read_by_pressures(model.machine)
    made = np.zeros((len(model.parameters), len(read)))
    for k, each in enumerate(read):
        at = model.parameters.index(f"{each.name}.{each.effort_symbol}_offset")
        made[at, k] = std * float(np.linalg.norm([*each.effort_factors.values()]))
    return made


def _read_by_pressures(machine: Machine) -> tuple[Cylinder | Motor, ...]:
    return tuple(each for each in machine.measured_actuators if isinstance(each, Cylinder | Motor))


def _with_offset(actuator: Cylinder | Motor) -> Cylinder | Motor:
    if not actuator.measured or actuator.friction.offset is not None:
        return actuator
    return actuator.model_copy(update={"friction": actuator.friction.model_copy(update={"offset": 0.0})})
