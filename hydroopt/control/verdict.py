"""What is wrong with a motion or a loop before it is simulated, and what a reader should doubt afterwards."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

import numpy as np

from hydroopt.control.demand import Demand
from hydroopt.control.sampled import Margin
from hydroopt.control.valves import Valves
from hydroopt.errors import ProblemError
from hydroopt.inertia import Array
from hydroopt.model.plant import Plant
from hydroopt.synthetic import Trajectory

if TYPE_CHECKING:
    from hydroopt.control.comparison import Comparison

FEEDFORWARD = "feedforward"
ENOUGH_DB, ENOUGH_DEG = 6.0, 45.0
"""Gain and phase margins below which a loop is doubted."""


def refuse_flow(plant: Plant, motion: Trajectory) -> None:
    """Refuse a motion for which the pump is too small: growing chambers take what they sweep.

    Raises:
        ProblemError: tells the time, what is demanded and what there is.
    """
    machine, t = plant.machine, motion.t
    areas = np.array([each.areas for each in plant.actuators])
    speed = plant.model.over(plant.actuator_motion, motion.q, motion.qd)[1][:, :, 0]
    drawn = np.where(speed > 0, areas[:, 0], areas[:, 1]) * np.abs(speed)
    total = np.sum(drawn, axis=1)
    k, most = int(np.argmax(total)), machine.pump.max_flow if machine.pump else None
    if most is not None and total[k] > most:
        raise ProblemError(
            f"at {t[k]:.2f} s the motion demands {total[k] * 6e4:.0f} L/min of a pump that gives "
            f"{most * 6e4:.0f} L/min", where="--trajectory",
            remedy=f"let it take {np.ceil(100 * (total[k] / most - 1)):.0f} % longer, or move fewer joints at a time")


def refuse_opening(plant: Plant, t: Array, aim: Demand, valves: Valves) -> None:
    """Refuse a motion for which a valve is too small.

    Raises:
        ProblemError: tells the time and the valve.
    """
    opening = openings(aim, valves, plant.supply)
    k, i = divmod(int(np.argmax(np.abs(opening))), opening.shape[1])
    if abs(opening[k, i]) >= 1:
        raise ProblemError(
            f"at {t[k]:.2f} s the motion demands more of '{plant.actuators[i].actuator.name}' than its valve gives "
            "when fully open", where="--trajectory",
            remedy="drive it slower, or correct the valve's flow or the pump's pressure")


def openings(aim: Demand, valves: Valves, supply: Array) -> Array:
    """Of the valves (N, n) along a motion, cut at fully open."""
    ahead = aim.ahead
    return np.array([np.asarray(valves.function(ahead.speed[k], ahead.force_rate[k], ahead.length[k], ahead.pressure[k],
                                                supply)[1]).ravel() for k in range(len(ahead.speed))])


def refuse_unstable(name: str, margins: Sequence[Margin]) -> None:
    """Refuse a controller whose loops do not hold the machine.

    Raises:
        ProblemError: tells the loop, the posture and the gain margin.
    """
    unstable = [margin for margin in margins if margin.damping < 0]
    if unstable:
        worst = min(unstable, key=lambda margin: margin.distance)
        raise ProblemError(
            f"the loop of '{worst.loop}' is unstable with {name} in the posture of the {worst.point}, where its gain "
            f"margin is {20 * np.log10(worst.gain):.1f} dB", where="control",
            remedy="lower --gain or --sensitivity, raise --rate, or leave this controller out with --controller")


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
