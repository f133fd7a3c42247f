"""A first guess of the motion: from sample to sample, by rates ahead and by angles, lengths and inclination back."""

from __future__ import annotations

import numpy as np

from hydroopt.errors import LogError
from hydroopt.estimation.motion.observations import Observations
from hydroopt.machine.machine import Machine
from hydroopt.model.sensor_readings import SensorReadings
from hydroopt.spatial.inertia import Array

STEP = 0.1
"""Time [s] over which readings are averaged."""
ACCELERATION = 0.7
"""How much links accelerate [m/s²], which a guess by the inclination of gravity leaves out."""
COARSE = {"q": 0.01, "qd": 0.02, "qdd": np.inf, "length": 0.01, "gyro": 0.02, "accel": ACCELERATION, "roll": 0.05,
          "pitch": 0.05, "x": 0.05, "y": 0.05, "z": 0.05}
"""How much readings may differ from a guess [SI], by the kind of channel."""
DRIFT = 0.02
"""How much a joint's speed by the guess errs [rad/s or m/s]."""
SETTLE = 30
"""Steps towards the first posture."""


def first_guess(machine: Machine, made: SensorReadings, data: Observations, g: Array) -> tuple[Array, Array]:
    """Times (M,) and joint positions (M, n) over a stretch, by a filter with the geometry g (p,).

    Raises:
        LogError: no reading depends on some joint.
    """
    edges = data.t[0] + STEP * np.arange(int((data.t[-1] - data.t[0]) / STEP) + 1)
    bins = np.searchsorted(edges, data.t, side="right") - 1
    counts = np.bincount(bins, minlength=len(edges))[:, None]
    bins_used = np.zeros((len(edges), len(data.channels)))
    sums = np.zeros_like(bins_used)
    np.add.at(bins_used, bins, data.used)
    np.add.at(sums, bins, np.where(data.used, data.values, 0.0))
    filled = counts[:, 0] > 0
    times, weights = edges[filled] + STEP / 2, bins_used[filled] > 0
    values = np.divide(sums[filled], bins_used[filled], out=np.zeros_like(sums[filled]), where=weights)

    ranges = np.array([machine.link(joint).joint.range for joint in machine.joints])
    q, spread = ranges.mean(axis=1), np.diag(np.ptp(ranges, axis=1) ** 2)
    speed = np.zeros_like(q)
    noise = np.array([COARSE[channel.rpartition(".")[2].partition("_")[0]] for channel in data.channels])
    rates = np.array([channel.rpartition(".")[2][:4] in ("qd", "gyro") for channel in data.channels])
    path = np.empty((len(times), len(q)))
    depends = np.zeros(len(q), dtype=bool)
    for k, reading in enumerate(values):
        ahead = spread + np.eye(len(q)) * (DRIFT * STEP) ** 2
        predicted = q + speed * STEP * (k > 0)
        found = predicted
        for _ in range(SETTLE if k == 0 else 1):
            state = found[None]
            expected, by_q, by_qd, _, _ = made(state, 0 * state, 0 * state, g)
            own = weights[k] & np.isfinite(expected[0])
            placed = own & ~rates
            rows = by_q[0][placed] / noise[placed, None]
            left = (reading - expected[0])[placed] / noise[placed] + rows @ found
            information = np.linalg.inv(ahead) + rows.T @ rows
            target = np.linalg.solve(information, np.linalg.solve(ahead, predicted) + rows.T @ left)
            found = found + np.clip(target - found, -0.3, 0.3)
        turning = own & rates
        rows = by_qd[0][turning] / noise[turning, None]
        moving = np.linalg.inv(np.eye(len(q)) + rows.T @ rows)  # speeds are of the order of one
        speed = moving @ rows.T @ ((reading - expected[0])[turning] / noise[turning])
        depends |= np.any(by_q[0] != 0, axis=0) | np.any(by_qd[0] != 0, axis=0)
        q, spread = found, np.linalg.inv(information)
        path[k] = q
    if not depends.all():
        joint = machine.joints[int(np.flatnonzero(~depends)[0])]
        raise LogError(f"no reading depends on the joint '{joint}'", where=data.name, remedy="record its angle, the "
                       "length of its cylinder, or an IMU on the link that it moves")
    return times, path
