"""Marginal distributions from chords through samples, against eigenvalues and SciPy's truncated normal distribution."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import brentq
from scipy.stats import truncnorm

from hydroopt.kernels import shared_library
from hydroopt.kernels.marginals import TILE, marginals

MATRICES, SINGLE, SUMS, SAMPLES = 3, 2, 5, 2 * TILE
UPPER = np.triu_indices(4)


def ends(matrices: np.ndarray, along: np.ndarray, single: np.ndarray, slope: np.ndarray) -> tuple[float, float]:
    """How far a step along a direction leads down and up until a condition (matrices (m, 4, 4), numbers (k,)) ends."""
    rates = [slope / single]
    for matrix, change in zip(matrices, along, strict=True):
        inverse = np.linalg.inv(np.linalg.cholesky(matrix))
        rates.append(np.linalg.eigvalsh(inverse @ change @ inverse.T))
    every = np.concatenate(rates)
    return -1 / max(every.max(), 0.025), -1 / min(every.min(), -0.025)  # SciPy's moments are NaN without ends


@pytest.mark.usefixtures("vectors")
@pytest.mark.parametrize(("far", "thin"), [(0.0, 1.0), (-12.0, 1.0), (12.0, 1.0), (0.0, 1e-4)])
def test_they_are_means_of_truncated_normal_distributions(far: float, thin: float) -> None:
    """In thin bodies, all samples but one change as little as they have; that one is at its edge."""
    rng = np.random.default_rng(int(abs(far)))
    factors, size = rng.standard_normal((MATRICES, SAMPLES, 4, 5)), np.array([1.0, 1.0, thin, thin])
    factors[0] *= size[:, None]
    factors[1, 0, -1] *= thin
    bodies, single = factors @ factors.swapaxes(2, 3), rng.exponential(size=(SINGLE, SAMPLES))
    along = rng.standard_normal((SUMS, MATRICES, 4, 4))
    along += along.swapaxes(2, 3)
    along[:, 0] *= np.outer(size, size)
    along[0], slope = 0.0, rng.standard_normal((SUMS, SINGLE))  # by single conditions alone
    at = far + rng.standard_normal((SUMS, SAMPLES))
    slack = np.concatenate([bodies[..., *UPPER].transpose(2, 0, 1).reshape(10 * MATRICES, SAMPLES), single])
    changes = np.concatenate([along[..., *UPPER].transpose(0, 2, 1).reshape(SUMS, 10 * MATRICES), slope], axis=1)
    found = marginals(slack, changes, at, MATRICES, 0.025)
    if found is None:
        assert shared_library.compiler() is None
        return
    for n in range(SUMS):
        chords = [ends(bodies[:, i], along[n], single[:, i], slope[n]) for i in range(SAMPLES)]
        parts = [truncnorm(t + down, t + up) for t, (down, up) in zip(at[n], chords, strict=True)]
        assert found[n, 0] == pytest.approx(np.mean([one.mean() for one in parts]), abs=1e-5)
        assert found[n, 1] == pytest.approx(np.mean([one.moment(2) for one in parts]), abs=1e-4)
        for q, wanted in zip(found[n, 2:], (0.025, 0.975), strict=True):
            exact = brentq(lambda x, parts=parts, wanted=wanted: np.mean([one.cdf(x) for one in parts]) - wanted,
                           far - 20, far + 20, xtol=1e-9)
            assert q == pytest.approx(exact, abs=1e-5)
