"""The layout of a table of text: decided once from its lines, as far as a map does not state it."""

from __future__ import annotations

import codecs
import csv
import re
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from itertools import pairwise

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
_INFINITE = ("inf", "+inf", "-inf", "infinity", "-infinity")
_ENCODINGS = {codecs.BOM_UTF8: "utf-8-sig", codecs.BOM_UTF32_LE: "utf-32", codecs.BOM_UTF32_BE: "utf-32",
              codecs.BOM_UTF16_LE: "utf-16", codecs.BOM_UTF16_BE: "utf-16", b"": "utf-8"}
_NUMBER = re.compile(r"[+-]?(\d+([.,]\d*)?|[.,]\d+|\d{1,3}((,\d{3})+(\.\d*)?|(\.\d{3})+(,\d*)?))([eE][+-]?\d+)?")
"""No digit can be read in two ways: time grows with the length of a cell, not with its square."""
_THOUSANDS = re.compile(r"[+-]?[1-9]\d{0,2}([.,]\d{3})+")
_CLOCK = re.compile(r"[ymdhsfz]{2,}([\W_t]+[ymdhsfz]{2,})+", re.IGNORECASE)
"""A form of dates or times, such as ``hh:mm:ss``, where a unit may stand."""
_BINARY = re.compile(r"[\x00-\x08\x0e-\x1f]")


@dataclass(frozen=True)
class TextTable:
    """The lines of a text with their layout, in which nothing is left open.

    Attributes:
        lines: all of the file.
        layout: that was decided.
        names: (n,) of the columns with their units, `name [unit]`; empty of a table without header.
        rows: (N,) 0-based lines of the data rows, which are all behind the header but comments, empty ones and footer.
        comments: lines left out as such behind the header.
    """

    lines: Sequence[str]
    layout: Layout
    names: list[str] = field(default_factory=list)
    rows: Sequence[int] = ()
    comments: int = 0

    def shown(self, stated: Layout) -> str:
        """What was decided beyond what is `stated`, and is not the usual table, in a sentence; empty of none."""
        found = self.layout
        decided = {key: getattr(found, key) if getattr(stated, key) is None else None for key in Layout.model_fields}
        mark = decided["delimiter"]
        said = [
            found.encoding not in ("utf-8", "utf-8-sig") and decided["encoding"] and
            f"encoding {'Latin-1' if found.encoding == 'latin-1' else str(found.encoding).upper()}",
            mark not in (None, ",") and f"{'white space' if mark == 'whitespace' else repr(mark)} between columns",
            decided["skip"] and f"{_lines(decided['skip'])} before the {'header' if found.header else 'first row'}",
            decided["header"] is False and "no header",
            decided["units_row"] and "units in the line below the header",
            decided["decimal"] == "," and "',' for decimals",
            decided["thousands"] and f"'{found.thousands}' between thousands",
            decided["quote"] == "'" and "quotation marks '",
            self.comments and f"{_lines(self.comments, 'comment line')} left out",
            found.footer and f"{_lines(found.footer)} behind the last row left out"]
        return ", ".join(str(part) for part in said if part)


def _lines(count: int, noun: str = "line") -> str:
    return f"{count} {noun}{'s' * (count > 1)}"


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


def table_of(lines: Sequence[str], stated: Layout, where: str) -> TextTable:
    """The table of these lines, in the layout that is stated, and decided where nothing is.

    Raises:
        LogError: what is stated is not there, or whether a mark stands for decimals or thousands is open.
    """
    full = [k for k, line in enumerate(lines) if line.strip()]
    sample = [lines[k] for k in full[:SAMPLE]]
    quote = stated.quote if stated.quote is not None else _quote(sample)
    layout = stated.model_copy(update={"quote": quote})
    if stated.delimiter is None:
        fits = {each: _usual(sample, layout.model_copy(update={"delimiter": each})) for each in DELIMITERS}
        fits = {each: usual for each, usual in fits.items() if len(usual.words) > 1 and usual.fit}
        layout = layout.model_copy(update={"delimiter": max(fits, key=lambda each: fits[each].fit, default=",")})
    judged = _Judged(lines, full, layout, where)
    header = judged.header()
    comment = judged.comment(header)
    rows = [k for k in full if k > header.last and not (comment and lines[k].lstrip().startswith(comment))]
    comments = sum(k > header.last for k in full) - len(rows)
    footer = judged.footer(rows)
    rows = rows[: len(rows) - footer]
    decimal, thousands = _marks(judged, [*rows[:SAMPLE], *rows[SAMPLE:][-SAMPLE:]], where)
    layout = layout.model_copy(update={
        "header": header.named, "skip": header.first, "units_row": header.units, "comment": comment, "footer": footer,
        "decimal": decimal, "thousands": thousands})
    names = header.names
    if rows and names:
        dated = [looks_dated(cell) for cell in judged.cells(rows[0])]
        names = ["t [s]" if is_dated and parts_of(name)[0] == "t" else parts_of(name)[0] if is_dated and header.units
                 else name for name, is_dated in zip(names, [*dated, *[False] * len(names)], strict=False)]
    return TextTable(lines, layout, names, rows, comments)


@dataclass(frozen=True)
class _Header:
    """Lines `first` to `last` of a header, `last` < `first` where there is none and rows begin with line `first`."""

    first: int
    last: int
    named: bool = True
    units: bool = False
    names: list[str] = field(default_factory=list)


@dataclass(frozen=True)
class _Judged:
    """Lines of a text in a layout whose delimiter and quotation mark are decided; `full` are those not empty."""

    lines: Sequence[str]
    full: Sequence[int]
    layout: Layout
    where: str

    def cells(self, k: int) -> list[str]:
        """The cells of a line."""
        return cells_of(self.lines[k], self.layout)

    @cached_property
    def usual(self) -> tuple[int, tuple[int, ...]]:
        """Number of columns of usual rows, and those of them that hold numbers or dates."""
        found = _usual([self.lines[k] for k in self.full[:SAMPLE]], self.layout)
        return len(found.words), tuple(sorted(found.numbers))

    @cached_property
    def spare(self) -> int:
        """How many of the last columns are empty in all rows of the sample."""
        ends = [len(cells) - max((j + 1 for j, cell in enumerate(cells) if cell.strip()), default=0)
                for k in self.full[:SAMPLE] if self.kind(k) == "row" for cells in [self.cells(k)]]
        return min(ends, default=0)

    def kind(self, k: int) -> str:
        """What a line is beside the usual rows: "row", "mixed" (numbers and words where rows have numbers) or ""."""
        width, columns = self.usual
        cells = self.cells(k)
        if len(cells) != width:
            return ""
        numbers, words = (any(is_it(cells[j]) for j in columns) for is_it in (_is_number, _is_word))
        return "row" if numbers and not words else "mixed" if numbers else ""

    def words(self, k: int) -> list[str]:
        """The cells of a line, without a mark of comments, if they may be names or units of the usual columns."""
        width, columns = self.usual
        line = self.lines[k].strip()
        line = line.removeprefix(self.mark(k)).strip(" ") if self.mark(k) else line
        blank = self.layout.delimiter == "whitespace"
        ways = [re.split(r"\s+(?![\[(])", line), re.split(r"\s{2,}|\t", line)] if blank else []
        for found in [cells_of(line, self.layout), *ways]:
            cells = [cell.strip() for cell in found]
            while cells and not cells[-1]:
                cells.pop()
            named = cells and 0 <= width - len(cells) <= self.spare
            if named and not any(_is_number(cells[j]) for j in columns if j < len(cells)):
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

    def header(self) -> _Header:
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
        first = self.cells(begin)[self.usual[1][0]]
        if above and stated.delimiter != "whitespace" and len(cells := self.cells(above[0])) > self.usual[0] and all(
                map(_is_word, cells)):
            return self._named(above[0])  # of rows that are all too short
        if stated.header or (self.kind(begin) == "mixed" and _is_word(first)):  # names that are numbers
            return self._named(begin if self.kind(begin) == "mixed" or not above else above[0])
        return _Header(begin, begin - 1, named=False)

    def _header_at(self, skip: int) -> _Header:
        """The header behind so many lines."""
        stated = self.layout
        rest = [k for k in self.full if k >= skip and (self.words(k) or not self.mark(k))]
        if not rest:
            raise LogError(f"skip = {skip}, but there are {len(self.lines)} lines", where=self.where,
                           remedy="correct 'skip' in the map, or remove it")
        if stated.header is False or (stated.header is None and self.kind(rest[0]) == "row"):
            return _Header(skip, skip - 1, named=False)
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

    def comment(self, header: _Header) -> str:
        """What comments behind the header begin with, or nothing."""
        if self.layout.comment is not None:
            return self.layout.comment
        if not {line.lstrip()[:1] for line in self.lines} & {mark[0] for mark in COMMENTS}:
            return ""
        return next((mark for k in self.full if k > header.last and (mark := self.mark(k))), "")

    def footer(self, rows: Sequence[int]) -> int:
        """How many of the last lines are none of the table: words stand where the first number of a row would."""
        def is_footer(k: int) -> bool:
            cells, columns = self.cells(k), self.usual[1]
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


@dataclass
class _Usual:
    """Lines with words in the same columns; how many numbers others hold, and the sum of the shares of these."""

    words: tuple[bool, ...]
    numbers: Counter[int] = field(default_factory=Counter)
    fit: float = 0.0


def _usual(sample: Sequence[str], layout: Layout) -> _Usual:
    """The lines of a sample that hold most numbers or dates, as those of a table do."""
    found: dict[tuple[bool, ...], _Usual] = {}
    for line in sample:
        cells = cells_of(line, layout)
        words, numbers = tuple(map(_is_word, cells)), [j for j, cell in enumerate(cells) if _is_number(cell)]
        alike = found.setdefault(words, _Usual(words))
        alike.numbers.update(numbers)
        alike.fit += len(numbers) / max(len(numbers) + sum(words), 1)
    return max(found.values(), key=lambda each: each.numbers.total(), default=_Usual(()))


def _is_number(cell: str) -> bool:
    """Whether a cell is a number, with any marks, or a date."""
    text = cell.strip()
    if not any(map(str.isdigit, text)):
        return text.lower() in _INFINITE
    return _NUMBER.fullmatch(text) is not None or looks_dated(text)


def _is_word(cell: str) -> bool:
    return cell.strip() not in NO_NUMBER and not _is_number(cell)


def _marks(judged: _Judged, rows: Sequence[int], where: str) -> tuple[str, str]:
    """Marks of decimals and of thousands, as stated or by the numbers.

    Raises:
        LogError: both could be.
    """
    stated = judged.layout
    thousands = stated.thousands or ""
    if stated.decimal is not None:
        return stated.decimal, thousands
    if thousands:
        return "," if thousands == "." else ".", thousands
    numbers = list(_numbers(judged, rows))
    both = [n for n in numbers if "," in n and "." in n]
    last = {max(",.", key=n.rfind) for n in both}
    if len(last) > 1:
        raise _ambiguous(both[0], where)
    if both:
        decimal = last.pop()
        return decimal, "," if decimal == "." else "."
    having = {mark: [n for n in numbers if mark in n] for mark in ",."}
    grouped = [mark for mark, found in having.items() if found and all(map(_THOUSANDS.fullmatch, found))]
    marks = [mark for mark, found in having.items() if found]
    for mark in grouped:
        if any(n.count(mark) > 1 for n in having[mark]) or len(marks) > len(grouped):
            return "," if mark == "." else ".", mark
    if len(marks) > 1 or (grouped and (grouped == [","] or stated.delimiter == ";")):
        raise _ambiguous(having[marks[0]][0], where)
    return (marks or ["."])[0], ""


def _numbers(judged: _Judged, rows: Sequence[int]) -> Iterator[str]:
    for k in rows:
        for cell in map(str.strip, judged.cells(k)):
            if _NUMBER.fullmatch(cell) and ("," in cell or "." in cell):
                yield cell


def _ambiguous(number: str, where: str) -> LogError:
    mark, other = (",", ".") if "," in number else (".", ",")
    return LogError(f"'{number:.30}' may have decimals or thousands behind its '{mark}'", where=where,
                    remedy=f"state decimal = '{mark}' or decimal = '{other}' with thousands = '{mark}' in a map")
