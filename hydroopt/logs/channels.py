"""Channels of logs: which names there are, and the SI unit of each."""

from collections.abc import Iterable, Mapping

import numpy as np
from numpy.typing import NDArray

from hydroopt.errors import LogError
from hydroopt.machine.quantity import CHANNEL_UNITS
from hydroopt.support.notebook_card import CardTable, figure
from hydroopt.units import UnitError, factor, in_print

FORCES = frozenset({"force", "tau", "p_head", "p_rod", "p_a", "p_b"})
"""Ends of the names of channels that tell an actuator's force."""


def is_force(channel: str) -> bool:
    """Whether a channel tells the force of an actuator, which other actuators do without.

    >>> is_force("boom_cylinder.p_head"), is_force("boom.q")
    (True, False)
    """
    return channel.rpartition(".")[2] in FORCES


def si_unit(channel: str, unit: str | None = None) -> str:
    """SI unit of a channel such as ``boom.q``, of the kind of `unit` where the channel allows several.

    Raises:
        LogError: unknown suffix.
        UnitError: `unit` is of no kind that suits the channel.
    """
    kinds = ("s",) if channel == "t" else CHANNEL_UNITS.get(channel.rpartition(".")[2] if "." in channel else "")
    if kinds is None:
        raise LogError(f"'{channel}' is not a channel", where="channel",
                       remedy="use 't' or a name that ends in " + ", ".join(
                           f".{k}{'…z' * k.endswith('_x')}" for k in CHANNEL_UNITS if not k.endswith(("_y", "_z"))))
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


def channel_table(channels: Mapping[str, NDArray[np.float64]], units: Mapping[str, str]) -> CardTable:
    """Channels (N,) with their ranges in SI and the number of missing samples, for a notebook."""
    rows = []
    for name, values in channels.items():
        read = values[np.isfinite(values)]
        span = (figure(float(read.min())), figure(float(read.max()))) if read.size else ("", "")
        rows.append((name, in_print(units[name]), *span, str(values.size - read.size or "")))
    return CardTable(("channel", "unit", "smallest", "largest", "missing"), rows)
