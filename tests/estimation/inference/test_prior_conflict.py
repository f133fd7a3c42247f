"""Data against priors: false alarms at their level, and bodies that are wrong are named."""

from __future__ import annotations

import numpy as np

from hydroopt.estimation.inference.prior_conflict import prior_test

P, ROWS = 6, 20
GROUPS = {"first": np.array([0, 1, 2]), "second": np.array([3, 4, 5])}
NOMINAL = np.array([1.0, 2.0, 3.0, 1.0, 2.0, 3.0])
SIGMA = 0.2 * NOMINAL
PRIOR = (np.diag(1 / SIGMA), NOMINAL / SIGMA)


def p_values(count: int, factor: float) -> list[tuple[float, str, float]]:
    rng = np.random.default_rng(5)
    found = []
    for _ in range(count):
        R = 4 * rng.normal(size=(ROWS, P))
        truth = NOMINAL + SIGMA * rng.normal(size=P)
        truth[:3] *= factor
        test = prior_test(R, R @ truth + rng.normal(size=ROWS), PRIOR, NOMINAL, NOMINAL, GROUPS)
        assert test.worst is not None
        found.append((test.p_value, test.worst.group, test.worst.p_value))
    return found


def test_sound_priors_are_rarely_contradicted() -> None:
    found = p_values(400, 1.0)
    assert 0.02 < np.mean([p < 0.05 for p, _, _ in found]) < 0.08
    assert np.mean([p < 0.05 for _, _, p in found]) < 0.08


def test_a_body_that_is_wrong_as_a_whole_is_named() -> None:
    found = p_values(60, 3.0)
    assert np.mean([p < 1e-3 for _, _, p in found]) > 0.95
    assert np.mean([group == "first" for _, group, _ in found]) > 0.95


def test_what_the_data_do_not_know_contradicts_nothing() -> None:
    test = prior_test(np.zeros((3, P)), np.full(3, 9.0), PRIOR, NOMINAL, NOMINAL, GROUPS)
    assert (test.p_value, test.directions, test.worst) == (1.0, 0, None)
