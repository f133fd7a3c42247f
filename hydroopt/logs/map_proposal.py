"""A column map proposed from what a file says: names and units of its columns, their values, the machine's geometry."""

from __future__ import annotations

import json
import math
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Literal

import numpy as np
from scipy.integrate import cumulative_trapezoid

from hydroopt.logs import stamps
from hydroopt.logs.column_words import ChannelNames, Naming
from hydroopt.logs.formats.files import open_files
from hydroopt.logs.formats.sheet import Sheet
from hydroopt.logs.stamps import DateOrderError
from hydroopt.logs.table import Array, NoNumbersError
from hydroopt.logs.unit_words import of_kind
from hydroopt.machine.machine import Machine
from hydroopt.machine.sensors import ACCELEROMETER, GYROSCOPE
from hydroopt.model.model import Model, recent_model
from hydroopt.units import factor

Sureness = Literal["sure", "likely", "guess"]
Range = tuple[float, float]
TRIED = {"rad": ("rad", "deg"), "m": ("m", "mm", "cm"), "Pa": ("Pa", "kPa", "bar", "psi", "MPa"),
         "m/s^2": ("m/s^2", "g_0", "mg_0"), "rad/s": ("rad/s", "deg/s", "mdeg/s")}
"""Units that are tried of a column that states none, by SI unit."""
BEYOND = 0.02
"""Share of a range by which values may leave it, and by which one column at least moves whose unit is inferred."""
NEAR = 2.0
"""Factor within which IMUs whose units are inferred measure gravity and turn it, by that many standard deviations."""
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
TURNS = (-math.tau, math.tau)
"""Range of a joint without limits [rad]."""
ANGLES = {("quantities", "angle"), ("quantities", "position")}
LEFT_OUT = ("qdd", "distance", "x", "y", "z", "fx", "fy", "fz", "mx", "my", "mz")
"""Suffixes of channels that are not looked for."""


@dataclass(frozen=True)
class ColumnOf:
    """A column of a file: its sheet, index and header, what the header says, and its values (N,).

    Of `dated` ones that are not `ordered` the day or the month may come first.
    """

    sheet: Sheet
    index: int
    header: str
    named: Naming
    values: Array
    dated: bool = False
    ordered: bool = True

    @property
    def label(self) -> str:
        """The header, behind the name of the sheet or topic where there are several."""
        return f"{self.sheet.name}: {self.header}" if self.sheet.name else self.header


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
        proposals: by channel and, of the time, by sheet; `missing`: channels without a column, with the unit that the
            file has for their kind; `unused`: labels of columns.
        possible: channels that an unused column may be by its part or its quantity, by label.
        own_stamps: whether the rows of all sheets have stamps of their own; `several`: whether there are several.
        layout: keys of the map that state the layout of the text, as decided, but those in which sheets differ.
        unnamed: number of columns of a table without header.
    """

    path: str
    machine: str
    proposals: tuple[Proposal, ...]
    missing: Mapping[str, str]
    unused: tuple[str, ...]
    own_stamps: bool
    several: bool
    possible: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    layout: Mapping[str, str | int | bool] = field(default_factory=dict)
    unnamed: int = 0

    def toml(self) -> str:
        """The map as a TOML file; guesses are comments.

        >>> from hydroopt.machine.machine_file import load_machine
        >>> from tempfile import TemporaryDirectory
        >>> with TemporaryDirectory() as directory:
        ...     file = Path(directory) / "run.csv"
        ...     _ = file.write_text("Zeit [s];Ausleger Winkel (°)\\n0;1,5\\n0,1;1,7\\n")
        ...     lines = propose_map(file, load_machine("cat215b")).toml().splitlines()
        >>> print(lines[8], lines[13], sep="\\n")
        delimiter = ";"
        t = { column = "Zeit [s]", unit = "s" }  # sure: named as the time in s, and increases
        """
        times = [each for each in self.proposals if each.channel == "t"]
        used = [each.column.sheet.name for each in self.proposals if each.channel != "t" and each.sureness != "guess"]
        clocks = [each for each in times if self.several and each.column.sheet.name in used]
        listed = [each for each in self.proposals if each not in clocks and not (self.several and each in times)]
        lines = [f"# Column map of {Path(self.path).name} for {self.machine}, proposed by hydroopt map.",
                 "# sure: name, unit and values say so; likely: the only possibility; guess: a comment, to decide.",
                 "# Signs and zeros of angles are judged here by triangles alone, by hydroopt identify with forces."]
        if self.layout:
            lines += ["", "# the layout of the text as it was found; a line that is removed is decided for each file",
                      *(f"{key} = {json.dumps(value, ensure_ascii=False)}" for key, value in self.layout.items())]
        lines += ["", "[columns]"]
        if self.own_stamps:
            lines.append("# the time is that of the file's own stamps")
        elif not times:
            lines.append('# t = { column = "?", unit = "s" }  # no column is named as a time')
        lines += [self._line(_key(each.channel), each) for each in listed]
        if self.unnamed:
            lines += ["", f"# the table has no header: its columns are 0 to {self.unnamed - 1}"]
        if self.missing:
            lines += ["", "# no column was found for these: write its name and unit, and remove the #",
                      *(f'# {_key(name)} = {{ column = "?", unit = "{unit}" }}' for name, unit in self.missing.items())]
        if self.unused:
            lines += ["", "# no channel was found for the columns:",
                      *(self._unused_line(label) for label in self.unused)]
        for each in clocks:
            lines += ["", f"[clocks.{json.dumps(each.column.sheet.name, ensure_ascii=False)}]", self._line("t", each),
                      '# delay = "0 ms ± 50 ms"  # if its clock is not that of the others: it is estimated with these']
        return "\n".join(lines) + "\n"

    def _unused_line(self, label: str) -> str:
        line = f"# {json.dumps(label, ensure_ascii=False)}"
        return f"{line}  # {self.question(label)} Its name does not say" if label in self.possible else line

    def question(self, label: str) -> str:
        """Which of the possible channels a column is, as a question."""
        names = self.possible[label]
        return " or ".join([*names[:MOST], *([f"{len(names) - MOST} more"] if len(names) > MOST else [])]) + "?"

    def _line(self, key: str, each: Proposal) -> str:
        alone = each.column.sheet.header.count(each.column.header) == 1
        column = json.dumps(each.column.header, ensure_ascii=False) if alone else str(each.column.index)
        parts = [f"column = {column}", *([f'unit = "{each.unit}"'] if each.unit else [])]
        if self.several and each.channel != "t":
            parts.append(f"group = {json.dumps(each.column.sheet.name, ensure_ascii=False)}")
        line = f"{key} = {{ {', '.join(parts)} }}  # {each.sureness}: {each.reason}"
        return f"# {line}" if each.sureness == "guess" else line


def propose_map(path: str | Path, machine: Machine) -> MapProposal:
    """A column map of a log for a machine, of names, units and values of its columns.

    A column counts for a channel if its name says so by the words of `spellings.toml` and its unit and values allow
    it: angles within joint limits, lengths within strokes, pressures below relief. Its unit stands in brackets or is
    the last word of its header, see `unit_words`. A unit that the file does not state, or states by a word with
    several meanings, is taken if one alone allows the values, or gravity those of IMUs. Angles and lengths that agree
    through a cylinder's triangle are sure, and guesses if they contradict each other there.

    Raises:
        LogError: the file is damaged or of an unknown kind.
    """
    wanted = {name: si for name, si in machine.channel_units.items() if name.rpartition(".")[2] not in LEFT_OUT}
    model = recent_model(machine)
    names = ChannelNames(wanted, _upright(model))
    with open_files([str(path)], None) as (sheets, _):
        columns = [column for sheet in sheets for column in _columns(sheet, names)]
        own = all(sheet.own_stamps for sheet in sheets)
        several = len(sheets) > 1
        layout, unnamed = _layout(sheets), max(sheet.unnamed for sheet in sheets)
        times = [] if own else [each for sheet in sheets if not sheet.own_stamps
                                for each in _time(sheet, columns)]
    rest = [column for column in columns if column not in [each.column for each in times]]
    ranges = _ranges(machine)
    found = _by_triangles(model, _by_number(machine, rest, ranges) | _by_name(
        names, rest, ranges, machine.gravity, times))
    found = _loud_enough(found, wanted)
    taken = {(each.column.sheet.name, each.column.index) for each in found.values()}
    usual = {*(f"{joint}.q" for joint in machine.joints),
             *(chamber for each in machine.hydraulic_actuators for chamber in each.chambers)}
    unused = [column for column in rest if (column.sheet.name, column.index) not in taken]
    free = [name for name in wanted if name not in found]
    possible = {column.label: some for column in unused if (some := _possible(names, column.named, free, usual))}
    missing = {name: _stated_unit(wanted[name], [*(each for each in unused if name in possible.get(each.label, ())),
                                                 *rest]) for name in free if name in usual}
    return MapProposal(
        str(path), machine.name, (*times, *(found[name] for name in wanted if name in found)), missing,
        tuple(column.label for column in unused), own, several, possible, layout, unnamed)


def _upright(model: Model) -> frozenset[str]:
    """The joints about whose axes gravity has no torque, so that no inclination is their angle."""
    limits = [model.machine.link(joint).joint for joint in model.machine.joints]
    middle = [0.5 * ((each.lower or 0.0) + (each.upper or 0.0)) for each in limits]
    torques = np.abs(np.asarray(model.gravity_torques(middle, model.parameters.nominal))).ravel()
    return frozenset(joint for joint, torque in zip(model.machine.joints, torques, strict=True)
                     if torque < np.finfo(float).eps ** 0.5 * torques.max())


def _stated_unit(si: str, columns: Iterable[ColumnOf]) -> str:
    """The unit of the first of these columns that states one of a kind; the SI unit where none does."""
    return next((unit for column in columns for unit in of_kind(column.named.units, si)), si)


def _layout(sheets: Sequence[Sheet]) -> dict[str, str | int | bool]:
    """What the layouts of all tables of text have in common, but what is the same in nearly all files."""
    layouts = [layout.model_dump(exclude_none=True) for sheet in sheets if (layout := sheet.layout) is not None]
    usual = {"comment": "", "quote": '"', "thousands": "", "footer": 0}
    return {key: value for key, value in (layouts[0] if layouts else {}).items()
            if usual.get(key) != value and all(each.get(key) == value for each in layouts)}


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


def _possible(names: ChannelNames, named: Naming, free: Sequence[str], usual: Collection[str]) -> tuple[str, ...]:
    """Which of the free channels a header may stand for, the usual ones alone if there are such."""
    found = tuple(name for name in free if names.may_be(name, named)
                  and (of_kind(named.units, names.channels[name]) if named.units else name in usual))
    return tuple(name for name in found if name in usual) or found


def _key(channel: str) -> str:
    return channel if channel == "t" else f'"{channel}"'


def _columns(sheet: Sheet, names: ChannelNames) -> Iterator[ColumnOf]:
    """The columns of a sheet that hold numbers or dates."""
    for index, header in enumerate(sheet.header or map("column {}".format, range(sheet.unnamed))):
        try:
            table = sheet.read([index], time=index)
        except DateOrderError:
            yield ColumnOf(sheet, index, header, names.naming(header, sheet.name), np.arange(2.0), dated=True,
                           ordered=False)
            continue
        except NoNumbersError:
            continue
        values = table.columns[index]
        if np.isfinite(values).any():
            dated = table.stamps is not None and not table.stamps.unit
            yield ColumnOf(sheet, index, header, names.naming(header, f"{sheet.name} {sheet.title}"), values, dated)


def _time(sheet: Sheet, columns: Sequence[ColumnOf]) -> list[Proposal]:
    """The time of a sheet: the column that is named so, or alone has a unit of time, and increases."""
    held = [column for column in columns if column.sheet == sheet]
    named = [column for column in held if column.dated or column.named.is_time]
    increasing = [each for each in named if _increases(each)] or named
    if not increasing:
        clocks = [each for each in held if of_kind(each.named.units, "s") and _increases(each)]
        return [Proposal("t", each, each.named.units[0], "likely", f"the only column in a unit of time, "
                         f"{_shown(each, each.named.units[0])}, that increases") for each in clocks[:len(clocks) == 1]]
    column = increasing[0]
    if not column.ordered:
        return [Proposal("t", column, "", "guess", "dates whose day or month may come first: state dates = 'day first' "
                         "or 'month first' above [columns]")]
    if column.dated:
        return [Proposal("t", column, "", "sure", "holds dates or times of day")]
    several: Sureness = "sure" if len(increasing) == 1 else "likely"
    if stated := of_kind(column.named.units, "s"):
        return [Proposal("t", column, stated[0], several, f"named as the time in {_shown(column, stated[0])}, and "
                         "increases")]
    if (unit := stamps.epoch_unit(column.values)) is not None:
        return [Proposal("t", column, unit, "likely", f"an epoch in {unit}: another unit would be no date of this age")]
    step = float(np.nanmedian(np.diff(column.values)))
    said = f"named as a time without a unit; its step is {step:.4g}"
    fitting = [unit for unit, ticks in stamps.EPOCHS.items() if step > 0 and LEAST_RATE <= ticks / step <= MOST_RATE]
    if len(fitting) == 1 and _increases(column):
        return [Proposal("t", column, fitting[0], "likely", f"{said}, as of a log in {fitting[0]} alone")]
    return [Proposal("t", column, "s" if step < 1 else "ms", "guess", said)]


def _increases(column: ColumnOf) -> bool:
    values = column.values[np.isfinite(column.values)]
    return bool(np.all(np.diff(values) >= 0) and values[0] < values[-1])


def _by_name(names: ChannelNames, columns: Sequence[ColumnOf], ranges: Mapping[str, Range], gravity: float,
             times: Sequence[Proposal]) -> dict[str, Proposal]:
    """The best column of each channel by its name, judged by unit and values; a guess if there are several."""
    scores = {channel: [(score, column) for column in columns if (score := names.fit(channel, column.named))]
              for channel in names.channels}
    named = [column for found in scores.values() for _, column in found]
    for column in columns:
        if column not in named and (alone := names.fit_alone(column.named)):
            scores[alone].append((1, column))
    usual = _inferred_units(ranges, {channel: [column for score, column in found if score > 1]
                                     for channel, found in scores.items()}, names.channels)
    usual |= _by_gravity(gravity, scores, times)
    made = [(score, each) for channel, si in names.channels.items() for score, column in scores[channel]
            if (each := _judged(channel, si, column, score, usual.get(si, (si,)), ranges.get(channel)))]
    best: dict[str, int] = {}
    for score, each in made:
        best[each.channel] = max(score, best.get(each.channel, 0))
    chosen: dict[str, Proposal] = {}
    top = [each for score, each in made if score == best[each.channel]]
    for each in top:
        if each.channel not in chosen:
            others = [f"'{other.column.header}' may be it" for other in top
                      if other.channel == each.channel and other is not each]
            channels = [f"it may be {other.channel}" for other in top if other.column is each.column
                        and other is not each and best[other.channel] >= best[each.channel]]
            chosen[each.channel] = each if not others + channels else replace(
                each, sureness="guess", reason=f"{each.reason}; {(others + channels)[0]}, too")
    return chosen


def _by_number(machine: Machine, columns: Sequence[ColumnOf], ranges: Mapping[str, Range]) -> dict[str, Proposal]:
    """Columns `q1` to `qn` or `joint 1 [deg]` as guesses for the n joints, in the machine file's order."""
    numbered: dict[int, list[ColumnOf]] = {}
    for column in columns:
        for reading in column.named.readings:
            number = [int(word) for kind, word in reading if kind == "numbers"]
            rest = {word for word in reading if word[0] != "numbers"}
            angle = rest & ANGLES or of_kind(column.named.units, "rad")
            if len(number) == 1 and angle and rest <= {("devices", "joint"), *ANGLES}:
                numbered.setdefault(number[0], []).append(column)
                break
    count = len(machine.joints)
    if sorted(numbered) != list(range(1, count + 1)) or any(len(each) > 1 for each in numbered.values()):
        return {}
    return {channel: replace(each, sureness="guess", reason=f"number {k} of {count} in the machine file's order")
            for k, channel in enumerate(map("{}.q".format, machine.joints), 1)
            if machine.channel_units.get(channel) == "rad"
            and (each := _judged(channel, "rad", numbered[k][0], 2, TRIED["rad"], ranges.get(channel)))}


def _inferred_units(ranges: Mapping[str, Range], named: Mapping[str, Sequence[ColumnOf]],
                    si: Mapping[str, str]) -> dict[str, tuple[str, ...]]:
    """The usual units of each kind that allow all columns without a unit: a logger writes all of a kind in one.

    Angles, lengths and pressures are then within their ranges and move, or the highest is a pressure of a hydraulic
    machine. Columns that no unit allows do not count. Where units differ from column to column, all usual ones.
    """
    units = dict(TRIED)
    for kind in ("rad", "m", "Pa"):
        columns = [(ranges.get(channel), column.values) for channel, found in named.items() if si[channel] == kind
                   for column in found if not column.named.units]
        allowed = [fitting for low_high, values in columns if (fitting := [
            unit for unit in _fitting(low_high, kind, values, TRIED[kind])
            if kind == "Pa" or _shows(low_high, kind, values, unit)])]
        highest = max((float(np.nanmax(values)) for _, values in columns), default=0.0)
        together = tuple(unit for unit in TRIED[kind] if all(unit in each for each in allowed)
                         and (kind != "Pa" or highest * factor(unit, "Pa") >= LEAST_PRESSURE))
        units[kind] = together or TRIED[kind]
    return units


def _shows(low_high: Range | None, si: str, values: Array, unit: str) -> bool:
    """Whether values in a unit are a pressure above `SILENT`, or move by more than a range may be left by."""
    if si == "Pa":
        return bool(np.nanmax(values) * factor(unit, si) >= SILENT)
    return low_high is None or bool(np.ptp(values[np.isfinite(values)]) * factor(unit, si) >=
                                    BEYOND * (low_high[1] - low_high[0]))


def _by_gravity(gravity: float, scores: Mapping[str, Sequence[tuple[int, ColumnOf]]],
                times: Sequence[Proposal]) -> dict[str, tuple[str, ...]]:
    """The units of accelerations and rates of which all IMUs measure gravity, and turn it at their own rates.

    A gravity a that stands still turns by ȧ = −ω × a in the axes of an IMU, over one second here.
    """
    named = {channel: [column for score, column in found if score > 1] for channel, found in scores.items()}
    sizes: dict[str, list[float]] = {"m/s^2": []}
    fit = np.zeros(4)
    for name in dict.fromkeys(channel.rpartition(".")[0] for channel in named if channel.endswith(".accel_x")):
        accelerations, rates = ([found[0] for end in ends for found in [named.get(f"{name}.{end}", [])]
                                 if len(found) == 1] for ends in (ACCELEROMETER, GYROSCOPE))
        if len(accelerations) < 3:
            continue
        lengths = np.linalg.norm([each.values for each in accelerations], axis=0)
        length = float(np.nanmedian(lengths))
        if not any(each.named.units for each in accelerations):
            sizes["m/s^2"].append(length / gravity)
        sheet = accelerations[0].sheet
        clock = next((each for each in times if each.column.sheet == sheet), None)
        if clock is None or len(rates) < 3 or any(each.named.units or each.sheet != sheet for each in rates):
            continue
        t = clock.column.values * (factor(clock.unit, "s") if clock.unit else 1.0)
        values = np.array([each.values for each in (*accelerations, *rates)]).T
        sound = np.isfinite(values).all(axis=1) & np.isfinite(t)
        t, a, rate = t[sound], values[sound, :3] / length, values[sound, 3:]
        later = np.searchsorted(t, t + 1.0)
        start = np.flatnonzero(later < len(t))
        change, turn = (each[later[start]] - each[start] for each in (
            a, cumulative_trapezoid(-np.cross(rate, a), t, axis=0, initial=0)))
        fit += np.sum(turn * change), np.sum(turn**2), np.sum(change**2), np.ptp(t)
    if fit[0] > 0 and fit[0] ** 2 * fit[3] > NEAR**2 * fit[1] * fit[2]:
        sizes["rad/s"] = [fit[1] / fit[0]]
    near = {si: [unit for unit in TRIED[si] if 1 / NEAR < np.median(size) * factor(unit, si) < NEAR]
            for si, size in sizes.items() if size}
    return {si: tuple(units) or TRIED[si] for si, units in near.items()}


def _fitting(low_high: Range | None, si: str, values: Array, units: Sequence[str]) -> list[str]:
    """Of the units, those in which the values are within a channel's range; all usual ones where it has none."""
    if low_high is None:
        return [*units] if si in TRIED else []
    return [unit for unit in units if _within(values * factor(unit, si), low_high)]


def _judged(channel: str, si: str, column: ColumnOf, score: int, usual: Sequence[str],
            low_high: Range | None) -> Proposal | None:
    """The proposal of a column that is named as a channel; None where its unit is of another kind.

    Args:
        usual: the units that a column without one may have; `low_high`: the channel's range.
    """
    named, values, stated = column.named, column.values, of_kind(column.named.units, si)
    if named.units and not stated:
        return None
    said = {3: "named as the channel", 2: "part and quantity in its name", 1: "part or quantity inferred"}[score]
    sureness: Sureness = "guess"
    if len(stated) == 1:
        unit, scale = stated[0], factor(stated[0], si)
        said = f"{said}, in {_shown(column, unit)}"
        if low_high in (None, TURNS) or _within(values * scale, low_high):
            sureness = "sure" if score > 1 else "likely"
            said += ", values within its range" if low_high not in (None, TURNS) else ""
        else:
            least, most = np.nanmin(values), np.nanmax(values)
            said += (f", but its values from {least:.4g} to {most:.4g} {unit} are not within "
                     f"{low_high[0] / scale:.4g} to {low_high[1] / scale:.4g} {unit}")
        return Proposal(channel, column, unit, sureness, said)
    fitting, tried = (_fitting(low_high, si, values, units) for units in (stated or usual, TRIED.get(si, (si,))))
    shown = fitting if stated else [unit for unit in fitting if _shows(low_high, si, values, unit)]
    unit = (fitting or stated or [si])[0]
    if stated:
        said += f", '{named.text}' may be {' or '.join(stated)}"
    if len(shown) == 1 and score > 1 and (stated or len(usual) == 1):  # else columns of a kind contradict each other
        who = ("its values allow" if stated or len(tried) == 1 else "gravity allows" if low_high is None else
               "all columns of its kind without a unit together allow")
        unit, sureness = shown[0], "likely"
        said += f"; of {'these' if stated else 'the usual units'} {who} {unit} alone"
    elif stated:
        said += ": write the right unit"
    else:
        said += f", without a unit ({' or '.join(tried) if tried else 'none of the usual ones fits'})"
    return Proposal(channel, column, unit, sureness, said)


def _shown(column: ColumnOf, unit: str) -> str:
    """A unit, with the word that was read as it."""
    return unit if column.named.text == unit else f"{unit} ('{column.named.text}')"


def _ranges(machine: Machine) -> dict[str, Range]:
    """Lowest and highest value [SI] of the channels that have such; of a joint without limits a turn either way."""
    found: dict[str, Range] = {channel: (-1e5, 1.1 * MOST_PRESSURE) for channel, si in machine.channel_units.items()
                               if si == "Pa"}
    for each in machine.hydraulic_actuators:
        found |= dict.fromkeys(each.chambers, (-1e5, 1.1 * (each.relief_pressure or MOST_PRESSURE)))
    for cylinder in machine.cylinders:
        found[f"{cylinder.name}.length"] = cylinder.dead_length, cylinder.dead_length + cylinder.stroke
    for channel in (f"{link.name}.q" for link in machine.links if f"{link.name}.q" in machine.channel_units):
        joint = machine.link(channel[:-2]).joint
        if joint.lower is not None and joint.upper is not None:
            found[channel] = joint.lower, joint.upper
        elif machine.channel_units[channel] == "rad":
            found[channel] = TURNS
    return found


def _within(values: Array, low_high: Range) -> bool:
    finite = values[np.isfinite(values)]
    margin = BEYOND * (low_high[1] - low_high[0])
    low, high = np.quantile(finite, (0.001, 0.999))
    return bool(low_high[0] - margin <= low and high <= low_high[1] + margin)


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
