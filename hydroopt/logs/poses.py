"""Tables of poses: the machine stands still at each row, and some of its channels were read."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hydroopt.errors import LogError
from hydroopt.logs.channels import channel_table, refuse_other_units, si_unit
from hydroopt.logs.column_headers import map_of_header, parts_of
from hydroopt.logs.column_map import Labels, LogMap, TextColumn, read_map
from hydroopt.logs.formats.files import open_files, true_kind
from hydroopt.logs.formats.sheet import Sheet
from hydroopt.logs.frames import FrameSheet, Tabular
from hydroopt.logs.table import frozen, in_si, refuse_damage, stamps_of
from hydroopt.support.notebook_card import Card

if TYPE_CHECKING:
    import pandas as pd

__all__ = ["LogMap", "Poses", "joined", "read_map", "read_pose_files", "read_poses"]

Array = NDArray[np.float64]
Texts = NDArray[np.str_]
HEADER = 2**16
"""Longest header [bytes] of a table of text."""
_LABELS = ("stage", "fixture", "pose", "tape", "setup")
_BY_POSE = (*_LABELS, "t", "row", "file")


def _no_texts() -> Texts:
    return np.empty(0, np.str_)


@dataclass(frozen=True, eq=False, repr=False)
class Poses(Tabular):
    """Channels of N poses at rest. All arrays are frozen; those left out get the stated default.

    Attributes:
        name: short name, for tables and figures.
        stage: (N,) part of the procedure a pose belongs to; default '', not stated.
        fixture: (N,) what held or targeted the tip; default ''.
        pose: (N,) label of the pose; default, and where empty, the number of its row.
        tape: (N,) fixture at which the taped distances of the row end, whether or not it holds the tip; default ''.
        setup: (N,) set-up of the instruments whose poses are not known; default '', the only one.
        t: (N,) time [s], of dates since 1970; default NaN, not stated.
        channels: (N,) values by channel name such as ``boom.q`` or ``tip.x``, in SI; NaN where not read.
        units: SI unit by channel; defaults to the usual one of the suffix (rad for ``.q``).
        row: (N,) 1-based data row in its file; default 1..N.
        file: (N,) path of the file each row came from; default '', made.
        sha256: of those files' bytes, by path.

    Raises:
        LogError: there is no channel, its name is unknown, lengths differ, a value is infinite, or a unit is not SI.

    >>> Poses("hole 1", stage=np.array(["low", "low"]), channels={"boom.q": np.array([0.1, 0.2])})
    Poses('hole 1': 2 poses, 1 stage, 1 channel)
    >>> some = Poses("hole 1", channels={"boom.q": np.array([0.1, 0.2, 0.3])}).select([0, 2])
    >>> some.encoded().decode().splitlines()[-1]
    '"","","3",0.3'
    """

    noun: ClassVar = "table of poses"
    name: str
    stage: Texts = field(default_factory=_no_texts)
    fixture: Texts = field(default_factory=_no_texts)
    pose: Texts = field(default_factory=_no_texts)
    tape: Texts = field(default_factory=_no_texts)
    setup: Texts = field(default_factory=_no_texts)
    t: Array = field(default_factory=lambda: np.empty(0))
    channels: Mapping[str, Array] = field(default_factory=dict)
    units: Mapping[str, str] = field(default_factory=dict)
    row: NDArray[np.int64] = field(default_factory=lambda: np.empty(0, int))
    file: Texts = field(default_factory=_no_texts)
    sha256: Mapping[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if not self.channels:
            raise LogError("there is no channel", where=self.name,
                           remedy="add columns such as 'boom.q [deg]' or 'tip.x [m]'")
        channels = {name: frozen(x, float) for name, x in self.channels.items()}
        size = next(iter(channels.values())).size
        row = frozen(self.row if np.size(self.row) else np.arange(1, size + 1), int)
        if np.size(self.t) and np.asarray(self.t).dtype.kind not in "fiu":
            raise LogError(f"the time holds {np.asarray(self.t).dtype}, not seconds", where=self.name,
                           remedy="make the table by Poses.from_frame(frame, units={...})")
        t = frozen(self.t if np.size(self.t) else np.full(size, np.nan), float)
        texts = {name: _texts(getattr(self, name), size) for name in _LABELS}
        file = frozen(self.file if np.size(self.file) else np.full(size, ""), np.str_)
        for name, x in {"t": t, "row": row, "file": file, **texts, **channels}.items():
            if x.shape != (size,):
                raise LogError(f"'{name}' has shape {x.shape}, the first channel ({size},)", where=self.name,
                               remedy="give all of them the same length")
        for name, x in {"t": t, **channels}.items():
            if (bad := np.flatnonzero(np.isinf(x))).size:
                raise LogError(f"'{name}' is infinite", where=f"{file[bad[0]] or self.name}, data row {row[bad[0]]}",
                               remedy="correct the cell, or leave it empty if nothing was read")
        texts["pose"] = frozen(np.where(texts["pose"] == "", row.astype(np.str_), texts["pose"]), np.str_)
        refuse_other_units(self.units, channels, "table of poses", self.name)
        units = {name: self.units.get(name) or si_unit(name) for name in channels}
        for name, value in {**texts, "t": t, "channels": channels, "units": units, "row": row, "file": file}.items():
            object.__setattr__(self, name, value)

    def __repr__(self) -> str:
        counts = {"pose": len(self), "stage": len(set(self.stage.tolist()) - {""}), "channel": len(self.channels)}
        said = ", ".join(f"{count} {noun}{'s' * (count != 1)}" for noun, count in counts.items() if count)
        return f"Poses('{self.name}': {said or 'none'})"

    def card(self) -> Card:
        """What a notebook shows: channels with their ranges, and stages."""
        facts = {what: ", ".join(found) for what, found in (
            ("stages", sorted({*self.stage.tolist()} - {""})), ("fixtures", sorted({*self.fixture.tolist()} - {""})),
            ("files", list(self.sha256))) if found}
        return Card(repr(self), facts, [channel_table(self.channels, self.units)])

    def __len__(self) -> int:
        return int(self.row.size)

    def select(self, which: ArrayLike) -> Poses:
        """The poses where a mask (N,) is True, or those of the 0-based indices (M,), in that order; may be none."""
        index = np.asarray(which)
        index = np.arange(len(self))[index if index.dtype == bool else index.astype(int)]
        kept = {name: getattr(self, name)[index] for name in _BY_POSE}
        return replace(self, **kept, channels={name: x[index] for name, x in self.channels.items()},
                       sha256={path: digest for path, digest in self.sha256.items() if path in kept["file"]})

    @classmethod
    def from_frame(cls, frame: pd.DataFrame, *, units: Mapping[str, str] | None = None, name: str = "frame") -> Poses:
        """A table of poses of a pandas DataFrame.

        Args:
            frame: columns named ``boom.q [deg]``, or ``boom.q`` with a unit in `units`, and texts ``stage``,
                ``fixture``, ``pose``, ``tape``, ``setup``; empty cells mean "not read". A time is stated as for
                `Log.from_frame`.
            units: unit by name of the columns that have none in it.
            name: short name of the table.

        Raises:
            LogError: a column is no channel or label, has no unit, two units or no numbers.

        >>> import pandas as pd
        >>> frame = pd.DataFrame({"stage": ["low", "low"], "boom.q": [10.0, 20.0]})
        >>> poses = Poses.from_frame(frame, units={"boom.q": "deg"})
        >>> len(poses), poses.stage.tolist(), poses.units["boom.q"]
        (2, ['low', 'low'], 'rad')
        """
        return _of_sheet(FrameSheet(frame, units, name), None, name, {}, "", {})

    def columns(self) -> dict[str, NDArray[Any]]:
        """Its columns (N,): labels, those of time, tape and set-up where a pose has one, and ``name [SI unit]``.

        >>> poses = Poses("run", stage=["a", "a"], channels={"boom.q": [0.1, 0.2]})
        >>> poses.to_frame().columns.tolist()
        ['stage', 'fixture', 'pose', 'boom.q [rad]']
        """
        more = {name: texts for name, texts in (("tape", self.tape), ("setup", self.setup)) if np.any(texts != "")}
        time = {} if np.all(np.isnan(self.t)) else {"t [s]": self.t}
        channels = {f"{name} [{self.units[name]}]": x for name, x in self.channels.items()}
        return {"stage": self.stage, "fixture": self.fixture, "pose": self.pose, **more, **time, **channels}


def joined(parts: Sequence[Poses]) -> Poses:
    """All poses of several tables, in order; NaN where a table lacks a channel that another one has.

    Raises:
        LogError: there is no table, or two state a channel in units of different kinds.
    """
    if not parts:
        raise LogError("there is no table of poses", where="poses", remedy="give at least one")
    units: dict[str, str] = {}
    for part in parts:
        for name, unit in part.units.items():
            if units.setdefault(name, unit) != unit:
                raise LogError(f"channel '{name}' is in '{unit}' here and in '{units[name]}' in a table before",
                               where=next(iter(part.sha256), part.name), remedy="state it in units of one kind")
    names = list(dict.fromkeys(part.name for part in parts))
    return Poses(
        names[0] if len(names) == 1 else f"{names[0]} and {len(names) - 1} more",
        **{name: np.concatenate([getattr(part, name) for part in parts]) for name in _BY_POSE},
        channels={name: np.concatenate([part.channels.get(name, np.full(len(part), np.nan)) for part in parts])
                  for name in units},
        units=units,
        sha256={path: digest for part in parts for path, digest in part.sha256.items()})


def is_pose_table(path: str | Path) -> bool:
    """Whether the header of a file has labels of poses and no time; False for what cannot be read."""
    try:
        with open(path, "rb") as file:
            line = file.readline(HEADER)
        if line.isascii() and b"\0" not in line:
            names = {parts_of(cell.strip(' "\r\n'))[0] for cell in re.split("[,;\t]", line.decode())}
        else:
            with open_files([str(path)], None) as (sheets, _):
                names = {parts_of(cell)[0] for cell in sheets[0].header}
    except (OSError, LogError):
        return False
    return "t" not in names and bool(names & {"stage", "fixture", "pose"})


def read_poses(path: str | Path, *, mapping: LogMap | str | Path | None = None) -> Poses:
    """Read a table of poses from text, a spreadsheet or Parquet.

    Args:
        path: file with text columns `stage`, `fixture`, `pose`, `tape`, `setup` and columns `name [unit]` of channels
            and of the time `t`, of which at least one channel must be there. Empty cells and NaN mean "not read".
        mapping: for files with other headers, the map of their columns (`read_map` with ``poses=True``) and labels.

    Raises:
        LogError: the file is missing, damaged or not understood; the sentence names row and column.

    >>> from tempfile import TemporaryDirectory
    >>> with TemporaryDirectory() as directory:
    ...     file = Path(directory) / "poses.csv"
    ...     _ = file.write_text("stage,pose,boom.q [deg]\\nlow,a,180\\nlow,b,\\n")
    ...     poses = read_poses(file)
    >>> poses.pose.tolist(), poses.channels["boom.q"].round(4).tolist()
    (['a', 'b'], [3.1416, nan])
    """
    where = str(path)
    layout = mapping if isinstance(mapping, LogMap) or mapping is None else read_map(mapping, poses=True)
    if (true_kind(path, layout) or "").startswith("mat"):
        raise LogError("a .mat file has no columns of text", where=where, remedy="export it as .csv or .parquet")
    with open_files([where], layout) as (sheets, digest):
        if len(sheets) > 1:
            raise LogError(f"there are {len(sheets)} sheets or files", where=where,
                           remedy="save the table of poses alone")
        words = {"folder": Path(path).absolute().parent.name, "file": Path(path).stem}
        return _of_sheet(sheets[0], layout, Path(path).stem, words, where, {where: digest})


def _of_sheet(sheet: Sheet, layout: LogMap | None, name: str, words: Mapping[str, str], file: str,
              sha256: Mapping[str, str]) -> Poses:
    """The poses of a sheet by its header or a map, whose labels may hold `words` of the file's path."""
    layout = map_of_header(sheet.header, sheet.where, poses=True)[0] if layout is None else layout
    labels = dict(layout.labels or Labels())
    time = layout.columns["t"].column if "t" in layout.columns else None
    table = sheet.read(layout.keys, [each.column for each in labels.values() if isinstance(each, TextColumn)], time)
    values, units = in_si(layout, table, sheet.where)
    made = stamps_of(layout, table)
    if "t" in values and made is not None and made.start is not None:  # seconds since 1970, as in all tables
        values["t"] = values["t"] + made.start.astype("M8[ns]").astype(float) * 1e-9
    refuse_damage(table, sheet.where)
    if not units:
        raise LogError("there is no channel", where=sheet.where,
                       remedy="add columns such as 'boom.q [deg]' or 'tip.x [m]'")
    texts = {key: table.texts[label.column] if isinstance(label, TextColumn) else [label.format(**words)]
             * table.rows.size for key, label in labels.items()}
    return Poses(name, **{key: np.array(some) for key, some in texts.items()}, t=values.pop("t", np.empty(0)),
                 channels=values, units=units, row=table.rows, file=np.full(table.rows.size, file), sha256=sha256)


def read_pose_files(paths: Sequence[str | Path], *, mapping: LogMap | str | Path | None = None) -> Poses:
    """Read several tables of poses as one, each as `read_poses` does with the same `mapping`.

    Raises:
        LogError: as in `read_poses` and `joined`, or a file is named twice and its poses would count twice.

    >>> from tempfile import TemporaryDirectory
    >>> with TemporaryDirectory() as directory:
    ...     files = [Path(directory) / name for name in ("low.csv", "high.csv")]
    ...     for file in files:
    ...         Poses(file.stem, stage=np.array([file.stem]), channels={"boom.q": np.array([0.1])}).write(file)
    ...     poses = read_pose_files(files)
    >>> poses
    Poses('low and 1 more': 2 poses, 2 stages, 1 channel)
    """
    layout = mapping if isinstance(mapping, LogMap) or mapping is None else read_map(mapping, poses=True)
    read: set[Path] = set()
    for path in paths:
        if (real := Path(path).resolve()) in read:
            raise LogError("this file is named twice", where=str(path), remedy="name it once")
        read.add(real)
    return joined([read_poses(path, mapping=layout) for path in paths])


def _texts(values: ArrayLike, size: int) -> Texts:
    """Labels on one line without blanks around, so that they compare and can be written; '' where left out."""
    array = np.asarray(values)
    if not array.size:
        return frozen(np.full(size, ""), np.str_)
    return frozen(np.array([" ".join(str(text).split()) for text in array.ravel()]).reshape(array.shape), np.str_)
