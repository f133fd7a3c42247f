"""Headers `name [unit]` of the columns of a file, CSV or Parquet: which channel a column holds, in which unit."""

from hydroopt.errors import LogError
from hydroopt.logs.channels import si_unit
from hydroopt.logs.column_map import ColumnMap, Labels, LogMap, TextColumn
from hydroopt.logs.unit_words import of_kind, units_of
from hydroopt.machine.quantity import CHANNEL_UNITS
from hydroopt.units import UnitError


def parts_of(header: str) -> tuple[str, str | None]:
    """Name and unit of a header `name [unit]`; the header itself and None of any other.

    >>> parts_of("boom.q [deg]"), parts_of("boom.q"), parts_of("position[boom] [rad or m]")
    (('boom.q', 'deg'), ('boom.q', None), ('position[boom]', 'rad or m'))
    """
    header = header.strip()
    name, found, rest = header.rpartition("[")
    if not found or not rest.endswith("]") or "]" in rest[:-1] or name.count("[") != name.count("]"):
        return header, None
    return name.rstrip(), rest[:-1]


def map_of_header(header: list[str], where: str, *, poses: bool = False,
                  timed: bool = False) -> tuple[LogMap, tuple[str, ...]]:
    """Map of a file with headers `name [unit]`, and the names of columns that are no channels and are left out.

    A table of `poses` needs no time, may have labels (`stage`, `fixture`, `pose`, `tape`, without unit) and no other
    columns: one might be a misspelt label, without which its poses would be taken for others. Nor does a `timed` file
    need one, which has stamps of its own.

    Raises:
        LogError: no time, a missing or unsuitable unit, an unknown suffix, or a name that stands twice.
    """
    columns: dict[str, ColumnMap] = {}
    labels: dict[str, TextColumn] = {}
    ignored: list[str] = []
    for index, text in enumerate(header):
        name, unit = parts_of(text)
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
            meant = of_kind(units_of(unit), *CHANNEL_UNITS.get(name.rpartition(".")[2], ("s",)))
            if len(meant) > 1:
                raise LogError(f"the unit '{unit.strip()}' may be {' or '.join(meant)}", where=here,
                               remedy=f"write its header as '{name} [{meant[0]}]' or '{name} [{meant[1]}]'")
            unit = meant[0] if meant else unit.strip()
            si_unit(name, unit)
        except (LogError, UnitError) as error:
            raise LogError(error.what, where=here, remedy=error.remedy) from None
        columns[name] = ColumnMap(column=index, unit=unit)
    if "t" not in columns and not (poses or timed):
        shown = ", ".join(f"'{name.strip()[:40]}'" for name in header[:12])
        raise LogError(f"there is no column 't [s]' among {shown}", where=where,
                       remedy="name the time column 't [s]' or give a map of the columns with --map, which "
                       "hydroopt map proposes")
    return LogMap(columns=columns, labels=Labels(**labels) if poses else None), tuple(ignored)
