"""pandas DataFrames and Arrow tables as sheets of columns, and back: a user's own data and SI arrays."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from hydroopt.errors import LogError
from hydroopt.logs.channels import si_unit
from hydroopt.logs.column_headers import parts_of
from hydroopt.logs.formats.sheet import Sheet
from hydroopt.logs.table import encoded_columns, write_columns
from hydroopt.support.notebook_card import Shown

if TYPE_CHECKING:
    import pandas as pd
    import pyarrow as pa


class FrameSheet(Sheet):
    """The columns of a DataFrame or an Arrow table.

    Args:
        frame: columns named ``boom.q [deg]``, or ``boom.q`` with a unit in `units`. The time is a column ``t``, in
            a unit or as datetimes or timedeltas, or an index of datetimes or timedeltas.
        units: unit of columns without one in their name.
        where: what errors call the frame.

    Raises:
        LogError: a column has no unit or two, or the time is stated twice.
    """

    def __init__(self, frame: pd.DataFrame | pa.Table, units: Mapping[str, str] | None, where: str) -> None:
        import pandas as pd  # noqa: PLC0415 (import cost)

        if type(frame).__module__.partition(".")[0] == "pyarrow" and hasattr(frame, "to_pandas"):
            frame = frame.to_pandas()
        if not isinstance(frame, pd.DataFrame):
            raise LogError(f"this is a {type(frame).__name__}, not a pandas DataFrame or Arrow table", where=where,
                           remedy="give a DataFrame with columns such as 'boom.q [deg]'")
        if not len(frame):
            raise LogError("the frame has no rows", where=where, remedy="give at least one")
        names = [str(name).strip() for name in frame.columns]
        self._series = [frame.iloc[:, k] for k in range(len(names))]
        if _are_moments(frame.index):
            if any(parts_of(name)[0] == "t" for name in names):
                raise LogError("the time is stated both in a column and in the index", where=where,
                               remedy="remove one, for example with frame.reset_index(drop=True)")
            names, self._series = ["t", *names], [frame.index.to_series(), *self._series]
        stated = dict(units or {})
        header = [f"{parts_of(name)[0]} [s]" if _are_moments(series) else _header(name, stated.pop(name, None), where)
                  for name, series in zip(names, self._series, strict=True)]
        if stated:
            raise LogError(f"units are stated for {', '.join(map(repr, stated))}, but there is no such column",
                           where=where, remedy=f"correct the names; the columns are {', '.join(names[:20])}")
        super().__init__(where, header, len(frame))

    def values(self, index: int, rows: NDArray[np.int64], *, exact: bool = False) -> NDArray[Any]:
        """A column as numbers, missing ones NaN, or moments in UTC."""
        import pandas as pd  # noqa: PLC0415 (import cost)

        series = self._series[index]
        if exact and _are_moments(series):
            return np.asarray(series.dt.tz_convert(None) if isinstance(series.dtype, pd.DatetimeTZDtype) else series)
        if not pd.api.types.is_numeric_dtype(series.dtype) or pd.api.types.is_bool_dtype(series.dtype):
            raise self.no_numbers(index, series.dtype, "convert it, for example with pandas.to_numeric")
        whole = exact and series.dtype.kind in "iu" and not series.hasnans
        return np.asarray(series) if whole else np.asarray(series.to_numpy(dtype=float, na_value=np.nan))

    def texts(self, index: int, rows: NDArray[np.int64]) -> list[str]:
        """A column as texts, missing ones ''."""
        return list(map(str, self._series[index].astype(object).where(self._series[index].notna(), "")))


class Tabular(Shown):
    """What is written as columns, ``name [SI unit]``.

    Attributes:
        noun: what sentences call it.
    """

    noun: ClassVar[str]

    @abstractmethod
    def columns(self) -> dict[str, NDArray[Any]]:
        """Its columns (N,) by header."""

    def encoded(self, *, parquet: bool = False) -> bytes:
        """The content of the file that `write` writes, CSV or Parquet."""
        return encoded_columns(self.columns(), parquet=parquet)

    def write(self, path: str | Path) -> None:
        """Write as CSV or Parquet, by extension, with NaN as empty cells; complete or not at all.

        Raises:
            LogError: another extension, or the file cannot be written.
        """
        write_columns(path, self.columns(), self.noun)

    def to_frame(self) -> pd.DataFrame:
        """A pandas DataFrame (N rows) with the same columns, which `from_frame` reads back."""
        import pandas as pd  # noqa: PLC0415 (import cost)

        return pd.DataFrame({name: np.array(column) for name, column in self.columns().items()})


def all_of(given: Any, kinds: tuple[type, ...], noun: str, where: str) -> tuple[Any, ...]:
    """Logs, or one of them alone, as a tuple.

    Raises:
        LogError: something is none, such as a bare DataFrame; it says how to make a log of it.
    """
    items = tuple(given) if isinstance(given, Sequence) and not isinstance(given, str) else (given,)
    for item in items:
        if not isinstance(item, kinds):
            raise LogError(f"this is a {type(item).__name__}, not a {noun}", where=where,
                           remedy=f"read one by read_{kinds[0].__name__.lower()}(path), or make one by "
                                  f"{kinds[0].__name__}.from_frame(frame, units={{...}})")
    return items


def _header(name: str, unit: str | None, where: str) -> str:
    """The header `name [unit]` of a column; labels and columns that are no channels have no unit."""
    if name != parts_of(name)[0]:
        if unit is not None:
            raise LogError(f"column '{name}' has a unit in its name and '{unit}' in units", where=where,
                           remedy="state it once")
        return name
    if unit is None and (name == "t" or "." in name):
        raise LogError(f"column '{name}' has no unit", where=where,
                       remedy=f"name it '{name} [{si_unit(name)}]' or state units={{'{name}': '{si_unit(name)}'}}")
    return name if unit is None else f"{name} [{unit}]"


def _are_moments(values: pd.Series | pd.Index) -> bool:
    """Whether these are datetimes or timedeltas."""
    return getattr(values.dtype, "kind", "") in ("m", "M")
