"""Gains of force readings that the machine file calls uncertain: what they leave of the information about ψ.

A force that is read (1 + g) times too large, with g of standard deviation σ and the same in all logs, adds g·K·ψ to the
residuals f − K·ψ of its actuator. With g unknown, rows of unit variance [R, r] have the covariance I + σ²·s·sᵀ with
s = R·ψ, and (I + σ²·s·sᵀ)^(−1/2) makes rows of unit variance of them again.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from hydroopt.estimation.dynamic.folding import split, triangle
from hydroopt.estimation.dynamic.weighted_residuals import Problem, WeightedResiduals
from hydroopt.spatial.inertia import Array


def with_uncertain_gains(weighted: WeightedResiduals[Problem], psi: Array) -> WeightedResiduals[Problem]:
    """The information of weighted residuals about ψ where each force has the unknown gain that the machine file states.

    What is stored of each actuator stays as it is, since later jobs have unknown gains of their own. The same residuals
    where no gain is stated, or rows of actuators are mixed.

    Args:
        weighted: residuals of exact gains.
        psi: (p,) parameters about which forces are computed.
    """
    model = weighted.problem.model
    gain = model.machine.faults.gain
    if gain is None or len(weighted.triangles) != len(model.machine.balances):
        return weighted
    made = []
    for balance, own in zip(model.machine.balances, weighted.triangles, strict=True):
        force = own[:, :-1] @ psi
        square = float(force @ force)
        part = (1 - 1 / np.sqrt(1 + gain**2 * square)) / square if square and balance.actuators else 0.0
        made.append(own - part * np.outer(force, force @ own))
    R, r, rest = split(triangle(*made))
    return replace(weighted, R=R, r=r, rest=rest, gain=gain)
