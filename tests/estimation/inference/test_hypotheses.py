"""The engine of hypotheses against explicit least squares and densities, and by how often it errs on drawn data."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from hydroopt.estimation.inference.hypotheses import BELIEF, Hypothesis, Layout, LinearModel, name


@dataclass(frozen=True, kw_only=True)
class Column(Hypothesis["Drawn"]):
    """Known columns, or a sine of a frequency that its amount raises."""

    values: np.ndarray = field(compare=False)

    def columns(self, data: Drawn, amount: np.ndarray) -> np.ndarray:
        if self.linear:
            return self.values
        return (self.values[:, 0] * np.cos(self.values[:, 0] * amount[0]))[:, None]

    def effect(self, amount: np.ndarray) -> np.ndarray:
        return self.values @ amount if self.linear else np.sin(self.values[:, 0] * amount[0])

    def sentence(self, amount: np.ndarray) -> str:
        return self.name


@dataclass
class Drawn:
    """Nuisances N with a prior, readings, and what they belong to."""

    N: np.ndarray
    readings: np.ndarray
    prior: np.ndarray
    layout: Layout

    def model(self, held: Sequence[tuple[Column, np.ndarray]]) -> LinearModel[Column]:
        left = self.readings - sum((each.effect(amount) for each, amount in held), np.zeros(len(self.readings)))
        made = LinearModel[Column].of(self.N, left, self.layout, self.prior, np.zeros(len(self.prior)))
        for each, amount in held:
            made = made.holding(each, each.columns(self, amount), amount)
        return made

    def columns(self, hypotheses: Sequence[Column], held: Sequence[tuple[Column, np.ndarray]]) -> np.ndarray:
        return np.hstack([each.columns(self, np.zeros(len(each.std))) for each in hypotheses])


def drawn(rng: np.random.Generator, rows: int = 60, noise: Sequence[float] = (1.0, 1.0)) -> Drawn:
    """Two groups of rows in every block, with noise of their own."""
    blocks = 8
    group = np.tile(np.repeat([0, 1], rows // 2), blocks)
    layout = Layout(np.repeat(np.arange(blocks), 2 * (rows // 2)), group, np.full(2, blocks * (rows / 2)))
    N = rng.normal(size=(len(group), 5))
    sigma = np.array(noise)[group]
    return Drawn(N, N @ rng.normal(size=5) + sigma * rng.normal(size=len(group)), np.eye(5), layout)


def columns(rng: np.random.Generator, data: Drawn, count: int, d: int = 1) -> list[Column]:
    return [Column(name=f"h{k}", subject=(), std=(0.5,) * d, values=rng.normal(size=(len(data.N), d)))
            for k in range(count)]


def test_evidence_is_the_ratio_of_marginal_likelihoods() -> None:
    """Of both, the densities of the readings under the covariance with and without the columns; and least squares."""
    rng = np.random.default_rng(0)
    data = drawn(rng)
    (one,) = columns(rng, data, 1, d=2)
    data.readings = data.readings + one.values @ np.array([0.3, -0.2])
    without, with_it = data.model([]), data.model([(one, np.zeros(2))])
    found = with_it.found(one, without)

    def density(model: LinearModel[Column], V: np.ndarray) -> float:
        s = model.fit.variance
        V = V + np.diag(s[data.layout.group])
        return float(multivariate_normal.logpdf(data.readings, np.zeros(len(V)), V)
                     - 0.5 * BELIEF * np.sum(np.log(s) + 1 / s))

    V = data.N @ data.N.T
    expected = density(with_it, V + 0.25 * one.values @ one.values.T) - density(without, V)
    assert found.evidence == pytest.approx(expected, rel=1e-6)
    weight = 1 / with_it.fit.variance[data.layout.group]
    stack = np.hstack([data.N, one.values])
    information = stack.T @ (weight[:, None] * stack) + np.diag([1.0] * 5 + [4.0] * 2)
    x = np.linalg.solve(information, stack.T @ (weight * data.readings))
    np.testing.assert_allclose(found.amount, x[5:], rtol=1e-8)
    np.testing.assert_allclose(found.covariance, np.linalg.inv(information)[5:, 5:], rtol=1e-8)
    np.testing.assert_allclose(found.shift, x[:5] - without.fit.x, rtol=1e-6)
    assert found.moves(np.eye(5), np.full(5, 0.1)) == pytest.approx(10 * np.max(np.abs(found.shift)))
    assert without.screened([one], one.values)[0] == pytest.approx(found.evidence, abs=2.0)


def test_variances_are_those_of_the_groups_and_never_below_the_stated() -> None:
    rng = np.random.default_rng(1)
    data = drawn(rng, rows=400, noise=(3.0, 0.2))
    variance = data.model([]).fit.variance
    assert variance[0] == pytest.approx(9.0, rel=0.1)
    assert variance[1] == 1.0


def test_linearised_anew_a_nonlinear_amount_is_found() -> None:
    rng = np.random.default_rng(2)
    data = drawn(rng)
    values = rng.uniform(-2, 2, size=(len(data.N), 1))
    bent = Column(name="bent", subject=(), std=(1.0,), values=values, linear=False)
    data.readings = data.readings + np.sin(bent.values[:, 0] * 0.9)
    (found,) = name(data, [bent, *columns(rng, data, 5)])
    assert found.hypothesis is bent
    assert abs(found.size - 0.9) < 3 * found.std < 0.4


def test_sound_data_accuse_nothing_and_faults_are_named() -> None:
    """Of 300 drawn data with 20 hypotheses each, half with two faults and noise above what is stated."""
    false, right = 0, 0
    for seed in range(150):
        rng = np.random.default_rng(seed)
        data = drawn(rng, noise=(1.0, 2.0))
        candidates = columns(rng, data, 20)
        false += bool(name(data, candidates))
        data.readings = data.readings + candidates[3].values[:, 0] * 0.5 - candidates[7].values[:, 0] * 0.4
        right += {each.hypothesis.name for each in name(data, candidates)} == {"h3", "h7"}
    assert false <= 2
    assert right >= 147


def test_what_one_block_alone_shows_is_not_named() -> None:
    rng = np.random.default_rng(3)
    data = drawn(rng)
    candidates = columns(rng, data, 10)
    once = np.where(np.arange(len(data.N)) < 60, 3.0, 0.0)
    data.readings = data.readings + candidates[2].values[:, 0] * once
    assert not name(data, candidates)


def test_data_that_do_not_separate_hypotheses_name_both() -> None:
    rng = np.random.default_rng(4)
    data = drawn(rng)
    one, other = columns(rng, data, 2)
    near = Column(name="near", subject=(), std=(0.5,), values=one.values + 0.02 * other.values + data.N[:, :1])
    data.readings = data.readings + 0.5 * one.values[:, 0]
    (found,) = name(data, [one, near])
    assert {found.hypothesis.name, *(each.hypothesis.name for each in found.rivals)} == {"h0", "near"}


def test_the_smallest_size_that_shows_shows_in_nearly_all_data() -> None:
    shown = []
    for seed in range(60):
        rng = np.random.default_rng(seed)
        data = drawn(rng)
        candidates = columns(rng, data, 10)
        size, *_ = data.model([]).smallest(candidates, data.columns(candidates, []))
        data.readings = data.readings + size * candidates[0].values[:, 0]
        shown.append(bool(name(data, candidates)))
    assert np.mean(shown) >= 0.85
