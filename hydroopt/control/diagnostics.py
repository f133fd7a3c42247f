"""What a reader should know before trusting a comparison of controllers."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from hydroopt.control.comparison import FEEDFORWARD, Comparison

ENOUGH_DB, ENOUGH_DEG = 6.0, 45.0
"""Gain and phase margins below which a loop is doubted."""


def doubts(comparison: Comparison) -> tuple[str, ...]:
    """What a reader should know before trusting a comparison, in plain words."""
    return (*_margins(comparison), *_runs(comparison))


def _margins(comparison: Comparison) -> Iterator[str]:
    for outcome in comparison.outcomes:
        for each in comparison.setting.plant.actuators:
            worst = [outcome.worst(each.actuator.name, key) for key in ("gain", "phase")]
            if outcome.kind == FEEDFORWARD and outcome is not comparison.feedforward:
                continue  # its loops are those of the best one
            if unstable := next((m for m in worst if m.damping < 0), None):
                yield (f"{outcome.name} does not hold the machine in the posture of {unstable.point}, which the motion "
                       "does not come to.")
                break
            gain, phase = 20 * np.log10(worst[0].gain), np.degrees(worst[1].phase)
            if gain < ENOUGH_DB or phase < ENOUGH_DEG:
                yield (f"{outcome.name} leaves the loop of {each.actuator.name} margins of only {gain:.1f} dB "
                       f"({worst[0].point}) and {phase:.0f} degrees ({worst[1].point}).")


def _runs(comparison: Comparison) -> Iterator[str]:
    limits = comparison.setting.demands.valves.limits
    for outcome in comparison.outcomes:
        if outcome.run.stopped:
            yield f"With {outcome.name} {outcome.run.stopped}."
        full = np.mean((outcome.run.u <= limits[0]) | (outcome.run.u >= limits[1]), axis=0)
        for k, each in enumerate(comparison.setting.plant.actuators):
            if full[k] > 0.01:
                yield (f"With {outcome.name} the valve of {each.actuator.name} is fully open "
                       f"{100 * full[k]:.0f} % of the time.")
