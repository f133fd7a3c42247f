"""A column map proposed from what a file says: names and units of its columns, their values, the machine's geometry."""

from __future__ import annotations

import json
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Literal

import numpy as np

from hydroopt.errors import HydrooptError, LogError
from hydroopt.logs import stamps
from hydroopt.logs.channels import si_unit
from hydroopt.logs.column_words import GENERIC, Naming, matched, may_be, naming, words_of
from hydroopt.logs.formats.files import open_files
from hydroopt.logs.sheets import Sheet
from hydroopt.logs.table import Array
from hydroopt.logs.unit_words import of_kind
from hydroopt.machine.machine import Machine
from hydroopt.model.model import Model
from hydroopt.units import factor

Sureness = Literal["sure", "likely", "guess"]
TRIED = {"rad": ("rad", "deg"), "m": ("m", "mm", "cm"), "Pa": ("Pa", "kPa", "bar", "psi", "MPa")}
"""Units that are tried of a column that states none, by SI unit."""
BEYOND = 0.02
"""Share of a range by which values may leave it."""
LEAST_PRESSURE, MOST_PRESSURE = 1e6, 6e7
"""Highest pressure [Pa] of a log: at least, where its unit is inferred, and at most, where no relief is stated."""
SILENT = 1e5
"""Highest pressure [Pa] of a chamber, at least, whose unit is inferred."""
LEAST_RATE, MOST_RATE = 2.0, 2e4
"""Samples per second of a log, where the unit of its time is inferred."""
AGREES, DIFFERS = 0.01, 0.1
"""RMS difference of lengths from those by the angles, as part of their range, that confirms both, and that denies."""
MOST = 6
"""Channels that a question about a column names."""
LEFT_OUT = ("qdd", "distance", "x", "y", "z", "fx", "fy", "fz", "mx", "my", "mz")
"""Suffixes of channels that are not looked for."""


@dataclass(frozen=True)
class ColumnOf:
    """A column of a file: its sheet, index and header, what the header says, and its values (N,)."""

    sheet: Sheet
    index: int
    header: str
    named: Naming
    values: Array
    dated: bool = False


@dataclass(frozen=True)
class Proposal:
    """A column for a channel, in a unit, and why.

    Attributes:
        channel: of the machine, or "t".
        column: of the file; `unit`: of its values, empty of dates.
        sureness: "sure" (stated by name and unit, and its values agree, or its geometry proves it), "likely" (one of
            them is inferred, without another possibility), "guess".
        reason: in a few words.
    """

    channel: str
    column: ColumnOf
    unit: str
    sureness: Sureness
    reason: str


@dataclass(frozen=True)
class MapProposal:
    """What `propose_map` found: one proposal a channel at most.

    Attributes:
        path: of the file; `machine`: its name.
        proposals: by channel and, of the time, by sheet; `missing`: channels without a column; `unused`: headers.
        possible: channels that an unused column may be by its part or its quantity, by header.
        own_stamps: whether the rows of all sheets have stamps of their own; `several`: whether there are several.
    """

    path: str
    machine: str
    proposals: tuple[Proposal, ...]
    missing: tuple[str, ...]
    unused: tuple[str, ...]
    own_stamps: bool
    several: bool
    possible: Mapping[str, tuple[str, ...]] = field(default_factory=dict)

    def toml(self) -> str:
        """The map as a TOML file; guesses are comments.

        >>> from hydroopt.machine.machine_file import load_machine
        >>> from tempfile import TemporaryDirectory
        >>> with TemporaryDirectory() as directory:
        ...     file = Path(directory) / "run.csv"
        ...     _ = file.write_text("Zeit [s];Ausleger Winkel (°)\\n0;1,5\\n0,1;1,7\\n")
        ...     print(propose_map(file, load_machine("cat215b")).toml().splitlines()[5])
        t = { column = "Zeit [s]", unit = "s" }  # sure: named as the time in s, and increases
        """
        times = [each for each in self.proposals if each.channel == "t"]
        used = [each.column.sheet.name for each in self.proposals if each.channel != "t" and each.sureness != "guess"]
        clocks = [each for each in times if self.several and each.column.sheet.name in used]
        listed = [each for each in self.proposals if each not in clocks and not (self.several and each in times)]
        lines = [f"# Column map of {Path(self.path).name} for {self.machine}, proposed by hydroopt map.",
                 "# sure: name, unit and values say so; likely: the only possibility; guess: a comment, to decide.",
                 "# Signs and zeros of angles are judged here by triangles alone, by hydroopt identify with forces.",
                 "", "[columns]"]
        if self.own_stamps:
            lines.append("# the time is that of the file's own stamps")
        elif not times:
            lines.append('# t = { column = "?", unit = "s" }  # no column is named as a time')
        lines += [self._line(_key(each.channel), each) for each in listed]
        if self.missing:
            lines += ["", "# no column was found for these: write its name and unit, and remove the #",
                      *(f'# {_key(name)} = {{ column = "?", unit = "{si_unit(name)}" }}' for name in self.missing)]
        if self.unused:
            lines += ["", "# no channel was found for the columns:",
                      *(self._unused_line(name) for name in self.unused)]
        for each in clocks:
            lines += ["", f"[clocks.{json.dumps(each.column.sheet.name, ensure_ascii=False)}]", self._line("t", each),
                      '# delay = "0 ms ± 50 ms"  # if its clock is not that of the others: it is estimated with these']
        return "\n".join(lines) + "\n"

    def _unused_line(self, header: str) -> str:
        line = f"# {json.dumps(header, ensure_ascii=False)}"
        return f"{line}  # {self.question(header)} Its name does not say" if header in self.possible else line

    def question(self, header: str) -> str:
        """Which of the possible channels a column is, as a question."""
        names = self.possible[header]
        return " or ".join([*names[:MOST], *([f"{len(names) - MOST} more"] if len(names) > MOST else [])]) + "?"

    def _line(self, key: str, each: Proposal) -> str:
        same = [header for header in each.column.sheet.content.header if header == each.column.header]
        column = json.dumps(each.column.header, ensure_ascii=False) if len(same) == 1 else str(each.column.index)
        parts = [f"column = {column}", *([f'unit = "{each.unit}"'] if each.unit else [])]
        if self.several and each.channel != "t":
            parts.append(f"group = {json.dumps(each.column.sheet.name, ensure_ascii=False)}")
        line = f"{key} = {{ {', '.join(parts)} }}  # {each.sureness}: {each.reason}"
        return f"# {line}" if each.sureness == "guess" else line


def propose_map(path: str | Path, machine: Machine) -> MapProposal:
    """A column map of a log for a machine, of names, units and values of its columns.

    A column counts for a channel if its name says so (English or German) and its unit and values allow it: angles
    within joint limits, lengths within strokes, pressures below relief. Its unit stands in brackets or is the last
    word of its header, see `unit_words`. A unit that the file does not state, or states by a word with several
    meanings, is taken if one alone allows the values. Angles and lengths that agree through a cylinder's triangle are
    sure, and guesses if they contradict each other there.

    Raises:
        LogError: the file is damaged or of an unknown kind.
    """
    wanted = {name: si for name, si in machine.channel_units.items() if name.rpartition(".")[2] not in LEFT_OUT}
    parts = {channel.rpartition(".")[0] for channel in wanted}
    with open_files([str(path)], None) as source:
        columns = [column for sheet in source.sheets for column in _columns(sheet, parts)]
        own = all(sheet.content.own_stamps for sheet in source.sheets)
        several = len(source.sheets) > 1
        times = [] if own else [each for sheet in source.sheets if not sheet.content.own_stamps
                                for each in _time(sheet, columns)]
    rest = [column for column in columns if column not in [each.column for each in times]]
    found = _by_triangles(Model(machine), {**_by_number(machine, rest), **_by_name(machine, wanted, rest)})
    found = _loud_enough(found, wanted)
    taken = {(each.column.sheet.name, each.column.index) for each in found.values()}
    usual = {*(f"{joint}.q" for joint in machine.joints),
             *(chamber for each in machine.hydraulic_actuators for chamber in each.chambers)}
    unused = [column for column in rest if (column.sheet.name, column.index) not in taken]
    free = {name: si for name, si in wanted.items() if name not in found}
    possible = {column.header: some for column in unused if (some := _possible(column.named, free, usual))}
    return MapProposal(
        str(path), machine.name, (*times, *(found[name] for name in wanted if name in found)),
        tuple(name for name in wanted if name in usual and name not in found),
        tuple(column.header for column in unused), own, several, possible)


def _loud_enough(found: Mapping[str, Proposal], wanted: Mapping[str, str]) -> dict[str, Proposal]:
    """The proposals, those of pressures as guesses where none is that of a hydraulic machine in its unit."""
    highest = {name: float(np.nanmax(each.column.values)) * factor(each.unit, "Pa") for name, each in found.items()
               if wanted[name] == "Pa"}
    if max(highest.values(), default=np.inf) >= SILENT:
        return dict(found)
    most = max(highest.values())
    return {name: replace(each, sureness="guess", reason=(
        f"{each.reason}, but the highest of all pressures would be {most / 1e5:.2g} bar: write the right unit"))
            if name in highest else each for name, each in found.items()}


def _possible(named: Naming, free: Mapping[str, str], usual: Collection[str]) -> tuple[str, ...]:
    """Which of the free channels a header may stand for, the usual ones alone if there are such."""
    found = tuple(name for name, si in free.items() if may_be(name, named, si)
                  and (of_kind(named.units, si) if named.units else name in usual))
    return tuple(name for name in found if name in usual) or found


def _key(channel: str) -> str:
    return channel if channel == "t" else f'"{channel}"'


def _columns(sheet: Sheet, parts: Collection[str]) -> Iterator[ColumnOf]:
    """The columns of a sheet that hold numbers or dates."""
    for index, header in enumerate(sheet.content.header):
        named = naming(header, parts)
        if sheet.name and not any(part.isspace() for part in sheet.name):
            named = replace(named, of_sheet=words_of(sheet.name))
        try:
            table = sheet.content.read([index], time=index)
        except LogError:
            continue
        values = table.columns[index]
        if np.isfinite(values).any():
            dated = table.stamps is not None and not table.stamps.unit
            yield ColumnOf(sheet, index, header, named, values, dated)


def _time(sheet: Sheet, columns: Sequence[ColumnOf]) -> list[Proposal]:
    """The time of a sheet: the column that is named so, or alone has a unit of time, and increases."""
    held = [column for column in columns if column.sheet == sheet]
    named = [column for column in held if column.dated or column.named.words == {"time"} or column.named.bare == "t"]
    increasing = [each for each in named if _increases(each)] or named
    if not increasing:
        clocks = [each for each in held if of_kind(each.named.units, "s") and _increases(each)]
        return [Proposal("t", each, each.named.units[0], "likely", f"the only column in a unit of time, "
                         f"{_shown(each, each.named.units[0])}, that increases") for each in clocks[:len(clocks) == 1]]
    column = increasing[0]
    if column.dated:
        return [Proposal("t", column, "", "sure", "holds dates or times of day")]
    several: Sureness = "sure" if len(increasing) == 1 else "likely"
    if stated := of_kind(column.named.units, "s"):
        return [Proposal("t", column, stated[0], several, f"named as the time in {_shown(column, stated[0])}, and "
                         "increases")]
    if (unit := stamps.epoch_unit(column.values)) is not None:
        return [Proposal("t", column, unit, "likely", f"an epoch in {unit}: another unit would be no date of this age")]
    step = float(np.median(np.diff(column.values)))
    said = f"named as a time without a unit; its step is {step:.4g}"
    fitting = [unit for unit, ticks in stamps.EPOCHS.items() if step > 0 and LEAST_RATE <= ticks / step <= MOST_RATE]
    if len(fitting) == 1 and _increases(column):
        return [Proposal("t", column, fitting[0], "likely", f"{said}, as of a log in {fitting[0]} alone")]
    return [Proposal("t", column, "s" if step < 1 else "ms", "guess", said)]


def _increases(column: ColumnOf) -> bool:
    values = column.values[np.isfinite(column.values)]
    return bool(np.all(np.diff(values) >= 0) and values[0] < values[-1])


def _by_name(machine: Machine, wanted: Mapping[str, str], columns: Sequence[ColumnOf]) -> dict[str, Proposal]:
    """The best column of each channel by its name, judged by unit and values."""
    ranked: dict[str, list[tuple[int, Proposal]]] = {}
    scores = {channel: [(score, column) for column in columns if (score := matched(channel, column.named, si))]
              for channel, si in wanted.items()}
    usual = TRIED | {"Pa": _pressure_units(machine, {
        channel: [column for score, column in scores[channel] if score > 1]
        for channel, si in wanted.items() if si == "Pa"})}
    for channel, si in wanted.items():
        for score, column in scores[channel]:
            if (made := _judged(machine, channel, si, column, score, usual.get(si, (si,)))) is not None:
                ranked.setdefault(channel, []).append((score, made))
    best = {channel: max(score for score, _ in found) for channel, found in ranked.items()}
    claims: dict[tuple[str, int], list[str]] = {}
    for channel, found in ranked.items():
        for score, each in found:
            if score == best[channel]:
                claims.setdefault((each.column.sheet.name, each.column.index), []).append(channel)
    chosen: dict[str, Proposal] = {}
    for channel, found in ranked.items():
        top = [each for score, each in found if score == best[channel]]
        each = top[0]
        rivals = [name for name in claims[each.column.sheet.name, each.column.index]
                  if name != channel and best[name] >= best[channel]]
        if len(top) > 1:
            each = replace(each, sureness="guess", reason=f"{each.reason}; '{top[1].column.header}' may be it, too")
        elif rivals:
            each = replace(each, sureness="guess", reason=f"{each.reason}; it may be {rivals[0]}, too")
        chosen[channel] = each
    return chosen


def _by_number(machine: Machine, columns: Sequence[ColumnOf]) -> dict[str, Proposal]:
    """Columns `q1` to `qn` or `joint 1 [deg]` as guesses for the n joints, in the machine file's order."""
    numbered: dict[int, list[ColumnOf]] = {}
    for column in columns:
        number = [word for word in column.named.words if word.isdigit()]
        angle = "angle" in column.named.words or of_kind(column.named.units, "rad")
        if len(number) == 1 and angle and not column.named.words - GENERIC - {"angle", *number}:
            numbered.setdefault(int(number[0]), []).append(column)
    joints = machine.joints
    if sorted(numbered) != list(range(1, len(joints) + 1)) or any(len(each) > 1 for each in numbered.values()):
        return {}
    made = {f"{joint}.q": _judged(machine, f"{joint}.q", "rad", numbered[number][0], 2, TRIED["rad"])
            for number, joint in enumerate(joints, 1) if machine.channel_units.get(f"{joint}.q") == "rad"}
    return {channel: replace(each, sureness="guess", reason=(
        f"number {joints.index(channel[:-2]) + 1} of {len(joints)} in the machine file's order"))
        for channel, each in made.items() if each is not None}


def _pressure_units(machine: Machine, named: Mapping[str, Sequence[ColumnOf]]) -> tuple[str, ...]:
    """The usual units that allow all pressures without a unit: a logger writes all of them in one.

    Columns that no unit allows do not count. Where units differ from column to column, all usual ones.
    """
    columns = [(channel, column) for channel, found in named.items() for column in found if not column.named.units]
    allowed = [set(fitting) for channel, column in columns
               if (fitting := _fitting(machine, channel, "Pa", column.values, TRIED["Pa"]))]
    highest = max((float(np.nanmax(column.values)) for _, column in columns), default=0.0)
    together = tuple(unit for unit in TRIED["Pa"] if all(unit in each for each in allowed)
                     and highest * factor(unit, "Pa") >= LEAST_PRESSURE)
    return together or TRIED["Pa"]


def _fitting(machine: Machine, channel: str, si: str, values: Array, units: Sequence[str]) -> list[str]:
    """Of the units, those in which the values are within a channel's range; none where the machine states no range."""
    low_high = _range(machine, channel)
    return [] if low_high is None else [unit for unit in units if _within(values * factor(unit, si), low_high)]


def _judged(machine: Machine, channel: str, si: str, column: ColumnOf, score: int,
            usual: Sequence[str]) -> Proposal | None:
    """The proposal of a column that is named as a channel; None where its unit is of another kind.

    Args:
        usual: the units that a column without one may have.
    """
    stated, low_high = of_kind(column.named.units, si), _range(machine, channel)
    if column.named.units and not stated:
        return None
    said = {3: "named as the channel", 2: "part and quantity in its name", 1: "part in its name"}[score]
    if len(stated) == 1:
        unit = stated[0]
        sureness: Sureness = "sure" if score > 1 else "likely"
        said = f"{said}, in {_shown(column, unit)}"
        if low_high is None:
            return Proposal(channel, column, unit, sureness, said)
        if _within(column.values * factor(unit, si), low_high):
            return Proposal(channel, column, unit, sureness, f"{said}, values within its range")
        return Proposal(channel, column, unit, "guess", f"{said}, but {_outside(column, unit, si, low_high)}")
    fitting = _fitting(machine, channel, si, column.values, stated or usual)
    if si == "Pa" and not stated:
        fitting = [unit for unit in fitting if np.nanmax(column.values) * factor(unit, si) >= SILENT]
    if stated:
        said += f", '{column.named.text}' may be {' or '.join(stated)}"
    if len(fitting) == 1 and score > 1:
        alone = stated or len(_fitting(machine, channel, si, column.values, TRIED.get(si, (si,)))) == 1
        who = "its values allow" if alone else "all pressures without a unit together allow"
        return Proposal(channel, column, fitting[0], "likely", f"{said}; of {'these' if stated else 'the usual units'} "
                        f"{who} {fitting[0]} alone")
    if stated:
        return Proposal(channel, column, (fitting or stated)[0], "guess", f"{said}: write the right unit")
    choice = " or ".join(fitting) if fitting else "none of the usual ones fits"
    return Proposal(channel, column, (fitting or [si])[0], "guess", f"{said}, without a unit ({choice})")


def _shown(column: ColumnOf, unit: str) -> str:
    """A unit, with the word that was read as it."""
    return unit if column.named.text == unit else f"{unit} ('{column.named.text}')"


def _range(machine: Machine, channel: str) -> tuple[float, float] | None:
    """Lowest and highest value [SI] that a channel can have; None where the machine does not say."""
    part, _, suffix = channel.rpartition(".")
    try:
        if suffix == "q":
            joint = machine.link(part).joint
            return None if joint.lower is None or joint.upper is None else (joint.lower, joint.upper)
        if suffix == "length":
            cylinder = next(each for each in machine.cylinders if each.name == part)
            if cylinder.dead_length is None or cylinder.stroke is None:
                return None
            return cylinder.dead_length, cylinder.dead_length + cylinder.stroke
    except (StopIteration, HydrooptError, KeyError):
        return None
    if suffix.startswith("p_"):
        relief = next((each.relief_pressure for each in machine.hydraulic_actuators if each.name == part), None)
        return -1e5, 1.1 * (relief or MOST_PRESSURE)
    return None


def _within(values: Array, low_high: tuple[float, float]) -> bool:
    finite = values[np.isfinite(values)]
    margin = BEYOND * (low_high[1] - low_high[0])
    low, high = np.quantile(finite, (0.001, 0.999))
    return bool(low_high[0] - margin <= low and high <= low_high[1] + margin)


def _outside(column: ColumnOf, unit: str, si: str, low_high: tuple[float, float]) -> str:
    finite = column.values[np.isfinite(column.values)]
    scale = factor(unit, si)
    return (f"its values from {finite.min():.4g} to {finite.max():.4g} {unit} are not within "
            f"{low_high[0] / scale:.4g} to {low_high[1] / scale:.4g} {unit}")


def _by_triangles(model: Model, found: Mapping[str, Proposal]) -> dict[str, Proposal]:
    """The proposals, those of angles and lengths judged by the triangle that both stand in."""
    out = dict(found)
    pairs = [(f"{joint}.q", each.name) for joint, drivers in model.machine.drivers.items() for each in drivers]
    for angle, cylinder in pairs:
        length = f"{cylinder}.length"
        if length not in found or angle not in found or cylinder not in model.triangles:
            continue
        pair = found[angle], found[length]
        if pair[0].column.sheet != pair[1].column.sheet:
            continue
        q = pair[0].column.values * factor(pair[0].unit, "rad")
        measured = pair[1].column.values * factor(pair[1].unit, "m")
        sound = np.isfinite(q) & np.isfinite(measured)
        spread = float(np.ptp(measured[sound])) if sound.any() else 0.0
        if spread == 0:
            continue
        expected = np.asarray(model.triangles[cylinder][0](q[sound])).ravel()
        miss = float(np.sqrt(np.mean((expected - measured[sound]) ** 2)))
        if AGREES * spread <= miss <= DIFFERS * spread:
            continue
        sureness: Sureness = "sure" if miss < AGREES * spread else "guess"
        text = "agree" if sureness == "sure" else "disagree"
        for channel, each, other in ((angle, pair[0], pair[1]), (length, pair[1], pair[0])):
            reason = (f"{each.reason}; it and '{other.column.header}' {text} through the triangle of {cylinder} "
                      f"(RMS {1e3 * miss:.3g} mm)")
            out[channel] = replace(each, sureness=sureness, reason=reason)
    return out
