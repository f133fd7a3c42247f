"""One channel of a log, in the unit that the machine has for it, and without gaps."""

from __future__ import annotations

import numpy as np

from hydroopt.errors import LogError
from hydroopt.logs.log import Log
from hydroopt.machine.machine import Machine
from hydroopt.spatial.inertia import Array


def reading(machine: Machine, log: Log, channel: str) -> Array:
    """Values (N,) of a log's channel in the SI unit that the machine has for it.

    Raises:
        LogError: the log has no such channel, or it measures another kind of quantity than the machine's joint.
    """
    values, have, want = log.channel(channel), log.units[channel], machine.channel_units[channel]
    if have != want:
        joint = channel.rpartition(".")[0]
        raise LogError(f"'{channel}' is of the kind '{have}', but the machine's joint '{joint}' is "
                       f"{machine.link(joint).joint.type} and needs '{want}'", where=log.path or log.name,
                       remedy="correct the column's unit or the joint's type")
    return values


def bridged(x: Array) -> Array:
    """Samples (N,) with a straight line where they hold no number.

    >>> bridged(np.array([1.0, np.nan, 3.0])).tolist()
    [1.0, 2.0, 3.0]
    """
    there, at = np.isfinite(x), np.arange(len(x))
    return x if there.all() else np.interp(at, at[there], x[there])
