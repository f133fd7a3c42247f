"""How the columns of a file become channels: by headers `name [unit]`, or by a TOML map for foreign files."""

import re
import tomllib
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError, field_validator, model_validator

from hydroopt.errors import HydrooptError, LogError
from hydroopt.quantity import CHANNEL_UNITS
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


class LogMap(BaseModel):
    """What stands where in a foreign file; read from TOML by `read_map`."""

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True)

    format: Literal["csv", "parquet", "mat"] | None = None
    header: bool = True
    delimiter: str = ","
    decimal: Literal[".", ","] = "."
    rows: Annotated[tuple[Annotated[int, Field(ge=1)], Annotated[int, Field(ge=1)]],
                    Field(strict=False)] | None = None
    columns: dict[str, ColumnMap]

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
        if "t" not in self.columns:
            raise ValueError("channel 't' is missing")
        for name, column in self.columns.items():
            try:
                column.shift(si_unit(name, column.unit), f"columns.{name}")
            except HydrooptError as error:
                raise ValueError(f"[columns] {name}: {error.what}, {error.remedy}") from None
        return self


def read_map(path: str | Path) -> LogMap:
    """Read a map of foreign columns.

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
        raise LogError(f"the map is not TOML ({error})", where=where, remedy="mend that line") from None
    try:
        return LogMap.model_validate(data)
    except ValidationError as error:
        first = error.errors()[0]
        key = ".".join(str(part) for part in first["loc"])
        message = {"missing": "this key is missing", "extra_forbidden": "this key is unknown"}.get(
            first["type"], first["msg"].removeprefix("Value error, "))
        raise LogError(f"{key + ': ' if key else ''}{message[0].lower()}{message[1:]}", where=where,
                       remedy=_remedy(first["type"], key)) from None


def map_of_header(header: list[str], where: str) -> tuple[LogMap, tuple[str, ...]]:
    """Map of a file with headers `name [unit]`, and the names of foreign columns that are left out.

    Raises:
        LogError: no time, a missing or unsuitable unit, an unknown suffix, or a name that stands twice.
    """
    columns: dict[str, ColumnMap] = {}
    ignored: list[str] = []
    for index, text in enumerate(header):
        match = _HEADER.match(text.strip())
        name, unit = (match["name"], match["unit"]) if match else (text.strip(), None)
        if name != "t" and "." not in name:
            ignored.append(text.strip())
            continue
        here = f"{where}, column {index + 1} '{text.strip()}'"
        if name in columns:
            raise LogError(f"channel '{name}' stands there twice", where=here,
                           remedy="remove or rename one")
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
    if "t" not in columns:
        shown = ", ".join(f"'{name.strip()[:40]}'" for name in header[:12])
        raise LogError(f"there is no column 't [s]' among {shown}", where=where,
                       remedy="name the time column 't [s]' or give a map of the columns with --map")
    return LogMap(columns=columns), tuple(ignored)


def _remedy(kind: str, key: str) -> str:
    if kind == "extra_forbidden":
        allowed = ColumnMap if key.startswith("columns.") else LogMap
        return "use one of " + ", ".join(allowed.model_fields)
    return "correct that key" if key else "correct the map"
