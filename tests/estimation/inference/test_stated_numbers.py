"""Numbers that are further off than stated, by draws of a linear model whose estimate is known in closed form."""

from __future__ import annotations

import numpy as np

from hydroopt.estimation.inference.stated_numbers import contradicted
from hydroopt.results.diagnostic import Diagnostic

GROUPS = ["lengths"] * 4 + ["angles"] * 4
NAMES = [f"{group}{k}" for k, group in enumerate(GROUPS)]


def draws(factor: float, count: int) -> list[list[Diagnostic]]:
    """What is said of numbers that are so many times as far off as stated, of which readings determine some."""
    rng = np.random.default_rng(5)
    sigma = 10.0 ** rng.uniform(-3, 0, 8)
    A = rng.standard_normal((12, 8)) * [3, 3, 3, 0.1, 3, 3, 1, 0.1] / sigma
    covariance = np.linalg.inv(A.T @ A + np.diag(1 / sigma**2))
    found = []
    for _ in range(count):
        theta = factor * sigma * rng.standard_normal(8)
        estimate = covariance @ A.T @ (A @ theta + rng.standard_normal(12))
        spread = np.eye(8) - covariance / np.outer(sigma, sigma)
        found.append(list(contradicted(NAMES, GROUPS, estimate / sigma, spread)))
    return found


def test_numbers_as_far_off_as_stated_are_hardly_ever_contradicted() -> None:
    assert sum(bool(said) for said in draws(1.0, 3000)) <= 3000 * 1e-3 + 3 * np.sqrt(3000 * 1e-3)


def test_numbers_three_times_as_far_off_are_contradicted_and_their_ratio_is_said() -> None:
    some = [said for said in draws(3.0, 200) if said]
    assert len(some) > 160
    assert all(each.kind == "stated numbers contradicted" and each.subject for said in some for each in said)
    ratios = [each.evidence["ratio"] for said in some for each in said]
    assert 2.5 < np.sqrt(np.mean(np.square(ratios))) < 4.5  # those that are noticed are the larger ones
    assert {each.evidence["group"] for said in some for each in said} == {"lengths", "angles", "numbers"}
