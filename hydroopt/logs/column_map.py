"""A column map: a TOML file that says which columns of a file with other headers are which channels."""

import re
from pathlib import Path
from typing import Annotated, Any, Literal, Self

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
from hydroopt.logs.channels import si_unit
from hydroopt.logs.clock import Clock
from hydroopt.logs.stamps import of_texts
from hydroopt.support.input_file import read_text, toml
from hydroopt.units import to_si

Key = str | int
FORMATS = {".csv": "csv", ".txt": "csv", ".dat": "csv", ".tsv": "csv", ".asc": "csv",
           ".parquet": "parquet", ".mat": "mat", ".h5": "hdf5", ".hdf5": "hdf5", ".hdf": "hdf5", ".npz": "npz",
           ".xlsx": "xlsx", ".xls": "xlsx", ".xlsb": "xlsx", ".ods": "xlsx", ".tdms": "tdms", ".mf4": "mdf",
           ".mdf": "mdf", ".bag": "bags", ".db3": "bags", ".mcap": "bags"}
"""Kinds of files, as a map may state them, by the ending of their names."""


class Stated(BaseModel):
    """A table of a map, in which no other key may stand."""

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True, defer_build=True)


class ColumnMap(Stated):
    """Where one channel stands in a file: value = factor × (column − minus) [unit] + offset.

    The offset alone is a value that holds throughout the file, such as the slope that the machine stood on. `group` is
    the sheet, topic or file in which the column stands, where several have one of that name, or a clock of the map. A
    time `t` of dates needs no unit. ``variable = "angles", row = 2`` is another way to write ``column = "angles[2]"``.
    """

    column: Key | None = None
    minus: Key | None = None
    group: str | None = None
    unit: str = ""
    factor: Annotated[float, Field(allow_inf_nan=False)] = 1.0
    offset: str | None = None

    @model_validator(mode="before")
    @classmethod
    def _variable(cls, data: Any) -> Any:
        """A column that is stated as a variable of a .mat file, or as a row of one."""
        if not isinstance(data, dict) or not {"variable", "row"} & data.keys():
            return data
        rest = {key: value for key, value in data.items() if key not in ("variable", "row")}
        variable, row = data.get("variable"), data.get("row", 0)
        if "column" in rest or not isinstance(variable, str):
            raise ValueError("give either 'column' or, for a .mat file, 'variable', a name, with its 'row'")
        if not isinstance(row, int) or row < 0:
            raise ValueError("'row' is a whole number from 0 on")
        return rest | {"column": f"{variable}[{row}]" if "row" in data else variable}

    @model_validator(mode="after")
    def _one_source(self) -> "ColumnMap":
        if self.column is None and (self.offset is None or self.minus is not None):
            raise ValueError("give either 'column' or, for a .mat file, 'variable', or for a constant 'offset' alone")
        if self.factor == 0:
            raise ValueError("'factor' is zero")
        return self

    @property
    def keys(self) -> tuple[Key, ...]:
        """Keys of the raw columns this channel needs."""
        return tuple(key for key in (self.column, self.minus) if key is not None)

    def shift(self, si: str, where: str) -> float:
        """The offset in the SI unit `si`."""
        return 0.0 if self.offset is None else to_si(self.offset, si, where=where)


class ClockMap(Stated):
    """The clock of a group: its own column of times, where it has one, and what its stamps lack.

    `start` is the moment of t = 0 of times without a date; `delay` and `drift` are as `Clock` has them.
    """

    t: ColumnMap | None = None
    start: str | None = None
    delay: str = "0 s"
    drift: str = "0 %"

    @model_validator(mode="after")
    def _sound(self) -> "ClockMap":
        try:
            Clock.of(self.delay, self.drift)
            if self.start is not None and of_texts([self.start], None, "start").start is None:
                raise ValueError(f"'{self.start:.40}' has no date")
            if self.t is not None:
                si_unit("t", self.t.unit or "s")
        except HydrooptError as error:
            raise ValueError(f"{error.what}, {error.remedy}") from None
        return self


class TextColumn(Stated):
    """A text column of a file."""

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


class Labels(Stated):
    """Texts that tell poses apart: constant, with {folder} and {file} of the file's path, or from a column."""

    stage: Label = ""
    fixture: Label = ""
    pose: Label = ""
    tape: Label = ""
    setup: Label = ""


class Layout(Stated):
    """The layout of a table of text. What is not stated is decided from the lines of the file, once, when it is opened.

    Attributes:
        header: whether a line has the names of the columns.
        skip: lines before the header, or before the first row of a table without one.
        units_row: whether the line below the header states units.
        footer: lines behind the last row.
        comment: what lines of comment begin with; empty of none.
        delimiter: one character or "whitespace"; `quote`: mark around cells, empty of none.
        decimal: mark of decimals; `thousands`: the one between thousands, empty of none.
        encoding: of the text, as Python calls it.
        dates: whether dates such as 03/04/2026 state the day or the month first.
    """

    header: bool | None = None
    skip: Annotated[int, Field(ge=0)] | None = None
    units_row: bool | None = None
    footer: Annotated[int, Field(ge=0)] | None = None
    comment: str | None = None
    delimiter: str | None = None
    quote: Literal["", '"', "'"] | None = None
    decimal: Literal[".", ","] | None = None
    thousands: Literal["", ".", ",", " ", "'"] | None = None
    encoding: str | None = None
    dates: Literal["day first", "month first"] | None = None

    @field_validator("encoding")
    @classmethod
    def _encoding(cls, value: str | None) -> str | None:
        try:
            "".encode(value or "utf-8")
        except (LookupError, ValueError):
            raise ValueError(f"'{value:.40}' is not an encoding of text") from None
        return value

    @field_validator("delimiter")
    @classmethod
    def _delimiter(cls, value: str | None) -> str | None:
        if value is not None and value != "whitespace" and (
                len(value) != 1 or not value.isascii() or value.isalnum() or value in "\r\n\0\"'+-."):
            raise ValueError("the delimiter is one character, such as ';', or 'whitespace'")
        return value

    @model_validator(mode="after")
    def _sound(self) -> Self:
        if self.decimal is not None and self.decimal == self.thousands:
            raise ValueError("'decimal' and 'thousands' are the same mark")
        if self.units_row and self.header is False:
            raise ValueError("'units_row' needs a header above the units, and 'header' is false")
        return self


class LogMap(Layout):
    """Map of the columns of a file with other headers; `read_map` reads it. Only tables of poses have `labels`.

    Attributes:
        format: kind of file, where its name does not say. The keys of a `Layout` are those of a table of text.
        rows: first and last 1-based data row to be read.
        columns: by channel; `labels`: texts of poses; `clocks`: by group of channels.
    """

    format: str | None = None
    rows: Annotated[tuple[Annotated[int, Field(ge=1)], Annotated[int, Field(ge=1)]],
                    Field(strict=False)] | None = None
    columns: dict[str, ColumnMap]
    labels: Labels | None = None
    clocks: dict[str, ClockMap] = {}

    @field_validator("format")
    @classmethod
    def _format(cls, value: str | None) -> str | None:
        if value is not None and value not in FORMATS.values():
            raise ValueError(f"'{value:.40}' is not one of {', '.join(dict.fromkeys(FORMATS.values()))}")
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
            if name == "t" and not column.unit:
                continue
            if not column.unit:
                raise ValueError(f"columns.{name}.unit: this key is missing")
            try:
                column.shift(si_unit(name, column.unit), f"columns.{name}")
            except HydrooptError as error:
                raise ValueError(f"[columns] {name}: {error.what}, {error.remedy}") from None
        return self

    @property
    def keys(self) -> list[Key]:
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
    data = toml(read_text(path, LogError, noun="map"), LogError, where=where)
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
        LogError: it has labels, which a log cannot keep.
    """
    if layout.labels is not None:
        raise LogError("labels belong to tables of poses, not to a log over time", where=where,
                       remedy="remove [labels] from the map")
    return layout


def _remedy(kind: str, key: str) -> str:
    if kind == "extra_forbidden":
        tables: dict[str, type[BaseModel]] = {"columns": ColumnMap, "labels": Labels, "clocks": ClockMap}
        allowed = tables.get(key.rpartition(".")[0].partition(".")[0], LogMap)
        return "use one of " + ", ".join(allowed.model_fields)
    return "correct that key" if key else "correct the map"
