"""How a table of text is dressed: encoding, lines before the header, delimiter, decimal mark, a row of units."""

from __future__ import annotations

import codecs
import csv
import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

from hydroopt.errors import LogError
from hydroopt.logs.column_headers import parts_of
from hydroopt.logs.column_map import LogMap
from hydroopt.logs.stamps import looks_dated
from hydroopt.logs.unit_words import units_of

DELIMITERS = (";", "\t", "|", ",", "whitespace")
"""Between columns, in the order in which they are tried: those that no number contains come first."""
COMMENTS = ("#", "%")
SAMPLE = 400
"""Lines at the beginning, and as many at the end, by which a table is judged."""
_NUMBER = {".": re.compile(r"[+-]?(\d{1,3}(,\d{3})+|\d+)?\.?\d*([eE][+-]?\d+)?"),
           ",": re.compile(r"[+-]?(\d{1,3}(\.\d{3})+|\d+)?,?\d*([eE][+-]?\d+)?")}
_NO_NUMBER = {"", "nan", "na", "null", "inf", "+inf", "-inf", "infinity", "-infinity", "-nan(ind)", "#n/a"}
_THOUSANDS = re.compile(r"[+-]?[1-9]\d{0,2}([.,]\d{3})+")


@dataclass(frozen=True)
class Dress:
    """How a text table is to be read.

    Attributes:
        delimiter: one character, or "whitespace".
        decimal: mark of the decimals; `thousands`: mark between thousands, or empty.
        header: (n,) names of the columns with their units, `name [unit]`; empty of a table without header.
        first: 0-based line of the first data row, comments not counted.
        shown: what was taken of it that is not the usual table, in a sentence; empty where nothing was.
    """

    delimiter: str
    decimal: str
    thousands: str
    header: list[str]
    first: int
    shown: str = ""


def decoded(data: bytes, stated: str | None, where: str) -> tuple[str, str]:
    """The text of a file in the encoding that is `stated`, if any, and what was taken of it; empty of UTF-8.

    Raises:
        LogError: it is not text.
    """
    binary = LogError("this is not a text file (binary data inside)", where=where,
                      remedy="export it as CSV or name the file after its true format")
    if stated is not None:
        try:
            text = data.decode(stated).removeprefix("\ufeff")
        except (UnicodeDecodeError, LookupError):
            raise LogError(f"this is not text in {stated}", where=where,
                           remedy="correct 'encoding' in the map") from None
        if "\0" in text:
            raise binary
        return text, ""
    marks = {codecs.BOM_UTF8: "utf-8-sig", codecs.BOM_UTF32_LE: "utf-32", codecs.BOM_UTF32_BE: "utf-32",
             codecs.BOM_UTF16_LE: "utf-16", codecs.BOM_UTF16_BE: "utf-16"}
    for mark, name in marks.items():
        if data.startswith(mark):
            try:
                text = data.decode(name)
            except UnicodeDecodeError:
                raise binary from None
            if "\0" in text or (name != "utf-8-sig" and not text[:SAMPLE].isprintable()
                                and re.search(r"[^\x09-\x0d\x20-\x7e\xa0-\uffff]", text[:4096])):
                raise binary
            return text, "" if name == "utf-8-sig" else f"encoding {name.upper()}"
    if b"\0" in data:
        raise binary
    try:
        return data.decode("utf-8"), ""
    except UnicodeDecodeError as error:
        text = data.decode("latin-1")
        if error.start > 4096 or re.search(r"[\x00-\x08\x0e-\x1f\x7f-\x9f]", text[:4096]):
            raise binary from None
        return text, "encoding Latin-1"


def lines_of(text: str, layout: LogMap) -> tuple[list[str], int]:
    """The lines of a text but comments, and how many these were; a header that is a comment stays without its mark."""
    lines = text.replace("\r\n", "\n").replace("\r", "\n").rstrip("\n ").split("\n")
    marks = (layout.comment,) if layout.comment else COMMENTS
    if not re.search(rf"^[ \t]*(?:{'|'.join(map(re.escape, marks))})", text, re.MULTILINE):
        return lines, 0
    kept = [line for line in lines if not line.lstrip().startswith(marks)]
    comments = len(lines) - len(kept)
    if comments and kept and layout.header and not layout.skip:
        first = lines.index(kept[0])
        above = lines[first - 1].lstrip().lstrip("".join(marks)).strip() if first else ""
        if above and _numeric_share(_cells(kept[0], _likely(kept, layout))) == 1 and (
                len(_cells(above, _likely(kept, layout))) == len(_cells(kept[0], _likely(kept, layout)))):
            return [above, *kept], comments - 1
    return kept, comments


def dress_of(lines: Sequence[str], layout: LogMap, where: str) -> Dress:
    """The dress of a table of these lines, as far as its map does not state it.

    Raises:
        LogError: whether a mark stands for decimals or thousands is ambiguous.
    """
    notes = []
    delimiter = layout.delimiter or _likely(lines, layout)
    if not layout.delimiter and delimiter != ",":
        notes.append(f"{'white space' if delimiter == 'whitespace' else repr(delimiter)} between columns")
    top, first, units = _header(lines, delimiter, layout)
    if layout.skip is None and top:
        notes.append(f"{top} line{'s' * (top > 1)} before the header")
    header = [] if not layout.header else [cell.strip() for cell in _cells(lines[top], delimiter)]
    if units:
        stated = _cells(lines[first - 1], delimiter)
        header = [_with_unit(name, unit) for name, unit in zip(header, stated, strict=True)]
        notes.append("units in the line below the header")
    sample = [*lines[first : first + SAMPLE], *lines[max(first + SAMPLE, len(lines) - SAMPLE):]]
    decimal, thousands = _marks(sample, delimiter, layout, where)
    if layout.decimal is None and decimal != ".":
        notes.append("',' for decimals")
    if layout.thousands is None and thousands:
        notes.append(f"'{thousands}' between thousands")
    return Dress(delimiter, decimal, thousands, header, first, ", ".join(notes))


def _with_unit(name: str, unit: str) -> str:
    bare = unit.strip().strip("[]()").strip()
    return name if not bare or parts_of(name)[1] is not None else f"{name} [{bare}]"


def _likely(lines: Sequence[str], layout: LogMap) -> str:
    """The delimiter under which most cells of the lines are numbers or dates."""
    if layout.delimiter:
        return layout.delimiter
    named = {key for key in layout.keys if isinstance(key, str)}
    sample = lines[:SAMPLE]
    best, share = ",", 0.0
    for delimiter in DELIMITERS:
        rows = [_cells(line, delimiter) for line in sample]
        if named and any(named <= {cell.strip() for cell in row} for row in rows[:100]):
            return delimiter
        width, count = Counter(map(len, rows)).most_common(1)[0]
        if width < 2:
            continue
        alike = [row for row in rows if len(row) == width]
        found = count / len(rows) * sum(map(_numeric_share, alike)) / len(alike)
        if found > 1.2 * share + 0.02:
            best, share = delimiter, found
    return best


def _header(lines: Sequence[str], delimiter: str, layout: LogMap) -> tuple[int, int, bool]:
    """Line of the header, of the first data row, and whether the line before that states units."""
    top = _top(lines, delimiter, layout) if layout.skip is None else min(layout.skip, len(lines) - 1)
    if not layout.header:
        return top, top, False
    below = _cells(lines[top + 1], delimiter) if top + 1 < len(lines) else []
    units = layout.units_row
    if units is None:
        names = _cells(lines[top], delimiter)
        units = len(below) == len(names) and _are_units(below) and not any(parts_of(name)[1] for name in names)
    return top, min(top + 1 + units, len(lines)), units


def _top(lines: Sequence[str], delimiter: str, layout: LogMap) -> int:
    """The line of the header, or of the first row where there is none."""
    rows = [_cells(line, delimiter) for line in lines[:SAMPLE]]
    named = {key for key in layout.keys if isinstance(key, str)}
    for k, row in enumerate(rows):
        cells = [cell.strip() for cell in row]
        names = {parts_of(cell)[0] for cell in cells} | set(cells)
        if (named and named <= names) or (not named and any(re.fullmatch(r"t *\[.*\]", cell) for cell in cells)):
            return k
    if named or not layout.header:
        return 0
    # a last column may end in free text with the delimiter in it: the usual width is that of most lines
    width = Counter(map(len, rows)).most_common(1)[0][0]
    data = next((k for k, row in enumerate(rows) if len(row) == width and _numeric_share(row) > 0), 0)
    if data and _are_units(rows[data - 1]) and data > 1 and len(rows[data - 2]) == width:
        data -= 1
    return max(data - 1, 0) if data and len(rows[data - 1]) == width else 0


def _cells(line: str, delimiter: str) -> list[str]:
    if delimiter == "whitespace":
        return line.split()
    if '"' not in line:
        return line.split(delimiter)
    try:
        return next(csv.reader([line], delimiter=delimiter), [""])
    except csv.Error:
        return line.split(delimiter)


def _is_number(cell: str) -> bool:
    text = cell.strip()
    return any(character.isdigit() for character in text) and any(p.fullmatch(text) for p in _NUMBER.values())


def _numeric_share(cells: Sequence[str]) -> float:
    """Share of the cells that are numbers or dates, of those that are not empty."""
    full = [cell for cell in cells if cell.strip().lower() not in _NO_NUMBER]
    return sum(_is_number(cell) or looks_dated(cell) for cell in full) / len(full) if full else 0.0


def _are_units(cells: Sequence[str]) -> bool:
    """Whether a line states units: nothing but units, or blanks, or units in brackets, and more than one."""
    bare = [cell.strip().strip("[]()").strip() for cell in cells]
    full = [cell for cell in bare if cell not in ("", "-", "—")]
    return any(cell != "1" for cell in full) and all(
        cell in ("1", "%") or (not _is_number(cell) and units_of(cell)) for cell in full)


def _marks(lines: Sequence[str], delimiter: str, layout: LogMap, where: str) -> tuple[str, str]:
    """Mark of the decimals, and that between thousands or none.

    Raises:
        LogError: both could be.
    """
    thousands = layout.thousands or ""
    if layout.decimal is not None:
        return layout.decimal, thousands
    if thousands:
        return (",", thousands) if thousands == "." else (".", thousands)
    numbers = [text for line in lines for cell in _cells(line, delimiter) if _is_number(text := cell.strip())]
    commas, points = [n for n in numbers if "," in n], [n for n in numbers if "." in n]
    both = [n for n in commas if "." in n]
    if both:
        last = {max("., ".strip(), key=n.rfind) for n in both}
        if len(last) > 1:
            raise _ambiguous(both[0], where)
        decimal = last.pop()
        return decimal, "," if decimal == "." else "."
    if commas and points:  # each in cells of its own, such as 1,5 and 1.250
        grouped = {mark: all(_THOUSANDS.fullmatch(n) for n in found) for mark, found in ((",", commas), (".", points))}
        if grouped[","] == grouped["."]:
            raise _ambiguous(commas[0], where)
        return (".", ",") if grouped[","] else (",", ".")
    if commas and all(_THOUSANDS.fullmatch(n) for n in commas):
        if any(n.count(",") > 1 for n in commas):
            return ".", ","
        raise _ambiguous(commas[0], where)
    if commas:
        return ",", ""
    if points and delimiter == ";" and all(_THOUSANDS.fullmatch(n) for n in points):
        if any(n.count(".") > 1 for n in points):
            return ",", "."
        raise _ambiguous(points[0], where)
    return ".", ""


def _ambiguous(number: str, where: str) -> LogError:
    mark, other = ("," , ".") if "," in number else (".", ",")
    return LogError(f"'{number:.30}' may have decimals or thousands behind its '{mark}'", where=where,
                    remedy=f"state decimal = '{mark}' or decimal = '{other}' with thousands = '{mark}' in a map")
