"""The parts of a machine, and what follows from them: joints, actuators, channels, numbers."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from functools import cached_property
from itertools import chain
from typing import Any, Self

import numpy as np
from pydantic import Field

from hydroopt.machine import addresses
from hydroopt.machine.actuators import Actuator, Cylinder, CylinderFriction, Drive, Motor, Pinned
from hydroopt.machine.addresses import Number
from hydroopt.machine.balances import Balance, UnmeasuredJoint, balance, entangled, matched
from hydroopt.machine.calibration_chain import Fixture
from hydroopt.machine.closures import closures
from hydroopt.machine.file_schema import Parts
from hydroopt.machine.links import Link, Note
from hydroopt.machine.loops import Coupling
from hydroopt.machine.parameter_kind import ParameterKind
from hydroopt.machine.quantity import Noun, quantity_of
from hydroopt.machine.sensors import Imu, Lag, Measuring, Sensor
from hydroopt.machine.survey import SEEN, TIP
from hydroopt.machine.valves import Circuit, Valve
from hydroopt.spatial.inertia import Array

BASE = "base"
"""Name of the machine's chassis, the root of the tree; it does not move."""
WRENCH = ("tip.fx", "tip.fy", "tip.fz", "tip.mx", "tip.my", "tip.mz")
"""Channels of the wrench that the surroundings exert on the machine at its tip: force, and moment about the tip, along
the axes of the base frame."""


class MachineDescription(Parts):
    """The parts of a machine and what is known of their numbers; `Machine` adds the invariants between them."""

    links: tuple[Link, ...] = Field(min_length=1)
    """Links, each behind the one that carries it."""
    notes: dict[str, Note] = Field(default_factory=dict)
    """Confidences, bounds and sources of numbers, by address; a file states them beside each number."""

    def __copy__(self) -> Self:
        """A copy without what was derived from the numbers that the caller is about to change."""
        copied = super().__copy__()
        for name in set(vars(copied)) - set(type(self).model_fields):
            del copied.__dict__[name]
        return copied

    @cached_property
    def joints(self) -> tuple[str, ...]:
        """Names of the joints that move by themselves (those of their links), in the order of the joint vector q."""
        return tuple(link.name for link in self.links if link.joint.independent)

    @property
    def ranges(self) -> Array:
        """Lower and upper limits (n, 2) [rad, m] of the joints that move by themselves."""
        return np.array([link.joint.range for link in self.links if link.joint.independent]).reshape(-1, 2)

    @cached_property
    def tree_joints(self) -> tuple[str, ...]:
        """Names of all moving joints: those of q, and the dependent ones that loops and couplings determine."""
        return tuple(link.name for link in self.links if link.joint.moving)

    @property
    def dependent_joints(self) -> tuple[str, ...]:
        """Names of the joints that loops and couplings determine."""
        return tuple(link.name for link in self.links if link.joint.moving and not link.joint.independent)

    @property
    def base_joints(self) -> tuple[str, ...]:
        """Names of the joints of a moving base, which the ground moves."""
        by_ground = {drive.joint for drive in self.drives if drive.ground}
        return tuple(joint for joint in self.joints if joint in by_ground)

    @cached_property
    def followed(self) -> dict[str, tuple[str, ...]]:
        """The joints of q that each moving joint follows: an independent one itself."""
        found: dict[str, tuple[str, ...]] = {joint: (joint,) for joint in self.joints}
        for closure in closures(self.links, self.loops, self.couplings):
            found |= dict.fromkeys(closure.joints, closure.follows)
        return found

    @property
    def tip(self) -> str:
        """The link whose far end is the machine's tip: the last one."""
        return self.links[-1].name

    @property
    def chain(self) -> tuple[Link, ...]:
        """Links from the base to the tip that carries the ball: those of the machine, then the calibrator's."""
        if self.calibrator is None:
            return ()
        own = (self.link(name) for name in reversed(self.ancestry(self.calibrator.parent)))
        return (*own, *self.calibrator.links)

    @cached_property
    def actuators(self) -> tuple[Actuator, ...]:
        """All actuators in the order of the joints that they are there to move."""
        found: tuple[Actuator, ...] = (*self.cylinders, *self.motors, *self.drives)
        return tuple(sorted(found, key=lambda actuator: self.joints.index(self.main_joint(actuator))))

    @cached_property
    def balances(self) -> tuple[Balance, ...]:
        """The measured equations of motion in the order of their joints: the order of measured forces."""
        drivers, found = self.drivers, []
        for joint in self.joints:
            made = balance(joint, self.redundant.get(joint, drivers[joint]),
                           prismatic=self.link(joint).joint.type == "prismatic")
            found += [made] if made else []
        return tuple(found)

    @cached_property
    def measured_actuators(self) -> tuple[Actuator, ...]:
        """The measured actuators that a balance depends on, in the order of `actuators`."""
        at = {each.joint for each in self.balances}
        return tuple(each for each in self.actuators if each.measured and at.intersection(self.moved_by(each)))

    @property
    def unmeasured_joints(self) -> tuple[UnmeasuredJoint, ...]:
        """Every joint that has no balance though something moves it; none of those that the ground moves."""
        return tuple(UnmeasuredJoint(joint, actuators, lost) for joint, actuators in self.drivers.items()
                     if joint not in self.base_joints
                     and (lost := tuple(each.name for each in actuators if not each.measured)))

    @property
    def one_each(self) -> bool:
        """Whether each joint of q has one actuator, which is measured: balances are then the actuators' forces."""
        balances = self.balances
        return len(balances) == len(self.joints) and all(each.alone for each in balances)

    @cached_property
    def drivers(self) -> dict[str, tuple[Actuator, ...]]:
        """The actuators that are there to move each joint of q."""
        mains = [(self.main_joint(each), each) for each in self.actuators]
        return {joint: tuple(each for main, each in mains if main == joint) for joint in self.joints}

    @cached_property
    def powered(self) -> tuple[Actuator, ...]:
        """The actuators of the machine itself, in the order of `actuators`: all but the ground that moves its base."""
        return tuple(each for each in self.actuators if self.main_joint(each) not in self.base_joints)

    @property
    def sealed(self) -> tuple[str, ...]:
        """Names of the measured cylinders whose friction depends on their pressures."""
        return tuple(each.name for each in self.measured_actuators
                     if isinstance(each, Cylinder) and each.friction.seal is not None)

    @property
    def circuits(self) -> dict[str, Circuit]:
        """Valves, hoses and leaks of the actuators that state them, by the actuator's name."""
        return {each.name: each.circuit for each in self.hydraulic_actuators if each.circuit is not None}

    @property
    def hydraulic_actuators(self) -> tuple[Cylinder | Motor, ...]:
        """The actuators that oil drives, in the order of `actuators`."""
        return tuple(actuator for actuator in self.actuators if not isinstance(actuator, Drive))

    @property
    def pinned(self) -> tuple[Pinned, ...]:
        """The parts between two pins: hydraulic and gas-charged cylinders, and springs."""
        return (*self.cylinders, *self.gas_cylinders, *self.springs)

    def main_joint(self, actuator: Actuator) -> str:
        """The joint of q that an actuator is there to move, see `hydroopt.machine.balances.matched`."""
        return self._mains[actuator.name]

    @cached_property
    def _mains(self) -> dict[str, str]:
        return matched(self._moved, [joint for joint in self.joints if not self.link(joint).joint.passive])

    @cached_property
    def _moved(self) -> dict[str, tuple[str, ...]]:
        actuators: tuple[Actuator, ...] = (*self.cylinders, *self.motors, *self.drives)
        return {each.name: self.moved_by(each) for each in actuators}

    @cached_property
    def entangled(self) -> tuple[tuple[str, ...], ...]:
        """Groups of joints that only all of their actuators move together, as those of a platform."""
        return entangled(self._moved, self._mains, self.joints)

    @cached_property
    def redundant(self) -> dict[str, tuple[Actuator, ...]]:
        """The joints of `entangled` that more actuators than joints move together, with all of these actuators."""
        found: dict[str, tuple[Actuator, ...]] = {}
        for group in self.entangled:
            shared = tuple(each for each in self.actuators if self.main_joint(each) in group)
            found |= dict.fromkeys(group, shared) if len(shared) > len(group) else {}
        return found

    def moved_by(self, part: Actuator | Pinned) -> tuple[str, ...]:
        """The joint of q that a motor or drive turns, or those on which a cylinder's length depends."""
        if isinstance(part, Motor | Drive):
            return (part.joint,)
        between, followed = self.joints_between(part.barrel.link, part.rod.link), self.followed
        moving = {name for joint in between for name in followed.get(joint, ())}
        return tuple(joint for joint in self.joints if joint in moving)

    def moved_along(self, joint: str) -> tuple[str, ...]:
        """Dependent joints that couplings move along with one joint, as the sections of a telescope on one chain."""
        return tuple(other for coupling in self.couplings
                     if [each for each in coupling.joints if each in self.joints] == [joint]
                     for other in coupling.joints if other != joint)

    def link(self, name: str) -> Link:
        """The link of this name."""
        return next(link for link in self.links if link.name == name)

    def ancestry(self, name: str) -> tuple[str, ...]:
        """Links from the one named down to the base, the base left out."""
        chain: list[str] = []
        while name != BASE:
            chain.append(name)
            name = self.link(name).parent
        return tuple(chain)

    def joints_between(self, one: str, other: str) -> tuple[str, ...]:
        """Moving joints of the tree on the way between two links, in the order of the links."""
        apart = set(self.ancestry(one)) ^ set(self.ancestry(other))
        return tuple(joint for joint in self.tree_joints if joint in apart)

    def axis_of(self, cylinder: Pinned) -> str:
        """The joint whose axis orients the cylinder's bodies: the last moving one of the tree between its ends."""
        return self.joints_between(cylinder.barrel.link, cylinder.rod.link)[-1]

    def effort_unit(self, joint: str) -> str:
        """SI unit of a joint's effort: a torque, or a force where it slides."""
        return "N" if self.link(joint).joint.type == "prismatic" else "N*m"

    def turns(self, joint: str) -> bool:
        """Whether a joint turns, not slides."""
        return self.link(joint).joint.type == "revolute"

    def in_words(self, posture: Mapping[str, float]) -> str:
        """Positions [rad or m] of joints by name in words."""
        return ", ".join(f"{joint} = {math.degrees(value):.1f} deg" if self.turns(joint) else f"{joint} = {value:.3f} m"
                         for joint, value in posture.items())

    def position_unit(self, joint: str) -> str:
        """SI unit of a joint's position."""
        return "m" if self.link(joint).joint.type == "prismatic" else "rad"

    def ratio_unit(self, joint: str, other: str) -> str:
        """SI unit of the speed of one joint per speed of another one."""
        own, unit = self.position_unit(joint), self.position_unit(other)
        return "1" if own == unit else f"{own}/{unit}"

    def unit(self, node: Noun, key: str, owner: str) -> str | None:
        """SI unit of a key of a part, as its joint turns or slides, its channels are or its command is; None of none.

        `owner` is the name of the part that has the key, or of the joint in a table of numbers by joints.
        """
        match node, key:
            case Coupling(), "ratios":
                return self.ratio_unit(node.joint, owner)
            case Coupling(), "offset":
                owner = node.joint
            case Sensor(), "accuracy" | "resolution":
                return self.channel_units.get(node.channels[0])
            case Valve(), "neutral" | "full" | "dead_band" | "dead_band_reverse":
                return node.command
        mark = quantity_of(type(node), key)
        if mark is None or mark.sliding == mark.si:
            return None if mark is None else mark.si
        rotary: tuple[Motor | Drive, ...] = (*self.motors, *self.drives)
        moved = next((part.joint for part in rotary if part.name == owner), owner)
        links = (*self.links, *(self.calibrator.links if self.calibrator else ()))
        slides = isinstance(node, CylinderFriction) or any(
            link.name == moved and link.joint.type == "prismatic" for link in links)
        return mark.sliding if slides else mark.si

    @property
    def channel_units(self) -> dict[str, str]:
        """Every channel that a log of this machine may have, with its SI unit."""
        units: dict[str, str] = {}
        for joint in self.joints:
            unit = self.position_unit(joint)
            units |= {f"{joint}.q": unit, f"{joint}.qd": f"{unit}/s", f"{joint}.qdd": f"{unit}/s^2",
                      f"{joint}.tau": self.effort_unit(joint)}
        for cylinder in self.cylinders:
            units |= {f"{cylinder.name}.length": "m", **dict.fromkeys(cylinder.chambers, "Pa"),
                      f"{cylinder.name}.force": "N"}
        for motor in self.motors:
            units |= dict.fromkeys(motor.chambers, "Pa")
        units |= {f"{name}.u": circuit.valve.command for name, circuit in self.circuits.items()}
        if self.pump:
            units |= {"pump.p_supply": "Pa", "pump.p_tank": "Pa"}
        for joint in self.dependent_joints:
            units[f"{joint}.q"] = self.position_unit(joint)
        for link in self.chain:
            if link.joint.moving:
                units[f"{link.name}.q"] = "m" if link.joint.type == "prismatic" else "rad"
            units[f"{link.name}.distance"] = "m"
        units |= dict.fromkeys(WRENCH[:3], "N") | dict.fromkeys(WRENCH[3:], "N*m")
        if self.tracker:
            units |= {f"tip.{axis}": unit for axis, unit in SEEN.items()}
        for part in self.measuring:
            units |= part.channel_units(self.target_names)
        return units

    @cached_property
    def measuring(self) -> tuple[Measuring, ...]:
        """The parts that poses are measured with beside joints, cylinders, the tracked tip and tapes to fixtures."""
        return tuple(part for parts in self.parts.values() for part in parts if isinstance(part, Measuring))

    @property
    def target_names(self) -> tuple[str, ...]:
        """Names of the targets, and of the calibrator's tip."""
        return (*(target.name for target in self.targets), *((TIP,) if self.calibrator else ()))

    @property
    def numbers(self) -> dict[str, Number]:
        """Every number that a calibration may change, by its address: bodies, friction, gas, hydraulics, geometry.

        >>> from hydroopt.machine.machine_file import load_machine
        >>> load_machine("cat215b").numbers["boom.a"].unit
        'm'
        """
        found: list[Number] = []
        for link in (*self.links, *(self.calibrator.links if self.calibrator else ())):
            if link.body is not None:
                found += addresses.body_numbers(link.name, link.body, f"{link.name}.body")
        for cylinder in self.cylinders:
            for end, attachment in (("rod", cylinder.rod), ("barrel", cylinder.barrel)):
                if attachment.body is not None:
                    owner = f"{cylinder.name}.{end}"
                    found += addresses.body_numbers(owner, attachment.body, f"{owner}.body")
        for joint in self.tree_joints:
            found += self.effort_numbers(joint)
        found += [*self.passive_numbers, *self.hydraulic_numbers, *self.geometry_numbers]
        found += chain.from_iterable(map(self.fixture_numbers, self.fixtures))
        return {number.name: number for number in found}

    @property
    def parts(self) -> dict[str, tuple[Any, ...]]:
        """The parts that have names, by the key of their tables, those of the calibrator last."""
        found = {key: value for key, value in self if isinstance(value, tuple) and value and hasattr(value[0], "name")}
        return found | {"calibrator.links": self.calibrator.links if self.calibrator else ()}

    def place(self, path: str) -> str:
        """Place in the machine file of a number's path: ``links[boom].body.m`` of ``boom.body.m``."""
        owner, _, rest = path.partition(".")
        found = next((key for key, parts in self.parts.items() if any(part.name == owner for part in parts)), None)
        return f"{found}[{owner}].{rest}" if found else path

    def _stated(self, rows: Sequence[addresses.Row], *kinds: Sequence[Any]) -> Iterator[Number]:
        return (number for parts in kinds for part in parts
                for number in addresses.stated(part, rows, self.unit, part.name))

    def effort_numbers(self, joint: str) -> tuple[Number, ...]:
        """Friction, offset and rotor of a moving joint and its actuators, in the order of Eq. 4.53, 4.54."""
        return (*self._stated(addresses.JOINT, (self.link(joint),)),
                *self._stated(addresses.ACTUATOR, self.drivers.get(joint, ())))

    @property
    def passive_numbers(self) -> tuple[Number, ...]:
        """Pressures of gas-charged cylinders, stiffness and preload of springs between two pins."""
        return (*self._stated((("precharge", ParameterKind.GAS_PRESSURE),), self.gas_cylinders),
                *self._stated(addresses.ELASTIC, self.springs))

    @property
    def hydraulic_numbers(self) -> tuple[Number, ...]:
        """Numbers of the oil, then of valves, hoses and leaks, actuator by actuator."""
        circuits = (addresses.stated(circuit, addresses.CIRCUIT, self.unit, name, f"{name}.circuit")
                    for name, circuit in self.circuits.items())
        return (*(addresses.stated(self.oil, addresses.OIL, self.unit, "oil") if self.oil else ()),
                *chain.from_iterable(circuits))

    @property
    def geometry_numbers(self) -> tuple[Number, ...]:
        """Numbers of links and joints, pins, tip and tracker."""
        links = (*self.links, *(self.calibrator.links if self.calibrator else ()))
        single: list[Number] = []
        if self.calibrator:
            tip: Sequence[addresses.Row] = (("tip", ParameterKind.POSITION, ""),)
            single += addresses.stated(self.calibrator, tip, self.unit, "tip", "calibrator")
        if self.tracker:
            single += addresses.stated(self.tracker, addresses.FRAME, self.unit, "tracker")
        return (*self._stated(addresses.DENAVIT_HARTENBERG, links),
                *self._stated((("joint.compliance", ParameterKind.COMPLIANCE),),
                              [link for link in links if link.joint.moving]),
                *self._stated(addresses.LOOP, self.loops), *self._stated(addresses.COUPLING, self.couplings),
                *self._stated((("dead_length", ParameterKind.DEAD_LENGTH),), self.cylinders), *single,
                *chain.from_iterable(self._stated(rows, getattr(self, key))
                                     for key, rows in addresses.MEASURING.items()),
                *self._stated(addresses.ENDS, self.pinned))

    def fixture_numbers(self, fixture: Fixture) -> tuple[Number, ...]:
        """Where a fixture stands, and how unless it is a ball."""
        return tuple(self._stated(addresses.FRAME[:1] if fixture.kind == "ball" else addresses.FRAME, (fixture,)))

    @property
    def imu_numbers(self) -> frozenset[str]:
        """Addresses of the numbers that say where IMUs sit."""
        return frozenset(number.name for number in self._stated(addresses.FRAME, self.imus))

    def sensor(self, channel: str) -> Sensor | None:
        """The sensor that reads a channel, if the file states one."""
        own = (part.sensor(channel) for part in self.measuring)
        return next((s for s in (*self.sensors, *own) if s and channel in s.channels), None)

    @property
    def lags(self) -> dict[str, Sensor | Imu]:
        """What may lag, by the path of its lag."""
        found: dict[str, Sensor | Imu] = {f"sensors.{k}.lag": sensor for k, sensor in enumerate(self.sensors)}
        return found | {f"{imu.name}.lag": imu for imu in self.imus}

    def lag(self, channel: str) -> Lag:
        """How a channel's readings lag behind the true values; none if the file states none."""
        for path, one in self.lags.items():
            if one.lag and channel in one.channels:
                name = one.name if isinstance(one, Imu) else ", ".join(one.channels)
                return Lag(f"{name}: lag", one.lag, self.notes.get(path, Note()).spread(one.lag) or 0.0)
        return Lag()
