"""A machine: its parts, and the invariants that hold between them."""

from __future__ import annotations

import hashlib
import json
import math
from collections import Counter
from collections.abc import Collection, Iterator, Mapping
from functools import cached_property
from itertools import chain
from typing import Any, Self

from pydantic import ModelWrapValidatorHandler, ValidationError, ValidationInfo, model_validator

from hydroopt.errors import MachineError
from hydroopt.machine import addresses
from hydroopt.machine.actuators import Actuator, Drive, Motor
from hydroopt.machine.description import BASE, MachineDescription
from hydroopt.machine.environment import STEEPEST
from hydroopt.machine.links import Joint, Note
from hydroopt.machine.quantity import ImpossibleError, Noun, quantity_of, with_likely_units
from hydroopt.machine.sensors import INCLINATION, Imu, Sensor
from hydroopt.machine.survey import TIP
from hydroopt.support.input_file import similar
from hydroopt.support.notebook_card import Card, CardTable, Drawn
from hydroopt.units import UnitError, to_si

__all__ = ["BASE", "Machine"]


class Machine(Drawn, MachineDescription):
    """A manipulator: a tree of links on the base, their actuators, and the sensors.

    `orientation` is roll, pitch, yaw of the base frame in a world whose z points up. Above the frequency `bandwidth`
    the links no longer move as rigid bodies driven by their actuators: measured motion is smoothed at least that much.
    `ground` is the height of the ground in the base frame [m], along z: the ground is as tilted as the base on it.

    >>> from hydroopt.machine.machine_file import load_machine
    >>> machine = load_machine("cat215b")
    >>> machine
    Machine('cat215b': 3 joints, 2 cylinders, 1 motor)
    >>> machine.joints
    ('swing', 'boom', 'stick')
    """

    def __repr__(self) -> str:
        counts = {"joint": self.joints, "cylinder": self.cylinders, "motor": self.motors, "drive": self.drives,
                  "gas cylinder": self.gas_cylinders, "spring": self.springs}
        said = ", ".join(f"{len(parts)} {noun}{'s' * (len(parts) != 1)}" for noun, parts in counts.items() if parts)
        return f"Machine('{self.name}': {said or 'no joints'})"

    __str__ = __repr__

    def card(self) -> Card:
        """What a notebook shows: joints with their ranges, and what moves them."""
        rows = []
        for link in self.links:
            joint = link.joint
            moved = ", ".join(each.name for each in self.drivers.get(link.name, ()))
            rows.append((link.name, joint.type, _span(joint), moved or ("passive" * joint.passive)))
        facts = {"description": self.description} if self.description else {}
        return Card(repr(self), facts, [CardTable(("link", "joint", "range", "moved by"), rows)])

    def _mistakes(self) -> Iterator[ImpossibleError]:
        kinds = (self._names, self._references, self._tree, self._actuation, self._seen, self._masses, self._bounds)
        return chain.from_iterable(kind() for kind in kinds)

    @model_validator(mode="wrap")
    @classmethod
    def _units_fit(cls, data: Any, handler: ModelWrapValidatorHandler[Self], info: ValidationInfo) -> Self:
        # only here are both the type of a joint and the unit of a text available
        machine = handler(data)
        from_file = bool((info.context or {}).get("from_file"))
        for where, text, si in machine._units_stated(machine, data, "", ""):
            try:
                _ = isinstance(text, str) and to_si(text, si, where=where)
            except UnitError as error:
                raise ImpossibleError(f"{error.what} (its joint, channel or valve calls for {si})", error.remedy,
                                      where) from None
            if from_file and si != "1" and isinstance(text, int | float):
                raise ImpossibleError(f"{text:.9g} has no unit", f"write it as {with_likely_units(text, si)}", where)
        return machine

    def _units_stated(self, node: Noun, raw: Any, place: str, owner: str) -> Iterator[tuple[str, Any, str]]:
        """Place, statement and proper SI unit of each number whose unit depends on what its part belongs to."""
        for key in type(node).model_fields if isinstance(raw, Mapping) else ():
            value, text, at = getattr(node, key), raw.get(key), f"{place}.{key}".lstrip(".")
            if isinstance(value, Noun):
                yield from self._units_stated(value, text, at, owner)
            elif isinstance(value, tuple) and value and isinstance(value[0], Noun):
                for k, (part, one) in enumerate(zip(value, text or (), strict=True)):
                    name = getattr(part, "name", None)
                    yield from self._units_stated(part, one, f"{at}[{k if name is None else name}]", name or owner)
            elif isinstance(node, Sensor) or ((mark := quantity_of(type(node), key)) and mark.sliding != mark.si):
                for at_, one, name in ([(f"{at}.{name}", text[name], name) for name in value]
                                       if isinstance(value, dict) else [(at, text, owner)]):
                    if (si := self.unit(node, key, name)) is not None:
                        yield at_, one, si

    def _names(self) -> Iterator[ImpossibleError]:
        tables = {key: f"that of the table [{key}]" for key, value in self if isinstance(value, Noun)}
        taken = {BASE: "the chassis", "all": "all actuators together, in tables of how well they fit"} | tables | (
            {TIP: "the calibrator's tip"} if self.calibrator else {})
        count = Counter([*taken, *(part.name for parts in self.parts.values() for part in parts)])
        for name, times in count.items():
            if times > 1:
                yield ImpossibleError(f"the name '{name}' is {taken.get(name, f'used {times} times')}",
                                      "give the part another one" if name in taken else "give each part a name of "
                                      "its own; tables such as linkages and base_motion name links, too")

    def _references(self) -> Iterator[ImpossibleError]:
        """What names a link that does not exist."""
        links = [link.name for link in self.links]
        fixed, own = [BASE, *links], [link.name for link in (self.calibrator.links if self.calibrator else ())]
        seen, a_link = [BASE, *links, *own], "name a link or the base"  # instruments see the calibrator, too
        anywhere = f"use one of {', '.join(seen)}, or none for the ground"
        rows: list[tuple[str, str, Collection[str], str, str]] = [
            *((f"link '{each.name}' is attached to", each.parent, fixed, f"name '{BASE}' or another link as its parent",
               "") for each in self.links),
            *((f"the loop '{each.name}' closes over", each.link, links, "name a link", each.place)
              for each in self.loops),
            *((f"the loop '{each.name}' closes over", each.to.link, fixed, "name a link", each.place)
              for each in self.loops),
            *((f"the {end} of '{each.name}' is pinned to", getattr(each, end).link, fixed, a_link, "")
              for each in self.pinned for end in ("barrel", "rod"))]
        for key, parts in self.parts.items():
            rests = key in ("targets", "instruments")
            rows += [(f"'{each.name}' is attached to", each.link or BASE, seen if rests else fixed,
                      anywhere if rests else a_link, f"{key}[{each.name}].link")
                     for each in parts if key != "loops" and hasattr(each, "link")]
        if self.calibrator:
            rows.append(("the calibrator is attached to", self.calibrator.parent, links,
                         "name the link that carries it", "calibrator.parent"))
        for says, name, known, remedy, place in rows:
            if name not in known:
                yield ImpossibleError(f"{says} '{name}', which does not exist", remedy, place)

    def _tree(self) -> Iterator[ImpossibleError]:
        placed = {BASE}
        for link in self.links:
            if link.parent not in placed:
                yield ImpossibleError(f"link '{link.name}' comes before its parent '{link.parent}' or is its own "
                                      "ancestor", "list every parent before its children")
            placed.add(link.name)
        for coupling in self.couplings:
            for joint in coupling.joints:
                if joint not in self.tree_joints:
                    yield ImpossibleError(f"the coupling '{coupling.name}' relates '{joint}', which is not a moving "
                                          f"joint", f"use some of {', '.join(self.tree_joints)}", coupling.place)
            for joint, ratio in coupling.ratios.items():
                if joint == coupling.joint or ratio == 0:
                    yield ImpossibleError(f"the coupling '{coupling.name}' states "
                                          + (f"'{joint}' by itself" if joint == coupling.joint else "a ratio of zero"),
                                          "remove it", f"{coupling.place}.ratios.{joint}")
        followed = self.followed
        for joint in self.tree_joints:
            if joint not in followed:
                yield ImpossibleError(f"nothing determines the dependent joint '{joint}'",
                                      "state the loop or coupling that determines it, or let it move by itself",
                                      f"links[{joint}].joint.dependent")
        for link in self.calibrator.links if self.calibrator else ():
            if link.joint.dependent:
                yield ImpossibleError(f"the calibrator's joint '{link.name}' is dependent, but no loop closes over a "
                                      "calibrator", "let it move by itself",
                                      f"calibrator.links[{link.name}].joint.dependent")

    def _actuation(self) -> Iterator[ImpossibleError]:
        for part in self.pinned:
            if not self.joints_between(part.barrel.link, part.rod.link):
                yield ImpossibleError(f"no moving joint lies between the two ends of '{part.name}'",
                                      "pin its ends to links that move relative to each other")
        rotary: tuple[Motor | Drive, ...] = (*self.motors, *self.drives)
        for actuator in rotary:
            if actuator.joint not in self.joints:
                yield ImpossibleError(f"'{actuator.name}' drives '{actuator.joint}', which is not a moving joint",
                                      "name the link whose joint it drives")
        across = {joint: each for each in self.actuators for joint in self.moved_by(each)[:-1]}
        for joint, drivers in self.drivers.items():
            if self.link(joint).joint.passive and drivers:
                yield ImpossibleError(f"the joint '{joint}' is passive, but '{drivers[0].name}' drives it",
                                      "remove 'passive', or the actuator", f"links[{joint}].joint.passive")
            if not self.link(joint).joint.passive and not drivers:
                yield self._undriven(joint, across.get(joint))
            sensed = [each.name for each in drivers if isinstance(each, Drive) and each.measured]
            if len(sensed) > 1:
                yield ImpossibleError(f"'{sensed[0]}' and '{sensed[1]}' are both measured by '{joint}.tau'",
                                      "state one drive with the torque of both")
            unmeasured = [each for each in drivers if not each.measured]
            for each in unmeasured:
                if len(unmeasured) > 1 and len(moved := self.moved_by(each)) > 1:
                    other = next(one.name for one in unmeasured if one is not each)
                    yield ImpossibleError(f"'{each.name}', which moves {' and '.join(moved)}, and '{other}' are not "
                                          f"measured: the equation of '{joint}' cannot eliminate both",
                                          "measure one of them, or pin the first to the two sides of one joint")
        for group in self.entangled:
            shared = self.redundant.get(group[0], ())
            if lost := next((each.name for each in shared if not each.measured), None):
                yield ImpossibleError(f"'{lost}' is not measured, one of {len(shared)} actuators that move "
                                      f"{len(group)} joints, {', '.join(group)}, together: the equations of motion "
                                      "cannot distinguish its force from those of the others",
                                      "measure all of them, or state as many as joints")
        if self.joints and not self.measured_actuators:
            yield ImpossibleError("no equation of motion contains a measured force",
                                  "measure at least one joint's actuators: all of them that move it")
        if self.circuits and self.oil is None:
            yield ImpossibleError(f"the oil that feeds {', '.join(self.circuits)} is not stated",
                                  "state 'oil' with its 'bulk_modulus'", "oil")

    def _undriven(self, joint: str, across: Actuator | None) -> ImpossibleError:
        """Of a joint that nothing drives: actuators too few for joints that only they move together, as those of a
        platform; or one of several cylinders at another joint that may be pinned wrongly."""
        moved = self.moved_by(across) if across else ()
        together = [each.name for each in self.actuators if self.moved_by(each) == moved]
        if 1 < len(together) < len(moved):
            return ImpossibleError(f"{len(together)} actuators, {together[0]} to {together[-1]}, cannot move the "
                                   f"{len(moved)} joints {', '.join(moved)}",
                                   "add actuators, or state fewer joints, such as coordinates of a free link")
        several = next((each for each in self.drivers.values() if len(each) > 1), ())
        rocker = next((name for name, follows in self.followed.items() if name != joint and follows == (joint,)), joint)
        pin = f"pin {' or '.join(repr(each.name) for each in several)} to '{rocker}'; or " if several else ""
        only = f"; '{across.name}' crosses it, but drives another joint" if across else ""
        return ImpossibleError(f"nothing drives the joint '{joint}'{only}", f"{pin}add its actuator, with measured = "
                               "false if no log holds its force; make the joint locked, or passive if it swings "
                               "freely; or state the loop that determines it and make it dependent")

    def _seen(self) -> Iterator[ImpossibleError]:
        """What measures and surrounds the machine."""
        if (self.fixtures or self.tracker) and not self.calibrator:
            yield ImpossibleError("the ball or target has no carrier that fixtures and trackers need",
                                  "state a calibrator, if need be with a tip only")
        for distance in self.distances:
            kind = "target" if distance.measured else "fixture"
            ends = self.target_names if distance.measured else [fixture.name for fixture in self.fixtures]
            for name in distance.between:
                if name not in ends:
                    other = ", or state the 'length' between two fixtures" if distance.measured else ""
                    yield ImpossibleError(f"'{distance.name}' starts or ends at '{name}', which is not a {kind}",
                                          f"name two {kind}s{other}")
            if distance.between[0] == distance.between[1]:
                yield ImpossibleError(f"'{distance.name}' starts and ends at the same {kind}", f"name two {kind}s")
        joints = {link.name for link in self.chain if link.joint.independent} | set(self.joints)
        for stage in self.stages:
            for name in (*stage.moves, *stage.locked):
                if name not in joints:
                    yield ImpossibleError(f"stage '{stage.name}' names '{name}', which is not a moving joint",
                                          f"use {', '.join(sorted(joints))}")
        for imu in self.imus:
            if not imu.channels and not any(self.sensor(f"{imu.name}.{angle}") for angle in INCLINATION):
                yield ImpossibleError(f"the IMU '{imu.name}' measures nothing",
                                      "state 'gyroscope' or 'accelerometer' with noise and bias, or a sensor of its "
                                      "'.roll' and '.pitch'", f"imus[{imu.name}]")
        known: Mapping[str, str] = self.channel_units
        sensed: list[Sensor | Imu] = [*self.sensors, *self.imus]
        for channel, times in Counter(channel for each in sensed for channel in each.channels).items():
            if channel not in known:
                yield ImpossibleError(f"a sensor reads '{channel}', which this machine does not have",
                                      f"use one of {', '.join(known)}")
            if times > 1:
                yield ImpossibleError(f"the channel '{channel}' has two sensors", "keep one of them")
        for sensor in self.sensors:
            if len(units := {known[channel] for channel in sensor.channels}) > 1:
                yield ImpossibleError(f"one sensor reads {', '.join(sensor.channels)}, which are in "
                                      f"{' and '.join(sorted(units))}",
                                      "state one sensor for joints that turn and one for joints that slide")
        for laser in self.rangefinders:
            if self.ground is None:
                yield ImpossibleError(f"the beam of '{laser.name}' ends at the ground, whose height is not stated",
                                      "state 'ground', the height of the ground in the base frame", "ground")
        if self.footprint and self.ground is None:
            yield ImpossibleError("the machine has a footprint, but its height is not stated",
                                  "state 'ground', the height of the ground in the base frame")
        tilt = math.acos(math.cos(self.orientation[0]) * math.cos(self.orientation[1]))
        if self.ground is not None and tilt > STEEPEST:
            yield ImpossibleError("the ground is a height along the base's z axis, which points "
                                  f"{math.degrees(tilt):.0f} deg away from upwards", "describe the machine in a base "
                                  "frame whose z axis points up, or leave out 'ground'", "ground")

    def _masses(self) -> Iterator[ImpossibleError]:
        bodies = {link.name for link in self.links if link.body} | {
            f"{c.name}.{end}" for c in self.cylinders for end in ("barrel", "rod") if getattr(c, end).body}
        friction = {a.name: (type(a), {key for key, value in a.friction if value is not None and key != "offset"})
                    for a in self.actuators}
        rows: list[tuple[str, tuple[str, ...], Collection[str], str]] = [
            *((f"{kind}[{each.name}].bodies", each.bodies, bodies, "a body that the machine states")
              for kind, parts in (("total_masses", self.total_masses), ("identical", self.identical))
              for each in parts),
            *((f"identical[{each.name}].friction", each.friction, friction, "an actuator") for each in self.identical)]
        for place, owners, known, what in rows:
            for owner in owners:
                if owner not in known:
                    yield ImpossibleError(f"'{owner}' is not {what}", f"use some of {', '.join(sorted(known))}", place)
                if owners.count(owner) > 1:
                    yield ImpossibleError(f"'{owner}' is named twice", "name it once", place)
        for one in self.identical:
            if any(friction[name] != friction[one.friction[0]] for name in one.friction):
                yield ImpossibleError(f"{', '.join(one.friction)} do not state the same terms of friction",
                                      "name actuators of one kind, and state the same terms of each",
                                      f"identical[{one.name}].friction")

    def _bounds(self) -> Iterator[ImpossibleError]:
        for number in self.numbers.values():
            note, value = self.notes.get(number.path, Note()), number.value
            for bound, side, beyond in ((note.lower, "below its lower", note.lower is not None and value < note.lower),
                                        (note.upper, "above its upper", note.upper is not None and value > note.upper)):
                if beyond:
                    yield ImpossibleError(f"the value, {value:.9g} {number.unit}, lies {side} bound, {bound:.9g} "
                                          f"{number.unit}", "correct the value or the bound", self.place(number.path))

    def with_values(self, values: Mapping[str, float], notes: Mapping[str, Note] | None = None) -> Machine:
        """The machine with other numbers, each under its address, and with what is known about them.

        A body that gets a new inertial parameter is stated about its frame's origin from then on. The confidences of
        its centre of mass and of its inertia about that are dropped: they are no confidences of the new numbers.

        Args:
            values: by address, in SI.
            notes: by address. A vector has one note; of those of its components the last one counts.

        Raises:
            MachineError: an address is unknown, or no machine can have these numbers.

        >>> from hydroopt.machine.machine_file import load_machine
        >>> machine = load_machine("cat215b").with_values(
        ...     {"boom.a": 5.2, "boom_cylinder.f_coulomb": 3000.0}, {"boom.a": Note(sigma=1e-3, source="tape measure")})
        >>> machine.link("boom").joint.a, machine.notes["boom.joint.a"].source
        (5.2, 'tape measure')
        """
        known, where = self.numbers, f"machine '{self.name}'"
        for name in (*values, *(notes or {})):
            if name not in known:
                close = similar(name, known)
                raise MachineError(f"no number has the address '{name}'", where=where,
                                   remedy=f"did you mean {' or '.join(close)}")
        data = self.model_dump(exclude={"notes"})
        dropped = addresses.rewrite(data, known, values)
        stated = {path: note for path, note in self.notes.items() if path not in dropped}
        stated |= {known[name].path: note for name, note in (notes or {}).items()}
        return self._rebuilt(data, stated)

    def with_joint_limits(self, limits: Mapping[str, tuple[float, float]]) -> Machine:
        """The machine with other limits (lower, upper) [rad or m] of some joints.

        Raises:
            MachineError: a lower limit is not below the upper one.

        >>> from hydroopt.machine.machine_file import load_machine
        >>> load_machine("cat215b").with_joint_limits({"boom": (-1.0, 0.4)}).link("boom").joint.range
        (-1.0, 0.4)
        """
        data = self.model_dump(exclude={"notes"})
        for link in data["links"]:
            if link["name"] in limits:
                link["joint"] |= dict(zip(("lower", "upper"), limits[link["name"]], strict=True))
        return self._rebuilt(data, self.notes)

    def without_bodies(self, owners: Collection[str]) -> Machine:
        """The machine without the bodies of these links, barrels and rods, nor what is stated of them.

        Raises:
            MachineError: a total mass needs one of them.

        >>> from hydroopt.machine.machine_file import load_machine
        >>> load_machine("cat215b").without_bodies(["boom_cylinder.rod"]).cylinders[0].rod.body is None
        True
        """
        data = self.model_dump(exclude={"notes"})
        addresses.remove_bodies(data, owners)
        return self._rebuilt(data, {path: note for path, note in self.notes.items()
                                    if not path.startswith(tuple(f"{owner}.body." for owner in owners))})

    def _rebuilt(self, data: Mapping[str, Any], notes: Mapping[str, Note]) -> Machine:
        try:
            return Machine.model_validate({**data, "notes": notes})
        except ValidationError as error:
            first, where = error.errors()[0], f"machine '{self.name}'"
            rule = first.get("ctx", {}).get("error")
            if isinstance(rule, ImpossibleError):
                raise MachineError(rule.what, where=where, remedy=rule.remedy) from None
            raise MachineError(f"{first['msg'][:1].lower()}{first['msg'][1:]}, not {first['input']!r:.40}",
                               where=f"{where}: {'.'.join(map(str, first['loc']))}", remedy="correct it") from None

    @cached_property
    def source(self) -> str:
        """What names it on a command line: a bundled machine or a path, and ``MACHINE`` if it was made in memory."""
        return "MACHINE"

    @property
    def sha256(self) -> str:
        """Digest of the description, the same however its file is laid out."""
        return hashlib.sha256(json.dumps(self.model_dump(mode="json"), sort_keys=True).encode()).hexdigest()


def _span(joint: Joint) -> str:
    """The range of a joint in the unit that people read: degrees or metres."""
    if joint.lower is None or joint.upper is None:
        return ""
    size, unit = (1.0, "m") if joint.type == "prismatic" else (math.degrees(1), "deg")
    return f"{size * joint.lower:.4g} … {size * joint.upper:.4g} {unit}"
