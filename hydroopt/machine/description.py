"""The parts of a machine, and what follows from them: joints, actuators, channels, numbers."""

from __future__ import annotations

from functools import cached_property
from itertools import chain
from typing import Self

from pydantic import Field

from hydroopt.machine import addresses
from hydroopt.machine.actuators import Actuator, Cylinder, Drive, Motor
from hydroopt.machine.addresses import Number
from hydroopt.machine.balances import Balance, balance
from hydroopt.machine.closures import closures
from hydroopt.machine.couplings import Coupling
from hydroopt.machine.file_schema import Parts
from hydroopt.machine.imus import INCLINATION, Imu
from hydroopt.machine.links import Link, Note
from hydroopt.machine.matching import entangled, matched
from hydroopt.machine.quantity import CHANNEL_UNITS
from hydroopt.machine.sensor import Lag, Sensor
from hydroopt.machine.springs import Pinned
from hydroopt.machine.targets import TIP
from hydroopt.machine.valves import Circuit

BASE = "base"
"""Name of the machine's chassis, the root of the tree; it does not move."""
WRENCH = ("tip.fx", "tip.fy", "tip.fz", "tip.mx", "tip.my", "tip.mz")
"""Channels of the wrench that the surroundings exert on the machine at its tip: force, and moment about the tip, along
the axes of the base frame."""
_TURN_UNITS = dict.fromkeys(("rx", "ry", "rz"), "rad") | dict.fromkeys(("qw", "qx", "qy", "qz"), "1")
"""Components of a measured orientation: rotation vector, and quaternion."""


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
        """The joint of q that an actuator is there to move, see `hydroopt.machine.matching.matched`."""
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

    def effort_units(self, joint: str) -> tuple[str, str]:
        """SI units of a joint's effort (torque, or force where it slides) and of its viscous coefficient."""
        return ("N", "N*s/m") if self.link(joint).joint.type == "prismatic" else ("N*m", "N*m*s/rad")

    def position_unit(self, joint: str) -> str:
        """SI unit of a joint's position."""
        return "m" if self.link(joint).joint.type == "prismatic" else "rad"

    def ratio_unit(self, joint: str, other: str) -> str:
        """SI unit of the speed of one joint per speed of another one."""
        own, unit = self.position_unit(joint), self.position_unit(other)
        return "1" if own == unit else f"{own}/{unit}"

    def coupling_units(self, coupling: Coupling) -> dict[str, str]:
        """SI units of a coupling's ratios by joint, and of its offset."""
        ratios = {f"ratio.{joint}": self.ratio_unit(coupling.joint, joint) for joint in coupling.ratios}
        return ratios | {"offset": self.position_unit(coupling.joint)}

    def friction_units(self, joint: str) -> dict[str, str]:
        """SI units of what a joint, motor or drive may state as friction, by key."""
        effort, viscosity = self.effort_units(joint)
        speed = "m/s" if self.link(joint).joint.type == "prismatic" else "rad/s"
        return (dict.fromkeys(("offset", "coulomb", "coulomb_reverse", "stribeck"), effort)
                | dict.fromkeys(("viscous", "viscous_reverse"), viscosity)
                | dict.fromkeys(("stribeck_speed", "dead_zone"), speed))

    def spring_units(self, joint: str) -> dict[str, str]:
        """SI units of what a joint's spring states, by key."""
        effort, position = self.effort_units(joint)[0], self.position_unit(joint)
        return {"stiffness": f"{effort}/{position}", "reference": position, "preload": effort}

    @property
    def channel_units(self) -> dict[str, str]:
        """Every channel that a log of this machine may have, with its SI unit."""
        units: dict[str, str] = {}
        for joint in self.joints:
            prismatic = self.link(joint).joint.type == "prismatic"
            units[f"{joint}.q"] = "m" if prismatic else "rad"
            units[f"{joint}.qd"] = "m/s" if prismatic else "rad/s"
            units[f"{joint}.qdd"] = "m/s^2" if prismatic else "rad/s^2"
            units[f"{joint}.tau"] = self.effort_units(joint)[0]
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
        for imu in self.imus:
            units |= {channel: CHANNEL_UNITS[channel.rpartition(".")[2]][0] for channel in imu.channels}
            units |= {f"{imu.name}.{angle}": "rad" for angle in INCLINATION}
        units |= dict.fromkeys(WRENCH[:3], "N") | dict.fromkeys(WRENCH[3:], "N*m")
        if self.tracker:
            units |= dict.fromkeys(("tip.x", "tip.y", "tip.z"), "m") | {f"tip.{k}": u for k, u in _TURN_UNITS.items()}
        for instrument in self.instruments:
            for target in self.target_names:
                units |= {f"{instrument.name}.{target}.{axis}": unit
                          for axis, unit in (dict.fromkeys("xyz", "m") | _TURN_UNITS).items()}
        units |= {f"{datum.name}.{target}.{axis}": "m" for datum in self.datums for target in self.target_names
                  for axis in datum.axes}
        return units | {f"{each.name}.length": "m" for each in self.distances if each.measured}

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
            found += addresses.cylinder_bodies(cylinder)
        for joint in self.tree_joints:
            found += self.effort_numbers(joint)
        for gas in self.gas_cylinders:
            found += addresses.gas_numbers(gas)
        for spring in self.springs:
            found += addresses.spring_numbers(spring)
        found += [*self.hydraulic_numbers, *self.geometry_numbers]
        for fixture in self.fixtures:
            found += addresses.fixture_numbers(fixture)
        return {number.name: number for number in found}

    def place(self, path: str) -> str:
        """Place in the machine file of a number's path: ``links[boom].body.m`` of ``boom.body.m``."""
        owner, _, rest = path.partition(".")
        kinds = ("links", "loops", "couplings", "cylinders", "motors", "drives", "gas_cylinders", "springs", "imus",
                 "fixtures", "distances", "targets", "instruments", "datums", "stages", "total_masses")
        found = [kind for kind in kinds if any(part.name == owner for part in getattr(self, kind))]
        if self.calibrator and any(link.name == owner for link in self.calibrator.links):
            found.append("calibrator.links")
        return f"{found[0]}[{owner}].{rest}" if found else path

    def effort_numbers(self, joint: str) -> tuple[Number, ...]:
        """Friction, offset and rotor of a moving joint and its actuators, in the order of Eq. 4.53, 4.54."""
        units = self.friction_units(joint)
        return (*addresses.joint_friction(self.link(joint), units),
                *addresses.joint_spring(self.link(joint), self.spring_units(joint)), *chain.from_iterable(
            addresses.actuator_numbers(each, units) for each in self.drivers.get(joint, ())))

    @property
    def hydraulic_numbers(self) -> tuple[Number, ...]:
        """Numbers of the oil, then of valves, hoses and leaks, actuator by actuator."""
        circuits = (addresses.circuit_numbers(name, circuit) for name, circuit in self.circuits.items())
        return (*(addresses.oil_numbers(self.oil) if self.oil else ()), *chain.from_iterable(circuits))

    @property
    def geometry_numbers(self) -> tuple[Number, ...]:
        """Numbers of links and joints, pins, tip and tracker."""
        links = (*self.links, *(self.calibrator.links if self.calibrator else ()))
        found = [*chain.from_iterable(map(addresses.link_geometry, links)),
                 *chain.from_iterable(map(addresses.joint_compliance, links)),
                 *chain.from_iterable(map(addresses.loop_numbers, self.loops)),
                 *chain.from_iterable(addresses.coupling_numbers(each, self.coupling_units(each))
                                      for each in self.couplings),
                 *chain.from_iterable(map(addresses.dead_length, self.cylinders))]
        if self.calibrator:
            found += addresses.point("tip", self.calibrator.tip, "calibrator.tip")
        if self.tracker:
            found += [*addresses.point("tracker", self.tracker.position, "tracker.position"),
                      *addresses.orientation("tracker", self.tracker.orientation, "tracker.orientation")]
        found += [*self._mountings, *chain.from_iterable(map(addresses.target_numbers, self.targets)),
                  *chain.from_iterable(map(addresses.instrument_numbers, self.instruments)),
                  *chain.from_iterable(map(addresses.datum_numbers, self.datums))]
        return (*found, *chain.from_iterable(map(addresses.pins, self.pinned)))

    @property
    def imu_numbers(self) -> frozenset[str]:
        """Addresses of the numbers that say where IMUs sit."""
        return frozenset(number.name for number in self._mountings)

    @property
    def _mountings(self) -> list[Number]:
        return [number for imu in self.imus
                for number in (*addresses.point(imu.name, imu.position, f"{imu.name}.position"),
                               *addresses.orientation(imu.name, imu.orientation, f"{imu.name}.orientation"))]

    def sensor(self, channel: str) -> Sensor | None:
        """The sensor that reads a channel, if the file states one."""
        units = (imu.sensor(channel) for imu in self.imus)
        return next((s for s in (*self.sensors, *units) if s and channel in s.channels), None)

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
