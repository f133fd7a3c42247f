"""How much friction and offsets differ from session to session without any order: random effects.

In each session, every friction and offset is off by a random amount whose RMS force is κ times the friction force of
its actuator. A step or drift is held against that, and κ² is its mean over what the sessions say outside of this step
or drift. Before, κ follows Cauchy's density (Gelman 2006): few sessions leave it uncertain, and the most probable κ
would often be zero where it is not.

Of all parameters together, κ is zero as likely as not, so that sound machines are seen as such. A single parameter may
scatter where the others do not: κ is then not zero, and what this parameter did is left out of it, so that a large
change does not hide itself.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hydroopt.estimation.dynamic.problem import IdentificationProblem
from hydroopt.estimation.dynamic.stored_information import StoredInformation
from hydroopt.estimation.inference.identifiability import ROUNDING_TOLERANCE
from hydroopt.model.model import Model
from hydroopt.parameters.parameter_set import ParameterKind
from hydroopt.spatial.inertia import Array

NONE = 0.5
"""Probability that a machine's sessions do not scatter at all, before anything is measured."""
USUAL = 0.1
"""Median κ of those that do."""
GRID = np.append(0.0, np.geomspace(1e-4, 2.0, 60))
"""Values of κ that are distinguished."""
UNEQUAL = 2.0
"""Degrees of freedom of each parameter's own variance: κ² is that of all, and single ones differ from it."""


@dataclass(frozen=True, eq=False)
class SessionScatter:
    """Random effects of friction and offsets in k coordinates of variance 1.

    Attributes:
        directions: (k, c·N) effects of the random amounts for κ = 1.
        sums: (k,) the measured coordinates.
    """

    directions: Array
    sums: Array

    def variance(self, explained: Array, none: float) -> float:
        """κ² by what an orthonormal basis (k, d) does not explain; zero where nothing can scatter.

        Args:
            explained: the basis.
            none: probability that κ is zero, before.
        """
        if not np.any(self.directions):
            return 0.0
        outside = np.linalg.qr(explained, mode="complete")[0][:, explained.shape[1] :]
        effects, axes = np.linalg.eigh(outside.T @ self.directions @ self.directions.T @ outside)
        total = 1 + GRID[:, None] ** 2 * np.maximum(effects, 0.0)
        deviance = np.sum((axes.T @ outside.T @ self.sums) ** 2 / total + np.log(total), axis=1)
        likelihood = np.exp(-(deviance - deviance.min()) / 2)
        some = (1 - none) * likelihood * 2 / np.pi / USUAL / (1 + (GRID / USUAL) ** 2)
        return float(np.trapezoid(some * GRID**2, GRID) / (none * likelihood[0] + np.trapezoid(some, GRID)))


def random_amounts(model: Model, places: Sequence[int], sessions: Sequence[StoredInformation]) -> Array:
    """Change (c,) of each parameter whose RMS force is that of its actuator's friction; zero for other parameters."""
    parameters, p = model.parameters, len(model.parameters)
    rows = np.concatenate([session.triangles for session in sessions], axis=1)
    K, prior = rows[:, :, :p], IdentificationProblem(model, ()).prior_rows
    A = np.vstack([K.reshape(-1, p), prior[0]]) * parameters.scale
    psi = parameters.scale * np.linalg.lstsq(A, np.append(rows[:, :, p].ravel(), prior[1]), rcond=ROUNDING_TOLERANCE)[0]
    friction = np.array([kind.is_friction for kind in parameters.kinds])
    varies = friction | np.array([kind is ParameterKind.FORCE_OFFSET for kind in parameters.kinds])
    force, size = np.linalg.norm(K @ (psi * friction), axis=1), np.linalg.norm(K, axis=1)[:, places]
    actuator, each = np.argmax(size, axis=0), np.arange(len(places))
    length = size[actuator, each]
    return np.where(varies[places] & (length > 0), force[actuator] / np.where(length > 0, length, 1.0), 0.0)
