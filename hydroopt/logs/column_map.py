"""How the columns of a file become channels: by headers `name [unit]`, or by a TOML map."""

import re
import tomllib
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import (
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    ValidationError,
    field_validator,
    model_validator,
)

from hydroopt.errors import HydrooptError, LogError
from hydroopt.machine.quantity import CHANNEL_UNITS
from hydroopt.units import UnitError, factor, to_si

Key = str | int
_HEADER = re.compile(r"^(?P<name>[^\[\]]*?)\s*(?:\[(?P<unit>[^\[\]]*)\])?$")


def si_unit(channel: str, unit: str | None = None) -> str:
    """SI unit of a channel such as ``boom.q``, of the kind of `unit` where the channel allows several.

    Raises:
        LogError: unknown suffix.
        UnitError: `unit` is of no kind that suits the channel.
    """
    kinds = ("s",) if channel == "t" else CHANNEL_UNITS.get(channel.rpartition(".")[2] if "." in channel else "")
    if kinds is None:
        raise LogError(f"'{channel}' is not a channel", where="channel",
                       remedy="use 't' or a name that ends in " + ", ".join(f".{k}" for k in CHANNEL_UNITS))
    if unit is None:
        return kinds[0]
    for kind in kinds:
        try:
            factor(unit, kind)
        except UnitError:
            continue
        return kind
    raise UnitError(f"'{unit}' does not suit channel '{channel}'", where="unit",
                    remedy=f"use {' or '.join(kinds)} or another unit of that kind")


def refuse_other_units(units: Mapping[str, str], names: Iterable[str], noun: str, where: str) -> None:
    """Refuse channels `names` that are stated in other units than SI ones.

    Raises:
        LogError: names the channel and its SI unit.
    """
    for name in names:
        unit, usual = units.get(name), si_unit(name)
        if unit and unit not in CHANNEL_UNITS[name.rpartition(".")[2]]:
            raise LogError(f"channel '{name}' is stated in '{unit}', but a {noun} holds SI values only", where=where,
                           remedy=f"convert it to '{usual}', or make the {noun} by "
                                  f"from_frame(frame, units={{'{name}': '{unit}'}})")


class ColumnMap(BaseModel):
    """Where one channel stands in a file: value = factor × (column − minus) [unit] + offset."""

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True)

    column: Key | None = None
    minus: Key | None = None
    variable: str | None = None
    row: Annotated[int, Field(ge=0)] | None = None
    unit: str
    factor: Annotated[float, Field(allow_inf_nan=False)] = 1.0
    offset: str | None = None

    @model_validator(mode="after")
    def _one_source(self) -> "ColumnMap":
        if (self.column is None) == (self.variable is None):
            raise ValueError("give either 'column' or, for a .mat file, 'variable'")
        if self.variable is None and self.row is not None:
            raise ValueError("'row' belongs to a 'variable' of a .mat file")
        if self.variable is not None and self.minus is not None:
            raise ValueError("'minus' belongs to a 'column'")
        if self.factor == 0:
            raise ValueError("'factor' is zero")
        return self

    @property
    def keys(self) -> tuple["Key | tuple[str, int | None]", ...]:
        """Keys of the raw columns this channel needs."""
        if self.variable is not None:
            return ((self.variable, self.row),)
        assert self.column is not None
        return (self.column,) if self.minus is None else (self.column, self.minus)

    def shift(self, si: str, where: str) -> float:
        """The offset in the SI unit `si`."""
        return 0.0 if self.offset is None else to_si(self.offset, si, where=where)


class TextColumn(BaseModel):
    """A text column of a file."""

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True)

    column: Key


def _label(value: object) -> object:
    """Judged here, because of a union pydantic would name the branches instead of the fault."""
    if isinstance(value, TextColumn):
        return value
    if isinstance(value, str):
        if re.search("[{}]", re.sub(r"\{(folder|file)\}", "", value)):
            raise ValueError(f"'{value:.40}' has braces other than {{folder}} and {{file}}")
        return value
    try:
        return TextColumn.model_validate(value)
    except ValidationError:
        raise ValueError("a label is a text or { column = ... }") from None


Label = Annotated[str | TextColumn, BeforeValidator(_label)]


class Labels(BaseModel):
    """Texts that tell poses apart: constant, with {folder} and {file} of the file's path, or from a column."""

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True)

    stage: Label = ""
    fixture: Label = ""
    pose: Label = ""


class LogMap(BaseModel):
    """Map of the columns of a file with other headers; `read_map` reads it. Only tables of poses have `labels`."""

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True)

    format: Literal["csv", "parquet", "mat"] | None = None
    header: bool = True
    delimiter: str = ","
    decimal: Literal[".", ","] = "."
    rows: Annotated[tuple[Annotated[int, Field(ge=1)], Annotated[int, Field(ge=1)]],
                    Field(strict=False)] | None = None
    columns: dict[str, ColumnMap]
    labels: Labels | None = None

    @field_validator("delimiter")
    @classmethod
    def _delimiter(cls, value: str) -> str:
        if value != "whitespace" and len(value) != 1:
            raise ValueError("the delimiter is one character or 'whitespace'")
        return value

    @field_validator("rows")
    @classmethod
    def _rows(cls, value: tuple[int, int] | None) -> tuple[int, int] | None:
        if value is not None and value[1] <= value[0]:
            raise ValueError("'rows' is [first, last] with last > first")
        return value

    @model_validator(mode="after")
    def _channels(self) -> "LogMap":
        for name, column in self.columns.items():
            try:
                column.shift(si_unit(name, column.unit), f"columns.{name}")
            except HydrooptError as error:
                raise ValueError(f"[columns] {name}: {error.what}, {error.remedy}") from None
        return self

    @property
    def keys(self) -> "list[Key | tuple[str, int | None]]":
        """Keys of the raw columns that the channels need, each once."""
        return list(dict.fromkeys(key for column in self.columns.values() for key in column.keys))


def read_map(path: str | Path, *, poses: bool = False) -> LogMap:
    """Read a column map.

    Args:
        path: a TOML file.
        poses: whether it is for tables of poses, which need no time and may have labels.

    Raises:
        LogError: the file is missing, is not TOML, or a key is unknown, missing or of the wrong kind.
    """
    where = str(path)
    try:
        data: dict[str, Any] = tomllib.loads(Path(path).read_text(encoding="utf-8"))
    except OSError as error:
        raise LogError(f"the map cannot be read ({error.strerror or error})", where=where,
                       remedy="give the path of a TOML file") from None
    except (ValueError, RecursionError) as error:  # a ValueError is bad TOML, no text or a number of a thousand digits
        raise LogError(f"the map is not TOML ({error})", where=where, remedy="correct that line") from None
    try:
        layout = LogMap.model_validate(data)
    except ValidationError as error:
        first = error.errors()[0]
        key = ".".join(str(part) for part in first["loc"])
        message = {"missing": "this key is missing", "extra_forbidden": "this key is unknown",
                   "model_type": "this is not a table", "dict_type": "this is not a table"}.get(
            first["type"], first["msg"].removeprefix("Value error, "))
        raise LogError(f"{key + ': ' if key else ''}{message[0].lower()}{message[1:]}", where=where,
                       remedy=_remedy(first["type"], key)) from None
    return layout if poses else for_log(layout, where)


def for_log(layout: LogMap, where: str) -> LogMap:
    """The map itself, where a log can be read with it.

    Raises:
        LogError: it has no time, or labels, which a log cannot keep.
    """
    if "t" not in layout.columns:
        raise LogError("channel 't' is missing", where=where, remedy="correct the map")
    if layout.labels is not None:
        raise LogError("labels belong to tables of poses, not to a log over time", where=where,
                       remedy="remove [labels] from the map")
    return layout


def map_of_header(header: list[str], where: str, *, poses: bool = False) -> tuple[LogMap, tuple[str, ...]]:
    """Map of a file with headers `name [unit]`, and the names of columns that are no channels and are left out.

    A table of `poses` needs no time, may have labels (`stage`, `fixture`, `pose`, without unit) and no other columns:
    one might be a misspelt label, without which its poses would be taken for others.

    Raises:
        LogError: no time, a missing or unsuitable unit, an unknown suffix, or a name that stands twice.
    """
    columns: dict[str, ColumnMap] = {}
    labels: dict[str, TextColumn] = {}
    ignored: list[str] = []
    for index, text in enumerate(header):
        match = _HEADER.match(text.strip())
        name, unit = (match["name"], match["unit"]) if match else (text.strip(), None)
        here = f"{where}, column {index + 1} '{text.strip()}'"
        if name in columns or name in labels:
            raise LogError(f"{'channel' if name in columns else 'label'} '{name}' occurs twice", where=here,
                           remedy="remove or rename one")
        if poses and name in Labels.model_fields:
            if unit is not None:
                raise LogError("a label has no unit", where=here, remedy=f"write its header as '{name}'")
            labels[name] = TextColumn(column=index)
            continue
        if name != "t" and "." not in name:
            if poses:
                raise LogError("this is neither a channel nor a label", where=here, remedy="remove the column, name it "
                               f"as in 'boom.q [deg]' or {', '.join(Labels.model_fields)}, or give a map")
            ignored.append(text.strip())
            continue
        try:
            usual = si_unit(name)
            if not unit or not unit.strip():
                raise LogError("the column has no unit", where=here,
                               remedy=f"write its header as '{name} [{usual}]'")
            si_unit(name, unit.strip())
        except LogError as error:
            raise LogError(error.what, where=here, remedy=error.remedy) from None
        except UnitError as error:
            raise LogError(error.what, where=here, remedy=error.remedy) from None
        columns[name] = ColumnMap(column=index, unit=unit.strip())
    if "t" not in columns and not poses:
        shown = ", ".join(f"'{name.strip()[:40]}'" for name in header[:12])
        raise LogError(f"there is no column 't [s]' among {shown}", where=where,
                       remedy="name the time column 't [s]' or give a map of the columns with --map")
    return LogMap(columns=columns, labels=Labels(**labels) if poses else None), tuple(ignored)


def _remedy(kind: str, key: str) -> str:
    if kind == "extra_forbidden":
        tables: dict[str, type[BaseModel]] = {"columns": ColumnMap, "labels": Labels}
        allowed = tables.get(key.rpartition(".")[0].partition(".")[0], LogMap)
        return "use one of " + ", ".join(allowed.model_fields)
    return "correct that key" if key else "correct the map"
