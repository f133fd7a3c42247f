"""How well a log, as it is read, agrees with the machine file: forces, lengths, ranges, rates, before any fit."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import median_filter

from hydroopt.errors import HydrooptError
from hydroopt.logs.forces_from_pressures import force_noise, pressures
from hydroopt.logs.joint_angles import measured_angles
from hydroopt.logs.log import Log
from hydroopt.logs.tip_wrench import free_forces
from hydroopt.machine.sensors import Sensor
from hydroopt.model.model import Model
from hydroopt.spatial.inertia import Array

SPIKE = 5
"""Samples of the median that single spikes of forces are removed by."""
SAMPLES = 72
"""Samples of a log that are examined; below `hydroopt.kernels.native.FEW`, so that nothing is compiled for them."""
MODEL_ERROR = 0.05
"""Error of the nominal forces beyond what the priors admit, as a part of their size."""
LARGEST = 3.0
"""Forces, as a multiple of those measured, from which on the model's error grows no more."""
LEVEL = 0.35
"""Natural logarithm of the ratio of force levels that counts as one standard deviation."""
GAP = 0.025
"""Difference between measured length and geometry that counts as one standard deviation, as a part of the stroke."""
MARGIN = 0.05
"""How far beyond a joint's limits, as a part of its range, a reading may lie."""
HASTE = 1.5
"""Speed, as a multiple of the stated limit, beyond which a sample counts as too fast."""
RATES = (2.0, 2e4)
"""Sampling rates [Hz] that are usual where the machine file states none."""
SLOW = 0.1
"""Speed, as a part of a joint's RMS speed, that is no motion."""
WINDOWS = (11, 21, 41, 81, 161)
"""Samples of the cubic polynomials that angles are differentiated by."""
MANIFOLD = 10.0
"""Error of a force, as a multiple of it, from which it is stated as a factor."""


@dataclass(frozen=True, eq=False)
class Agreement:
    """What the machine file and a log say of each other under one reading; smaller numbers agree better.

    Attributes:
        squares: weighted squares of each actuator's forces at `SAMPLES` samples, by the most probable parameters and
            with a model error.
        priors: weighted squares of these parameters' differences from the machine file's.
        levels: squared logarithm of force levels outside what nominal forces and priors admit, in units of `LEVEL`.
        lengths: mean squares of lengths' differences from the geometry, in units of `GAP`, weighted and bounded.
        ranges: share of samples beyond joint limits or too fast, weighted.
        rate: logarithm of the ratio of the sampling rate to the stated one, weighted.
        missed: RMS of each actuator's nominal error as a part of its RMS force, by actuator. At a passive joint nothing
            is read, and errors of angles are as large as what is left: it takes no part in forces, nor does a joint
            that carries bodies which are missing or placeholders.
        beyond: the same of what exceeds one standard deviation by the machine file's priors and sensors.
        gap: largest mean difference [m] between a length and the geometry; NaN where none is measured.
        outside: share of the samples that lie beyond a joint's limits, the worst joint's.
        hertz: sampling rate [Hz].
        noise: what the sensors' noise alone adds to `squares` on average.
        reversals: of a joint, on average.
    """

    squares: Array
    priors: float
    levels: float
    lengths: float
    ranges: float
    rate: float
    missed: dict[str, float]
    beyond: dict[str, float]
    gap: float
    outside: float
    hertz: float
    noise: float
    reversals: float

    @property
    def score(self) -> float:
        """All of it beyond the sensors' noise."""
        return (float(np.sum(self.squares)) + self.priors - self.noise + self.levels + self.lengths + self.ranges
                + self.rate)

    @property
    def worst(self) -> float:
        """Nominal error of the actuator that is missed most."""
        return max(self.missed.values(), default=0.0)

    @property
    def refuted(self) -> float:
        """The same of what priors and sensors do not explain."""
        return max(self.beyond.values(), default=0.0)

    def words(self, other: Agreement) -> str:
        """In words what this reading agrees in better or worse than another; of forces, those that change most."""
        said = [f"misfit {self.score:.3g}"]
        if self.missed:
            actuator = max(self.missed, key=lambda name: abs(self.missed[name] - other.missed[name]))
            missed = self.missed[actuator]
            error = f"{100 * missed:.0f} %" if missed < MANIFOLD else f"a factor of {float(f'{missed:.2g}'):,.0f}"
            said.append(f"nominal forces of {actuator} off by {error}")
        if abs(self.gap - other.gap) > 1e-3:
            said.append(f"lengths off by {1e3 * self.gap:.0f} mm")
        if abs(self.outside - other.outside) > 0.005:
            said.append(f"{100 * self.outside:.0f} % of the angles beyond joint limits")
        if abs(self.hertz / other.hertz - 1) > 0.01:
            said.append(f"a rate of {self.hertz:.3g} Hz")
        return ", ".join(said)


Evaluated = dict[tuple[bytes, float], tuple[Array, Array]]
"""Regressors and nominal forces by motion: most mistakes in forces leave the motion as it is."""


def agreement(model: Model, log: Log, evaluated: Evaluated | None = None) -> Agreement | None:
    """How a log agrees with a machine; None where it cannot be evaluated, such as lengths of an open triangle.

    `evaluated` keeps what depends on the motion alone, for other readings of the same log.
    """
    evaluated = {} if evaluated is None else evaluated
    try:
        angles, pressed = measured_angles(model, log), pressures(model, log)
        measured = free_forces(model, log, angles)
    except HydrooptError:
        return None
    if len(angles) < WINDOWS[0] or not np.all(np.isfinite(angles)):
        return None
    step = float(np.median(np.diff(log.t)))
    window = _window(angles, log)
    kernel = _polynomial(window)
    rows = _rows(log, window)
    if rows.size < 8:
        return None
    around = rows[:, None] + np.arange(window) - window // 2
    q, qd, qdd = (np.tensordot(angles[around], kernel[k], (1, 0)) / step**k for k in range(3))
    noise = _noise(angles, log.segment)
    for values, weights, order in ((qd, kernel[1], 1), (qdd, kernel[2], 2)):  # joints at rest have no motion but noise
        values[:, np.mean(values**2, axis=0) < 2 * (noise * np.linalg.norm(weights) / step**order) ** 2] = 0.0
    known = np.all(np.isfinite(measured[around]), axis=1)
    calm = median_filter(np.nan_to_num(measured)[around], SPIKE, mode="nearest", axes=(1,))
    force = np.tensordot(calm, kernel[0], (1, 0))
    state = (q, qd, qdd) if pressed is None else (q, qd, qdd, pressed[rows])
    key = np.concatenate([values.ravel() for values in state]).tobytes(), step
    if key not in evaluated:
        evaluated[key] = (model.over(model.regressor, *state)[0],
                          model.over(model.inverse_dynamics, *state, model.parameters.nominal)[0][:, :, 0])
    K, nominal = evaluated[key]
    if not (np.all(np.isfinite(K)) and np.all(np.isfinite(nominal))):
        return None
    force = np.where(known, force, nominal)  # a force that is not measured contradicts nothing
    # else dry friction changes its sign within the window
    steady = known & (np.abs(qd) > np.abs(qdd) * step * window / 2)[:, model.dynamics.kept]
    squares, priors, by_noise, levels, missed, beyond = _force_terms(
        model, log, K, np.stack([force, nominal]), steady, float(np.sqrt(np.sum(kernel[0] ** 2))))
    gap, lengths = _length_terms(model, log, angles, rows)
    outside, ranges = _range_terms(model, q, qd)
    rate = _rate_term(model, log, 1 / step)
    return Agreement(squares, priors, levels, lengths, ranges, rate, missed, beyond, gap, outside, 1 / step, by_noise,
                     _reversals(qd))


def _reversals(qd: Array) -> float:
    """How often a joint reverses, on average over joints; slow speeds count for none."""
    fast = np.abs(qd) > SLOW * np.sqrt(np.mean(qd**2, axis=0))
    signs = (np.sign(speed[kept]) for speed, kept in zip(qd.T, fast.T, strict=True))
    return float(np.mean([np.count_nonzero(np.diff(sign)) for sign in signs]))


def _window(angles: Array, log: Log) -> int:
    """The shortest window whose second derivatives of angles are not mostly noise, the same for all joints."""
    longest = max(WINDOWS[0], int(np.max(np.bincount(log.segment - log.segment[0]))) // 6)
    noise = _noise(angles, log.segment)
    chosen = WINDOWS[0]
    for window in WINDOWS:
        if window > longest:
            break
        chosen = window
        kernel = _polynomial(window)[2]
        rows = _rows(log, window)
        if not rows.size:
            break
        bent = np.tensordot(angles[rows[:, None] + np.arange(window) - window // 2], kernel, (1, 0))
        if np.all(noise * np.linalg.norm(kernel) < 0.15 * np.sqrt(np.mean(bent**2, axis=0)) + 1e-300):
            break
    return chosen


def _noise(angles: Array, segment: NDArray[np.int64]) -> Array:
    """Standard deviation (n,) of the angles' white noise, from third differences within stretches."""
    within = segment[3:] == segment[:-3]
    return np.asarray(np.std(np.diff(angles, 3, axis=0)[within], axis=0) / np.sqrt(20.0))


def _polynomial(window: int) -> Array:
    """Weights (3, window) of value, slope and second derivative per sample of the fitted cubic at its middle."""
    x = np.arange(window) - window // 2
    inverse = np.linalg.pinv(np.vander(x / window, 4, increasing=True))
    return np.asarray(inverse[:3] * np.array([1.0, 1.0 / window, 2.0 / window**2])[:, None])


def _rows(log: Log, window: int) -> Array:
    """Evenly spread samples whose window lies within one stretch."""
    half = window // 2
    k = np.arange(half, log.size - half)
    k = k[log.segment[k - half] == log.segment[k + half]]
    rows: Array = k[np.unique(np.linspace(0, k.size - 1, SAMPLES).astype(int))] if k.size else k
    return rows


def _force_terms(model: Model, log: Log, K: Array, both: Array, steady: NDArray[np.bool_],
                 averaged: float) -> tuple[Array, float, float, float, dict[str, float], dict[str, float]]:
    """Weighted squares of forces and of priors, noise's part in them, the term of levels, relative errors, and what of
    these priors and sensors do not explain.

    `both` (2, N, n) are the measured and the nominal forces; those that are not `steady` count in levels only.
    """
    unstated = model.joints_without_nominal_forces
    read = [k for k, each in enumerate(model.machine.balances) if each.actuators and each.joint not in unstated]
    K, steady, (force, nominal) = K[:, read], steady[:, read], both[:, :, read]
    parameters, p = model.parameters, len(model.parameters)
    known = np.diag(parameters.information) > 0
    information = parameters.information + np.diag(np.where(known, 0.0, 1 / (3 * parameters.scale) ** 2))
    covariance = np.linalg.inv(information)
    size = np.sqrt(np.mean(nominal**2, axis=0))
    spread = np.sqrt(np.mean(np.sum((K @ np.linalg.cholesky(covariance)) ** 2, axis=2), axis=0))
    stated = np.nan_to_num(force_noise(model, log)[read], nan=0.0) * averaged
    rms = np.sqrt(np.mean(force**2, axis=0))
    expected = np.maximum(size, 0.3 * np.minimum(spread, 10 * size + 1e-9))
    sigma = np.hypot(stated, MODEL_ERROR * np.minimum(expected, LARGEST * rms))  # else what is far too large fits
    sigma = np.maximum(sigma, 1e-9 * max(1.0, float(np.max(size, initial=0.0))))
    weight = steady / sigma
    rows, right = (K * weight[:, :, None]).reshape(-1, p), ((force - nominal) * weight).ravel()
    scale = np.sqrt(np.diag(covariance))
    A = rows * scale
    lowest = (parameters.lower - parameters.nominal) / scale
    inner = _bounded(scale[:, None] * information * scale + A.T @ A, A.T @ right, lowest)
    left = (right - A @ inner).reshape(force.shape)
    noise = np.sum((stated * weight) ** 2, axis=0)
    priors = float(inner @ (scale * (information @ (scale * inner))))
    squares = np.maximum(np.sum(left**2, axis=0), noise)  # silence agrees no better than noise
    allowed = np.clip(rms, size, np.sqrt(size**2 + spread**2 + stated**2))
    levels = float(np.sum((np.log(np.maximum(rms, 1e-12) / np.maximum(allowed, 1e-12)) / LEVEL) ** 2))
    error = np.sqrt(np.mean((force - nominal) ** 2, axis=0))
    missed, beyond = (each / np.maximum(rms, 1e-12)
                      for each in (error, np.maximum(error - np.hypot(spread, stated), 0.0)))
    names = [model.machine.balances[k].name for k in read]
    return (squares, priors, float(np.sum(noise)), levels, dict(zip(names, missed.tolist(), strict=True)),
            dict(zip(names, beyond.tolist(), strict=True)))


def _bounded(H: Array, g: Array, lower: Array) -> Array:
    """The x not below its bounds of a small x′Hx − 2g′x: it is held at them one after the other, and never leaves."""
    held, x = np.zeros(g.size, dtype=bool), np.zeros(g.size)
    for _ in range(g.size):
        free = ~held
        x[free] = np.linalg.solve(H[np.ix_(free, free)], g[free] - H[np.ix_(free, held)] @ x[held])
        below = free & (x < lower)
        if not np.any(below):
            break
        held |= below
        x[below] = lower[below]
    return x


def _length_terms(model: Model, log: Log, angles: Array, rows: Array) -> tuple[float, float]:
    """The largest mean gap [m] of a length that the angles do not come from, and the term of all."""
    machine, worst, total = model.machine, np.nan, 0.0
    read = {f"{joint}.q" for joint in machine.joints} & set(log.channels)
    places = [(k, c) for k, c in enumerate(machine.pinned) if f"{c.name}.length" in log.channels
              and any(f"{joint}.q" in read for joint in machine.moved_by(c))]
    if not places:
        return worst, total
    q = angles[rows]
    expected = model.over(model.cylinder_kinematics, q, 0 * q, 0 * q)[0][:, :, 0]
    for k, cylinder in places:
        gap = log.channel(f"{cylinder.name}.length")[rows] - expected[:, k]
        worst = float(np.fmax(worst, abs(np.mean(gap))))
        stroke = getattr(cylinder, "stroke", 1.0)
        total += 20 * min(float(np.mean((gap / (GAP * stroke)) ** 2)), 100.0)
    return worst, total


def _range_terms(model: Model, q: Array, qd: Array) -> tuple[float, float]:
    """The largest share of a joint's samples beyond its limits, and the term of ranges and speeds."""
    joints = [model.machine.link(name).joint for name in model.machine.joints]
    low, high = model.machine.ranges.T
    slack = MARGIN * (high - low)
    outside = np.mean((q < low - slack) | (q > high + slack), axis=0)
    fastest = np.array([joint.max_speed or np.inf for joint in joints])
    hasty = np.mean(np.abs(qd) > HASTE * fastest, axis=0)
    return float(np.max(outside)), 100 * float(np.sum(outside) + np.sum(hasty))


def stated_rate(sensors: tuple[Sensor, ...], channels: set[str]) -> tuple[float, float]:
    """Sampling rates [Hz] from the lowest to the highest that the file states of a log's channels."""
    rates = [sensor.rate for sensor in sensors if sensor.rate and channels & set(sensor.channels)]
    return (min(rates), max(rates)) if rates else RATES


def _rate_term(model: Model, log: Log, hertz: float) -> float:
    low, high = stated_rate(model.machine.sensors, set(log.channels))
    return 20 * abs(float(np.log(hertz / np.clip(hertz, low, high))))
