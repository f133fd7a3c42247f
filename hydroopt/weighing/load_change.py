"""When the load changes: a generalised likelihood ratio on the last samples of joints that move."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hydroopt.spatial.inertia import Array
from hydroopt.weighing.equations import Equations
from hydroopt.weighing.gaussian import Gaussian
from hydroopt.weighing.least_squares import Weighed, linearised, load_prior

RECENT = 10
"""Number of samples among which a change is sought."""
THRESHOLD = 30.0
"""Likelihood ratio (twice its logarithm) from which the load has changed."""


class Change(NamedTuple):
    """A change of the load: likelihood ratio, the first sample with the other load, and by how much [kg]."""

    ratio: float
    sample: int
    size: float


def load_change(equations: Equations, samples: NDArray[np.intp], reference: Weighed) -> Change:
    """The most likely change of mass within some samples.

    Standing joints do not count, since dry friction hides changes and makes others up.

    Args:
        equations: of the log.
        samples: (m,) the last ones, of which the first belongs to the load of before.
        reference: what was known before them; its misfit widens the errors.
    """
    taken = equations.moving()[samples]
    place, balance = np.nonzero(taken)
    at = (samples[place], balance)
    if not len(place) or len(samples) < 2:
        return Change(0.0, int(samples[-1]), 0.0)
    rest, J = linearised(equations, at, reference.own.mean, reference.phi)
    V = equations.covariance(at, reference.phi) * max(1.0, reference.misfit) ** 2 + _spread(reference, J)
    changed = samples[1:]
    columns = np.where(at[0][:, None] >= changed, J[:, :1], 0.0)
    solved = np.linalg.solve(V, np.column_stack([rest, columns]))
    along, size = columns.T @ solved[:, 0], np.einsum("xc,xc->c", columns, solved[:, 1:])
    amount = np.divide(along, size, out=np.zeros_like(along), where=size > 0)
    best = int(np.argmax(amount * along))
    return Change(float(amount[best] * along[best]), int(changed[best]), float(amount[best]))


def _spread(reference: Weighed, J: Array) -> Array:
    """Covariance of predicted forces, by that of the reference."""
    J = J[:, J.shape[1] - len(reference.both.right) :]
    root = np.linalg.solve(reference.both.root.T, J.T)
    return np.asarray(root.T @ root) * max(1.0, reference.misfit) ** 2


def anything(equations: Equations, known: Weighed) -> Weighed:
    """A reference that knows nothing of the load but the prior, and of the scale what `known` does."""
    c = known.count
    root, right = np.zeros((10 + c, 10 + c)), np.zeros(10 + c)
    prior = np.linalg.qr(load_prior(equations, equations.scale.load.full_scale), mode="r")
    root[:10, :10], root[10:, 10:], right[10:] = prior, known.own.root, known.own.right
    return Weighed(Gaussian(root, right), c, known.misfit, 0, 0)
