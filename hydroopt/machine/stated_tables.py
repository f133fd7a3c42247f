"""Tables of a machine file before they are expanded: what is no table, unknown keys and missing ones are refused."""

from __future__ import annotations

from typing import Any

from hydroopt.errors import MachineError
from hydroopt.machine.quantity import Noun


def tables(node: Any, where: str) -> list[Any]:
    """A list of tables.

    Raises:
        MachineError: it is no list.
    """
    if not isinstance(node, list):
        key = where.rpartition(" ")[2]
        raise MachineError("must be a list of tables", where=where, remedy=f"write [[{key}]] above each of them")
    return node


def table(node: Any, where: str) -> dict[str, Any]:
    """A table.

    Raises:
        MachineError: it is none.
    """
    if not isinstance(node, dict):
        raise MachineError(f"must be a table, not {node!r:.60}", where=where, remedy="state it key by key")
    return node


def refuse_keys(node: Any, kind: type[Noun], where: str) -> None:
    """Refuse what is no table, and keys that a kind of table does not have or that it needs and that are missing.

    Raises:
        MachineError: names the key and the remedy.
    """
    table(node, where)
    known = kind.model_fields
    for key in node:
        if key not in known:
            raise MachineError("this key is unknown", where=f"{where}.{key}", remedy=f"use {', '.join(sorted(known))}")
    for key in sorted(known):
        if known[key].is_required() and key not in node:
            raise MachineError("this key is missing", where=f"{where}.{key}", remedy="add it")
