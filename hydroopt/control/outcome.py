"""What one controller achieves on a motion."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hydroopt.control.closed_loop import Run
from hydroopt.control.loop_margins import Margin
from hydroopt.control.loops import Loops
from hydroopt.control.model_variants import ModelVariant
from hydroopt.spatial.inertia import Array

PI, FEEDFORWARD, LQG = "pi", "feedforward", "lqg"


@dataclass(frozen=True, eq=False)
class Outcome:
    """What one controller achieved on the motion.

    Attributes:
        name: such as ``feedforward complete``.
        kind: `PI`, `FEEDFORWARD` or `LQG`.
        variant: the model and parameters that it uses.
        run: what the machine did.
        error: of the joints (N, n) [rad or m].
        tip: distance (N,) [m] of the last link's far end from where it should be.
        margins: of all loops at all points.
        loops: at the point with the smallest Nyquist distance.
    """

    name: str
    kind: str
    variant: ModelVariant
    run: Run
    error: Array
    tip: Array
    margins: tuple[Margin, ...]
    loops: Loops

    @property
    def in_cascade(self) -> bool:
        """Whether its loops are those of the cascade, which are the same whatever is fed forward."""
        return self.kind != LQG

    @property
    def uses_model(self) -> bool:
        """Whether it knows which forces the motion takes; without them it lags behind."""
        return self.kind != PI

    @property
    def tip_rms(self) -> float:
        """Root mean square [m] of the distance of the tip; infinite if the machine hit its stops."""
        return float(np.sqrt(np.mean(self.tip**2))) if not self.run.stopped else np.inf

    def worst(self, loop: str, key: str, points: Sequence[str] = ()) -> Margin:
        """The smallest margin of a loop by `key`, such as ``gain``, ``disk`` or ``damping``, at some points or all."""
        candidates = [margin for margin in self.margins
                      if margin.loop == loop and (not points or margin.point in points)]
        return min(candidates, key=lambda margin: float(getattr(margin, key)))
