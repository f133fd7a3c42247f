"""The matrix that commercial scales use: boom force over boom and stick angle, for the empty machine and for a load.

Tabulated are forces while lifting slowly on level ground, with the friction of that, on a grid of boom and stick
angles, as a calibration run with a weight tells them; the mass is linear between them. Averaged over samples in which
the boom lifts, as scales do that weigh "while lifting".
"""

from __future__ import annotations

import numpy as np
from scipy.interpolate import RectBivariateSpline

from hydroopt import Log
from hydroopt.model.carried_load import carried_load
from hydroopt.spatial.inertia import from_centre_of_mass
from hydroopt.weighing.smoothed_log import smoothed_log
from studies.weighing.machines import SimulatedMachine

GRID = 15
"""Number of angles of each joint."""
SLOW = 0.1
"""Speed at which the table is made [rad/s]."""
BOOM, STICK = 1, 2


class QuasistaticScale:
    """Table of a machine; the true one, so that it is at its best."""

    def __init__(self, machine: SimulatedMachine, weight: float) -> None:
        model, limits = machine.model, [machine.model.machine.link(joint).joint.range
                                        for joint in machine.model.machine.joints]
        axes = [np.linspace(*limits[joint], GRID) for joint in (BOOM, STICK)]
        boom, stick = (each.ravel() for each in np.meshgrid(*axes, indexing="ij"))
        q = np.column_stack([0 * boom, boom, stick])
        qd = np.zeros_like(q)
        qd[:, BOOM] = -SLOW  # lifting
        carrier = machine.carrier
        body = carried_load(model, carrier.link, carrier.centre) @ from_centre_of_mass(1.0, np.zeros(3), np.zeros(6))
        tables = []
        for mass in (0.0, weight):
            force = model.over(model.inverse_dynamics, q, qd, 0 * q, machine.psi + mass * body)[0][:, BOOM, 0]
            tables.append((force * (1 + machine.load_friction[BOOM])).reshape(GRID, GRID))
        self.empty = RectBivariateSpline(axes[0], axes[1], tables[0])
        self.per_mass = RectBivariateSpline(axes[0], axes[1], (tables[1] - tables[0]) / weight)
        self.model = model

    def mass(self, log: Log, begin: float, end: float) -> float:
        """Mean mass [kg] while the boom lifts between two times; NaN where it does not."""
        smoothed = smoothed_log(self.model, log)
        taken = (smoothed.t > begin) & (smoothed.t < end) & (smoothed.sign[:, BOOM] == -1)
        if not taken.any():
            return float("nan")
        at = smoothed.q[taken][:, [BOOM, STICK]].T
        found = (smoothed.force[taken, BOOM] - self.empty.ev(*at)) / self.per_mass.ev(*at)
        return float(np.mean(found))

