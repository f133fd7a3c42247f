"""Machine files: ``models/*.toml`` to `Machine` and back.

A number is a string with its unit, or a table ``{value = "27.8 deg", sigma = "0.5 deg", source = "Table 2"}`` that
adds its confidence (``sigma`` absolute or in %), bounds (``lower``, ``upper``) and source.
"""

from __future__ import annotations

import tomllib
from collections.abc import Mapping, Sequence
from importlib import resources
from pathlib import Path
from typing import Any

import tomlkit
from pydantic import BaseModel, ValidationError

from hydroopt import geometry
from hydroopt.errors import MachineError
from hydroopt.machine import ImpossibleError, Machine, Note, Quantity, Sensor
from hydroopt.units import UnitError, spread_to_si, to_si

_NOTE_KEYS = {"value", "sigma", "lower", "upper", "source"}


def bundled() -> tuple[str, ...]:
    """Names of the machines that come with hydroopt."""
    files = resources.files("hydroopt").joinpath("models").iterdir()
    return tuple(sorted(file.name.removesuffix(".toml") for file in files if file.name.endswith(".toml")))


def load_machine(machine: str | Path, *, parameter_set: str | None = None) -> Machine:
    """Read a machine: the name of a bundled one, or the path of a ``.toml`` file.

    Args:
        machine: name or path.
        parameter_set: which of the file's sets of inertial parameters; by default the one the file names.

    Raises:
        MachineError: the file is missing, malformed, incomplete, contradictory or geometrically impossible.
    """
    name = str(machine)
    if name in bundled():
        return read_machine(resources.files("hydroopt").joinpath(f"models/{name}.toml").read_text("utf-8"),
                            where=name, parameter_set=parameter_set)
    path = Path(machine)
    if path.suffix != ".toml":
        raise MachineError("this is neither a bundled machine nor a .toml file", where=name,
                           remedy=f"name a .toml file or one of {', '.join(bundled())}")
    try:
        text = path.read_text("utf-8")
    except UnicodeDecodeError:
        raise MachineError("the file is not text", where=name, remedy="give a TOML file in UTF-8") from None
    except OSError as error:
        raise MachineError(f"cannot be read ({error.strerror})", where=name, remedy="check the path") from None
    return read_machine(text, where=name, parameter_set=parameter_set)


def read_machine(text: str, *, where: str = "machine", parameter_set: str | None = None) -> Machine:
    """Machine from the text of a machine file; `where` names it in errors.

    Raises:
        MachineError: see `load_machine`.
    """
    try:
        data: dict[str, Any] = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise MachineError(f"is not valid TOML ({error})", where=where, remedy="correct that line") from None
    _choose_parameter_set(data, parameter_set, where)
    notes: dict[str, Note] = {}
    data = _strip_notes(data, "", notes, where)
    for earlier, link in zip([None, *data.get("links", [])], data.get("links", []), strict=False):
        if isinstance(link, dict):  # in a serial chain the parent need not be said
            link.setdefault("parent", "base" if earlier is None else earlier.get("name"))
    try:
        machine = Machine.model_validate(data | {"notes": notes}, context={"from_file": True})
        geometry.check(machine)
    except ValidationError as error:
        raise _in_plain_words(error, data, where) from None
    except ImpossibleError as error:
        raise MachineError(error.what, where=where, remedy=error.remedy) from None
    return machine


def _choose_parameter_set(data: dict[str, Any], wanted: str | None, where: str) -> None:
    sets = data.pop("parameter_sets", {})
    chosen = wanted or data.pop("default_parameter_set", None)
    data.pop("default_parameter_set", None)
    if chosen is None:
        return
    if not isinstance(sets, dict) or chosen not in sets:
        have = ", ".join(sets) or "none"
        raise MachineError(f"there is no parameter set '{chosen}'", where=where, remedy=f"the file has: {have}")
    parts = {part.get("name"): part for key in ("links", "cylinders") for part in data.get(key, [])
             if isinstance(part, dict)}
    for name, stated in sets[chosen].items():
        if name not in parts:
            raise MachineError(f"parameter set '{chosen}' speaks of '{name}', which does not exist", where=where,
                               remedy="name a link or a cylinder")
        for end in ("barrel", "rod"):
            if isinstance(stated.get(end), dict) and isinstance(parts[name].get(end), dict):
                parts[name][end]["body"] = stated[end]
        if "m" in stated:
            parts[name]["body"] = stated
    data["parameter_set"] = chosen


def _strip_notes(node: Any, path: str, notes: dict[str, Note], where: str) -> Any:
    """The same tree with plain values; what was said about them goes to `notes` under their dotted path."""
    if isinstance(node, dict) and "value" in node and set(node) <= _NOTE_KEYS:
        notes[path] = _note(node, f"{where}: {path}")
        return node["value"]
    if isinstance(node, dict):
        return {key: _strip_notes(value, f"{path}.{key}".lstrip("."), notes, where) for key, value in node.items()}
    if isinstance(node, list):
        # parts are addressed by their names, which are unique over the machine
        return [_strip_notes(item, str(item["name"]) if isinstance(item, dict) and "name" in item else f"{path}.{k}",
                             notes, where) for k, item in enumerate(node)]
    return node


def _note(node: Mapping[str, Any], where: str) -> Note:
    value = node["value"]
    like = str(value[0] if isinstance(value, list) and value else value)
    said: dict[str, Any] = {"source": node.get("source", "")}
    try:
        for key in ("lower", "upper"):
            if key in node:
                said[key] = spread_to_si(str(node[key]), like, where=f"{where}.{key}")
        sigma = str(node.get("sigma", "")).strip()
        if sigma.endswith("%"):
            said |= {"sigma": to_si(sigma.replace("%", " %").replace("  ", " "), "1", where=where), "relative": True}
        elif sigma:
            said["sigma"] = spread_to_si(sigma, like, where=f"{where}.sigma")
        if said.get("sigma", 1.0) <= 0:
            raise MachineError("a confidence (sigma) must be positive", where=where, remedy="give one or leave it out")
        return Note(**said)
    except UnitError as error:
        raise MachineError(error.what, where=error.where, remedy=error.remedy) from None
    except ValidationError:
        raise MachineError("'source' must be text", where=where, remedy="put it in quotation marks") from None


def _in_plain_words(error: ValidationError, data: dict[str, Any], where: str) -> MachineError:
    first = error.errors()[0]
    place, node = [], data
    for step in first["loc"]:
        node = node[step] if isinstance(node, list | dict) and step in (
            node if isinstance(node, dict) else range(len(node))) else None  # type: ignore[index]
        if isinstance(step, int) and isinstance(node, dict) and "name" in node:
            place.append(f"[{node['name']}]")
        else:
            place.append(f".{step}" if place and not isinstance(step, int) else f"[{step}]"
                         if isinstance(step, int) else str(step))
    at = f"{where}: {''.join(place)}" if place else where
    impossible = first.get("ctx", {}).get("error")
    if isinstance(impossible, ImpossibleError):
        return MachineError(impossible.what, where=at, remedy=impossible.remedy)
    if first["type"] == "missing":
        return MachineError("this key is missing", where=at, remedy="add it")
    if first["type"] == "extra_forbidden":
        return MachineError("this key is unknown", where=at, remedy="correct its spelling or remove it")
    return MachineError(f"{first['msg'].lower()}, not {first['input']!r:.60}", where=at, remedy="correct the value")


def dump_machine(machine: Machine) -> str:
    """Text of a machine file (SI units) that `read_machine` turns into an equal machine."""
    return tomlkit.dumps(_plain(machine, "", machine))


def _plain(node: BaseModel, path: str, machine: Machine) -> dict[str, Any]:
    table: dict[str, Any] = {}
    for key, field in type(node).model_fields.items():
        value = getattr(node, key)
        if key == "notes" or value is None or (not field.is_required() and value == field.get_default(
                call_default_factory=True)):
            continue
        at = f"{path}.{key}".lstrip(".")
        if isinstance(value, BaseModel):
            table[key] = _plain(value, at, machine)
        elif isinstance(value, tuple) and value and isinstance(value[0], BaseModel):
            table[key] = [_plain(item, getattr(item, "name", f"{at}.{k}"), machine) for k, item in enumerate(value)]
        else:
            unit = _unit(node, key, machine)
            table[key] = _noted(_with_unit(value, unit), machine.notes.get(at), unit)
    return table


def _unit(node: BaseModel, key: str, machine: Machine) -> str | None:
    """SI unit of a field: from its annotation, or from the kind of the joint or channel it belongs to."""
    if isinstance(node, Sensor) and key in ("accuracy", "resolution"):
        return machine.channel_units[node.channels[0]]
    if key in ("lower", "upper", "max_speed", "max_acceleration"):
        base = "m" if getattr(node, "type", "") == "prismatic" else "rad"
        return base + {"max_speed": "/s", "max_acceleration": "/s^2"}.get(key, "")
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
