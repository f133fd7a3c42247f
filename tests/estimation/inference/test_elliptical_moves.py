"""Moves of chains: compiled ones against NumPy's, on the same random numbers."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from hydroopt.estimation.dynamic.problem import IdentificationProblem
from hydroopt.estimation.inference.posterior import Posterior, sample
from hydroopt.kernels import ellipses

BODY = np.array([2.0, 1.5, 0, 0, 1, 0, 0, 2, 0, 2])


def drawn(problem: IdentificationProblem, R: np.ndarray) -> Posterior:
    start = problem.parameters.nominal + np.array([0.0, -1.2, *np.zeros(8)])  # the nominal body cannot exist
    found = sample(problem, R, R @ problem.parameters.nominal, start, consistent=True, seed=3)
    assert found is not None
    return found


@pytest.mark.parametrize("distance", ["gaussian", "log-det"])
def test_compiled_moves_are_those_of_numpy(one_body: Callable[..., IdentificationProblem], distance: str,
                                           monkeypatch: pytest.MonkeyPatch) -> None:
    problem = one_body(BODY, (0.5, 0.3, 0.5)).with_distance(distance)
    R = 0.3 * np.random.default_rng(1).standard_normal((10, 10))
    compiled = drawn(problem, R)
    monkeypatch.setattr(ellipses, "compiled", lambda: None)
    np.testing.assert_allclose(compiled.samples, drawn(problem, R).samples, atol=1e-9)
    assert np.ptp(compiled.samples, axis=0).min() > 0.1  # chains do move
