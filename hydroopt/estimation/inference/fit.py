"""How closely a model follows readings."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Fit:
    """How well one channel is predicted: RMS error [N or N·m], variance accounted for, error relative to the signal.

    VAF is 1 − var(error)/var(signal) (Eq. 3.45); relative is ‖error‖/‖signal‖.
    """

    rms: float
    vaf: float
    relative: float
    unit: str
