"""Units as loggers write them: words of several languages, in any case, in brackets or behind a name."""

from __future__ import annotations

import re
import tomllib
import unicodedata
from collections.abc import Collection, Iterable
from functools import cache
from itertools import product
from pathlib import Path
from typing import Any, NamedTuple

from hydroopt.units import same_kind

GERMAN = re.compile("winkel|neigung|stellung|drehung|schwenk|lage")
"""Behind these, "grad" stands for degrees."""
TIMES = ("ms", "us", "ns")
"""Units that name a column of the time by themselves, beside words for the second of three letters and more."""
_PLAIN = str.maketrans({"²": "2", "³": "3", "μ": "u", "µ": "u", "·": "*", "\u202f": " ", "\xa0": " "})
_BRACKETS = re.compile(r"(.*?\S)\s*[\[({]([^\[\](){}]*)[\])}]")
_GAUGE = re.compile(r"\b(bar|psi)\s*\([ga]\)", re.IGNORECASE)
_OPERATOR = re.compile(r"\s*(/|\*|\bper\b|\bpro\b)\s*", re.IGNORECASE)
_POWER = re.compile(r"(.+?)\^?([23])")
_ENDS = tuple((re.compile(pattern), unit) for pattern, unit in (
    (r"(.*?\S)[\s,;:]+(\S+\s+(?:per|pro|/)\s+\S+)", r"\2"), (r"(.*\S)[\s,;:]+(\S+)", r"\2"),
    (r"(?i)(.*[^\W_])_+(?!per_)([^\W_]+)_(?:per_)?(s|s2|sec)", r"\2/\3"),
    (r"(.*[^\W_])_+([^\W_][^_]*|[°º˚%])", r"\2"), (r"([^/]*?\S)\s*/\s*(\S.*)", r"\2"),
    (r"(.*[^\W_])(°|º|˚|°/s|%)", r"\2"), (r"(.*[a-z\d])([A-Z]{1,2}[a-z]+)", r"\2"),
    (r"(.*[a-z\d])([A-Z]{1,2}[a-z]+)S", r"\2/s")))
"""How a header may end in a unit without brackets, the longest unit first."""


@cache
def spellings() -> dict[str, Any]:
    """The tables of `spellings.toml`."""
    return tomllib.loads(Path(__file__).with_name("spellings.toml").read_text("utf-8"))


class Header(NamedTuple):
    """A header in its parts: the name, the text of its unit, and what that may stand for; both empty of none."""

    name: str
    text: str
    units: tuple[str, ...]


def header_of(header: str, names: Collection[str] = ()) -> Header:
    """The parts of a header whose unit stands in brackets, behind "/" or "in", or is its last word.

    In brackets any unit counts, else those of `spellings.toml`. A last word that is among `names`, the words of a
    machine's parts, stays one. A word for a unit of time alone, such as ``ms``, is name and unit.

    >>> header_of("Druck Boom bar"), header_of("Winkel (Grad)").units, header_of("boom angle [grad]").units
    (Header(name='Druck Boom', text='bar', units=('bar',)), ('deg',), ('deg', 'gon'))
    >>> header_of("boom_max"), header_of("tow_bar", names={"tow", "bar"}).units
    (Header(name='boom_max', text='', units=()), ())
    """
    header = _GAUGE.sub(r"\1", header.strip())
    if found := _BRACKETS.fullmatch(header):
        if units := units_of(found[2], found[1]):
            return Header(_bare(found[1]), found[2].strip(), units)
        return Header(header, "", ())
    for name, text in ((found[1], found.expand(unit)) for end, unit in _ENDS if (found := end.fullmatch(header))):
        units = units_of(text, name, listed=True)
        if units and _folded(text) not in names and any(each.isalnum() for each in name):
            return Header(_bare(name), text, units)
    if (units := units_of(header, listed=True)) and (units[0] in TIMES or (units == ("s",) and len(header) > 2)):
        return Header(header, header, units)
    return Header(header, "", ())


@cache
def units_of(text: str, name: str = "", *, listed: bool = False) -> tuple[str, ...]:
    """What the text of a unit may stand for, in a header of this name: nothing if it is none.

    >>> units_of("Grad/s"), units_of("grad"), units_of("grad", "Neigung"), units_of("kWh"), units_of("rad or m")
    (('deg/s',), ('deg', 'gon'), ('deg',), ('kWh',), ('rad', 'm'))

    Args:
        listed: whether only units of `spellings.toml` and powers, products and quotients of them count.
    """
    if " or " in text:
        return tuple(unit for each in text.split(" or ") for unit in units_of(each, name, listed=listed))
    plain = text.strip().rstrip(".").translate(_PLAIN).replace("**", "^")
    whole = [part for part in _OPERATOR.split(plain) if part] if _folded(plain) not in _words() else [plain]
    meant = [("/" if part.lower() in ("per", "pro", "/") else "*",) if k % 2 else _atom(part, name, listed)
             for k, part in enumerate(whole)]
    found = ("".join(each) for each in product(*meant))
    return tuple(unit for unit in found if unit and same_kind(unit, unit))


def is_unit(word: str) -> bool:
    """Whether a word of three letters and more is a unit of `spellings.toml`, wherever in a name it stands.

    >>> is_unit("deg"), is_unit("m"), is_unit("max")
    (True, False, False)
    """
    return len(word) > 2 and word in _words()


def of_kind(units: Iterable[str], *kinds: str) -> tuple[str, ...]:
    """Those of the units that measure one of the kinds.

    >>> of_kind(units_of("nm"), "m"), of_kind(units_of("nm"), "N*m", "N")
    (('nm',), ('N*m',))
    """
    return tuple(each for each in units if any(same_kind(each, kind) for kind in kinds))


@cache
def _words() -> dict[str, tuple[str, ...]]:
    """The units of each word; several where it stands for several."""
    found: dict[str, tuple[str, ...]] = {}
    for unit, words in spellings()["units"].items():
        for word in words.split():
            found[word] = (*found.get(word, ()), unit)
    return found


def _atom(text: str, name: str, listed: bool) -> tuple[str, ...]:
    """What one word means, or a power of it; in degrees per second the words are two."""
    if written := spellings()["units_as_written"].get(text):
        return (written,)
    folded = _folded(text)
    if folded == "grad" and GERMAN.search(_folded(name)):
        return ("deg",)
    if folded in _words():
        return _words()[folded]
    if (power := _POWER.fullmatch(text)) and (base := _atom(power[1], name, listed)):
        return tuple(f"{each}^{power[2]}" for each in base)
    return () if listed or not same_kind(text, text) else (text,)


def _bare(name: str) -> str:
    """A name without what joins it to its unit."""
    return re.sub(r"(?:\s+in|\s*[/,;:_-])\s*$", "", name).strip() or name.strip()


def _folded(text: str) -> str:
    """Without accents and in lower case."""
    parts = unicodedata.normalize("NFD", text.strip().rstrip(".")) if not text.isascii() else text.strip().rstrip(".")
    return "".join(each for each in parts if not unicodedata.combining(each)).lower()
