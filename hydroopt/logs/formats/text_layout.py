"""The layout of a table of text: decided once from its lines, as far as a map does not state it."""

from __future__ import annotations

import codecs
import csv
import json
import re
from collections.abc import Sequence
from functools import cached_property
from itertools import chain, pairwise
from typing import NamedTuple

from hydroopt.errors import LogError
from hydroopt.logs.column_headers import parts_of
from hydroopt.logs.column_map import Layout
from hydroopt.logs.stamps import looks_dated
from hydroopt.logs.unit_words import header_of, units_of

DELIMITERS = (";", "\t", "|", ",", "whitespace")
"""Between columns; of those that fit equally well the first: those that no number contains come first."""
COMMENTS = ("#", "%", "//", ";", "!")
"""What comments begin with."""
SAMPLE = 400
"""Lines at the beginning, and as many at the end, by which a table is judged."""
NO_NUMBER = ("", "nan", "NaN", "NAN", "+nan", "-nan", "-nan(ind)", "NA", "N/A", "#N/A", "null", "NULL")
"""Cells in which no number was written."""
USUAL = {"header": (True,), "skip": (0,), "units_row": (False,), "footer": (0,), "comment": ("",), "delimiter": (",",),
         "quote": ('"', ""), "decimal": (".",), "thousands": ("",), "encoding": ("utf-8", "utf-8-sig"), "dates": ()}
"""What need not be said of the layout of a table."""
_INFINITE = ("inf", "+inf", "-inf", "infinity", "-infinity")
_ENCODINGS = {codecs.BOM_UTF8: "utf-8-sig", codecs.BOM_UTF32_LE: "utf-32", codecs.BOM_UTF32_BE: "utf-32",
              codecs.BOM_UTF16_LE: "utf-16", codecs.BOM_UTF16_BE: "utf-16", b"": "utf-8"}
_NUMBER = re.compile(r"[+-]?(\d+([.,]\d*)?|[.,]\d+|\d{1,3}((,\d{3})+(\.\d*)?|(\.\d{3})+(,\d*)?))([eE][+-]?\d+)?")
"""No digit can be read in two ways: time grows with the length of a cell, not with its square."""
_THOUSANDS = re.compile(r"[+-]?[1-9]\d{0,2}([.,]\d{3})+")
_CLOCK = re.compile(r"[ymdhsfz]{2,}([\W_t]+[ymdhsfz]{2,})+", re.IGNORECASE)
"""A form of dates or times, such as ``hh:mm:ss``, where a unit may stand."""
_BINARY = re.compile(r"[\x00-\x08\x0e-\x1f]")


def decoded(data: bytes, stated: str | None, where: str) -> tuple[str, str]:
    """The text of a file, and its encoding: the one that is `stated`, or by its first bytes, UTF-8 or Latin-1.

    Raises:
        LogError: it is not text.
    """
    encoding = stated or next(name for mark, name in _ENCODINGS.items() if data.startswith(mark))
    try:
        text = data.decode(encoding).removeprefix("\ufeff")
    except (UnicodeDecodeError, LookupError):
        if stated is not None:
            raise LogError(f"this is not text in {stated}", where=where,
                           remedy="correct 'encoding' in the map") from None
        text, encoding = data.decode("latin-1"), "latin-1"
        if data.startswith(tuple(filter(None, _ENCODINGS))) or re.search(r"[\x00-\x08\x0e-\x1f\x7f-\x9f]", text):
            text = "\0"
    if "\0" in text or _BINARY.search(text, 0, 4096):
        raise LogError("this is not a text file (binary data inside)", where=where,
                       remedy="export it as CSV or name the file after its true format")
    return text, encoding


def cells_of(line: str, layout: Layout) -> list[str]:
    """The cells of a line, without quotation marks."""
    blank = layout.delimiter == "whitespace"
    if layout.quote and layout.quote in line:
        try:
            return next(csv.reader([" ".join(line.split()) if blank else line], quotechar=layout.quote,
                                   delimiter=" " if blank else str(layout.delimiter), skipinitialspace=True), [""])
        except csv.Error:
            pass
    return line.split(None if blank else layout.delimiter)


class _Header(NamedTuple):
    """Lines `first` to `last` of a header, `last` < `first` where there is none and rows begin with line `first`."""

    first: int
    last: int
    units: bool = False
    names: list[str] | None = None


class TextTable:
    """The lines of a text with their layout: the one that is stated, and decided where nothing is.

    Attributes:
        layout: in which nothing is left open.
        names: (n,) of the columns with their units, `name [unit]`; empty of a table without header.
        rows: (N,) 0-based lines of the data rows, which are all behind the header but comments, empty ones and footer.
        shown: what was decided beyond what is stated, and is not the usual table, as keys of a map; empty of none.

    Raises:
        LogError: what is stated is not there, or whether a mark stands for decimals or thousands is open.
    """

    def __init__(self, lines: Sequence[str], stated: Layout, encoding: str, where: str) -> None:
        self.lines, self.where = lines, where
        self.full = [k for k, line in enumerate(lines) if line.strip()]
        sample = [lines[k] for k in self.full[:SAMPLE]]
        layout = stated.model_copy(update={
            "encoding": encoding, "quote": _quote(sample) if stated.quote is None else stated.quote})
        if stated.delimiter is None:
            fits = {mark: fit for mark in DELIMITERS for width, _, fit in [
                _usual(sample, layout.model_copy(update={"delimiter": mark}))] if width > 1 and fit}
            layout = layout.model_copy(update={"delimiter": max(fits, key=lambda mark: fits[mark], default=",")})
        self.layout = layout
        self.width, self.columns, _ = _usual(sample, layout)
        header = self._header()
        comment = self._comment(header)
        rows = [k for k in self.full if k > header.last and not (comment and lines[k].lstrip().startswith(comment))]
        footer = self._footer(rows)
        self.rows = rows = rows[: len(rows) - footer]
        decimal, thousands = self._marks([*rows[:SAMPLE], *rows[SAMPLE:][-SAMPLE:]])
        self.names = header.names or []
        if rows and self.names:
            dated = [looks_dated(cell) for cell in self.cells(rows[0])]
            self.names = [
                "t [s]" if is_dated and parts_of(name)[0] == "t" else parts_of(name)[0] if is_dated and header.units
                else name for name, is_dated in zip(self.names, [*dated, *[False] * len(self.names)], strict=False)]
        self.layout = layout.model_copy(update={
            "header": header.names is not None, "skip": header.first, "units_row": header.units, "comment": comment,
            "footer": footer, "decimal": decimal, "thousands": thousands})
        self.shown = ", ".join(f"{key} = {json.dumps(value)}" for key, value in self.layout if value is not None
                               and getattr(stated, key) is None and value not in USUAL[key])

    def cells(self, k: int) -> list[str]:
        """The cells of a line."""
        return cells_of(self.lines[k], self.layout)

    @cached_property
    def spare(self) -> int:
        """How many of the last columns are empty in all rows of the sample."""
        ends = [len(cells) - max((j + 1 for j, cell in enumerate(cells) if cell.strip()), default=0)
                for k in self.full[:SAMPLE] if self.kind(k) == "row" for cells in [self.cells(k)]]
        return min(ends, default=0)

    def kind(self, k: int) -> str:
        """What a line is beside the usual rows: "row", "mixed" (numbers and words where rows have numbers) or ""."""
        cells = self.cells(k)
        if len(cells) != self.width:
            return ""
        numbers, words = (any(is_it(cells[j]) for j in self.columns) for is_it in (_is_number, _is_word))
        return "row" if numbers and not words else "mixed" if numbers else ""

    def words(self, k: int) -> list[str]:
        """The cells of a line, without a mark of comments, if they may be names or units of the usual columns."""
        line = self.lines[k].strip()
        line = line.removeprefix(self.mark(k)).strip(" ") if self.mark(k) else line
        blank = self.layout.delimiter == "whitespace"
        ways = [re.split(r"\s+(?![\[(])", line), re.split(r"\s{2,}|\t", line)] if blank else []
        for found in [cells_of(line, self.layout), *ways]:
            cells = [cell.strip() for cell in found]
            while cells and not cells[-1]:
                cells.pop()
            named = cells and 0 <= self.width - len(cells) <= self.spare
            if named and not any(_is_number(cells[j]) for j in self.columns if j < len(cells)):
                return cells
        return []

    def mark(self, k: int) -> str:
        """What a line begins with that may be a comment, or nothing."""
        marks = COMMENTS if self.layout.comment is None else (self.layout.comment,)
        line = self.lines[k].lstrip()
        found = next((mark for mark in marks if mark and mark != self.layout.delimiter and line.startswith(mark)), "")
        return found if found and self.kind(k) != "row" else ""

    @cached_property
    def begin(self) -> int | None:
        """The first line of the first rows that follow each other; None where there are none."""
        plain = [k for k in self.full[:SAMPLE] if not self.mark(k)]
        kinds = {k: self.kind(k) for k in plain}
        pairs = (a for a, b in pairwise(plain) if kinds[a] == "row" and kinds[b])
        first = next(pairs, next((k for k in plain if kinds[k] == "row"), None))
        if first is None:
            return None
        above = plain[: plain.index(first)]
        while above and kinds[above[-1]]:
            first = above.pop()
        return first

    def _header(self) -> _Header:
        """Where the header stands, as far as that is not stated; columns that are units of a row state them."""
        stated = self.layout
        begin = self.begin
        if stated.skip is not None or begin is None or stated.header is False:
            return self._header_at(stated.skip or 0)
        above = [k for k in reversed(self.full[:SAMPLE]) if k < begin]
        for commented in (False, True):
            found = [k for k in above if bool(self.mark(k)) == commented and self.words(k)]
            if found and (stated.units_row or (stated.units_row is None and len(found) > 1
                                               and self._are_units(found[0], found[1]))):
                if len(found) == 1:
                    raise self._no_units(begin)
                return self._named(found[1], found[0])
            if found:
                return self._named(found[0])
        if stated.units_row:
            raise self._no_units(begin)
        first = self.cells(begin)[self.columns[0]]
        if above and stated.delimiter != "whitespace" and len(cells := self.cells(above[0])) > self.width and all(
                map(_is_word, cells)):
            return self._named(above[0])  # of rows that are all too short
        if stated.header or (self.kind(begin) == "mixed" and _is_word(first)):  # names that are numbers
            return self._named(begin if self.kind(begin) == "mixed" or not above else above[0])
        return _Header(begin, begin - 1)

    def _header_at(self, skip: int) -> _Header:
        """The header behind so many lines."""
        stated = self.layout
        rest = [k for k in self.full if k >= skip and (self.words(k) or not self.mark(k))]
        if not rest:
            raise LogError(f"skip = {skip}, but there are {len(self.lines)} lines", where=self.where,
                           remedy="correct 'skip' in the map, or remove it")
        if stated.header is False or (stated.header is None and self.kind(rest[0]) == "row"):
            return _Header(skip, skip - 1)
        below = next((k for k in rest[1:] if bool(self.mark(k)) <= bool(self.mark(rest[0]))), None)
        if stated.units_row and (below is None or not self.words(below) or self.kind(below) == "row"):
            raise self._no_units(rest[0] + 1 if below is None else below)
        if below is not None and (stated.units_row or (
                stated.units_row is None and self.words(below) and self._are_units(below, rest[0]))):
            return self._named(rest[0], below)
        return self._named(rest[0])

    def _no_units(self, k: int) -> LogError:
        return LogError("units_row = true, but no row of units stands below a header",
                        where=f"{self.where}, line {k + 1}",
                        remedy="remove 'units_row' from the map, or correct 'skip'")

    def _named(self, k: int, units: int | None = None) -> _Header:
        """The header in a line, with the units of another."""
        names = self.words(k) or [cell.strip() for cell in self.cells(k)]
        if units is None:
            return _Header(k, k, names=names)
        below = self.words(units)
        if len(below) > len(names):
            raise LogError(f"there are {len(below)} units for {len(names)} columns",
                           where=f"{self.where}, line {units + 1}",
                           remedy="correct that line, or state units_row = false in a map")
        return _Header(k, units, units=True, names=[
            _with_unit(name, unit) for name, unit in zip(names, [*below, *[""] * len(names)], strict=False)])

    def _are_units(self, k: int, header: int) -> bool:
        """Whether a line has units of the names in another: in brackets, or most of them known."""
        cells = [cell for cell in self.words(k) if cell]
        known = [bool(units_of(_bare(cell)) or _CLOCK.fullmatch(_bare(cell))) for cell in cells]
        said = [bool(header_of(cell).units) for cell in self.words(header) if cell]
        return sum(said) <= sum(known) and (2 * sum(known) > len(cells) or all(cell[0] in "[(" for cell in cells))

    def _comment(self, header: _Header) -> str:
        """What comments behind the header begin with, or nothing."""
        if self.layout.comment is not None:
            return self.layout.comment
        if not {line.lstrip()[:1] for line in self.lines} & {mark[0] for mark in COMMENTS}:
            return ""
        return next((mark for k in self.full if k > header.last and (mark := self.mark(k))), "")

    def _footer(self, rows: Sequence[int]) -> int:
        """How many of the last lines are none of the table: words stand where the first number of a row would."""
        def is_footer(k: int) -> bool:
            cells, columns = self.cells(k), self.columns
            return bool(columns) and len(cells) > columns[0] and cells[columns[0]].strip()[:1].isalpha() and (
                _is_word(cells[columns[0]]))

        stated = self.layout.footer
        if stated is None:
            return next((count for count, k in enumerate(reversed(rows)) if not is_footer(k)), 0)
        wrong = next((k for k in rows[len(rows) - min(stated, len(rows)):] if self.kind(k) == "row"), None)
        if wrong is not None:
            raise LogError(f"footer = {stated}, but this line is a row of the table",
                           where=f"{self.where}, line {wrong + 1}", remedy="correct 'footer' in the map, or remove it")
        return min(stated, len(rows))

    def _marks(self, rows: Sequence[int]) -> tuple[str, str]:
        """Marks of decimals and of thousands, as stated or by the numbers of some rows.

        Raises:
            LogError: both could be.
        """
        stated = self.layout
        thousands = stated.thousands or ""
        if stated.decimal is not None:
            return stated.decimal, thousands
        if thousands:
            return "," if thousands == "." else ".", thousands
        numbers = [cell for k in rows for cell in map(str.strip, self.cells(k))
                   if ("," in cell or "." in cell) and _NUMBER.fullmatch(cell)]
        both = [n for n in numbers if "," in n and "." in n]
        last = {max(",.", key=n.rfind) for n in both}
        if len(last) > 1:
            raise _ambiguous(both[0], self.where)
        if both:
            decimal = last.pop()
            return decimal, "," if decimal == "." else "."
        having = {mark: some for mark in ",." if (some := [n for n in numbers if mark in n])}
        grouped = [mark for mark, some in having.items() if all(map(_THOUSANDS.fullmatch, some))]
        for mark in grouped:
            if any(n.count(mark) > 1 for n in having[mark]) or len(having) > len(grouped):
                return "," if mark == "." else ".", mark
        if len(having) > 1 or (grouped and (grouped == [","] or stated.delimiter == ";")):
            raise _ambiguous(next(iter(having.values()))[0], self.where)
        return next(iter(having), "."), ""


def _bare(unit: str) -> str:
    return unit.strip().strip("[](){}").strip()


def _with_unit(name: str, unit: str) -> str:
    """A name with its unit of the row below, unless it states one itself or that is the form of a date."""
    bare = _bare(unit)
    stated = not bare or _CLOCK.fullmatch(bare) or parts_of(name)[1] or header_of(name).units
    return name if stated else f"{name} [{bare}]"


def _quote(sample: Sequence[str]) -> str:
    """The quotation mark of the lines."""
    single = re.compile(r"(^|[;,|\t ])'[^']*'($|[;,|\t ])")
    return "'" if not any('"' in line for line in sample) and any(map(single.search, sample)) else '"'


def _usual(sample: Sequence[str], layout: Layout) -> tuple[int, tuple[int, ...], float]:
    """Number of columns of the lines with words in the same columns that hold most numbers or dates, as those of a
    table do; which columns these are in; and the sum of their shares in the lines.
    """
    found: dict[tuple[bool, ...], list[list[int]]] = {}
    for line in sample:
        cells = cells_of(line, layout)
        found.setdefault(tuple(map(_is_word, cells)), []).append([j for j, c in enumerate(cells) if _is_number(c)])
    words, numbers = max(found.items(), key=lambda alike: sum(map(len, alike[1])), default=((), []))
    fit = sum(len(some) / max(len(some) + sum(words), 1) for some in numbers)
    return len(words), tuple(sorted({*chain(*numbers)})), fit


def _is_number(cell: str) -> bool:
    """Whether a cell is a number, with any marks, or a date."""
    text = cell.strip()
    if not any(map(str.isdigit, text)):
        return text.lower() in _INFINITE
    return _NUMBER.fullmatch(text) is not None or looks_dated(text)


def _is_word(cell: str) -> bool:
    return cell.strip() not in NO_NUMBER and not _is_number(cell)


def _ambiguous(number: str, where: str) -> LogError:
    mark, other = (",", ".") if "," in number else (".", ",")
    return LogError(f"'{number:.30}' may have decimals or thousands behind its '{mark}'", where=where,
                    remedy=f"state decimal = '{mark}' or decimal = '{other}' with thousands = '{mark}' in a map")
