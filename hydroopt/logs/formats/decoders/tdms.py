"""TDMS files of LabVIEW."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from nptdms import TdmsFile
from numpy.typing import NDArray

from hydroopt.logs.formats.decoders.content import Column, Content


def contents(path: Path) -> list[Content]:
    """The groups of a file, by length and step; channels with a step have stamps of their own."""
    file = TdmsFile.open(str(path))
    found = []
    for group in file.groups():
        alike: dict[tuple[int, float, str], list[Any]] = {}
        for channel in group.channels():
            if len(channel) > 1 and channel.dtype.kind in "fiumM":
                step = float(channel.properties.get("wf_increment", 0) or 0)
                moment = str(channel.properties.get("wf_start_time", ""))
                alike.setdefault((len(channel), step, moment), []).append(channel)
        for k, ((rows, step, _), channels) in enumerate(alike.items()):
            columns = [Column(channel.name, str(channel.properties.get("unit_string", "")).strip(),
                              partial(channel.__getitem__, slice(None))) for channel in channels]
            name = group.name if k == 0 else f"{group.name} {k + 1}"
            stamps = partial(_stamps, channels[0]) if step > 0 else None
            found.append(Content(name, columns, stamps, rows=rows))
    return found


def _stamps(channel: Any) -> NDArray[Any]:
    """Stamps (N,) of a channel with a constant step, as dates if it states its start."""
    properties = channel.properties
    t = float(properties.get("wf_start_offset", 0) or 0) + np.arange(len(channel)) * float(properties["wf_increment"])
    start = properties.get("wf_start_time")
    ticks = np.round(t * 1e9).astype("m8[ns]")
    return ticks if start is None or np.isnat(np.datetime64(start)) else np.datetime64(start, "ns") + ticks
