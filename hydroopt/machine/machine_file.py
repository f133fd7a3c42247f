"""Machine files: ``models/*.toml`` to `Machine` and back.

A number is a string with its unit, or a table ``{value = "27.8 deg", sigma = "0.5 deg", source = "Table 2"}`` that
adds its confidence (``sigma`` absolute or in %), bounds (``lower``, ``upper``) and source.
A file that is ``based_on`` a bundled machine states only where it differs: tables merge key by key, lists part by part
by their names, and parts that the bundled machine lacks stand before its own.
"""

from __future__ import annotations

import math
import os
import re
import shlex
from collections.abc import Mapping, Sequence
from difflib import get_close_matches
from pathlib import Path
from typing import Any, get_args

from pydantic import BaseModel, ValidationError

from hydroopt.errors import MachineError
from hydroopt.input_file import read_text, toml
from hydroopt.machine import (
    base_motion,
    cylinder_checks,
    free_links,
    idle_linkages,
    linkages,
    loop_checks,
    oil_links,
    other_ways,
    parameter_sets,
    prior_checks,
)
from hydroopt.machine.actuators import Cylinder, TorqueFriction
from hydroopt.machine.bundled_files import bundled_files
from hydroopt.machine.couplings import Coupling
from hydroopt.machine.links import Joint, JointFriction, JointSpring, Note
from hydroopt.machine.loops import Loop
from hydroopt.machine.machine import Machine
from hydroopt.machine.quantity import ImpossibleError, Noun, Quantity
from hydroopt.machine.sensor import Sensor
from hydroopt.machine.valves import Valve
from hydroopt.units import UnitError, spread_to_si, to_si

ROBOT_SUFFIXES = (".urdf", ".xml")
"""Endings of robot files."""
_NOTE_KEYS = {"value", "sigma", "lower", "upper", "source"}
_VECTOR = re.compile(r"\[\n((?: +[^\[\]\n]+,\n)+) *\]")


def bundled() -> tuple[str, ...]:
    """Names of the machines that come with hydroopt.

    >>> "cat215b" in bundled()
    True
    """
    return tuple(bundled_files())


def load_machine(machine: str | Path, *, parameter_set: str | None = None, tip: str | None = None) -> Machine:
    """Read a machine: the name of a bundled one, or the path of a ``.toml`` file or a robot's ``.urdf`` or
    ``.xml`` (MJCF).

    Args:
        machine: name or path, also of the folder that a command wrote with the calibrated machine.
        parameter_set: which of the file's sets of inertial parameters; by default the one the file names. A robot file
            has none.
        tip: of a robot file, the link at the end of the chain to read; all joints by default. See
            `hydroopt.machine.robot_formats.machine_tables.machine_tables`.

    Raises:
        MachineError: the file is missing, malformed, incomplete, contradictory or geometrically impossible.

    >>> load_machine("cat215b")
    Machine('cat215b': 3 joints, 2 cylinders, 1 motor)
    """
    name, path = str(machine), Path(machine)
    if path.suffix in ROBOT_SUFFIXES:
        if parameter_set is not None:
            raise MachineError(f"there is no parameter set '{parameter_set}'", where=name,
                               remedy="leave it out: a robot file states its bodies once")
        from hydroopt.machine.robot_formats.reading import read_robot  # noqa: PLC0415 (most machines need no XML)

        found = read_robot(path, tip=tip)
        return _loaded(build_machine(_merged(found.tables, found.rest), name), name)
    if tip is not None:
        raise MachineError(f"only of a robot file the chain to a tip such as '{tip}' can be read", where=name,
                           remedy="leave it out")
    if file := bundled_files().get(name):
        return _loaded(read_machine(file.read_text("utf-8"), where=name, parameter_set=parameter_set), name)
    if os.path.isdir(path) and len(machines := sorted(path.glob("*.toml"))) == 1:  # what a command wrote
        return _loaded(load_machine(machines[0], parameter_set=parameter_set), name)
    if path.suffix != ".toml":
        close = get_close_matches(name, bundled(), 2)
        raise MachineError(f"this is neither a bundled machine nor a .toml or {' or '.join(ROBOT_SUFFIXES)} file",
                           where=name, remedy=f"did you mean {' or '.join(close)}" if close else
                           "name a .toml file, or one of the machines that 'hydroopt models' lists")
    text = read_text(path, MachineError, noun="machine file")
    return _loaded(read_machine(text, where=name, parameter_set=parameter_set), name)


def _loaded(machine: Machine, source: str) -> Machine:
    """The machine with its `source`, which is not part of its description: equal machines may have different ones."""
    machine.__dict__["source"] = shlex.quote(source)
    return machine


def read_machine(text: str, *, where: str = "machine", parameter_set: str | None = None) -> Machine:
    """Machine from the text of a machine file; `where` names it in errors.

    Raises:
        MachineError: see `load_machine`.

    >>> machine = read_machine('''
    ... name = "pendulum"
    ... [[links]]
    ... name = "arm"
    ... joint = { type = "revolute", lower = "-90 deg", upper = "90 deg", a = "1.2 m" }
    ... [[drives]]
    ... name = "drive"
    ... joint = "arm"
    ... ''')
    >>> machine
    Machine('pendulum': 1 joint, 1 drive)
    """
    return build_machine(_with_base(toml(text, MachineError, where=where), where), where, parameter_set)


def build_machine(data: dict[str, Any], where: str, parameter_set: str | None = None) -> Machine:
    """Machine from the tables of a machine file, see `read_machine`."""
    if not data:
        raise MachineError("the file is empty", where=where, remedy="describe a machine in it")
    if "notes" in data:
        raise MachineError("this key is unknown", where=f"{where}: notes", remedy="remove it")
    _default_parents(data)
    in_linkages = linkages.expand(data, where) | oil_links.expand(data, where)
    moved = parameter_sets.expand(data, parameter_set, where) | in_linkages
    moved |= free_links.expand(data, where) | base_motion.expand(data, where)
    notes: dict[str, Note] = {}
    try:
        data = _strip_notes(data, "", "", notes)
        machine = Machine.model_validate(data | {"notes": notes}, context={"from_file": True})
        idle_linkages.check(machine, [loop.name for loop in machine.loops if f"loops[{loop.name}]" in moved])
        _check_geometry(machine)
        prior_checks.check(machine)
    except ValidationError as error:
        what, place, remedy = _in_plain_words(error, data)
        raise MachineError(what, where=_at(where, place, moved), remedy=remedy) from None
    except UnitError as error:
        raise MachineError(error.what, where=_at(where, error.where, moved), remedy=error.remedy) from None
    except ImpossibleError as error:
        raise MachineError(error.what, where=_at(where, error.key, moved), remedy=error.remedy) from None
    return machine


def _check_geometry(machine: Machine) -> None:
    try:
        loop_checks.check(machine)
        cylinder_checks.check(machine)
    except ImpossibleError as error:
        raise ImpossibleError(error.what, other_ways.remedy(machine) or error.remedy, error.key) from None


def _default_parents(data: dict[str, Any]) -> None:
    """In a serial chain the parent is optional: it is the link before."""
    before: Any = "base"
    for link in links if isinstance(links := data.get("links"), list) else []:
        if isinstance(link, dict):
            before = link.setdefault("parent", before) and link.get("name")
    calibrator = data.get("calibrator")
    if isinstance(calibrator, dict):
        before = calibrator.get("parent")
        for link in more if isinstance(more := calibrator.get("links"), list) else []:
            if isinstance(link, dict):
                before = link.setdefault("parent", before) and link.get("name")


def _with_base(data: dict[str, Any], where: str) -> dict[str, Any]:
    if "based_on" not in data:
        return data
    base = data.pop("based_on")
    if base not in bundled():
        raise MachineError(f"'{base}' is no bundled machine", where=f"{where}: based_on",
                           remedy=f"name one of {', '.join(bundled())}, or state the whole machine")
    before = toml(bundled_files()[base].read_text("utf-8"), MachineError, where=str(base))
    merged: dict[str, Any] = _merged(_with_base(before, str(base)), data)
    return merged


def _merged(base: Any, own: Any, key: str = "") -> Any:
    """What a machine is based on, with its own statements in place.

    Of parts with a name those that the base has not come last, as a link behind its parent, but stages first: what
    moved before is frozen.
    """
    if isinstance(base, dict) and isinstance(own, dict):
        return base | {name: _merged(base[name], value, name) if name in base else value for name, value in own.items()}
    if own and not isinstance(base, dict) and isinstance(own, dict) and "value" not in own and own.keys() <= _NOTE_KEYS:
        return {"value": base} | own  # of a sidecar, which states what is known of a robot file's number
    parts = [part for each in (base, own) if isinstance(each, list) for part in each]
    if not parts or not isinstance(base, list) or not isinstance(own, list) or not all(
            isinstance(part, dict) and "name" in part for part in parts):
        return own
    stated = {part["name"]: part for part in own}
    known = {part["name"] for part in base}
    more = [part for part in own if part["name"] not in known]
    same = [_merged(part, stated.get(part["name"], {})) for part in base]
    return more + same if key == "stages" else same + more


def _at(where: str, place: str, moved: Mapping[str, str]) -> str:
    """File and key as the file has them."""
    for inside, there in moved.items():
        if place == inside or place.startswith(f"{inside}."):
            place = there + place[len(inside):]
    return f"{where}: {place}" if place else where


def _strip_notes(node: Any, path: str, place: str, notes: dict[str, Note]) -> Any:
    """The same tree with plain values; their notes go to `notes` under their dotted path.

    `place` is where the node stands in the file, for error messages.
    """
    if isinstance(node, dict) and {"name", "value"} <= node.keys() and not isinstance(node["value"], dict):
        said = {key: node[key] for key in sorted(_NOTE_KEYS & node.keys())}  # a part whose one number it is
        node = {key: value for key, value in node.items() if key not in said} | {"value": said}
    elif isinstance(node, dict) and "value" in node and "name" not in node:
        notes[path] = _note(node, place)
        return node["value"]
    if isinstance(node, dict):
        return {key: _strip_notes(value, f"{path}.{key}".lstrip("."), f"{place}.{key}".lstrip("."), notes)
                for key, value in node.items()}
    if isinstance(node, list):
        # parts are addressed by their names, which are unique over the machine
        names = [item["name"] if isinstance(item, dict) and "name" in item else None for item in node]
        return [_strip_notes(item, f"{path}.{k}" if name is None else str(name),
                             f"{place}[{k if name is None else name}]", notes)
                for k, (name, item) in enumerate(zip(names, node, strict=True))]
    return node


def _note(node: Mapping[str, Any], place: str) -> Note:
    value = node["value"]
    like = str(value[0] if isinstance(value, list) and value else value)
    said: dict[str, Any] = {"source": node.get("source", "")}
    for key in node:
        if key not in _NOTE_KEYS:
            raise ImpossibleError("this key is unknown",
                                  f"beside 'value', use {', '.join(sorted(_NOTE_KEYS - {'value'}))}", f"{place}.{key}")
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


def _in_plain_words(error: ValidationError, data: dict[str, Any]) -> tuple[str, str, str]:
    """What, place and remedy of the first mistake, an unknown key before all: it often is the one that is missing."""
    mistakes = error.errors()
    first = next((m for m in mistakes if m["type"] == "extra_forbidden"), mistakes[0])
    place = ""
    node: Any = data
    above: Any = data
    for step in first["loc"]:
        above = node
        node = node[step] if isinstance(node, list | dict) and step in (  # type: ignore[index]
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
    if kind == "extra_forbidden":
        key, here = str(first["loc"][-1])[:80], _keys_at(first["loc"][:-1])
        like = get_close_matches(key, here, 1, 0.75)
        better = f"write '{like[0]}'" if like else f"use one of {', '.join(here)}"
        known = any(key in noun.model_fields for noun in Noun.__subclasses__())
        return f"this key {'has no meaning here' if known else 'is unknown'}", place, f"{better}, or remove it"
    said = str(node if isinstance(node, bool | int | float | str) else first["input"])
    said = said.lower() if isinstance(node, bool) else said
    return f"{_must(kind, context, first['msg'], first['input'])}, not '{said:.60}'", place, "correct it"


def _keys_at(steps: Sequence[int | str]) -> list[str]:
    """The keys of the part at a place of a machine file; none where it may be of no stated kind."""
    nouns: set[type[BaseModel]] = {Machine}
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
                         "made of letters, digits and _, a letter first", "string_": "text in quotation marks",
                         "tuple_": "a list in brackets", "model_": "a table of keys"}.items():
        if kind.startswith(start):
            return f"must be {words.format(**context)}"
    return message[:1].lower() + message[1:]


def dump_machine(machine: Machine) -> str:
    """Text of a machine file (SI units) that `read_machine` turns into an equal machine.

    >>> machine = load_machine("cat215b")
    >>> read_machine(dump_machine(machine)) == machine
    True
    """
    return dump_tables(machine_file_tables(machine))


def machine_file_tables(machine: Machine) -> dict[str, Any]:
    """The tables of a machine file (SI units)."""
    return _plain(machine, "", machine)


def dump_tables(tables: Mapping[str, Any]) -> str:
    """Text of a machine file's tables, vectors on one line each."""
    import tomli_w  # noqa: PLC0415 (most commands write no machine)

    def on_one_line(found: re.Match[str]) -> str:
        return f"[{', '.join(entry.strip().removesuffix(',') for entry in found[1].splitlines())}]"

    return _VECTOR.sub(on_one_line, tomli_w.dumps(tables))


def _plain(node: BaseModel, path: str, machine: Machine) -> dict[str, Any]:
    table: dict[str, Any] = {}
    for key, field in type(node).model_fields.items():
        value = getattr(node, key)
        at = f"{path}.{key}".lstrip(".")
        usual = not field.is_required() and value == field.get_default(call_default_factory=True)
        if key == "notes" or value is None or (usual and at not in machine.notes):
            continue
        if isinstance(value, BaseModel):
            table[key] = _plain(value, at, machine)
        elif isinstance(value, dict):
            table[key] = {}
            for name, item in value.items():
                unit = _unit(node, key, machine, name)
                table[key][name] = _noted(_with_unit(item, unit), machine.notes.get(f"{at}.{name}"), unit)
        elif isinstance(value, tuple) and value and isinstance(value[0], BaseModel):
            table[key] = [_plain(item, getattr(item, "name", f"{at}.{k}"), machine) for k, item in enumerate(value)]
        else:
            unit = _unit(node, key, machine, path.partition(".")[0])
            table[key] = _noted(_with_unit(value, unit), machine.notes.get(at), unit)
    return table


def _unit(node: BaseModel, key: str, machine: Machine, owner: str) -> str | None:
    """SI unit of a field: from its annotation, or from the kind of the joint or channel it belongs to.

    `owner` is the name of the part that the field belongs to, or of the joint whose number it is.
    """
    if isinstance(node, Coupling) and key in ("ratios", "offset"):
        return machine.coupling_units(node)["offset" if key == "offset" else f"ratio.{owner}"]
    if isinstance(node, Loop) and key == "posture":
        return machine.position_unit(owner)
    if isinstance(node, JointSpring):
        return machine.spring_units(owner)[key]
    if isinstance(node, JointFriction | TorqueFriction):
        driven = {part.name: part.joint for part in machine.actuators if not isinstance(part, Cylinder)}
        return machine.friction_units(driven.get(owner, owner))[key]
    if isinstance(node, Sensor) and key in ("accuracy", "resolution"):
        return machine.channel_units[node.channels[0]]
    if isinstance(node, Joint) and key in ("lower", "upper", "max_speed", "max_acceleration"):
        base = "m" if node.type == "prismatic" else "rad"
        return base + {"max_speed": "/s", "max_acceleration": "/s^2"}.get(key, "")
    if isinstance(node, Valve) and key in ("neutral", "full", "dead_band", "dead_band_reverse"):
        return node.command
    field = type(node).model_fields[key]
    marks = [*field.metadata, *_nested_metadata(field.annotation)]
    return next((mark.si for mark in marks if isinstance(mark, Quantity)), None)


def _nested_metadata(annotation: Any) -> Sequence[Any]:
    inner = [m for argument in getattr(annotation, "__args__", ()) for m in _nested_metadata(argument)]
    return [*getattr(annotation, "__metadata__", ()), *inner]


def _with_unit(value: Any, unit: str | None) -> Any:
    if isinstance(value, tuple):
        return [_with_unit(item, unit) for item in value]
    if unit is None or isinstance(value, str):
        return value
    return f"{value!r} {unit}" if unit != "1" else value


def _noted(value: Any, note: Note | None, unit: str | None) -> Any:
    if note is None:
        return value
    table: dict[str, Any] = {"value": value}
    if note.sigma is not None:
        table["sigma"] = f"{100 * note.sigma!r} %" if note.relative else _with_unit(note.sigma, unit)
    table |= {key: _with_unit(getattr(note, key), unit) for key in ("lower", "upper") if getattr(note, key) is not None}
    return table | ({"source": note.source} if note.source else {})
