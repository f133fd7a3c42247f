"""What the routines of the generated C are made of: structs, checks, and the symbols of a machine."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from functools import cached_property
from typing import NamedTuple

import casadi as ca
import numpy as np

from hydroopt.errors import ProblemError
from hydroopt.machine.geometry import Geometry
from hydroopt.machine.machine import Machine
from hydroopt.model.closed_chain import KinematicModel
from hydroopt.model.cylinder_motion import SHORTEST_LEVER
from hydroopt.model.kinematics import coordinates
from hydroopt.model.model import Model
from hydroopt.model.regressor import Dynamics
from hydroopt.spatial.inertia import NAMES, UNITS, Array

COINCIDENT = 1e-3
"""Pin distance [m] below which pins count as coinciding."""
STRAIGHT = 1e-4
"""Sine of the angle between the bars of a loop below which it is at a dead point, or cannot close."""
EMPTY = 1e-9
"""Volume [m³] below which a gas cylinder counts as empty."""
DETERMINED = 1e-6
"""How well a posture must determine the wrench at the tip, from 0 to 1, see `Dynamics.tip_wrench`."""


class Kind(NamedTuple):
    """Items that an array index enumerates: names in order, and units if they are numbers."""

    names: tuple[str, ...]
    units: tuple[str, ...] = ()


class Field(NamedTuple):
    """A member of a struct: shape as names of kinds or numbers, unit and meaning."""

    name: str
    shape: tuple[str | int, ...]
    unit: str
    text: str


class Struct(NamedTuple):
    """A struct of the interface."""

    name: str
    text: str
    fields: tuple[Field, ...]


class Guard(NamedTuple):
    """A check of a routine: a value, or its absolute value, must satisfy `relation` to a limit; else it returns
    `status`."""

    value: ca.SX
    relation: str
    limit: float
    status: str
    absolute: bool = False


class Routine(NamedTuple):
    """A function of the interface: the struct it takes and the members it reads, the struct it returns and its
    expressions.

    `lengths` are the pin distances of the hydraulic cylinders, which are compared with their strokes; None if the
    routine does not use them. `missing` states the reason for each member that this machine has not.
    """

    name: str
    text: str
    takes: str
    reads: tuple[str, ...]
    gives: str
    outputs: Mapping[str, ca.SX]
    guards: tuple[Guard, ...] = ()
    lengths: ca.SX | None = None
    missing: Mapping[str, str] = {}


class Symbols:
    """Symbols of a machine, and the structs that its routines add.

    Attributes:
        machine: the machine that is modelled.
        kinds: items that array indices enumerate; `units` are those of arrays with other units than their items.
        values: arrays that `prepare` takes, by name; empty ones are left out.
        inputs: symbols of those arrays and of all inputs of routines, by name.
        structs: parameters, inputs and outputs.
    """

    def __init__(self, machine: Machine, *, fold_geometry: bool = False, psi: Array | None = None) -> None:
        if not machine.one_each:
            raise ProblemError("code is generated for one measured actuator a joint only", where=machine.name,
                               remedy="describe the part of the machine for which that holds")
        self.machine = machine
        self.chain = KinematicModel(machine)
        self.complete, self.reduced = Model(machine), Model(machine, actuator_inertia=False)
        self.complete.refuse_seals("codegen")
        self.folded = fold_geometry
        known, free, units = self.complete.parameters, self.chain.parameters, machine.channel_units
        factors = [(channel, factor, units[channel], f"{unit}/({units[channel]})") for each, unit in
                   zip(self.complete.force_from_pressure.values(), self.complete.force_units, strict=True)
                   for channel, factor in each.items()]
        self.kinds = {
            "joint": Kind(machine.joints, tuple(units[f"{joint}.q"] for joint in machine.joints)),
            "link": Kind(tuple(link.name for link in machine.links)),
            "actuator": Kind(tuple(a.name for a in machine.actuators)),
            "cylinder": Kind(tuple(c.name for c in machine.cylinders)),
            "reading": Kind(tuple(f[0] for f in factors), tuple(f[2] for f in factors)),
            "geometry": Kind(() if fold_geometry else free.names, free.units), "psi": Kind(known.names, known.units),
            "reduced": Kind(self.reduced.parameters.names, self.reduced.parameters.units),
            "body": Kind(NAMES, tuple(UNITS)),
            "chain": Kind(self.chain.joints, tuple(units[f"{joint}.q"] for joint in self.chain.joints))}
        self.units = {"effort": tuple(f[3] for f in factors)}
        values = {
            "geometry": free.nominal if not fold_geometry else np.zeros(0),
            "psi": known.nominal if psi is None else psi,
            "effort": np.array([f[1] for f in factors]),
            "shortest": np.array([c.dead_length for c in machine.cylinders]),
            "longest": np.array([c.dead_length + c.stroke for c in machine.cylinders])}
        self.values: dict[str, Array] = {name: array for name, array in values.items() if len(array)}
        self.structs: dict[str, Struct] = {}
        self.struct("params", "Parameters: results of calibration and identification, and data of the manufacturer.",
                    Field("geometry", ("geometry",), "SI", "numbers of the geometry"),
                    Field("psi", ("psi",), "SI", "dynamic parameters"),
                    Field("effort", ("reading",), "SI", "actuator force per unit of each reading"),
                    Field("shortest", ("cylinder",), "m", "pin distance of each cylinder when retracted"),
                    Field("longest", ("cylinder",), "m", "pin distance of each cylinder when extended"))
        self.coordinates = coordinates(machine)
        self.inputs = {name: ca.SX.sym(name, len(array)) for name, array in self.values.items()}
        self.inputs |= dict(zip(("q", "qd", "qdd"), self.coordinates, strict=True))
        symbols = {name: self.inputs["geometry"][k] for k, name in enumerate(self.kinds["geometry"].names)}
        self.dynamics = Dynamics(Geometry(machine, symbols), self.coordinates)

    def size(self, field: Field) -> tuple[int, ...]:
        """Shape of a field in numbers."""
        return tuple(n if isinstance(n, int) else len(self.kinds[n].names) for n in field.shape)

    def struct(self, name: str, text: str, *fields: Field) -> str:
        """Add a struct, without empty members."""
        self.structs[name] = Struct(name, text, tuple(f for f in fields if all(self.size(f))))
        return name

    def symbol(self, name: str, size: int) -> ca.SX:
        """The symbol of an input (size,)."""
        return self.inputs.setdefault(name, ca.SX.sym(name, size))

    @property
    def lengths(self) -> ca.SX | None:
        """Pin distances of the hydraulic cylinders, if there are any."""
        if not self.machine.cylinders:
            return None
        return ca.vertcat(*(self.dynamics.cylinders[c.name].length for c in self.machine.cylinders))

    @property
    def measured(self) -> ca.SX:
        """Forces of the actuators by their readings (Eq. 4.33, 4.61)."""
        channels = self.kinds["reading"].names
        share = self.inputs["effort"] * self.symbol("reading", len(channels))
        return ca.vertcat(*(sum((share[channels.index(c)] for c in each), ca.SX(0))
                            for each in self.complete.force_from_pressure.values()))

    @cached_property
    def predicted(self) -> ca.SX:
        """Forces of a motion without a wrench at the tip."""
        return self.dynamics.forces(self.inputs["psi"])

    def guards(self, *, levers: bool = False, gas: bool = False) -> tuple[Guard, ...]:
        """Checks of loops and pin distances, and if asked for of lever arms and gas volumes."""
        found = [*self.straight(self.dynamics.tree.sines)]
        found += [Guard(self.dynamics.cylinders[c.name].length, ">", COINCIDENT, "OPEN_TRIANGLE")
                 for c in self.machine.all_cylinders]
        if levers:
            # the row of an actuator is that of the last joint it moves, so that the matrix of lever arms is triangular
            found += [Guard(bar, ">", SHORTEST_LEVER, "DEAD_POINT", absolute=True)
                      for bar in ca.vertsplit(ca.diag(self.dynamics.transmission)) if not bar.is_constant()]
        if gas:
            found += [Guard(each.gas_volume(self.dynamics.cylinders[each.name].length), ">", EMPTY, "NO_GAS_VOLUME")
                      for each in self.machine.gas_cylinders]
        return tuple(found)

    @staticmethod
    def straight(sines: Iterable[ca.SX]) -> tuple[Guard, ...]:
        """Checks that loops close, by the sines of the angles between their bars."""
        return tuple(Guard(sine, ">", STRAIGHT, "OPEN_TRIANGLE", absolute=True) for sine in sines)

    def motion(self) -> str:
        """The struct of a motion."""
        return self.struct("motion", "Motion of the joints.",
                           Field("q", ("joint",), "rad or m", "position of each joint"),
                           Field("qd", ("joint",), "rad/s or m/s", "its speed"),
                           Field("qdd", ("joint",), "rad/s^2 or m/s^2", "its acceleration"))

    def efforts(self) -> str:
        """The struct of actuator forces."""
        return self.struct("efforts", "Forces of the actuators, as measured by their pressures.", Field(
            "force", ("actuator",), "N or N*m", "force of each actuator, a cylinder's positive where it pushes"))
