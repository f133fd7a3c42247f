"""The wrench that the surroundings exert on the machine at its tip, as a log states it, and what it adds to forces."""

from __future__ import annotations

import numpy as np

from hydroopt.errors import LogError
from hydroopt.logs.forces_from_pressures import force_lags, forces
from hydroopt.logs.lag import lagged
from hydroopt.logs.log import Log
from hydroopt.machine.description import WRENCH
from hydroopt.model.model import Model
from hydroopt.spatial.inertia import Array


def wrench_channels(log: Log) -> set[str]:
    """The channels of the tip's wrench that a log has."""
    return set(WRENCH) & set(log.channels)


def tip_wrench(log: Log) -> Array | None:
    """The wrench (N, 6) [N, N·m] that a log states, see `WRENCH`; None if it states none.

    The tip is the far end of the machine's last link. A log without moments states a force that acts at the tip itself.

    Raises:
        LogError: some components of the force or of the moment are missing.

    >>> zero, force = [0.0, 0.0], [-4905.0, -4905.0]
    >>> log = Log("held load", [0.0, 0.1], {"tip.fx": zero, "tip.fy": zero, "tip.fz": force})
    >>> tip_wrench(log).tolist()
    [[0.0, 0.0, -4905.0, 0.0, 0.0, 0.0], [0.0, 0.0, -4905.0, 0.0, 0.0, 0.0]]
    """
    there = wrench_channels(log)
    if not there:
        return None
    needed = WRENCH if there & set(WRENCH[3:]) else WRENCH[:3]
    missing = [channel for channel in needed if channel not in there]
    if missing:
        raise LogError(f"the wrench at the tip lacks {', '.join(missing)}", where=log.path or log.name,
                       remedy="add them, with zeros where nothing acts, or leave out all channels of the tip's wrench")
    return np.column_stack([log.channel(channel) if channel in there else np.zeros(log.size) for channel in WRENCH])


def free_forces(model: Model, log: Log, q: Array) -> Array:
    """Measured forces (N, r) as if nothing touched the tip: measured ones minus what a stated wrench adds to them,
    with their lag.

    Args:
        model: the machine.
        log: with pressures or forces, and perhaps the wrench.
        q: (N, n) joint positions.

    Raises:
        LogError: a channel is missing.
    """
    wrench = tip_wrench(log)
    measured = forces(model, log, q)
    if wrench is None:
        return measured
    added = model.over(model.wrench_forces, q, wrench)[0][:, :, 0]
    lags = force_lags(model, log).tolist()
    return measured - np.column_stack([lagged(log.t, each, lag, log.segment)
                                       for each, lag in zip(added.T, lags, strict=True)])
