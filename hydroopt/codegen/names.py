"""Names in C: how a machine's names become identifiers and files, and which cannot."""

from __future__ import annotations

import re

from hydroopt.errors import MachineError

LONGEST = 63
"""Characters of an identifier that C99 compilers tell apart within a file, and the linkers of today between files."""
_C = ("auto break case char const continue default do double else enum extern float for goto if inline int long "
      "register restrict return short signed sizeof static struct switch typedef union unsigned void volatile while")
_OTHERS = ("alignas alignof asm bool catch class constexpr decltype delete explicit export false friend main mutable "
           "namespace new noexcept nullptr operator private protected public template this throw true try typename "
           "using virtual aux con nul prn assert complex ctype errno fenv float iso646 limits locale math setjmp "
           "signal features stdarg stddef stdint stdio stdlib string tgmath time wchar wctype inttypes "
           "all clean help install test")
KEYWORDS = frozenset(f"{_C} {_OTHERS}".split())
"""What no prefix may be: keywords of C and C++, and what file systems, C's headers and CMake keep."""


def prefix(text: str, *, where: str) -> str:
    """A prefix of all identifiers and files: a lower-case letter, then lower-case letters, digits and underscores.

    Raises:
        MachineError: the text is no such prefix.
    """
    if not re.fullmatch(r"[a-z][a-z0-9_]{0,30}", text) or text in KEYWORDS or "__" in text or text.endswith("_"):
        raise MachineError(
            f"{shown(text)} cannot begin the names of C functions and files", where=where,
            remedy="give --prefix up to 31 lower-case letters, digits and single underscores, beginning with a letter, "
                   "that are no word of C")
    return text


class Names:
    """Enumerators of one machine, each given once."""

    def __init__(self, start: str) -> None:
        self.start = start
        self._taken: dict[str, str] = {}

    def count(self, kind: str) -> str:
        """The enumerator that counts the things of a kind."""
        made = f"{self.start}_{kind}_count".upper()
        self._taken[made] = f"{kind} the count of them"
        return made

    def enumerator(self, kind: str, name: str) -> str:
        """``boom_cylinder.rod.m`` of a kind ``psi`` becomes ``CAT215B_PSI_BOOM_CYLINDER_ROD_M``.

        Raises:
            MachineError: the name holds what an identifier must not, is too long, or is another's in capitals.
        """
        if not re.fullmatch(r"[A-Za-z][A-Za-z0-9_]*(\.[A-Za-z0-9_]+)*", name):
            raise MachineError(f"{shown(name)} cannot be part of a name in C", where=self.start,
                               remedy="use letters, digits and underscores, beginning with a letter")
        made = "_".join((self.start, *filter(None, (kind,)), name)).replace(".", "_").upper()
        if len(made) > LONGEST:
            raise MachineError(
                f"{shown(name)} would be called {made[:20]}... with {len(made)} characters, of which C tells {LONGEST} "
                "apart", where=self.start, remedy="shorten the name or give a shorter --prefix")
        if self._taken.setdefault(made, f"{kind} {name}") != f"{kind} {name}":
            raise MachineError(f"{shown(name)} and '{self._taken[made].partition(' ')[2]}' would both be called {made}",
                               where=self.start, remedy="rename one of them")
        return made


def shown(text: str) -> str:
    """A name as it can stand in a sentence: short, and without what a terminal would act on."""
    plain = ascii(text)[1:-1]
    return f"'{plain if len(plain) <= 40 else plain[:37] + '...'}'"
