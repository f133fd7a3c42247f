"""Tables as text of TOML."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from typing import Any

_BARE = re.compile(r"[A-Za-z0-9_-]+")
_ESCAPED = {'"': '\\"', "\\": "\\\\", "\b": "\\b", "\t": "\\t", "\n": "\\n", "\f": "\\f", "\r": "\\r"}


def toml_text(tables: Mapping[str, Any]) -> str:
    """Text of tables: in each of them values first, then tables under headings of their own.

    Args:
        tables: strings, numbers, lists, and mappings of such.

    >>> print(toml_text({"name": "arm", "joint": {"a": {"value": "1.2 m", "sigma": "1 mm"}, "fixed": True}}), end="")
    name = "arm"
    <BLANKLINE>
    [joint]
    fixed = true
    <BLANKLINE>
    [joint.a]
    value = "1.2 m"
    sigma = "1 mm"
    """
    return "\n".join(_lines(tables, "")).lstrip("\n") + "\n"


def _lines(table: Mapping[str, Any], path: str) -> Iterator[str]:
    """The lines of a table whose heading, if any, is written already."""
    for key, value in table.items():
        if not (isinstance(value, Mapping) or _is_array_of_tables(value)):
            yield f"{_key(key)} = {_value(value)}"
    for key, value in sorted(table.items(), key=lambda item: isinstance(item[1], Mapping)) if path else table.items():
        at = f"{path}{_key(key)}"
        if isinstance(value, Mapping):
            inner = list(_lines(value, f"{at}."))
            yield from inner if inner and not inner[0] else ["", f"[{at}]", *inner]
        elif _is_array_of_tables(value):
            for each in value:
                yield from ("", f"[[{at}]]", *_lines(each, f"{at}."))


def _is_array_of_tables(value: Any) -> bool:
    return isinstance(value, list) and bool(value) and all(isinstance(each, Mapping) for each in value)


def _value(value: Any) -> str:
    if isinstance(value, str):
        return _quoted(value)
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, list | tuple):
        return f"[{', '.join(map(_value, value))}]"
    if isinstance(value, Mapping):
        return f"{{{', '.join(f'{_key(key)} = {_value(each)}' for key, each in value.items())}}}"
    return str(value)


def _key(key: str) -> str:
    return key if _BARE.fullmatch(key) else _quoted(key)


def _quoted(text: str) -> str:
    escaped = (_ESCAPED.get(c) or (f"\\u{ord(c):04x}" if ord(c) < 32 or ord(c) == 127 else c) for c in text)
    return f'"{"".join(escaped)}"'
