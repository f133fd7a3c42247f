"""On-line estimation of the valves' flows: a factor for each direction of each actuator, from its motion."""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property

import casadi as ca
import numpy as np

from hydroopt.control.closed_loop import CommandDelay, reading_std
from hydroopt.control.linear_plant import Reading
from hydroopt.kernels.virtual_machine import OneSample
from hydroopt.model.hydraulics import ActuatorHydraulics, Value, spool_position
from hydroopt.model.plant import Plant
from hydroopt.spatial.inertia import Array

STATE = ("started", "spool", "spool_rate", "pressure_a", "pressure_b", "length", "correction_extending",
         "correction_retracting", "variance", "covariance_extending", "covariance_retracting", "certainty_extending",
         "certainty_retracting", "certainty_both")
"""What one actuator's estimate keeps from sample to sample, all zero at first: whether there was a sample; the spool;
pressures at the last sample; the estimated length, factors less one, the variance of the length and its covariances
with the factors, and what is known of the factors: `PRIOR`² less their variances, and less their covariance."""
WAYS = ("extending", "retracting")
MEMORY = 0.3
"""Time [s] in which what the model misses of a motion adds up to `MODEL_ERROR`, and slow errors of readings change."""
PRIOR = 0.1
"""Standard deviation of a factor about one, before anything is seen."""
MODEL_ERROR = 0.05
"""Standard deviation of the motion in `MEMORY` by the model, as a part of it: spool and dead band."""
STORED_ERROR = 0.3
"""Standard deviation of the volume that oil stores, as a part of it: near vacuum, where it stores much, little is
learned."""
BELIEVED = 3.0
"""Standard deviations by which a reading may differ; beyond, more than its valve acts on the machine."""
NOTHING = 1e-9
"""Standard deviation of a length [m or rad] at least, so that nothing is divided by zero."""
FORGETTING = 30.0
"""Time constant [s] after which a factor may have changed by `PRIOR`."""
SUBSTEPS = 4
"""Steps of the spool's motion in a sample, by the rule of Runge and Kutta."""


def factors_in(state: ca.SX) -> ca.SX:
    """The factors (2, 1) in a state (14, 1), extending and retracting."""
    return 1 + state[[STATE.index(f"correction_{way}") for way in WAYS]]


def deviations_in(state: ca.SX) -> ca.SX:
    """Their standard deviations (2, 1)."""
    return ca.sqrt(ca.fmax(0, PRIOR**2 - state[[STATE.index(f"certainty_{way}") for way in WAYS]]))


def next_state(each: ActuatorHydraulics, state: ca.SX, command: ca.SX, length: ca.SX, length_std: ca.SX, p_a: ca.SX,
               p_b: ca.SX, supply: ca.SX, period: ca.SX, value: Value) -> ca.SX:
    """The state (14, 1) of one actuator after a further sample.

    Between samples the piston sweeps (A_a + A_b)·Δl = k₊·V₊ + k₋·V₋ − V_s, with V₊ and V₋ the volumes that the edges
    would have let through at the measured pressures, and V_s what compression and leaks took. Length and factors are
    estimated together from every reading (Kalman 1960). The factors' covariance grows towards that of the start with
    the time constant `FORGETTING`. After a reading that cannot be believed the length begins anew, and the factors stay
    as they are. A bias of the readings is a part of the estimated length, and so drops out of the factors.

    Args:
        each: the actuator.
        state: (14, 1), see `STATE`.
        command: that acted on its valve since the last sample, after its delay.
        length: of the actuator [m or rad].
        length_std: its standard deviation.
        p_a, p_b: pressures of its chambers [Pa].
        supply: pressures (2,) of supply and tank [Pa].
        period: since the last sample [s].
        value: of the numbers of its circuit.
    """
    at = dict(zip(STATE, ca.vertsplit(state), strict=True))
    before_a, before_b = (_either(at["started"], at[f"pressure_{side}"], now) for side, now in (("a", p_a), ("b", p_b)))
    spool, rate = at["spool"], at["spool_rate"]
    wanted, h = spool_position(each.valve, command, value), period / SUBSTEPS
    extending, retracting, stored = ca.SX(0), ca.SX(0), ca.SX(0)
    for k in range(SUBSTEPS):
        if each.spool_states:
            after, rate = _runge_kutta(lambda s, v: each.spool_rates(s, v, wanted, value), spool, rate, h)
        else:
            after = wanted
        middle, share = (spool + after) / 2 if each.spool_states else wanted, (k + 0.5) / SUBSTEPS
        here = before_a + share * (p_a - before_a), before_b + share * (p_b - before_b)
        through, leaks = (each.flows(place, *here, supply, value) for place in (middle, ca.SX(0)))
        net, lost = through.into_a - through.into_b, leaks.into_a - leaks.into_b
        extending += h * _positive(middle) * (net - lost)
        retracting += h * (1 - _positive(middle)) * (net - lost)
        stored -= h * lost
        spool = after
    capacity = each.capacities((p_a + before_a) / 2, (p_b + before_b) / 2, length, value)
    stored += capacity[0] * (p_a - before_a) - capacity[1] * (p_b - before_b)

    swept, stored = ca.vertcat(extending, retracting) / sum(each.areas), stored / sum(each.areas)
    correction, covariance = (ca.vertcat(*(at[f"{key}_{way}"] for way in WAYS)) for key in ("correction", "covariance"))
    own = [ca.fmax(0, ca.fmin(at[f"certainty_{way}"], PRIOR**2)) for way in WAYS]
    both = at["certainty_both"]
    certainty = ca.vertcat(ca.horzcat(own[0], both), ca.horzcat(both, own[1]))
    grown = PRIOR**2 * ca.SX.eye(2) - certainty * ca.exp(-period / FORGETTING)
    reading = length_std**2 + NOTHING**2
    missed = (MODEL_ERROR**2 * MEMORY / period * ca.sumsqr(swept) + (STORED_ERROR * stored) ** 2
              + reading * period / MEMORY)
    variance = ca.fmax(0, at["variance"] + 2 * swept.T @ covariance + swept.T @ grown @ swept + missed)
    covariance += grown @ swept
    expected = at["length"] + (1 + correction).T @ swept - stored
    error, spread = length - expected, variance + reading
    known = at["started"] * _positive(BELIEVED**2 * spread - error**2)
    certainty = PRIOR**2 * ca.SX.eye(2) - grown + known / spread * covariance @ covariance.T
    return ca.vertcat(1, spool, rate, p_a, p_b, _either(known, expected + variance / spread * error, length),
                      correction + known * error / spread * covariance,
                      _either(known, variance * reading / spread, reading), known * reading / spread * covariance,
                      certainty[0, 0], certainty[1, 1], certainty[0, 1])


def _positive(x: ca.SX) -> ca.SX:
    """1 where x is positive, otherwise 0: generated C has no branches."""
    return ca.fmax(ca.sign(x), 0)


def _either(condition: ca.SX, one: ca.SX, other: ca.SX) -> ca.SX:
    """One where a condition is 1, the other where it is 0."""
    return condition * one + (1 - condition) * other


def _runge_kutta(rates: Callable[[ca.SX, ca.SX], tuple[ca.SX, ca.SX]], place: ca.SX, speed: ca.SX,
                 h: ca.SX) -> tuple[ca.SX, ca.SX]:
    """Place and speed after a step h by the classical rule of the fourth order."""
    found = [rates(place, speed)]
    for share in (0.5, 0.5, 1.0):
        found.append(rates(place + share * h * found[-1][0], speed + share * h * found[-1][1]))
    weights = (1 / 6, 1 / 3, 1 / 3, 1 / 6)
    return (place + h * sum(w * each[0] for w, each in zip(weights, found, strict=True)),
            speed + h * sum(w * each[1] for w, each in zip(weights, found, strict=True)))


def length_std(plant: Plant, lever_arm: ca.SX) -> list[ca.SX]:
    """Standard deviations of the actuators' lengths, at lever arms (a, n), by those of the joints' sensors."""
    found = [reading_std(plant.machine, f"{joint}.q") for joint in plant.machine.joints]
    return [ca.norm_2(lever_arm[k, :].T * ca.DM(found)) for k in range(len(plant.actuators))]


class ValveRefit:
    """Factors on the flows that a controller uses, estimated while it drives.

    Args:
        plant: the machine as the controller knows it.
        theta: hydraulic parameters, of which the flows are corrected.
        period: of the samples [s].
    """

    def __init__(self, plant: Plant, theta: Array, period: float) -> None:
        self.plant, self.theta, self.period = plant, theta, period
        self.reset()

    def reset(self) -> None:
        """Return to the initial state."""
        neutral = np.array([each.valve.neutral for each in self.plant.actuators])
        self.state = np.zeros(len(STATE) * len(neutral))
        self._delay, self.acting = CommandDelay(self.plant.delays, self.period, neutral), neutral
        self.factors, self.std = np.ones((len(neutral), 2)), np.full((len(neutral), 2), PRIOR)
        """Factors (a, 2) on the flows, extending and retracting, and their standard deviations."""

    def read(self, reading: Reading) -> Array:
        """Enter the readings of a sample; returns the factors (a, 2) on the flows, extending and retracting."""
        self.state, self.factors, self.std = self._step(self.state, self.acting, reading.q, reading.pressure,
                                                         reading.supply)
        return self.factors

    def sent(self, u: Array) -> None:
        """Enter the commands (a,) of a sample."""
        pieces = self._delay.push(u)
        self.acting = np.asarray(sum(seconds * command for seconds, command in pieces) / self.period)

    @cached_property
    def _step(self) -> OneSample:
        """(state (14·a,), command (a,), q (n,), pressure (a, 2), supply (2,)) → state, factors and their standard
        deviations (a, 2)."""
        plant, count = self.plant, len(self.plant.actuators)
        size, command = len(STATE), ca.SX.sym("command", count)
        state = ca.SX.sym("state", size * count)
        q, pressure, supply = (ca.SX.sym("q", len(plant.machine.joints)), ca.SX.sym("pressure", count, 2),
                               ca.SX.sym("supply", 2))
        length, _ = plant.actuator_motion(q, ca.SX.zeros(q.numel()))
        std, theta, after = length_std(plant, plant.transmission(q)), ca.SX(ca.DM(self.theta)), []
        for k, each in enumerate(plant.actuators):
            own = state[k * size:(k + 1) * size]
            after.append(next_state(each, own, command[k], length[k], std[k], pressure[k, 0], pressure[k, 1], supply,
                                    ca.SX(self.period), plant.value(each, theta)))
        return OneSample(ca.Function("valve_refit", [state, command, q, pressure, supply], [
            ca.vertcat(*after), *(ca.horzcat(*(found(one) for one in after)).T for found in (factors_in, deviations_in))
        ]))
