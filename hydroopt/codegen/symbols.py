"""What the routines of the generated C are made of: structs, checks, and the symbols of a machine."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from functools import cached_property
from typing import NamedTuple

import casadi as ca
import numpy as np

from hydroopt.machine.actuators import Cylinder
from hydroopt.machine.balances import Balance
from hydroopt.machine.geometry import Geometry
from hydroopt.machine.machine import Machine
from hydroopt.model.closed_chain import KinematicModel
from hydroopt.model.cylinder_motion import SHORTEST_LEVER
from hydroopt.model.joints_from_readings import Slide, Together, slides, together
from hydroopt.model.kinematics import coordinates
from hydroopt.model.model import Model
from hydroopt.model.regressor import Dynamics
from hydroopt.spatial.inertia import NAMES, UNITS, Array

COINCIDENT = 1e-3
"""Pin distance [m] below which pins count as coinciding."""
STRAIGHT = 1e-4
"""Sine of the angle between the bars of a loop below which it is at a dead point, or cannot close."""
PARALLEL = 0.9995
"""Cosine of the angle between a cylinder and the axis that orients it above which they count as parallel (1.8°): single
precision then loses the angle."""
EMPTY = 1e-9
"""Volume [m³] below which a gas cylinder counts as empty."""
TURN = 2 * np.pi
NO_PRESSURE = -1e6
"""Reading [Pa, gauge] below which a pressure is none: far below vacuum, beyond what errors of transducers explain."""
ABOVE = f"above {NO_PRESSURE / 1e6:g} MPa"
"""The same in the comments of members."""
DETERMINED = 1e-6
"""How well a posture must determine the wrench at the tip, from 0 to 1, see `Dynamics.tip_wrench`."""


class Kind(NamedTuple):
    """Items that an array index enumerates: names in order, units if they are numbers, and what is to be known of them.
    """

    names: tuple[str, ...]
    units: tuple[str, ...] = ()
    remarks: Mapping[str, str] = {}


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
        row: what measured forces are counted in: actuators where each joint has a measured one, otherwise balances.
        valve: what commands are counted in: actuators, or valves where the ground counts as one that moves the base.
    """

    def __init__(self, machine: Machine, *, fold_geometry: bool = False, psi: Array | None = None) -> None:
        self.machine = machine
        self.chain = KinematicModel(machine)
        self.complete, self.reduced = Model(machine), Model(machine, actuator_inertia=False)
        self.complete.refuse_seals("codegen")
        self.folded = fold_geometry
        known, free, units = self.complete.parameters, self.chain.parameters, machine.channel_units
        self.row = "actuator" if machine.one_each else "balance"
        self.valve = "actuator" if machine.powered == machine.actuators else "valve"
        efforts = ((each, "N" if isinstance(each, Cylinder) else machine.effort_unit(each.joint))
                   for each in machine.measured_actuators)
        factors = [(channel, factor, units[channel], f"{unit}/({units[channel]})") for each, unit in efforts
                   for channel, factor in each.effort_factors.items()]
        self.kinds = {
            "joint": Kind(machine.joints, tuple(units[f"{joint}.q"] for joint in machine.joints)),
            "link": Kind(tuple(link.name for link in machine.links)),
            "actuator": Kind(tuple(a.name for a in machine.actuators), remarks={
                a.name: "not measured" for a in machine.actuators if not a.measured}),
            "valve": Kind(tuple(a.name for a in machine.powered)),
            "cylinder": Kind(tuple(c.name for c in machine.cylinders)),
            "reading": Kind(tuple(f[0] for f in factors), tuple(f[2] for f in factors)),
            "geometry": Kind(() if fold_geometry else free.names, free.units), "psi": Kind(known.names, known.units),
            "reduced": Kind(self.reduced.parameters.names, self.reduced.parameters.units),
            "body": Kind(NAMES, tuple(UNITS)),
            "balance": Kind(tuple(each.name for each in machine.balances), self.complete.force_units,
                            {each.name: _measured_by(each) for each in machine.balances}),
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

    def force_units(self, kind: str) -> tuple[str, ...]:
        """Units of the forces that are counted in actuators or balances."""
        if kind == "balance":
            return self.complete.force_units
        return tuple("N" if isinstance(each, Cylinder) else self.machine.effort_unit(each.joint)
                     for each in self.machine.actuators)

    @property
    def lengths(self) -> ca.SX | None:
        """Pin distances of the hydraulic cylinders, if there are any."""
        if not self.machine.cylinders:
            return None
        return ca.vertcat(*(self.dynamics.cylinders[c.name].length for c in self.machine.cylinders))

    @property
    def read(self) -> ca.SX:
        """Forces of the actuators by their readings (Eq. 4.33, 4.61); zero where nothing is read."""
        channels, parts = self.kinds["reading"].names, self.complete.force_from_pressure
        share = self.inputs["effort"] * self.symbol("reading", len(channels))
        return ca.vertcat(*(sum((share[channels.index(c)] for c in parts.get(each.name, ())), ca.SX(0))
                            for each in self.machine.actuators))

    @property
    def measured(self) -> ca.SX:
        """Measured forces of the balances by the actuators' readings."""
        return self.read if self.machine.one_each else self.dynamics.shares @ self.read

    @cached_property
    def slides(self) -> tuple[Slide, ...]:
        """The joints that slide and follow from one length."""
        return slides(self.complete)

    @cached_property
    def together(self) -> tuple[Together, ...]:
        """The joints that follow from several lengths."""
        return together(self.complete)

    @cached_property
    def predicted(self) -> ca.SX:
        """Forces of a motion without a wrench at the tip."""
        return self.dynamics.forces(self.inputs["psi"])

    def guards(self, *, levers: bool = False, gas: bool = False) -> tuple[Guard, ...]:
        """Checks of loops, and lengths and directions of cylinders; if asked for of lever arms and gas volumes."""
        cylinders = [self.dynamics.cylinders[c.name] for c in self.machine.pinned]
        found = [*self.turns(self.coordinates.q, self.machine.joints), *self.straight(self.dynamics.tree.sines),
                 *(Guard(each.length, ">", COINCIDENT, "OPEN_TRIANGLE") for each in cylinders),
                 *(Guard(each.along, "<", PARALLEL, "DEAD_POINT", absolute=True) for each in cylinders
                   if not each.along.is_constant())]
        if levers:
            # several actuators at a joint may pass their dead points
            found += self.arms(self.dynamics.levers)
        if gas:
            found += [Guard(each.gas_volume(self.dynamics.cylinders[each.name].length), ">", EMPTY, "NO_GAS_VOLUME")
                      for each in self.machine.gas_cylinders]
        return tuple(found)

    def turns(self, q: ca.SX, joints: Iterable[str]) -> tuple[Guard, ...]:
        """Checks that angles q of joints with limits are within half a turn of the middle of their ranges.

        Others, such as degrees for radians, would be taken for angles within them.
        """
        known, found = {link.name: link.joint for link in self.chain.links}, []
        for k, name in enumerate(joints):
            lower, upper = known[name].range
            if known[name].type == "revolute" and upper - lower < TURN:
                found.append(Guard(q[k] - (lower + upper) / 2, "<=", TURN / 2, "OUT_OF_RANGE", absolute=True))
        return tuple(found)

    def pressures(self, *names: str) -> tuple[Guard, ...]:
        """Checks that inputs which are pressures can be such; of readings those in Pa."""
        units = {"reading": self.kinds["reading"].units}
        return tuple(Guard(self.inputs[name][k], ">=", NO_PRESSURE, "OUT_OF_RANGE") for name in names
                     for k in range(self.inputs[name].numel()) if name not in units or units[name][k] == "Pa")

    @staticmethod
    def arms(bars: Iterable[ca.SX]) -> tuple[Guard, ...]:
        """Checks of lever arms."""
        return tuple(Guard(bar, ">", SHORTEST_LEVER, "DEAD_POINT", absolute=True) for bar in bars
                     if not bar.is_constant())

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

    def per_row(self, name: str, text: str, *by: str | int, unit: str = "N or N*m") -> Field:
        """A member with a row for each actuator or balance, and columns; ``{row}`` in its text stands for one of these.
        """
        return Field(name, (self.row, *by), unit, text.format(row=self.row))

    @property
    def force(self) -> Field:
        """The member with measured forces."""
        return self.per_row("force", "force of each {row}, a cylinder's positive where it pushes")

    def efforts(self) -> str:
        """The struct of measured forces."""
        text = "Forces of the actuators, as measured by their pressures."
        return self.struct("efforts", text if self.row == "actuator" else "What the balances measure, see their index.",
                           self.force)


def _measured_by(balance: Balance) -> str:
    """What a balance states, in words."""
    if balance.alone:
        return "the actuator's force"
    if not balance.actuators:
        return f"nothing drives {balance.joint}: measured is zero"
    return f"what {' and '.join(each.name for each in balance.actuators)} do at {balance.joint} together"
