"""Angles of the calibrator's joints in a log: they say that it was recorded with the calibrator attached."""

from __future__ import annotations

from hydroopt.logs.log import Log
from hydroopt.machine.machine import Machine


def calibrator_channels(machine: Machine, log: Log) -> set[str]:
    """The channels of a log that hold angles of the calibrator's joints; none where the calibrator has no bodies.

    >>> import hydroopt as ho
    >>> log = ho.Log("run", [0.0, 0.1], {"boom.q": [0.0, 0.1], "forearm.q": [0.0, 0.1]})
    >>> calibrator_channels(ho.load_machine("cat215b"), log)
    set()
    """
    links = machine.calibrator.links if machine.calibrator else ()
    if not any(link.body for link in links):
        return set()
    return {f"{link.name}.q" for link in links if link.joint.moving} & set(log.channels)
