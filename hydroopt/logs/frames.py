"""pandas DataFrames and Arrow tables as tables of columns, and back: a user's own data and SI arrays."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from hydroopt.errors import LogError
from hydroopt.logs.channels import si_unit
from hydroopt.logs.column_headers import map_of_header, parts_of
from hydroopt.logs.column_map import Labels, LogMap, TextColumn
from hydroopt.logs.stamps import of_column, of_datetimes
from hydroopt.logs.table import Array, Table, in_si

if TYPE_CHECKING:
    import pandas as pd
    import pyarrow as pa



def columns_of_frame(frame: pd.DataFrame | pa.Table, units: Mapping[str, str] | None, where: str, *,
                     poses: bool = False) -> tuple[Table, LogMap, tuple[str, ...], dict[str, Array], dict[str, str]]:
    """Raw table, layout, columns left out, values (N,) in SI with the time ``t``, and the SI unit of each channel.

    Args:
        frame: columns named ``boom.q [deg]``, or ``boom.q`` with a unit in `units`. The time is a column ``t``, in
            a unit or as datetimes or timedeltas, or an index of datetimes or timedeltas.
        units: unit of columns without one in their name.
        where: what errors call the frame.
        poses: whether it is a table of poses.

    Raises:
        LogError: a column has no unit, two units or no numbers; the time is missing or stated twice.
    """
    import pandas as pd  # noqa: PLC0415 (import cost)

    if type(frame).__module__.partition(".")[0] == "pyarrow" and hasattr(frame, "to_pandas"):
        frame = frame.to_pandas()
    if not isinstance(frame, pd.DataFrame):
        raise LogError(f"this is a {type(frame).__name__}, not a pandas DataFrame or Arrow table", where=where,
                       remedy="give a DataFrame with columns such as 'boom.q [deg]'")
    if not len(frame):
        raise LogError("the frame has no rows", where=where, remedy="give at least one")
    names = [str(name).strip() for name in frame.columns]
    series = [frame.iloc[:, k] for k in range(len(names))]
    moments = _moments(frame.index)
    if moments is not None:
        if any(parts_of(name)[0] == "t" for name in names):
            raise LogError("the time is stated both in a column and in the index", where=where,
                           remedy="remove one, for example with frame.reset_index(drop=True)")
        names, series = ["t", *names], [moments, *series]
    stated, header = dict(units or {}), []
    for k, name in enumerate(names):
        if (moment := _moments(series[k])) is not None:
            series[k] = moment
            header.append(f"{parts_of(name)[0]} [s]")
        else:
            header.append(_header(name, stated.pop(name, None), where, poses=poses))
    if stated:
        raise LogError(f"units are stated for {', '.join(map(repr, stated))}, but there is no such column", where=where,
                       remedy=f"correct the names; the columns are {', '.join(names[:20])}")
    layout, ignored = map_of_header(header, where, poses=poses)
    raw = {k: _numbers(series[k], names[k], where) for k in map(int, layout.keys)}  # type: ignore[arg-type]
    texts = {label.column: ["" if pd.isna(cell) else str(cell) for cell in series[int(label.column)]]
             for _, label in (layout.labels or Labels()) if isinstance(label, TextColumn)}
    epoch = None
    if "t" in layout.columns and isinstance(column := series[int(layout.columns["t"].keys[0])], pd.Series):  # type: ignore[arg-type]
        epoch = of_column(column.to_numpy())
    table = Table(dict(raw), np.arange(1, len(frame) + 1), texts=texts, stamps=epoch)  # type: ignore[arg-type]
    values, si = in_si(layout, table, where)
    return table, layout, ignored, values, si


def frame_of_columns(columns: Mapping[str, Any]) -> pd.DataFrame:
    """A DataFrame of columns (N,) by header."""
    import pandas as pd  # noqa: PLC0415 (import cost)

    return pd.DataFrame({name: np.array(column) for name, column in columns.items()})


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


def _header(name: str, unit: str | None, where: str, *, poses: bool) -> str:
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


def _numbers(series: Any, name: str, where: str) -> Array:
    """Values (N,) of a column, missing ones NaN."""
    import pandas as pd  # noqa: PLC0415 (import cost)

    if isinstance(series, np.ndarray):
        return series
    if not pd.api.types.is_numeric_dtype(series.dtype) or pd.api.types.is_bool_dtype(series.dtype):
        raise LogError(f"column '{name}' holds {series.dtype}, not numbers", where=where,
                       remedy="convert it, for example with pandas.to_numeric")
    return np.asarray(series.to_numpy(dtype=float, na_value=np.nan))


def _moments(values: Any) -> Array | None:
    """Seconds (N,) of datetimes, from the first on, or of timedeltas; None of anything else. Missing ones are NaN."""
    import pandas as pd  # noqa: PLC0415 (import cost)

    if isinstance(values, np.ndarray):
        return values
    dtype = values.dtype
    if isinstance(dtype, pd.DatetimeTZDtype):
        values = values.tz_convert("UTC").tz_localize(None) if isinstance(values, pd.Index) else (
            values.dt.tz_convert("UTC").dt.tz_localize(None))
    elif getattr(dtype, "kind", "") not in "mM":
        return None
    return of_datetimes(values.to_numpy()).seconds()
