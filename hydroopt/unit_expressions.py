"""Expressions of units such as ``kN*m/rad``: what they are in units that `units.txt` defines by nothing else.

The syntax and the definitions are pint's: names, symbols, prefixes, plurals, ``*``, ``·``, a point or a space,
``/`` or ``per``, ``^``, ``**`` or raised digits. Tests compare them with pint, which takes long to load.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import NamedTuple

_TOKEN = re.compile(r"(\d+\.?\d*(?:e[+-]?\d+)?|\.\d+|[^\W\d]\w*|[%‰]|\*\*|[*/^()+-])\s*", re.IGNORECASE)
_POINT = re.compile(r"·|(?<=[^\W\d])\.(?=[^\W\d])")
_RAISED = re.compile("[⁰¹²³⁴⁵⁶⁷⁸⁹⁻]+")
_DIGITS = str.maketrans("⁰¹²³⁴⁵⁶⁷⁸⁹⁻", "0123456789-")
_SIGNS = {"%": "percent", "‰": "permille"}


class Expression(NamedTuple):
    """A number times powers of units."""

    number: float
    powers: dict[str, float]

    def times(self, other: Expression, power: float = 1) -> Expression:
        """The product with a power of another one."""
        powers = Counter(self.powers)
        for name, exponent in other.powers.items():
            powers[name] += exponent * power  # type: ignore[assignment]
        return Expression(self.number * other.number**power, {name: value for name, value in powers.items() if value})


class _Definitions(NamedTuple):
    """What `units.txt` states: the expression of each unit, the size of each prefix, what each spelling of them
    stands for, and the symbols of units."""

    units: dict[str, str]
    prefixes: dict[str, float]
    spellings: dict[str, str]
    prefix_spellings: dict[str, str]
    symbols: dict[str, str]


@cache
def definitions() -> _Definitions:
    """The content of `units.txt`."""
    made = _Definitions({}, {}, {}, {}, {})
    text = re.sub(r"^@.*?^@end", "", Path(__file__).with_name("units.txt").read_text("utf-8"), flags=re.M | re.S)
    for line in text.splitlines():
        name, *stated = (part.strip() for part in line.split("="))
        if not stated or name.startswith("#"):
            continue
        spellings = [name, *(each for each in stated[1:] if each != "_")]
        if name.endswith("-"):
            made.prefixes[name[:-1]] = float(stated[0])
            made.prefix_spellings.update((each[:-1], name[:-1]) for each in spellings)
        else:
            made.units[name] = stated[0]
            made.spellings.update((each, name) for each in spellings)
            made.symbols[name] = name if "_" in stated[1:2] or len(stated) == 1 else stated[1]
    return made


@cache
def parsed(text: str) -> Expression:
    """The powers of units that an expression states, each unit by its prefix and its own name.

    Raises:
        ValueError, ArithmeticError: it is no expression, or a unit is unknown.

    >>> parsed("kN m / rad")
    Expression(number=1.0, powers={'kilonewton': 1, 'meter': 1, 'radian': -1})
    """
    plain = _RAISED.sub(lambda raised: f"^({raised[0].translate(_DIGITS)})", text.strip().replace("°", "degree"))
    plain = _POINT.sub("*", plain.replace(" per ", "/"))
    tokens = _TOKEN.findall(plain)
    if "".join(tokens) != "".join(plain.split()):
        raise ValueError(text)
    rest = iter([*tokens, ""])
    found, end = _product(next(rest), rest) if tokens else (Expression(1.0, {}), "")
    if end:
        raise ValueError(text)
    return found


def _product(token: str, rest: Iterator[str]) -> tuple[Expression, str]:
    """A product or quotient that begins with a token, and the token after it."""
    made, token = _power(token, rest)
    while token not in ("", ")"):
        sign = -1 if token == "/" else 1
        other, token = _power(next(rest) if token in ("*", "/") else token, rest)
        made = made.times(other, sign)
    return made, token


def _power(token: str, rest: Iterator[str]) -> tuple[Expression, str]:
    base, token = _atom(token, rest)
    if token not in ("^", "**"):
        return base, token
    token, sign = next(rest), 1
    if token in ("+", "-"):
        token, sign = next(rest), -1 if token == "-" else 1
    exponent, token = _power(token, rest)
    if exponent.powers:
        raise ValueError("an exponent has a unit")
    return Expression(1.0, {}).times(base, sign * exponent.number), token


def _atom(token: str, rest: Iterator[str]) -> tuple[Expression, str]:
    if token == "(":
        inner = next(rest)
        sign = -1.0 if inner == "-" else 1.0
        made, token = _product(next(rest) if inner == "-" else inner, rest)
        if token != ")":
            raise ValueError("a bracket stays open")
        made = made._replace(number=sign * made.number)
    elif token[:1].isdigit() or token[:1] == ".":
        made = Expression(float(token), {})
    else:
        made = Expression(1.0, {_named(_SIGNS.get(token, token)): 1})
    return made, next(rest)


def _named(text: str) -> str:
    """Prefix and name of the unit that a word stands for, in singular or plural.

    Raises:
        ValueError: there is none.
    """
    known = definitions()
    for word in (text, text[:-1] if text.endswith("s") else ""):
        if word in known.spellings and (word == text or len(word) > 1):
            return known.spellings[word]
        for spelled, prefix in known.prefix_spellings.items():
            rest = word.removeprefix(spelled)
            if rest != word and rest in known.spellings and (word == text or len(rest) > 1):
                return prefix + known.spellings[rest]
    raise ValueError(text)


@cache
def _defined(name: str) -> Expression | None:
    """What a unit with its prefix is by definition; None if by nothing else, as temperatures above a zero of their own.
    """
    known = definitions()
    if name in known.units:
        stated = known.units[name]
        return None if stated.startswith("[") or ";" in stated else parsed(stated)
    prefix = next(each for each in known.prefixes if name.startswith(each) and name.removeprefix(each) in known.units)
    return Expression(known.prefixes[prefix], {name.removeprefix(prefix): 1})


def root(given: Expression) -> Expression:
    """An expression in units that are defined by nothing else.

    >>> root(parsed("kN m / rad"))
    Expression(number=1000000.0, powers={'gram': 1.0, 'meter': 2.0, 'second': -2.0, 'radian': -1.0})
    """
    powers: dict[str, float] = {}
    above: dict[float, float] = {}
    below: dict[float, float] = {}

    def follow(some: Expression, power: float) -> None:
        for name, exponent in some.powers.items():
            inner, own = _defined(name), power * exponent
            if inner is None:
                powers[name] = powers.get(name, 0.0) + own
            else:
                side = above if own > 0 else below
                side[inner.number] = side.get(inner.number, 0.0) + own
                follow(inner, own)

    follow(given, 1)
    number = given.number
    for side, sign in ((above, 1), (below, -1)):  # cancelled and in this order pint's factors, to the last digit
        for size in side:
            power = above.get(size, 0.0) + below.get(size, 0.0)
            number *= size**power if sign * power > 0 else 1.0
    return Expression(number, {name: power for name, power in powers.items() if power})


def base(text: str) -> Expression:
    """An expression in base units of the SI and radians, the kilogram instead of the gram."""
    given = parsed(text)
    powers = {"kilogram" if name == "gram" else name: power for name, power in root(given).powers.items()}
    return Expression(root(given.times(Expression(1.0, powers), -1)).number, powers)
