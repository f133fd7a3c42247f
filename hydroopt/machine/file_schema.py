"""What a machine file may state: one schema of all its tables, and the sentences of what breaks it."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from difflib import get_close_matches
from typing import Annotated, Any, get_args

from pydantic import BaseModel, Discriminator, Field, Tag, ValidationError

from hydroopt.errors import MachineError
from hydroopt.machine.actuators import Cylinder, Drive, GasCylinder, Motor, Spring
from hydroopt.machine.calibration_chain import Calibrator, Fixture, Stage
from hydroopt.machine.environment import Footprint, Obstacle, Pump
from hydroopt.machine.free_links import FreeLink
from hydroopt.machine.linkages import Linkage
from hydroopt.machine.links import Body, Box, Identical, Joint, Link, Note, TotalMass
from hydroopt.machine.loops import Coupling, Loop
from hydroopt.machine.oil_links import OilLink
from hydroopt.machine.quantity import Acceleration, Angle, ImpossibleError, Length, Name, Noun, Rate
from hydroopt.machine.sensors import FaultSizes, Imu, Rangefinder, Sensor
from hydroopt.machine.survey import Datum, Distance, Instrument, Target, Tracker
from hydroopt.machine.valves import Oil
from hydroopt.units import UnitError, spread_to_si, to_si

NOTE_KEYS = {"value", "sigma", "lower", "upper", "source"}
"""What a table may state of a number: its value, and what is known of it."""
class CylinderBodies(Noun):
    """The bodies of a cylinder in a set of inertial parameters; of a link a set states the body itself."""

    barrel: Body | None = None
    """Its barrel's."""
    rod: Body | None = None
    """Its rod's."""


_LINK, _CYLINDER = "of a link", "of a cylinder"
SetBodies = Annotated[Annotated[Body, Tag(_LINK)] | Annotated[CylinderBodies, Tag(_CYLINDER)],
                      Discriminator(lambda stated: _CYLINDER if isinstance(stated, Mapping) and stated
                                    and stated.keys() <= CylinderBodies.model_fields.keys() else _LINK)]
"""What a parameter set states of one part: of a link its body, of a cylinder those of barrel and rod."""


class Parts(Noun):
    """The parts of a machine."""

    name: Name
    """Name of the machine."""
    parameter_set: str = ""
    """Chosen set of inertial parameters."""
    description: str = ""
    """What it is, in words."""
    suspect: str = ""
    """Why the answer that its numbers are from is not to be trusted; commands refuse such a machine."""
    gravity: Acceleration = Field(9.80665, ge=0)
    """Acceleration of gravity, along −z of the world."""
    orientation: tuple[Angle, Angle, Angle] = (0.0, 0.0, 0.0)
    """Roll, pitch, yaw of the base frame in the world, whose z points up."""
    bandwidth: Rate | None = Field(None, gt=0)
    """Highest frequency of the machine's motion; limits all smoothing."""
    links: tuple[Link, ...] = Field(min_length=1)
    """Links, each behind the one that carries it."""
    loops: tuple[Loop, ...] = ()
    """Pins that close loops of links."""
    couplings: tuple[Coupling, ...] = ()
    """Linear relations between joints."""
    cylinders: tuple[Cylinder, ...] = ()
    """Hydraulic cylinders."""
    motors: tuple[Motor, ...] = ()
    """Hydraulic motors."""
    drives: tuple[Drive, ...] = ()
    """Electric and other drives."""
    gas_cylinders: tuple[GasCylinder, ...] = ()
    """Gas-charged cylinders."""
    springs: tuple[Spring, ...] = ()
    """Springs between two pins."""
    sensors: tuple[Sensor, ...] = ()
    """Accuracy of what is measured."""
    imus: tuple[Imu, ...] = ()
    """Inertial measurement units."""
    rangefinders: tuple[Rangefinder, ...] = ()
    """Lasers that read the distance to the ground."""
    calibrator: Calibrator | None = None
    """What closes the chain of a kinematic calibration."""
    fixtures: tuple[Fixture, ...] = ()
    """Places that hold the calibrator's ball."""
    distances: tuple[Distance, ...] = ()
    """Known or measured distances."""
    tracker: Tracker | None = None
    """Instrument that tracks the tip."""
    targets: tuple[Target, ...] = ()
    """Prisms, balls, marks and markers."""
    instruments: tuple[Instrument, ...] = ()
    """Total stations, trackers and cameras."""
    datums: tuple[Datum, ...] = ()
    """Planes and lines that targets touch."""
    stages: tuple[Stage, ...] = ()
    """Stages of a kinematic calibration."""
    pump: Pump | None = None
    """The supply."""
    oil: Oil | None = None
    """The fluid."""
    ground: Length | None = None
    """Height of the ground above the origin of the base frame; designed motions stay above it."""
    workspace: Box | None = None
    """Where the far end of the last link may go, in the base frame."""
    obstacles: tuple[Obstacle, ...] = ()
    """Balls that it avoids."""
    footprint: Footprint | None = None
    """Tracks or outriggers."""
    total_masses: tuple[TotalMass, ...] = ()
    """Masses of several bodies together."""
    identical: tuple[Identical, ...] = ()
    """Identical parts."""
    faults: FaultSizes = FaultSizes()
    """Usual sizes of instruments' faults."""


class FileLink(Link):
    """A link with the joint that moves it, or free; its body stands in P_i = Trans(z,d)·Rot(z,θ)."""

    joint: Joint | None = None  # type: ignore[assignment]
    """How it moves, and how long it is; needed where it is not `free`."""
    free: FreeLink | None = None
    """Coordinates by which it moves without a joint."""

    def _mistakes(self) -> Iterator[ImpossibleError]:
        if self.joint is None and self.free is None:
            yield ImpossibleError("this key is missing", "add it", "joint")
        if self.joint is not None and self.free is not None:
            yield ImpossibleError("a free link has a joint, too", "state 'free' or 'joint'")

class MachineFile(Parts):
    """A machine file: the parts of a machine, and tables that stand for several of them.

    A file that is `based_on` a bundled machine states only where it differs: it is validated as merged with that one's.
    """

    links: tuple[FileLink, ...] = Field(min_length=1)
    """Links, each behind the one that carries it."""
    based_on: str = ""
    """A bundled machine, of which the file states only the differences: tables merge key by key, lists part by part by
    their names."""
    linkages: tuple[Linkage, ...] = ()
    """Rockers and couplers, for links and the loop that they close."""
    oil_links: tuple[OilLink, ...] = ()
    """Slave cylinders on the oil of a master."""
    base_motion: FreeLink | None = None
    """Coordinates by which the base stands on a slope or moves."""
    parameter_sets: dict[str, dict[str, SetBodies]] = Field(default_factory=dict)
    """Sets of bodies by their name: of each link its body, of each cylinder those of barrel and rod."""
    default_parameter_set: str = ""
    """The set that is chosen without `--set`."""


def validate(tables: Mapping[str, Any], where: str) -> None:
    """Validate the tables of a machine file, each of them, used or not.

    Args:
        tables: as TOML has them, links with their parents.
        where: the file, for errors.

    Raises:
        MachineError: names the first key that breaks the schema, and the remedy.
    """
    plain: dict[str, Any] = {}
    try:
        plain = without_notes(tables)[0]
        _refuse_noted_words(tables, MachineFile.model_validate(plain, context={"from_file": True}), "")
    except ValidationError as error:
        what, place, remedy = in_plain_words(error.errors(), plain)
        raise MachineError(what, where=f"{where}: {place}" if place else where, remedy=remedy) from None
    except (UnitError, ImpossibleError) as error:
        place = error.where if isinstance(error, UnitError) else error.key
        raise MachineError(error.what, where=f"{where}: {place}" if place else where, remedy=error.remedy) from None


def without_notes(tables: Mapping[str, Any]) -> tuple[dict[str, Any], dict[str, Note]]:
    """The same tables of a machine file with plain values, and what they state of numbers by dotted path.

    Raises:
        ImpossibleError, UnitError: of a statement, with its place.
    """
    notes: dict[str, Note] = {}
    return _plain(tables, "", "", notes), notes


def _plain(node: Any, path: str, place: str, notes: dict[str, Note]) -> Any:
    """The node without notes, which stands at `place` of the file and at `path` of the machine."""
    if isinstance(node, dict) and {"name", "value"} <= node.keys() and not isinstance(node["value"], dict):
        said = {key: node[key] for key in sorted(NOTE_KEYS & node.keys())}  # a part whose one number it is
        node = {key: value for key, value in node.items() if key not in said} | {"value": said}
    elif isinstance(node, dict) and "value" in node and "name" not in node:
        notes[path] = _note(node, place)
        return node["value"]
    if isinstance(node, dict):
        return {key: _plain(value, f"{path}.{key}".lstrip("."), f"{place}.{key}".lstrip("."), notes)
                for key, value in node.items()}
    if isinstance(node, list):
        # parts are addressed by their names, which are unique over the machine
        names = [item["name"] if isinstance(item, dict) and "name" in item else None for item in node]
        return [_plain(item, f"{path}.{k}" if name is None else str(name),
                       f"{place}[{k if name is None else name}]", notes)
                for k, (name, item) in enumerate(zip(names, node, strict=True))]
    return node


def _refuse_noted_words(stated: Any, read: Any, place: str) -> None:
    """Refuse sigma, bounds or source of what is no number: `read` is what the schema makes of `stated`.

    Raises:
        ImpossibleError: names the place.
    """
    if isinstance(stated, dict) and "value" in stated and "name" not in stated:
        if not _of_numbers(read):
            raise ImpossibleError("only a number has a 'value' beside what is known of it", "state it by itself", place)
    elif isinstance(stated, dict):
        for key, value in stated.items():
            _refuse_noted_words(value, read.get(key) if isinstance(read, dict) else getattr(read, key, None),
                                f"{place}.{key}".lstrip("."))
    elif isinstance(stated, list):
        for k, (value, each) in enumerate(zip(stated, read, strict=True)):
            _refuse_noted_words(value, each, f"{place}[{getattr(each, 'name', k)}]")


def _of_numbers(read: Any) -> bool:
    return bool(read) and all(map(_of_numbers, read)) if isinstance(read, tuple) else isinstance(read, int | float)


def _note(node: Mapping[str, Any], place: str) -> Note:
    value = node["value"]
    like = str(value[0] if isinstance(value, list) and value else value)
    said: dict[str, Any] = {"source": node.get("source", "")}
    for key in node:
        if key not in NOTE_KEYS:
            raise ImpossibleError("this key is unknown",
                                  f"beside 'value', use {', '.join(sorted(NOTE_KEYS - {'value'}))}", f"{place}.{key}")
    for key in ("lower", "upper"):
        if key in node:
            said[key] = spread_to_si(str(node[key]), like, where=f"{place}.{key}")
    if said.get("lower", -math.inf) >= said.get("upper", math.inf):
        raise ImpossibleError(f"the lower bound {node['lower']} is not below the upper one, {node['upper']}",
                              "exchange or correct them", place)
    sigma = str(node.get("sigma", "")).strip()
    if sigma.endswith("%"):
        percent = f"{sigma.removesuffix('%').strip()} %"
        said |= {"sigma": to_si(percent, "1", where=f"{place}.sigma"), "relative": True}
    elif sigma:
        said["sigma"] = spread_to_si(sigma, like, where=f"{place}.sigma")
    if not 0 < said.get("sigma", 1.0) < math.inf:
        raise ImpossibleError(f"a confidence must be positive and finite, not {sigma}", "correct it or leave it out",
                              f"{place}.sigma")
    if not isinstance(said["source"], str):
        raise ImpossibleError("this must be text", "put it in quotation marks", f"{place}.source")
    return Note(**said)


def in_plain_words(mistakes: Sequence[Mapping[str, Any]], data: Mapping[str, Any]) -> tuple[str, str, str]:
    """What, place and remedy of the first mistake, an unknown key before all: it often is the one that is missing."""
    first = next((m for m in mistakes if m["type"] == "extra_forbidden"), mistakes[0])
    place = ""
    node: Any = data
    above: Any = data
    steps = [step for step in first["loc"] if step not in (_LINK, _CYLINDER)]
    for step in steps:
        above = node
        node = node[step] if isinstance(node, list | dict) and step in (
            node if isinstance(node, dict) else range(len(node))) else None
        if isinstance(step, int):
            called = node.get("name") if isinstance(node, dict) else None
            place += f"[{step if called is None else called}]"
        else:
            place += f".{step}" if place else str(step)
    kind, context = first["type"], first.get("ctx", {})
    impossible = context.get("error")
    if isinstance(impossible, ImpossibleError):
        return impossible.what, f"{place}.{impossible.key}".strip("."), impossible.remedy
    if kind == "missing" and isinstance(first["loc"][-1], int):
        wanted = 1 + max(int(m["loc"][-1]) for m in mistakes if m["loc"][:-1] == first["loc"][:-1])
        return f"there are {len(above)} values instead of {wanted}", place.rpartition("[")[0], "state them all"
    if kind == "too_long":
        return f"there are {len(node)} values instead of {context['max_length']}", place, "remove those beyond"
    if kind == "too_short":
        return "the list is empty", place, "state at least one"
    if kind == "missing":
        return "this key is missing", place, "add it"
    if kind == "tuple_type" and _keys_at(steps):
        return "must be a list of tables", place, f"write [[{steps[-1]}]] above each of them"
    if kind == "extra_forbidden":
        key, here = str(first["loc"][-1])[:80], _keys_at(steps[:-1])
        like = get_close_matches(key, here, 1, 0.75)
        better = f"write '{like[0]}'" if like else f"use one of {', '.join(here)}"
        known = any(key in noun.model_fields for noun in _subclasses(Noun))
        return f"this key {'has no meaning here' if known else 'is unknown'}", place, f"{better}, or remove it"
    said = str(node if isinstance(node, bool | int | float | str) else first["input"])
    said = said.lower() if isinstance(node, bool) else said
    return f"{_must(kind, context, first['msg'], first['input'])}, not '{said:.60}'", place, "correct it"


def _subclasses(noun: type[Noun]) -> list[type[Noun]]:
    return [noun, *(each for below in noun.__subclasses__() for each in _subclasses(below))]


def _keys_at(steps: Sequence[int | str]) -> list[str]:
    """The keys of the part at a place of a machine file; none where it may be of no stated kind."""
    nouns: set[type[BaseModel]] = {MachineFile}
    for step in steps:
        fields = [noun.model_fields[step] for noun in nouns if step in noun.model_fields]
        nouns = {each for field in fields for each in _nouns(field.annotation)} if fields else nouns
    return [key for noun in nouns for key in noun.model_fields if key != "notes"]


def _nouns(annotation: Any) -> set[type[BaseModel]]:
    """The kinds of parts within a type."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return {annotation}
    return {each for part in get_args(annotation) for each in _nouns(part)}


def _must(kind: str, context: Mapping[str, Any], message: str, value: Any) -> str:
    """A rule that pydantic found broken, in plain words."""
    if kind == "finite_number" or (isinstance(value, float) and not math.isfinite(value)):
        return "must be a finite number"
    for start, words in {"greater_than_equal": "at least {ge:g}", "greater_than": "greater than {gt:g}",
                         "less_than_equal": "at most {le:g}", "less_than": "less than {lt:g}", "literal": "{expected}",
                         "int_": "a whole number", "float_": "a number", "string_pattern":
                         "at most 63 letters, digits and _, a letter first", "string_": "text in quotation marks",
                         "tuple_": "a list in brackets", "model_": "a table of keys"}.items():
        if kind.startswith(start):
            return f"must be {words.format(**context)}"
    return message[:1].lower() + message[1:]
