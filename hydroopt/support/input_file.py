"""Files from outside, which may be anything: read within limits, or refused in one sentence."""

from __future__ import annotations

import json
import math
import os
import re
import stat
import tomllib
from copy import deepcopy
from difflib import get_close_matches
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Iterable

    from hydroopt.errors import HydrooptError

TEXT_LIMIT = 4 * 1000**2
"""Largest file of TOML that is read [bytes]."""
JSON_LIMIT = 32 * 1000**2
"""Largest file of JSON or XML that is read [bytes]."""
LEVELS = 30
"""How deep tables may lie in each other."""
_LARGEST_INTEGER = 2**63
_DEEP_KEY = re.compile(rf"(?<![\w'\"-])(?:[\w'\"-]++[ \t]*+\.[ \t]*+){{{LEVELS}}}")
"""A key of so many parts, on which tomllib would take minutes."""


def read_bytes(path: str | Path, kind: type[HydrooptError], *, most: int, noun: str = "file") -> bytes:
    """The content of a file.

    Args:
        path: of a regular file; directories, pipes and devices are refused, since reading them may never end.
        kind: the error to raise.
        most: bytes that are read.
        noun: what the error calls it.

    Raises:
        HydrooptError: of that kind; it cannot be read, or is larger.
    """
    where = str(path)
    try:
        # without waiting for anybody to write into a pipe
        with open(os.open(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0)), "rb") as file:
            state = os.fstat(file.fileno())
            if not stat.S_ISREG(state.st_mode):
                raise kind("this is a directory or device, not a file", where=where, remedy=f"name one {noun}")
            data = file.read(min(most, state.st_size) + 1)  # takes memory for all that is asked for
            if len(data) > state.st_size:  # it grows, or states no size
                data += file.read(most + 1 - len(data))
    except FileNotFoundError:
        raise kind("there is no such file", where=where, remedy="check the path") from None
    except IsADirectoryError:
        raise kind("this is a directory or device, not a file", where=where, remedy=f"name one {noun}") from None
    except OSError as error:
        raise kind(f"the {noun} cannot be read ({error.strerror})", where=where,
                   remedy="check the path and its permissions") from None
    except ValueError:  # a NUL in the path
        raise kind("there is no such file", where=where, remedy="check the path") from None
    if len(data) > most:
        raise kind(f"the {noun} has more than {most / 1e6:.0f} MB", where=where, remedy="give a smaller one")
    return data


def read_text(path: str | Path, kind: type[HydrooptError], *, noun: str, most: int = TEXT_LIMIT) -> str:
    """The content of a file in UTF-8, with or without a byte order mark.

    Raises:
        HydrooptError: of that `kind`; it cannot be read, is larger than `most` bytes, or is not such text.
    """
    try:
        text = read_bytes(path, kind, most=most, noun=noun).decode("utf-8-sig")
    except UnicodeDecodeError:
        text = "\0"
    if "\0" in text:
        raise kind("the file is not text", where=str(path), remedy=f"give a {noun} in UTF-8")
    return text.replace("\r\n", "\n")


def toml(text: str, kind: type[HydrooptError], *, where: str) -> dict[str, Any]:
    """The tables of a TOML file.

    Raises:
        HydrooptError: of that `kind`; it is not TOML, or states numbers or tables beyond sense.
    """
    if _DEEP_KEY.search(text):
        raise kind(f"a key has {LEVELS} or more parts", where=where, remedy="correct it")
    try:
        data = deepcopy(_parsed(text))
    except RecursionError:
        raise kind(f"tables lie more than {LEVELS} deep in each other", where=where, remedy="correct them") from None
    except ValueError as error:  # bad TOML, or an integer of thousands of digits
        raise kind(f"is not valid TOML ({error})", where=where, remedy="correct that line") from None
    refuse_absurd(data, kind, where)
    return data


@lru_cache(maxsize=8)
def _parsed(text: str) -> dict[str, Any]:
    """The tables of a text, kept since a machine file is read again and again."""
    return tomllib.loads(text)


def read_json(path: str | Path, kind: type[HydrooptError]) -> dict[str, Any]:
    """The object of a JSON file; infinite numbers are refused.

    Raises:
        HydrooptError: of that `kind`; the file cannot be read, is not a JSON object, or states numbers beyond sense.
    """
    data = read_bytes(path, kind, most=JSON_LIMIT)
    try:
        content = json.loads(data)
        if b"\\u" in data:  # may escape half of a character, which no text can hold
            json.dumps(content, ensure_ascii=False).encode()
    except (ValueError, RecursionError):
        content = None
    if not isinstance(content, dict):
        raise kind("this file cannot be read as JSON", where=str(path), remedy="have it written again")
    refuse_absurd(content, kind, str(path), finite=True)
    return content


def similar(name: str, known: Iterable[str], most: int = 3) -> list[str]:
    """Known names that resemble one, or the first ones; at most so many.

    >>> similar("bom", ["swing", "boom", "stick"], 1)
    ['boom']
    """
    names = [each for each in known if len(each) <= 80][:1000]  # comparing is quadratic in the length
    return get_close_matches(name[:80], names, most) or names[:most]


def refuse_absurd(tree: Any, kind: type[HydrooptError], where: str, *, finite: bool = False) -> None:
    """Refuse integers beyond 64 bits, which no float may hold, and tables that lie deep in each other; if `finite` also
    numbers with an infinite square, in which Python's powers end in an error."""
    level = [tree]
    for _ in range(LEVELS):
        if any(isinstance(node, int) and not -_LARGEST_INTEGER <= node < _LARGEST_INTEGER for node in level):
            raise kind("an integer has more than 64 bits", where=where, remedy="correct it")
        if finite and not all(math.isfinite(node * node) for node in level if isinstance(node, float)):
            raise kind("a number is infinite, or its square is", where=where, remedy="have it written again")
        level = [child for node in level if isinstance(node, dict | list)
                 for child in (node.values() if isinstance(node, dict) else node)]
    if level:
        raise kind(f"tables lie more than {LEVELS} deep in each other", where=where, remedy="correct them")
