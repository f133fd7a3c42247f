"""The reference of machine files, from the types that read them: keys, units, defaults, and their docstrings."""

from __future__ import annotations

import inspect
import types
from collections.abc import Iterator
from typing import Any, Literal, Union, get_args, get_origin

from annotated_types import Ge, Gt, Le, Lt, MinLen
from pydantic import BaseModel
from pydantic.fields import FieldInfo
from pydantic_core import PydanticUndefined
from sphinx.pycode import ModuleAnalyzer

from extension.text import cell
from hydroopt.machine.file_schema import MachineFile
from hydroopt.machine.quantity import Noun, Quantity

HIDDEN = {"parameter_set"}
"""Fields that only a file written by hydroopt states."""


def pages() -> dict[str, str]:
    """Text of the page's part by its path below ``docs/generated``."""
    found: dict[type[BaseModel], str] = {}
    _collect(MachineFile, "", found)
    return {"machine_file.md": "\n".join(_section(kind, path) for kind, path in found.items())}


def _collect(kind: type[BaseModel], path: str, found: dict[type[BaseModel], str]) -> None:
    """Every type of part, with the place where a file states it first."""
    if kind in found:
        return
    found[kind] = path
    for name, field in kind.model_fields.items():
        if name not in HIDDEN:
            for part in _parts(field.annotation):
                below = f"{path.strip('[]')}.{name}".lstrip(".")
                _collect(part, f"[[{below}]]" if _many(field.annotation) else f"[{below}]", found)


def _section(kind: type[BaseModel], path: str) -> str:
    docs = {name: text for base in reversed(kind.__mro__) if issubclass(base, Noun)
            for (owner, name), text in ModuleAnalyzer.for_module(base.__module__).find_attr_docs().items()
            if owner == base.__qualname__}
    title = f"`{path}`" if path else "The machine"
    prose = (inspect.getdoc(kind) or "").split(">>>")[0].strip()
    lines = [f"({anchor(kind)})=", f"## {title}", "", prose.replace("``", "`"), "",
             "| key | value | default | meaning |", "|---|---|---|---|"]
    for name, field in kind.model_fields.items():
        if name in HIDDEN:
            continue
        text = " ".join(docs.get(name, []))
        if not text:
            raise ValueError(f"{kind.__module__}.{kind.__qualname__}.{name} has no docstring")
        lines.append(f"| `{name}` | {_value(kind, name, field)} | {_default(field, name)} | {cell(text)} |")
    return "\n".join([*lines, ""])


def anchor(kind: type[BaseModel]) -> str:
    """Target of links to the section of a type."""
    return f"machine-file-{kind.__name__.lower()}"


def _value(kind: type[BaseModel], name: str, field: FieldInfo) -> str:
    """What may stand behind a key: unit, choice, table, with its bounds."""
    if parts := list(_parts(field.annotation)):
        word = "tables" if _many(field.annotation) else "table"
        return " or ".join(f"[{word}](#{anchor(part)})" for part in parts)
    marks = [*field.metadata, *_marks(field.annotation)]
    units = next((" or ".join((mark.si, *mark.others)) if len(mark.others) < 3 else "the channels' unit"
                  for mark in marks if isinstance(mark, Quantity)), "")
    inner = _plain(field.annotation)
    bounds = ", ".join(text for mark in field.metadata if (text := _bound(mark)))
    if get_origin(inner) is Literal:
        return " or ".join(f"`\"{choice}\"`" for choice in get_args(inner))
    if get_origin(inner) is dict:
        return f"a table by names{', of ' + units if units else ''}"
    if get_origin(inner) is tuple:
        arguments = [each for each in get_args(inner) if each is not Ellipsis]
        if units and len(arguments) > 1:
            return f"{len(arguments)} × {cell(units)}"
        return "points" if units else "names" if len(arguments) == 1 else f"{len(arguments)} names"
    words = {bool: "`true` or `false`", int: "integer", str: "text", float: "number"}
    text = cell(units.replace("1", "number")) if units else words.get(inner, "text")
    return f"{text} ({bounds})" if bounds else text


def _bound(mark: Any) -> str:
    """A bound in words; lengths of lists aside."""
    if isinstance(mark, MinLen):
        return ""
    signs = ((Ge, "ge", "≥"), (Gt, "gt", "\\>"), (Le, "le", "≤"), (Lt, "lt", "\\<"))
    return next((f"{sign} {getattr(mark, key):g}" for kind, key, sign in signs if isinstance(mark, kind)), "")


def _default(field: FieldInfo, name: str) -> str:
    if field.is_required():
        return "from its place" if name == "parent" else "**required**"
    value = field.default
    if value is PydanticUndefined or value is None or value in ((), "") or isinstance(value, BaseModel):
        return "–"
    if isinstance(value, bool):
        return f"`{str(value).lower()}`"
    if isinstance(value, tuple):
        return "0" if not any(value) else cell(str(value))
    return f"`\"{value}\"`" if isinstance(value, str) else f"{value:g}"


def _parts(annotation: Any) -> Iterator[type[BaseModel]]:
    """Types of parts that an annotation contains."""
    if inspect.isclass(annotation) and issubclass(annotation, BaseModel):
        yield annotation
    for each in get_args(annotation):
        yield from _parts(each)


def _many(annotation: Any) -> bool:
    return any(get_origin(each) is tuple for each in (annotation, *get_args(annotation)))


def _plain(annotation: Any) -> Any:
    """An annotation without None and without marks."""
    if get_origin(annotation) in (Union, types.UnionType):
        return _plain(next(each for each in get_args(annotation) if each is not type(None)))
    return _plain(get_args(annotation)[0]) if hasattr(annotation, "__metadata__") else annotation


def _marks(annotation: Any) -> Iterator[Any]:
    """Marks of an annotation and of all that it contains."""
    yield from getattr(annotation, "__metadata__", ())
    for each in get_args(annotation):
        yield from _marks(each)
