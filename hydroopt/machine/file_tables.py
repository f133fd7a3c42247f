"""The tables of a machine file: to `Machine` and back.

A number is a string with its unit, or a table ``{value = "27.8 deg", sigma = "0.5 deg", source = "Table 2"}`` that
adds its confidence (``sigma`` absolute or in %), bounds (``lower``, ``upper``) and source.
A file that is ``based_on`` a bundled machine states only where it differs: tables merge key by key, lists part by part
by their names, and parts that the bundled machine lacks stand before its own.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

from pydantic import ValidationError

from hydroopt.errors import MachineError
from hydroopt.machine import file_checks, free_links, linkages, oil_links, range_checks
from hydroopt.machine.bundled_files import bundled_files
from hydroopt.machine.file_schema import CylinderBodies, in_plain_words, validate, without_notes
from hydroopt.machine.links import Note
from hydroopt.machine.machine import Machine
from hydroopt.machine.quantity import ImpossibleError, Noun
from hydroopt.support.input_file import toml
from hydroopt.units import UnitError

_VECTOR = re.compile(r"\[\n((?: +[^\[\]\n]+,\n)+) *\]")


def build_machine(data: dict[str, Any], where: str, parameter_set: str | None = None) -> Machine:
    """Machine from the tables of a machine file.

    Raises:
        MachineError: they are incomplete, contradictory or geometrically impossible.
    """
    if not data:
        raise MachineError("the file is empty", where=where, remedy="describe a machine in it")
    data = _with_base(data, where)
    _default_parents(data)
    validate(data, where)
    in_linkages = linkages.expand(data, where) | oil_links.expand(data, where)
    moved = _with_bodies(data, parameter_set, where) | in_linkages
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


def _with_bodies(data: dict[str, Any], wanted: str | None, where: str) -> dict[str, str]:
    """Put the chosen bodies in their places of a description that was validated.

    Returns:
        Which place of the machine stands where in the file.

    Raises:
        MachineError: there is no such set, or any of the sets names a part that there is not, or one of the other kind.
    """
    sets, default = data.pop("parameter_sets", {}), data.pop("default_parameter_set", "")
    chosen, moved = wanted or default, dict[str, str]()
    if chosen and chosen not in sets:
        raise MachineError(f"there is no parameter set '{chosen}'", where=where,
                           remedy=f"the file has: {', '.join(sets) or 'none'}")
    links, cylinders = ({part["name"]: part for part in data.get(kind, [])} for kind in ("links", "cylinders"))
    for given, bodies in sets.items():
        for name, stated in bodies.items():
            there = f"parameter_sets.{given}.{name}"
            ends = stated.keys() <= CylinderBodies.model_fields.keys()
            if name not in (cylinders if ends else links):
                other = {True: "a link: state its body", False: "a cylinder: state the bodies of 'barrel' and 'rod'"}
                raise MachineError(f"parameter set '{given}' names '{name}', which does not exist"
                                   if name not in {*links, *cylinders} else f"'{name}' is {other[ends]}",
                                   where=f"{where}: {there}", remedy="name a link or a cylinder, and what it has")
            if given == chosen and not ends:
                links[name]["body"] = stated
                moved[f"links[{name}].body"] = there
            for end, body in stated.items() if given == chosen and ends else ():
                cylinders[name][end]["body"] = body
                moved[f"cylinders[{name}].{end}.body"] = f"{there}.{end}"
    if chosen:
        data["parameter_set"] = chosen
    return moved


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
    base, bundled = data.pop("based_on"), bundled_files()
    if not isinstance(base, str) or base not in bundled:
        raise MachineError(f"'{base}' is no bundled machine", where=f"{where}: based_on",
                           remedy=f"name one of {', '.join(bundled)}, or state the whole machine")
    before = toml(bundled[base].read_text("utf-8"), MachineError, where=base)
    merged: dict[str, Any] = _merged(_with_base(before, base), data)
    return merged


def _merged(base: Any, own: Any, key: str = "") -> Any:
    """What a machine is based on, with its own statements in place.

    Of parts with a name those that the base has not come last, as a link behind its parent, but stages first: what
    moved before is frozen.
    """
    if isinstance(base, dict) and isinstance(own, dict):
        return base | {name: _merged(base[name], value, name) if name in base else value for name, value in own.items()}
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
