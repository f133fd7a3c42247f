"""Names in C: identifiers and file names from the names of a machine, and which are refused."""

from __future__ import annotations

import re

from hydroopt.errors import MachineError

LONGEST = 63
"""Significant characters of an identifier in C99, within a file; current linkers accept as many between files."""
_C = ("auto break case char const continue default do double else enum extern float for goto if inline int long "
      "register restrict return short signed sizeof static struct switch typedef union unsigned void volatile while")
_OTHERS = ("alignas alignof asm bool catch class constexpr decltype delete explicit export false friend main mutable "
           "namespace new noexcept nullptr operator private protected public template this throw true try typename "
           "using virtual aux con nul prn assert complex ctype errno fenv float iso646 limits locale math setjmp "
           "signal features stdarg stddef stdint stdio stdlib string tgmath time wchar wctype inttypes "
           "all clean help install test std")
KEYWORDS = frozenset(f"{_C} {_OTHERS}".split())
"""Reserved prefixes: keywords of C and C++, and names of file systems, C headers and CMake."""


def prefix(text: str, *, where: str) -> str:
    """A prefix of all identifiers and files: a lower-case letter, then lower-case letters, digits and underscores.

    Raises:
        MachineError: the text is not a valid prefix.
    """
    if not re.fullmatch(r"[a-z][a-z0-9_]{0,30}", text) or text in KEYWORDS or "__" in text or text.endswith("_"):
        raise MachineError(
            f"{quoted(text)} cannot begin the names of C functions and files", where=where,
            remedy="give --prefix up to 31 lower-case letters, digits and single underscores, beginning with a letter, "
                   "that are no keyword of C")
    return text


class Names:
    """Enumerators of one machine, each unique."""

    def __init__(self, start: str) -> None:
        self.start = start
        self._owners: dict[str, str] = {}

    def count(self, kind: str) -> str:
        """The enumerator with the number of items of a kind."""
        enumerator = f"{self.start}_{kind}_count".upper()
        self._owners[enumerator] = f"{kind} their number"
        return enumerator

    def enumerator(self, kind: str, name: str) -> str:
        """``boom_cylinder.rod.m`` of a kind ``psi`` becomes ``CAT215B_PSI_BOOM_CYLINDER_ROD_M``.

        Raises:
            MachineError: the name has characters that C identifiers cannot have, is too long, or equals another one in
                capitals.
        """
        if not re.fullmatch(r"[A-Za-z][A-Za-z0-9_]*(\.[A-Za-z0-9_]+)*", name):
            raise MachineError(f"{quoted(name)} cannot be part of a name in C", where=self.start,
                               remedy="use letters, digits and underscores, beginning with a letter")
        enumerator = "_".join((self.start, *filter(None, (kind,)), name)).replace(".", "_").upper()
        if len(enumerator) > LONGEST:
            raise MachineError(
                f"{quoted(name)} would be called {enumerator[:20]}... with {len(enumerator)} characters, more than "
                f"the {LONGEST} that are significant in C", where=self.start,
                remedy="shorten the name or give a shorter --prefix")
        if self._owners.setdefault(enumerator, f"{kind} {name}") != f"{kind} {name}":
            other = self._owners[enumerator].partition(" ")[2]
            raise MachineError(f"{quoted(name)} and '{other}' would both be called {enumerator}", where=self.start,
                               remedy="rename one of them")
        return enumerator


def quoted(text: str) -> str:
    """A name in quotes for a message: short, in printable ASCII."""
    plain = ascii(text)[1:-1]
    return f"'{plain if len(plain) <= 40 else plain[:37] + '...'}'"
