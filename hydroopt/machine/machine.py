"""A machine: its parts, and the invariants that hold between them."""

from __future__ import annotations

import hashlib
import json
import math
from collections import Counter
from collections.abc import Collection, Iterator, Mapping
from functools import cached_property
from typing import Any, Self

from pydantic import ModelWrapValidatorHandler, ValidationError, ValidationInfo, model_validator

from hydroopt.errors import MachineError
from hydroopt.input_file import similar
from hydroopt.machine import addresses
from hydroopt.machine.actuators import Actuator, Drive, Motor
from hydroopt.machine.closures import place
from hydroopt.machine.description import BASE, MachineDescription
from hydroopt.machine.environment import refuse_sideways
from hydroopt.machine.imus import INCLINATION
from hydroopt.machine.links import Joint, Note
from hydroopt.machine.quantity import ImpossibleError, Noun, with_likely_units
from hydroopt.machine.targets import TIP
from hydroopt.notebook_card import Card, CardTable, Drawn
from hydroopt.units import same_kind

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
        return Card(repr(self), facts, [CardTable(("link", "joint", "range", "moved by"), rows, noun="links")])

    @model_validator(mode="after")
    def _invariants(self) -> Self:
        self._names()
        self._tree()
        self._loops()
        self._actuation()
        self._chain()
        self._seen()
        self._channels()
        self._site()
        self._masses()
        self._bounds()
        return self

    @model_validator(mode="wrap")
    @classmethod
    def _units_fit(cls, data: Any, handler: ModelWrapValidatorHandler[Self], info: ValidationInfo) -> Self:
        # only here are both the type of a joint and the unit of a text available
        machine = handler(data)
        from_file = bool((info.context or {}).get("from_file"))
        for where, text, si in machine._stated_units(data) if isinstance(data, Mapping) else ():
            if isinstance(text, str) and not same_kind(unit := text.strip().partition(" ")[2].strip(), si):
                raise ImpossibleError(f"'{unit}' is not a unit of the kind '{si}', which its joint or valve calls for",
                                      f"use '{si}' or another unit of that kind", where)
            if from_file and si != "1" and isinstance(text, int | float):
                raise ImpossibleError(f"{text:.9g} has no unit", f"write it as {with_likely_units(text, si)}", where)
        return machine

    def _stated_units(self, data: Mapping[str, Any]) -> Iterator[tuple[str, Any, str]]:
        """Place, statement and proper SI unit of each number whose unit depends on whether a joint turns or slides."""
        frictions = [(f"links[{link.name}].joint.friction", link.name, _under(raw, "joint", "friction"))
                     for link, raw in zip(self.links, data["links"], strict=True)]
        frictions += [(f"{kind}[{part.name}].friction", part.joint, _under(raw, "friction"))
                      for kind in ("motors", "drives")
                      for part, raw in zip(getattr(self, kind), data.get(kind, ()), strict=True)]
        for where, joint, raw in frictions:
            for key, si in self.friction_units(joint).items():
                yield f"{where}.{key}", _under(raw, key), si
        for link, raw in zip(self.links, data["links"], strict=True):
            if link.joint.spring is not None:
                for key, si in self.spring_units(link.name).items():
                    yield f"links[{link.name}].joint.spring.{key}", _under(raw, "joint", "spring", key), si
        for loop, raw in zip(self.loops, data.get("loops", ()), strict=True):
            for joint in loop.posture:
                if any(link.name == joint for link in self.links):
                    yield f"{place(loop)}.posture.{joint}", _under(raw, "posture", joint), self.position_unit(joint)
        for coupling, raw in zip(self.couplings, data.get("couplings", ()), strict=True):
            units = self.coupling_units(coupling)
            yield f"{place(coupling)}.offset", _under(raw, "offset"), units["offset"]
            for joint in coupling.ratios:
                yield f"{place(coupling)}.ratios.{joint}", _under(raw, "ratios", joint), units[f"ratio.{joint}"]
        units = self.channel_units
        for k, (sensor, raw) in enumerate(zip(self.sensors, data.get("sensors", ()), strict=True)):
            for key in ("accuracy", "resolution"):
                yield f"sensors[{k}].{key}", _under(raw, key), units[sensor.channels[0]]

    def _names(self) -> None:
        extra = self.calibrator.links if self.calibrator else ()
        kinds = (self.links, extra, self.loops, self.couplings, self.cylinders, self.motors, self.drives,
                 self.gas_cylinders, self.springs, self.imus, self.fixtures, self.distances, self.targets,
                 self.instruments, self.datums, self.stages, self.obstacles, self.total_masses, self.identical)
        tables = {key: f"that of the table [{key}]" for key, value in self if isinstance(value, Noun)}
        taken = {BASE: "the chassis", "all": "all actuators together, in tables of how well they fit"} | tables | (
            {TIP: "the calibrator's tip"} if self.calibrator else {})
        count = Counter([*taken, *(part.name for kind in kinds for part in kind)])
        for name, times in count.items():
            if times > 1:
                raise ImpossibleError(f"the name '{name}' is {taken.get(name, f'used {times} times')}",
                                      "give the part another one" if name in taken else "give each part a name of "
                                      "its own; tables such as linkages and base_motion name links, too")

    def _tree(self) -> None:
        known = {BASE, *(link.name for link in self.links)}
        for link in self.links:
            if link.parent not in known:
                raise ImpossibleError(f"link '{link.name}' is attached to '{link.parent}', which does not exist",
                                      f"name '{BASE}' or another link as its parent")
        placed = {BASE}
        for link in self.links:
            if link.parent not in placed:
                raise ImpossibleError(f"link '{link.name}' comes before its parent '{link.parent}' or is its own "
                                      "ancestor", "list every parent before its children")
            placed.add(link.name)

    def _loops(self) -> None:
        links = {link.name for link in self.links}
        for loop in self.loops:
            for name in (loop.link, loop.to.link):
                if name not in links | ({BASE} if name is loop.to.link else set()):
                    raise ImpossibleError(f"the loop '{loop.name}' closes over '{name}', which does not exist",
                                          "name a link", f"loops[{loop.name}]")
        for coupling in self.couplings:
            for joint in coupling.joints:
                if joint not in self.tree_joints:
                    raise ImpossibleError(f"the coupling '{coupling.name}' relates '{joint}', which is not a moving "
                                          f"joint", f"use some of {', '.join(self.tree_joints)}", place(coupling))
            for joint, ratio in coupling.ratios.items():
                if joint == coupling.joint or ratio == 0:
                    raise ImpossibleError(f"the coupling '{coupling.name}' states "
                                          + (f"'{joint}' by itself" if joint == coupling.joint else "a ratio of zero"),
                                          "remove it", f"{place(coupling)}.ratios.{joint}")
        followed = self.followed
        for joint in self.tree_joints:
            if joint not in followed:
                raise ImpossibleError(f"nothing determines the dependent joint '{joint}'",
                                      "state the loop or coupling that determines it, or let it move by itself",
                                      f"links[{joint}].joint.dependent")
        if self.calibrator and (far := next((link.name for link in self.calibrator.links if link.joint.dependent), "")):
            raise ImpossibleError(f"the calibrator's joint '{far}' is dependent, but no loop closes over a calibrator",
                                  "let it move by itself", f"calibrator.links[{far}].joint.dependent")

    def _actuation(self) -> None:
        links = {link.name for link in self.links}
        for cylinder in self.pinned:
            for end, attachment in (("barrel", cylinder.barrel), ("rod", cylinder.rod)):
                if attachment.link not in links | {BASE}:
                    raise ImpossibleError(f"the {end} of '{cylinder.name}' is pinned to '{attachment.link}', which "
                                          "does not exist", "name a link or the base")
            if not self.joints_between(cylinder.barrel.link, cylinder.rod.link):
                raise ImpossibleError(f"no moving joint lies between the two ends of '{cylinder.name}'",
                                      "pin its ends to links that move relative to each other")
        rotary: tuple[Motor | Drive, ...] = (*self.motors, *self.drives)
        for actuator in rotary:
            if actuator.joint not in self.joints:
                raise ImpossibleError(f"'{actuator.name}' drives '{actuator.joint}', which is not a moving joint",
                                      "name the link whose joint it drives")
        across = {joint: each.name for each in self.actuators for joint in self.moved_by(each)[:-1]}
        for joint, drivers in self.drivers.items():
            self._driven(joint, drivers, across.get(joint))
        for group in self.entangled:
            shared = self.redundant.get(group[0], ())
            if lost := next((each.name for each in shared if not each.measured), None):
                raise ImpossibleError(f"'{lost}' is not measured, one of {len(shared)} actuators that move "
                                      f"{len(group)} joints, {', '.join(group)}, together: the equations of motion "
                                      "cannot distinguish its force from those of the others",
                                      "measure all of them, or state as many as joints")
        if self.joints and not self.measured_actuators:
            raise ImpossibleError("no equation of motion contains a measured force",
                                  "measure at least one joint's actuators: all of them that move it")

    def _enough(self, across: str | None) -> None:
        """Refuse fewer actuators than joints that only they move together, as those of a platform."""
        moved = next((self.moved_by(each) for each in self.actuators if each.name == across), ())
        together = [each.name for each in self.actuators if self.moved_by(each) == moved]
        if 1 < len(together) < len(moved):
            raise ImpossibleError(f"{len(together)} actuators, {together[0]} to {together[-1]}, cannot move the "
                                  f"{len(moved)} joints {', '.join(moved)}",
                                  "add actuators, or state fewer joints, such as coordinates of a free link")

    def _elsewhere(self, joint: str) -> str:
        """Which of several cylinders that drive another joint may be pinned wrongly, where nothing drives this one."""
        several = next((each for each in self.drivers.values() if len(each) > 1), ())
        rocker = next((name for name, follows in self.followed.items() if name != joint and follows == (joint,)), joint)
        if not several:
            return ""
        return f"pin {' or '.join(repr(each.name) for each in several)} to '{rocker}'; or "

    def _driven(self, joint: str, drivers: tuple[Actuator, ...], across: str | None) -> None:
        if self.link(joint).joint.passive:
            if drivers:
                raise ImpossibleError(f"the joint '{joint}' is passive, but '{drivers[0].name}' drives it",
                                      "remove 'passive', or the actuator", f"links[{joint}].joint.passive")
            return
        if not drivers:
            self._enough(across)
            only = f"; '{across}' crosses it, but drives another joint" if across else ""
            raise ImpossibleError(f"nothing drives the joint '{joint}'{only}", f"{self._elsewhere(joint)}"
                                  "add its actuator, with measured = false if no log holds its force; make the joint "
                                  "locked, or passive if it swings freely; or state the loop that determines it and "
                                  "make it dependent")
        sensed = [each.name for each in drivers if isinstance(each, Drive) and each.measured]
        if len(sensed) > 1:
            raise ImpossibleError(f"'{sensed[0]}' and '{sensed[1]}' are both measured by '{joint}.tau'",
                                  "state one drive with the torque of both")
        unmeasured = [each for each in drivers if not each.measured]
        for each in unmeasured:
            if len(unmeasured) > 1 and len(moved := self.moved_by(each)) > 1:
                other = next(one.name for one in unmeasured if one is not each)
                raise ImpossibleError(f"'{each.name}', which moves {' and '.join(moved)}, and '{other}' are not "
                                      f"measured: the equation of '{joint}' cannot eliminate both",
                                      "measure one of them, or pin the first to the two sides of one joint")

    def _chain(self) -> None:
        if self.calibrator and self.calibrator.parent not in {link.name for link in self.links}:
            raise ImpossibleError(f"the calibrator is attached to '{self.calibrator.parent}', which does not exist",
                                  "name the link that carries it", "calibrator.parent")
        if (self.fixtures or self.tracker) and not self.calibrator:
            raise ImpossibleError("the ball or target has no carrier that fixtures and trackers need",
                                  "state a calibrator, if need be with a tip only")
        for distance in self.distances:
            kind = "target" if distance.measured else "fixture"
            known = self.target_names if distance.measured else [fixture.name for fixture in self.fixtures]
            for name in distance.between:
                if name not in known:
                    other = ", or state the 'length' between two fixtures" if distance.measured else ""
                    raise ImpossibleError(f"'{distance.name}' starts or ends at '{name}', which is not a {kind}",
                                          f"name two {kind}s{other}")
            if distance.between[0] == distance.between[1]:
                raise ImpossibleError(f"'{distance.name}' starts and ends at the same {kind}", f"name two {kind}s")
        joints = {link.name for link in self.chain if link.joint.independent} | set(self.joints)
        for stage in self.stages:
            for name in (*stage.moves, *stage.locked):
                if name not in joints:
                    raise ImpossibleError(f"stage '{stage.name}' names '{name}', which is not a moving joint",
                                          f"use {', '.join(sorted(joints))}")

    def _seen(self) -> None:
        """Targets and instruments sit on links that there are."""
        known = (BASE, *(link.name for link in (*self.links, *(self.calibrator.links if self.calibrator else ()))))
        for kind, parts in (("target", self.targets), ("instrument", self.instruments)):
            for part in parts:
                if part.link not in {None, *known}:
                    raise ImpossibleError(
                        f"the {kind} '{part.name}' is attached to '{part.link}', which does not exist",
                        f"use one of {', '.join(known)}, or none for the ground", f"{kind}s[{part.name}].link")

    def _channels(self) -> None:
        known = self.channel_units
        for imu in self.imus:
            if imu.link not in {BASE, *(link.name for link in self.links)}:
                raise ImpossibleError(f"the IMU '{imu.name}' is attached to '{imu.link}', which does not exist",
                                      "name a link or the base", f"imus[{imu.name}].link")
            if not imu.channels and not any(self.sensor(f"{imu.name}.{angle}") for angle in INCLINATION):
                raise ImpossibleError(f"the IMU '{imu.name}' measures nothing",
                                      "state 'gyroscope' or 'accelerometer' with noise and bias, or a sensor of its "
                                      "'.roll' and '.pitch'", f"imus[{imu.name}]")
        for sensor in self.sensors:
            for channel in sensor.channels:
                if channel not in known:
                    raise ImpossibleError(f"a sensor reads '{channel}', which this machine does not have",
                                          f"use one of {', '.join(known)}")
            if len(units := {known[channel] for channel in sensor.channels}) > 1:
                raise ImpossibleError(f"one sensor reads {', '.join(sensor.channels)}, which are in "
                                      f"{' and '.join(sorted(units))}",
                                      "state one sensor for joints that turn and one for joints that slide")
        stated = [channel for sensor in self.sensors for channel in sensor.channels]
        stated += [channel for imu in self.imus for channel in imu.channels]
        twice = [channel for channel, n in Counter(stated).items() if n > 1]
        if twice:
            raise ImpossibleError(f"the channel '{twice[0]}' has two sensors", "keep one of them")

    def _site(self) -> None:
        if self.circuits and self.oil is None:
            raise ImpossibleError(f"the oil that feeds {', '.join(self.circuits)} is not stated",
                                  "state 'oil' with its 'bulk_modulus'", "oil")
        for obstacle in self.obstacles:
            if obstacle.link not in {BASE, *(link.name for link in self.links)}:
                raise ImpossibleError(f"the obstacle '{obstacle.name}' is attached to '{obstacle.link}', which does "
                                      "not exist", "name a link or the base")
        if self.footprint and self.ground is None:
            raise ImpossibleError("the machine has a footprint, but its height is not stated",
                                  "state 'ground', the height of the ground in the base frame")
        if self.ground is not None:
            refuse_sideways(self.orientation)

    def _masses(self) -> None:
        bodies = {link.name for link in self.links if link.body} | {
            f"{c.name}.{end}" for c in self.cylinders for end in ("barrel", "rod") if getattr(c, end).body}
        rubs = {a.name: (type(a), {key for key, value in a.friction if value is not None and key != "offset"})
                for a in self.actuators}
        stated: list[tuple[str, str, tuple[str, ...], Collection[str], str]] = [
            *(("total_masses", s.name, s.bodies, bodies, "bodies") for s in self.total_masses),
            *(("identical", s.name, s.bodies, bodies, "bodies") for s in self.identical),
            *(("identical", s.name, s.friction, rubs, "friction") for s in self.identical)]
        for kind, name, owners, known, key in stated:
            place = f"{kind}[{name}].{key}"
            for owner in owners:
                if owner not in known:
                    what = "a body that the machine states" if key == "bodies" else "an actuator"
                    raise ImpossibleError(f"'{owner}' is not {what}", f"use some of {', '.join(sorted(known))}", place)
                if owners.count(owner) > 1:
                    raise ImpossibleError(f"'{owner}' is named twice", "name it once", place)
        for one in self.identical:
            if any(rubs[name] != rubs[one.friction[0]] for name in one.friction):
                raise ImpossibleError(f"{', '.join(one.friction)} do not state the same terms of friction",
                                      "name actuators of one kind, and state the same terms of each",
                                      f"identical[{one.name}].friction")

    def _bounds(self) -> None:
        for number in self.numbers.values():
            note, stated = self.notes.get(number.path, Note()), f"the value, {number.value:.9g} {number.unit}, lies"
            if note.lower is not None and number.value < note.lower:
                raise ImpossibleError(f"{stated} below its lower bound, {note.lower:.9g} {number.unit}",
                                      "correct the value or the bound", self.place(number.path))
            if note.upper is not None and number.value > note.upper:
                raise ImpossibleError(f"{stated} above its upper bound, {note.upper:.9g} {number.unit}",
                                      "correct the value or the bound", self.place(number.path))

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


def _under(node: Any, *steps: str) -> Any:
    """What a part states under its keys, be it a table or already an object; None where it does not."""
    for step in steps:
        node = node.get(step) if isinstance(node, Mapping) else getattr(node, step, None)
    return node


def _span(joint: Joint) -> str:
    """The range of a joint in the unit that people read: degrees or metres."""
    if joint.lower is None or joint.upper is None:
        return ""
    size, unit = (1.0, "m") if joint.type == "prismatic" else (math.degrees(1), "deg")
    return f"{size * joint.lower:.4g} … {size * joint.upper:.4g} {unit}"
