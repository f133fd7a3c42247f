"""Machine files: ``models/*.toml`` to `Machine` and back.

A number is a string with its unit, or a table ``{value = "27.8 deg", sigma = "0.5 deg", source = "Table 2"}`` that
adds its confidence (``sigma`` absolute or in %), bounds (``lower``, ``upper``) and source.
A file that is ``based_on`` a bundled machine states only where it differs: tables merge key by key, lists part by part
by their names, and parts that the bundled machine lacks stand before its own.
"""

from __future__ import annotations

import os
import re
import shlex
from collections.abc import Mapping
from difflib import get_close_matches
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from hydroopt.errors import MachineError, ProblemError
from hydroopt.machine import file_checks, free_links, linkages, oil_links, parameter_sets, range_checks
from hydroopt.machine.bundled_files import bundled_files
from hydroopt.machine.file_schema import in_plain_words, validate, without_notes, without_value
from hydroopt.machine.links import Note
from hydroopt.machine.machine import Machine
from hydroopt.machine.quantity import ImpossibleError, Noun
from hydroopt.support.input_file import read_text, toml
from hydroopt.units import UnitError

ROBOT_SUFFIXES = (".urdf", ".xml", ".sdf", ".xacro")
"""Endings of robot files; a template of xacro is none, and named in its refusal."""
_VECTOR = re.compile(r"\[\n((?: +[^\[\]\n]+,\n)+) *\]")


def bundled() -> tuple[str, ...]:
    """Names of the machines that come with hydroopt.

    >>> "cat215b" in bundled()
    True
    """
    return tuple(bundled_files())


def load_machine(machine: str | Path, *, parameter_set: str | None = None, tip: str | None = None) -> Machine:
    """Read a machine: the name of a bundled one, or the path of a ``.toml`` file or a robot's ``.urdf``,
    ``.xml`` (MJCF) or ``.sdf``.

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
        raise MachineError(f"this is neither a bundled machine nor a .toml or {', '.join(ROBOT_SUFFIXES[:3])} file",
                           where=name, remedy=f"did you mean {' or '.join(close)}" if close else
                           "name a .toml file, or one of the machines that 'hydroopt models' lists")
    text = read_text(path, MachineError, noun="machine file")
    return _loaded(read_machine(text, where=name, parameter_set=parameter_set), name)


def _loaded(machine: Machine, source: str) -> Machine:
    """The machine with its `source`, which is not part of its description: equal machines may have different ones."""
    machine.__dict__["source"] = shlex.quote(source)
    return machine


GivenMachine = Machine | str | Path
"""What functions take for a machine, see `machine_of`."""


def machine_of(given: object, where: str) -> Machine:
    """A machine, that of a model, or the one of a name or path, as all public functions take them.

    Args:
        given: a machine, a model or plant, or what `load_machine` takes.
        where: the function, for errors.

    Raises:
        ProblemError: this is something else.
        MachineError: see `load_machine`.

    >>> machine_of("cat215b", "test").joints
    ('swing', 'boom', 'stick')
    """
    if isinstance(given, str | Path):
        return load_machine(given)
    found = given if isinstance(given, Machine) else getattr(given, "machine", None)
    if not isinstance(found, Machine):
        raise ProblemError(f"this is {type(given).__name__} {given!r:.40}, not a machine", where=where,
                           remedy="give a Machine, such as load_machine('cat215b') returns, its name, or its file")
    return found


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
    return build_machine(toml(text, MachineError, where=where), where, parameter_set)


def build_machine(data: dict[str, Any], where: str, parameter_set: str | None = None) -> Machine:
    """Machine from the tables of a machine file, see `read_machine`."""
    if not data:
        raise MachineError("the file is empty", where=where, remedy="describe a machine in it")
    data = _with_base(data, where)
    _default_parents(data)
    validate(data, where)
    in_linkages = linkages.expand(data, where) | oil_links.expand(data, where)
    moved = parameter_sets.expand(data, parameter_set, where) | in_linkages
    _expand_ground(data)
    moved |= free_links.expand(data) | free_links.expand_base(data)
    try:
        data, notes = without_notes(data)
        machine = Machine.model_validate(data | {"notes": notes}, context={"from_file": True})
        file_checks.check(machine, [loop.name for loop in machine.loops if loop.place in moved])
        range_checks.check(machine)
    except ValidationError as error:
        what, place, remedy = in_plain_words(error.errors(), data)
        raise MachineError(what, where=_at(where, place, moved), remedy=remedy) from None
    except (UnitError, ImpossibleError) as error:
        place = error.where if isinstance(error, UnitError) else error.key
        raise MachineError(error.what, where=_at(where, place, moved), remedy=error.remedy) from None
    return machine


def _expand_ground(data: dict[str, Any]) -> None:
    """Leave out the link of what stands on the ground: of a machine without a link of that name, `ground` rests."""
    if all(link["name"] != "ground" for link in data["links"]):
        for part in (*data.get("targets", []), *data.get("instruments", [])):
            if part.get("link") == "ground":
                del part["link"]


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
    if not isinstance(base, dict) and without_value(own):
        return {"value": base} | own  # of a sidecar, which states what is known of a robot file's number
    if not isinstance(base, list) or not isinstance(own, list) or not all(
            isinstance(part, dict) and isinstance(part.get("name"), str) for part in (*base, *own)):
        return own
    stated = {part["name"]: part for part in reversed(own)}
    known = {part["name"] for part in base}
    more = [part for part in own if part["name"] not in known or part is not stated[part["name"]]]
    same = [_merged(part, stated.get(part["name"], {})) for part in base]
    return more + same if key == "stages" else same + more


def _at(where: str, place: str, moved: Mapping[str, str]) -> str:
    """File and key as the file has them."""
    for inside, there in moved.items():
        if place == inside or place.startswith(f"{inside}."):
            place = there + place[len(inside):]
    return f"{where}: {place}" if place else where


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


def _plain(node: Noun, path: str, machine: Machine) -> dict[str, Any]:
    table: dict[str, Any] = {}
    for key, field in type(node).model_fields.items():
        value = getattr(node, key)
        at = f"{path}.{key}".lstrip(".")
        usual = not field.is_required() and value == field.get_default(call_default_factory=True)
        if key == "notes" or value is None or (usual and at not in machine.notes):
            continue
        if isinstance(value, Noun):
            table[key] = _plain(value, at, machine)
        elif isinstance(value, dict):
            table[key] = {}
            for name, item in value.items():
                unit = machine.unit(node, key, name)
                table[key][name] = _noted(_with_unit(item, unit), machine.notes.get(f"{at}.{name}"), unit)
        elif isinstance(value, tuple) and value and isinstance(value[0], Noun):
            table[key] = [_plain(item, getattr(item, "name", f"{at}.{k}"), machine) for k, item in enumerate(value)]
        else:
            unit = machine.unit(node, key, path.partition(".")[0])
            table[key] = _noted(_with_unit(value, unit), machine.notes.get(at), unit)
    return table


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
