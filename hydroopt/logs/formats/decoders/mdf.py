"""MDF files (ASAM measurement data, versions 2 to 4) of dSPACE, CANape, INCA and others."""

from __future__ import annotations

import logging
from datetime import UTC
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from asammdf import MDF
from numpy.typing import NDArray

from hydroopt.logs.formats.decoders.content import Column, Content


def contents(path: Path) -> list[Content]:
    """The channel groups of a file, with the stamps of their master channels."""
    logging.disable(logging.CRITICAL)
    file = MDF(path)
    moment = file.start_time
    if moment.tzinfo is not None:
        moment = moment.astimezone(UTC).replace(tzinfo=None)
    start = np.datetime64(moment, "ns")
    found: list[Content] = []
    groups: list[Any] = list(file.groups)
    for k, group in enumerate(groups):
        master = file.masters_db.get(k, -1)
        rows = int(group.channel_group.cycles_nr)
        columns = [Column(str(channel.name), str(getattr(channel, "unit", "") or "").strip(),
                          partial(_samples, file, k, j))
                   for j, channel in enumerate(group.channels) if j != master]
        if rows < 2 or not columns:
            continue
        name = str(getattr(group.channel_group, "acq_name", "") or f"group {k}")
        name = f"{name} {k}" if name in {each.name for each in found} else name
        found.append(Content(name, columns, partial(_stamps, file, k, start), rows=rows))
    return found


def _samples(file: Any, group: int, index: int) -> NDArray[Any]:
    signal = file.get(group=group, index=index)
    samples = np.asarray(signal.samples)
    if samples.dtype.kind == "S":  # numbers that stand for texts
        samples = np.asarray(file.get(group=group, index=index, raw=True).samples)
    if signal.invalidation_bits is not None and samples.ndim == 1:
        samples = np.where(np.asarray(signal.invalidation_bits, bool), np.nan, samples)
    return samples


def _stamps(file: Any, group: int, start: np.datetime64) -> NDArray[Any]:
    t = np.asarray(file.get_master(group), dtype=float)
    return start + np.round(t * 1e9).astype("m8[ns]")
