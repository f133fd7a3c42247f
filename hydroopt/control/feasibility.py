"""Checks before a simulation: flow of the pump, openings of the valves, stability of the loops."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hydroopt.control.loops import Margin
from hydroopt.control.reference import Demand
from hydroopt.control.valve_inversion import Valves
from hydroopt.errors import ProblemError
from hydroopt.model.hydraulics import TOLERANCE, demanded_flow
from hydroopt.model.plant import Plant
from hydroopt.simulation.simulate import Trajectory
from hydroopt.spatial.inertia import Array

SPARE = 0.02
"""Part of the pump's flow that is reserved for leaks in a steady motion."""


def flow_demand(plant: Plant, q: Array, qd: Array) -> Array:
    """Flow (N,) [m³/s] that growing chambers take in states (N, n) of the joints."""
    return demanded_flow(plant.machine, np.einsum("nij,nj->ni", plant.model.over(plant.model.transmission, q)[0], qd))


def steady_speeds(plant: Plant, q: Array, qd: Array, least: Array) -> Array:
    """Joint speeds (n,) near `qd`, none slower than `least` (n,), that the pump sustains in a posture `q` (n,).

    A slower joint gets its least speed, since the loop of a shut valve is open; joints without a valve have a least
    speed of zero. If all joints together then take more than the pump gives, the faster ones are slowed in proportion.
    """
    most = plant.machine.pump.max_flow if plant.machine.pump else None

    def slowed(part: float) -> Array:
        return np.where(qd < 0, -1.0, 1.0) * np.maximum(part * np.abs(qd), least)

    def beyond(part: float) -> float:
        return float(flow_demand(plant, q[None], slowed(part)[None])[0]) - (1 - SPARE) * (most or np.inf)

    if beyond(1.0) <= 0:
        return slowed(1.0)
    from scipy.optimize import brentq  # noqa: PLC0415 — most motions need none of it

    return slowed(float(brentq(beyond, 0.0, 1.0)) if beyond(0.0) < 0 else 0.0)


def refuse_flow(plant: Plant, motion: Trajectory) -> None:
    """Refuse a motion that demands more flow than the pump gives.

    Raises:
        ProblemError: the demand exceeds the pump's flow by more than `TOLERANCE`; the sentence states time and flows.
    """
    machine, t, total = plant.machine, motion.t, flow_demand(plant, motion.q, motion.qd)
    k, most = int(np.argmax(total)), machine.pump.max_flow if machine.pump else None
    if most is not None and total[k] > most * (1 + TOLERANCE):
        raise ProblemError(
            f"at {t[k]:.2f} s the motion demands {total[k] * 6e4:.0f} L/min of a pump that gives "
            f"{most * 6e4:.0f} L/min", where="--motion",
            remedy=f"let it take {np.ceil(100 * (total[k] / most - 1)):.0f} % longer, with a longer --duration of "
                   "excite or simulate, or move fewer joints at a time")


def refuse_opening(plant: Plant, t: Array, demand: Demand, valves: Valves) -> None:
    """Refuse a motion for whose speeds a valve is too small.

    What a change of force takes besides counts only where it saturates a valve in a run: at reversals friction jumps,
    and asks for a moment more than any valve gives.

    Raises:
        ProblemError: a valve would be fully open; the sentence states time and valve.
    """
    opening = openings(demand, valves, plant.supply)
    k, i = divmod(int(np.argmax(np.abs(opening))), opening.shape[1])
    if abs(opening[k, i]) >= 1:
        raise ProblemError(
            f"at {t[k]:.2f} s the motion demands more of '{plant.actuators[i].actuator.name}' than its valve gives "
            "when fully open", where="--motion",
            remedy="design it with the calibrated machine, drive it slower, with a longer --duration of excite or "
                   "simulate, or correct the valve's flow or the pump's pressure in the machine file")


def openings(demand: Demand, valves: Valves, supply: Array) -> Array:
    """Openings (N, a) of the valves for the speeds of a motion, −1 to 1, saturated at fully open."""
    preview = demand.preview
    return np.array([valves.command(speed, 0 * speed, length, pressure, supply)[1] for speed, length, pressure
                     in zip(preview.speed, preview.length, preview.pressure, strict=True)])


def refuse_unstable(name: str, margins: Sequence[Margin], duration: float) -> None:
    """Refuse a controller whose errors grow to more than e times within the motion's duration [s], if its loops were
    all the time as at one of its points.

    Slower growth passes: a point lasts for a part of the motion only, and a load that hangs almost undamped may swing a
    little more in a posture, whatever the controller. `UNSTABLE_IN_POSTURE` reports it.

    Raises:
        ProblemError: errors grow faster; the sentence states loop, posture and gain margin.
    """
    unstable = [margin for margin in margins if margin.growth * duration > 1]
    if unstable:
        worst = min(unstable, key=lambda margin: margin.distance)
        raise ProblemError(
            f"the loop of '{worst.loop}' is unstable with {name} in the posture of the {worst.point}, where its gain "
            f"margin is {20 * np.log10(worst.gain):.1f} dB", where="closed loop",
            remedy="lower --gain or --sensitivity, raise --rate, or leave this controller out with --controller")
