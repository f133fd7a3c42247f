"""Logs in any layout: `map` proposes a map, the log is read with that map, and its numbers are those that were written.

`layouts()` first gives the 90 layouts of three delimiters, a title or comment or neither, five ways to state units and
quotation marks or none; then layouts drawn at random from all that `Layout` lists, as far as text can express them. Of
a table without header the columns are written into the map by hand, as its comments say. `spoilt()` damages such logs:
each must be refused in a sentence with the number of the line, since a row that is dropped in silence is a wrong log.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime, timedelta
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from hydroopt.errors import HydrooptError
from hydroopt.logs.column_map import read_map
from hydroopt.logs.log import Log
from hydroopt.logs.log_files import read_log
from hydroopt.logs.map_proposal import propose_map
from hydroopt.machine.machine_file import load_machine

MACHINE = load_machine("cat215b")
CHANNELS = {"boom.q": ("deg", np.pi / 180), "stick.q": ("°", np.pi / 180), "boom_cylinder.p_head": ("bar", 1e5),
            "boom_cylinder.p_rod": ("bar", 1e5)}
"""Channels with the unit that is written and its size in SI."""
NAMES = {"plain": ("t", "boom.q", "stick.q", "boom_cylinder.p_head", "boom_cylinder.p_rod"),
         "German": ("Zeit", "Ausleger Winkel", "Stiel Winkel", "Auslegerzylinder Druck Kolbenseite",
                    "Auslegerzylinder Druck Ringseite")}
START = datetime(2026, 11, 23, 4, 20, 0, tzinfo=UTC)


@dataclass(frozen=True)
class Layout:
    """How a log is written; each attribute is one of the choices of `CHOICES`."""

    delimiter: str = ","
    decimal: str = "."
    above: str = ""
    units: str = "name"
    quotes: str = ""
    time: str = "s"
    names: str = "plain"
    encoding: str = "utf-8"
    end: str = "\n"
    blank: str = ""
    trailing: str = ""
    footer: str = ""
    comments: str = ""
    pad: str = ""
    holes: str = ""
    seed: int = field(default=0, compare=False)


CHOICES: dict[str, tuple[str, ...]] = {
    "delimiter": (",", ";", "\t", "|", " ", "   "), "decimal": (".", ","),
    "above": ("", "title", "titles", "padded", "separated", "serial", "sep=", "# ", "% ", "// ", "; ", "! "),
    "units": ("name", "brackets", "row", "bare", "word", "bare word", "none", "no header", "commented"),
    "quotes": ("", "header", "all", "single"),
    "time": ("s", "ms", "clock", "ISO", "ISO zone", "ISO blank", "dots", "slashes", "month first", "epoch", "epoch ms"),
    "names": ("plain", "German"), "encoding": ("utf-8", "utf-8-sig", "utf-16", "utf-16-be", "latin-1"),
    "end": ("\n", "\r\n", "\r"), "blank": ("", "title", "header", "end", "all"),
    "trailing": ("", "rows", "all", "three"), "footer": ("", "words", "mean", "comment"),
    "comments": ("", "header", "rows"), "pad": ("", "behind", "both"), "holes": ("", "cell")}


def layouts(count: int, seed: int = 1) -> Iterator[Layout]:
    """So many different layouts: those of FINDINGS's kind first, then random ones."""
    seen = set()
    for k, (mark, above, units, quotes) in enumerate(itertools.product(
            (",", ";", "\t"), ("", "title", "# "), ("name", "row", "bare", "word", "none"), ("", "all"))):
        seen.add(made := Layout(delimiter=mark, above=above, units=units, quotes=quotes, seed=k))
        yield made
    rng = np.random.default_rng(seed)
    while len(seen) < count:
        # usual in half of the attributes, so that each unusual one meets others, but not all of them
        drawn = {key: some[rng.integers(len(some))] for key, some in CHOICES.items() if rng.random() < 0.5}
        made = replace(Layout(**drawn), seed=len(seen))
        if made not in seen and possible(made):
            seen.add(made)
            yield made


def possible(layout: Layout) -> bool:
    """Whether text can express a layout, so that a reader without a map can find it out."""
    blank = not layout.delimiter.strip(" ")
    spaced = layout.time in ("ISO blank", "dots", "slashes", "month first")
    return not (
        (layout.decimal == layout.delimiter and layout.quotes not in ("all", "single"))
        or (blank and (layout.trailing or layout.pad or layout.holes or layout.names == "German" or spaced
                       or layout.above in ("separated", "padded") or layout.quotes == "header"))
        or (layout.above == "; " and layout.delimiter == ";" and layout.units == "commented")
        or (layout.units == "commented" and (layout.above[1:] != " " or layout.quotes))
        or (layout.quotes == "single" and layout.above in ("title", "titles"))  # the operator's quotation marks
        or (layout.units in ("no header", "none") and (layout.time in ("epoch", "epoch ms")))
        or ((layout.comments or layout.footer == "comment") and layout.above.strip() == layout.delimiter))


@dataclass(frozen=True)
class Written:
    """A log as text, and its numbers: times (N,) [s] and channels (N,) in SI."""

    text: str
    t: np.ndarray
    channels: dict[str, np.ndarray]
    layout: Layout
    first: int
    """0-based line of the first row."""

    def bytes(self) -> bytes:
        """The content of the file."""
        mark = "\ufeff" if self.layout.encoding == "utf-16-be" else ""
        return (mark + self.text).encode(self.layout.encoding, "replace")


def written(layout: Layout, rows: int = 60) -> Written:
    """A log in a layout, with numbers of its own seed."""
    rng = np.random.default_rng(layout.seed)
    step = float(rng.choice([0.01, 0.02, 0.04]))
    t = np.round(np.arange(rows) * step, 3)
    phase, way = rng.uniform(0, 6, 4), np.linspace(0, 6, rows)
    values = np.column_stack([-15 + 30 * np.sin(way + phase[0]), 90 + 40 * np.sin(way + phase[1]),
                              120 + 80 * np.sin(way + phase[2]), 60 + 40 * np.sin(way + phase[3])])
    digits = int(rng.integers(2, 7))
    cells = [[_time(layout, x), *(f"{v:.{digits}f}".replace(".", layout.decimal) for v in row)]
             for x, row in zip(t, values, strict=True)]
    numbers = np.array([[float(cell.replace(",", ".")) for cell in row[1:]] for row in cells])
    if layout.holes:
        cells[rows // 2][3], numbers[rows // 2, 2] = "", np.nan
    lines, first = _lines(layout, cells)
    end = "" if layout.blank != "end" else 3 * layout.end
    text = layout.end.join(lines) + (layout.end if layout.seed % 3 else "") + end
    return Written(text, t, {name: numbers[:, k] * scale for k, (name, (_, scale)) in enumerate(CHANNELS.items())},
                   layout, first)


def _time(layout: Layout, seconds: float) -> str:
    """A moment in the form of a layout."""
    moment = START + timedelta(seconds=seconds)
    day = {"ISO blank": "%Y-%m-%d ", "dots": "%d.%m.%Y ", "slashes": "%d/%m/%Y ", "month first": "%m/%d/%Y "}.get(
        layout.time, "%Y-%m-%dT")
    clock = f"{moment:%H:%M:%S}{layout.decimal}{moment.microsecond // 1000:03d}"
    if layout.time in ("s", "ms", "epoch", "epoch ms"):
        scale, digits = (1, 3) if layout.time in ("s", "epoch") else (1000, 0)
        zero = START.timestamp() if "epoch" in layout.time else 0.0
        return f"{(zero + seconds) * scale:.{digits}f}".replace(".", layout.decimal)
    if layout.time == "clock":
        return clock
    return f"{moment.strftime(day)}{clock}{'+00:00' if layout.time == 'ISO zone' else ''}"


def _lines(layout: Layout, cells: list[list[str]]) -> tuple[list[str], int]:
    """The lines of a log, and which of them is the first row."""
    def line(row: list[str], *, header: bool = False) -> str:
        quote = {"all": '"', "single": "'", "header": '"' if header else ""}.get(layout.quotes, "")
        joint = {"behind": f"{layout.delimiter} ", "both": f" {layout.delimiter} "}.get(layout.pad, layout.delimiter)
        more = {"three": 3, "all": 1, "rows": 0 if header else 1}.get(layout.trailing, 0)
        return joint.join(f"{quote}{cell}{quote}" for cell in row) + more * layout.delimiter

    blank = not layout.delimiter.strip(" ")
    usual = {"s": "s", "ms": "ms", "epoch": "s", "epoch ms": "ms"}.get(layout.time, "")
    units = [usual, *(unit for unit, _ in CHANNELS.values())]
    names = list(NAMES[layout.names])
    word = {"clock": "hh:mm:ss"}.get(layout.time, "yyyy-mm-dd hh:mm:ss" if not blank else "hh:mm:ss")
    titles = {"title": ["Logger export 12 of O'Neill"],
              "titles": ["Logger export 12", "Operator: O'Neill, at noon", ""],
              "padded": [f"Logger export 12{4 * layout.delimiter}"], "separated": [layout.delimiter.join(
                  ("Serial", "12", "at", "noon", "today"))], "serial": ["12"], "sep=": [f"sep={layout.delimiter}"]}
    above = titles.get(layout.above, [f"{layout.above}made by a logger"] * bool(layout.above))
    lines = [*above, *[""] * (layout.blank == "title")]
    mark = layout.above if layout.units == "commented" else ""
    if layout.units in ("name", "brackets", "commented"):
        left, right = "()" if layout.units == "brackets" else "[]"
        names = [f"{name}{'_' * (blank and layout.units == 'brackets')}{left}{unit}{right}" if unit else name
                 for name, unit in zip(names, units, strict=True)]
        if not blank:
            names = [name.replace(left, f" {left}") for name in names]
    if layout.units != "no header":
        lines.append(mark + line(names, header=True))
    if layout.units in ("row", "bare", "word", "bare word"):
        said = [word if "word" in layout.units else units[0] or "-", *units[1:]]
        lines.append(line(said if "bare" in layout.units else [f"[{unit}]" for unit in said], header=True))
    comment = layout.above if layout.above[1:] == " " or layout.above == "// " else "# "
    lines += [*[f"{comment}begin"] * (layout.comments == "header"), *[""] * (layout.blank == "header")]
    first = len(lines)
    body = [line(row) for row in cells]
    if layout.comments == "rows":
        body.insert(len(body) // 2, f"{comment}the driver stopped here")
    body += {"words": ["End of log"], "comment": [f"{comment}end"], "mean": [line(["Mean", *cells[0][1:]])]}.get(
        layout.footer, [])
    if layout.blank == "all":
        body = [part for row in body for part in (row, "")]
    return lines + body, first


def read_back(made: Written, folder: Path) -> Log:
    """The log as it is read with the map that is proposed for it.

    Raises:
        HydrooptError: it is not read.
    """
    file, to = folder / "log.csv", folder / "map.toml"
    file.write_bytes(made.bytes())
    text = propose_map(file, MACHINE).toml()
    if made.layout.units == "no header":
        unit = {"s": 'unit = "s"', "ms": 'unit = "ms"'}.get(made.layout.time, "")
        text = "\n".join([text.partition("[columns]")[0], "[columns]", f"t = {{ column = 0{', ' * bool(unit)}{unit} }}",
                          *(f'"{name}" = {{ column = {k}, unit = "{unit.replace("°", "deg")}" }}'
                            for k, (name, (unit, _)) in enumerate(CHANNELS.items(), 1))])
    to.write_text(text, "utf-8")
    return read_log(file, mapping=read_map(to))


def wrong(made: Written, log: Log) -> list[str]:
    """What of a log that was read is not as it was written."""
    found = [name for name in CHANNELS if name not in log.channels
             and not (made.layout.units == "none" and ".p_" in name)]  # whose unit is open
    if log.t.shape != made.t.shape or np.abs(log.t - log.t[0] - made.t).max() > 1e-9:
        return [*found, "t"]
    return found + [name for name, values in log.channels.items()
                    if not np.allclose(values, made.channels[name], rtol=1e-12, atol=0, equal_nan=True)]


SPOILT = ("cut", "short row", "long row", "other delimiter", "header again", "open quote", "word", "empty time word")
"""Kinds of damage."""


def spoilt(made: Written, kind: str) -> tuple[Written, int]:
    """A log with damage of a kind, and the 1-based line of it."""
    layout = made.layout
    lines = made.text.split(layout.end)
    rows = [k for k in range(made.first, len(lines)) if lines[k].strip()]
    k = rows[len(rows) // 3]
    cells = lines[k].split(layout.delimiter)
    if kind == "cut":
        lines[k:] = [layout.delimiter.join(cells[:2])]
    elif kind == "short row":
        lines[k] = layout.delimiter.join(cells[:-2])
    elif kind == "long row":
        lines[k] += f"{layout.delimiter}1{layout.delimiter}2"
    elif kind == "other delimiter":
        lines[k] = lines[k].replace(layout.delimiter, "|" if layout.delimiter != "|" else ";")
    elif kind == "header again":
        lines.insert(k, lines[made.first - 1])
    elif kind == "open quote":
        lines[k] = '"' + lines[k]
    else:
        place = 0 if kind == "empty time word" else 2
        lines[k] = layout.delimiter.join([*cells[:place], "stopped", *cells[place + 1:]])
    return replace(made, text=layout.end.join(lines)), k + 1


def spoilt_layouts(count: int) -> Iterator[Layout]:
    """Layouts that `spoilt` can damage: rows without comments, quotation marks or anything behind them."""
    plain = (each for each in layouts(20 * count, seed=2) if not (
        each.quotes or each.comments or each.footer or each.blank or each.trailing or each.pad or each.holes
        or each.units in ("no header", "commented") or len(each.delimiter) > 1))
    return itertools.islice(plain, count)


def run() -> dict[str, float]:
    """Counts of layouts and of spoilt logs: tried, read or refused with the line, wrong, ended in a traceback."""
    figures = dict.fromkeys(("layouts_tried", "layouts_read", "layouts_wrong_numbers", "layouts_tracebacks",
                             "layouts_spoilt_tried", "layouts_spoilt_refused"), 0.0)
    with TemporaryDirectory() as name:
        folder = Path(name)
        for layout in layouts(400):
            figures["layouts_tried"] += 1
            made = written(layout)
            try:
                bad = wrong(made, read_back(made, folder))
            except HydrooptError:
                continue
            except Exception:
                figures["layouts_tracebacks"] += 1
                continue
            figures["layouts_read"] += 1
            figures["layouts_wrong_numbers"] += bool(bad)
        for layout, kind in itertools.product(spoilt_layouts(20), SPOILT):
            figures["layouts_spoilt_tried"] += 1
            made, line = spoilt(written(layout), kind)
            try:
                read_back(made, folder)
            except HydrooptError as error:
                figures["layouts_spoilt_refused"] += f"line {line}" in str(error)
            except Exception:
                figures["layouts_tracebacks"] += 1
    return figures
