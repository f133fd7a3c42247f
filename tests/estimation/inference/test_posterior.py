"""The sampler against posteriors that are known exactly."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from scipy.stats import truncnorm, wishart

from hydroopt.estimation.dynamic.estimate import Estimate
from hydroopt.estimation.dynamic.identify import identify
from hydroopt.estimation.dynamic.problem import IdentificationProblem, identification_problem
from hydroopt.estimation.inference import posterior
from hydroopt.estimation.inference.posterior import _pivots, sample
from hydroopt.guided.kinds import KINDS
from hydroopt.guided.machine_text import machine_text
from hydroopt.guided.sketch import Sketch
from hydroopt.logs.log import Log
from hydroopt.logs.smoothing import Fourier
from hydroopt.machine.machine_file import read_machine
from hydroopt.model.model import Model
from hydroopt.simulation.simulate import random_trajectory, random_truth, simulate

NAMES = ("drive.tau_offset", "drive.tau_coulomb", "drive.tau_viscous", "drive.rotor_inertia")


def pooled(problem: IdentificationProblem, R: np.ndarray, mean: np.ndarray, *, consistent: bool = False,
           runs: int = 24) -> np.ndarray:
    """Samples (s, p) of the posterior of ``‖R·(ψ − mean)‖²``, from several seeds."""
    start = np.maximum(mean, problem.parameters.lower)
    drawn = [sample(problem, R, R @ mean, start, consistent=consistent, seed=seed) for seed in range(runs)]
    return np.concatenate([posterior.samples for posterior in drawn if posterior is not None])


@pytest.fixture(scope="module")
def free_wheel(wheel: Model) -> IdentificationProblem:
    assert wheel.parameters.names == NAMES
    return IdentificationProblem(wheel, ())


@pytest.mark.slow
def test_gaussian_where_no_constraint_is_near(free_wheel: IdentificationProblem) -> None:
    rng = np.random.default_rng(0)
    R = rng.standard_normal((4, 4)) + 2 * np.eye(4)
    mean = np.array([-3.0, 30.0, 40.0, 50.0])
    samples = pooled(free_wheel, R, mean)
    covariance = np.linalg.inv(R.T @ R)
    std = np.sqrt(np.diag(covariance))
    np.testing.assert_allclose(samples.mean(axis=0), mean, atol=0.05 * std.max())
    np.testing.assert_allclose(samples.std(axis=0), std, rtol=0.04)
    np.testing.assert_allclose(np.cov(samples.T) / np.outer(std, std), covariance / np.outer(std, std), atol=0.05)
    posterior = sample(free_wheel, R, R @ mean, mean, consistent=False, seed=0)
    assert posterior is not None
    np.testing.assert_allclose(
        posterior.interval()[1], mean[:, None] + 1.96 * std[:, None] * [-1, 1], atol=0.25 * std.max()
    )


@pytest.mark.slow
def test_priors_sharpen_what_data_say(one_body: Callable[..., IdentificationProblem]) -> None:
    problem = one_body(np.array([500.0, 0, 0, 0, 90, 0, 0, 90, 0, 90]), (2.0, 1.0, 0.5))
    rng = np.random.default_rng(1)
    R = rng.standard_normal((10, 10)) * 0.3
    H = R.T @ R + np.diag(1 / np.repeat([2.0, 1.0, 0.5], (1, 3, 6)) ** 2)
    samples = pooled(problem, R, problem.parameters.nominal, consistent=True)
    np.testing.assert_allclose(samples.std(axis=0), np.sqrt(np.diag(np.linalg.inv(H))), rtol=0.05)


@pytest.mark.parametrize("mean", [1.0, 0.0, -1.5])
def test_truncated_normal_where_a_friction_meets_its_bound(free_wheel: IdentificationProblem, mean: float) -> None:
    # correlated with the offset, so that the cut shifts the offset too
    std = np.array([2.0, 1.0, 1.0, 1.0])
    correlation = np.eye(4)
    correlation[0, 1] = correlation[1, 0] = 0.6
    R = np.linalg.cholesky(np.linalg.inv(correlation * np.outer(std, std))).T
    samples = pooled(free_wheel, R, np.array([10.0, mean, 30.0, 30.0]), runs=12)
    exact = truncnorm(-mean, np.inf, loc=mean, scale=1.0)
    for probability in (0.025, 0.25, 0.5, 0.75, 0.975):
        assert exact.cdf(np.quantile(samples[:, 1], probability)) == pytest.approx(probability, abs=0.025)
    assert samples[:, 1].std() == pytest.approx(exact.std(), rel=0.06)
    assert samples[:, 0].mean() == pytest.approx(10 + 0.6 * 2 * (exact.mean() - mean), abs=0.12)
    assert np.all(samples[:, 1] >= 0)


def test_truncated_normal_where_nominal_parameters_are_excluded(free_wheel: IdentificationProblem,
                                                                  monkeypatch: pytest.MonkeyPatch) -> None:
    least, found = free_wheel.parameters.nominal[1] + 40.0, []
    excluding = free_wheel.subject_to("rough", lambda p: p["drive.tau_coulomb"] >= least)
    convex, own = posterior.convex_program, posterior.convex_program.inner_point
    monkeypatch.setattr(convex, "inner_point", lambda *a, **k: found.append(own(*a, **k)) or found[-1])
    samples = pooled(excluding, np.eye(4), np.array([10.0, least - 1.0, 30.0, 30.0]), runs=6)
    assert len(found) == 6  # where the chains begin
    exact = truncnorm(1.0, np.inf, loc=least - 1.0, scale=1.0)
    for probability in (0.025, 0.5, 0.975):
        assert exact.cdf(np.quantile(samples[:, 1], probability)) == pytest.approx(probability, abs=0.03)
    assert np.all(samples[:, 1] >= least)


@pytest.mark.slow
def test_body_at_the_edge_of_existence(one_body: Callable[..., IdentificationProblem]) -> None:
    """Rejection sampling: draw from the Gaussian, keep the bodies that can exist."""
    problem = one_body(np.array([2.0, 1.5, 0, 0, 1, 0, 0, 2, 0, 2]), (0.5, 0.3, 0.5))
    std = np.repeat([0.5, 0.3, 0.5], (1, 3, 6))
    draws = problem.parameters.nominal + np.random.default_rng(3).standard_normal((200_000, 10)) * std
    J = np.zeros((len(draws), 4, 4))
    inertia = draws[:, [4, 5, 6, 5, 7, 8, 6, 8, 9]].reshape(-1, 3, 3)
    J[:, :3, :3] = 0.5 * np.trace(inertia, axis1=1, axis2=2)[:, None, None] * np.eye(3) - inertia
    J[:, :3, 3] = J[:, 3, :3] = draws[:, 1:4]
    J[:, 3, 3] = draws[:, 0]
    kept = draws[np.linalg.eigvalsh(J)[:, 0] > 0]
    assert 500 < len(kept) < 0.5 * len(draws)
    start = kept[0]
    drawn = [sample(problem, np.zeros((10, 10)), np.zeros(10), start, consistent=True, seed=seed) for seed in range(12)]
    samples = np.concatenate([posterior.samples for posterior in drawn if posterior is not None])
    np.testing.assert_allclose(samples.mean(axis=0), kept.mean(axis=0), atol=0.12 * std.max())
    np.testing.assert_allclose(samples.std(axis=0), kept.std(axis=0), rtol=0.1)


def test_the_mean_keeps_what_is_known_of_sums(free_wheel: IdentificationProblem) -> None:
    """A sum that is known ten thousand times better than its parts, two of which are cut off at zero."""
    R = np.eye(4)
    R[0, :3] = 1e4
    mean = np.array([-3.0, 1.0, 0.5, 30.0])
    for seed in range(3):
        posterior = sample(free_wheel, R, R @ mean, mean, consistent=False, seed=seed)
        assert posterior is not None
        assert posterior.mean is not None
        assert np.sum(posterior.mean[:3]) == pytest.approx(-1.5, abs=0.2e-4)
        np.testing.assert_allclose(posterior.mean, posterior.own.mean, atol=0.2)


def test_positive_definite_is_what_eigenvalues_say() -> None:
    rng = np.random.default_rng(4)
    good = wishart(4, np.eye(4)).rvs(2000, random_state=rng)
    odd = rng.standard_normal((2000, 4, 4))
    flat = good - np.linalg.eigvalsh(good)[:, :1, None] * np.eye(4) * rng.choice([0.9, 1.1], (2000, 1, 1))
    matrices = np.concatenate([good, odd + odd.swapaxes(1, 2), flat, np.zeros((1, 4, 4)), -np.eye(4)[None]])
    upper = np.triu_indices(4)
    expected = np.linalg.eigvalsh(matrices)[:, 0] > 0
    assert 0.2 < expected.mean() < 0.8
    np.testing.assert_array_equal(np.all(_pivots(matrices[:, upper[0], upper[1]].T) > 0, axis=0), expected)


@pytest.mark.slow
def test_samples_stay_on_a_linear_equality_and_inside_inequalities(free_wheel: IdentificationProblem) -> None:
    held = (free_wheel.subject_to("sum", lambda p: p["drive.tau_coulomb"] + 2 * p["drive.tau_viscous"] == 12)
            .subject_to("order", lambda p: p["drive.tau_coulomb"] >= p["drive.tau_viscous"])
            .fix("drive.rotor_inertia", 7.0))
    mean = np.array([0.0, 4.5, 3.75, 7.0])
    samples = pooled(held, np.eye(4), mean)
    np.testing.assert_allclose(samples[:, 1] + 2 * samples[:, 2], 12, rtol=1e-9)
    assert np.all(samples[:, 1] >= samples[:, 2])
    np.testing.assert_allclose(samples[:, 3], 7.0, rtol=1e-9)
    # coulomb along the line from 4 on: (c − 4.5)² + ((12 − c)/2 − 3.75)² = 1.25·(c − 4.5)²
    scale = 1 / np.sqrt(1.25)
    exact = truncnorm(-0.5 / scale, np.inf, loc=4.5, scale=scale)
    assert np.mean(samples[:, 1]) == pytest.approx(exact.mean(), abs=0.05)
    assert np.std(samples[:, 1]) == pytest.approx(exact.std(), rel=0.06)
    assert np.std(samples[:, 0]) == pytest.approx(1.0, rel=0.05)


@pytest.mark.slow
def test_fixed_parameter_has_no_interval_and_a_curved_equality_no_intervals(noisy: IdentificationProblem) -> None:
    fixed = identify(noisy.fix("boom.m", 1700.0))
    k = noisy.parameters.index("boom.m")
    assert (fixed.value[k], fixed.category(k)) == (1700.0, "fixed")
    assert np.isnan(fixed.std[k])
    assert np.ptp(fixed.posterior.samples[:, k]) == pytest.approx(0, abs=1e-6)
    assert np.nanmax(fixed.std) > 0
    curved = identify(noisy.subject_to("product", lambda p: p["boom.m"] * p["stick.m"] == 1.2e6), "nlp")
    assert np.all(np.isnan(curved.std))
    assert np.all(np.isnan(curved.ci95))
    assert np.all(np.isnan(curved.base_std))
    assert any("no intervals" in note for note in curved.notes)


def test_seed_decides(free_wheel: IdentificationProblem) -> None:
    mean = np.ones(4)
    one, same, other = (sample(free_wheel, np.eye(4), mean, mean, consistent=False, seed=seed) for seed in (3, 3, 4))
    assert one is not None
    assert same is not None
    assert other is not None
    np.testing.assert_array_equal(one.samples, same.samples)
    assert not np.any(one.samples == other.samples)


def test_a_whole_identification_at_a_bound(wheel: Model) -> None:
    """Friction that is really zero: value and interval are those of the truncated posterior of ordinary regression."""
    rng = np.random.default_rng(11)
    t = np.arange(0, 40, 0.02)
    omega = 2 * np.pi * 0.25
    q, qd, qdd = np.sin(omega * t), omega * np.cos(omega * t), -(omega**2) * np.sin(omega * t)
    columns = np.column_stack([np.ones_like(t), np.sign(qd), qd, qdd])
    noise = rng.standard_normal(t.size)
    noise -= columns @ np.linalg.lstsq(columns, noise, rcond=None)[0]  # so that the estimate before the cut is known
    psi = np.array([0.5, -0.03, 3.0, 2.0])
    log = Log("wheel", t, {"wheel.q": q, "wheel.tau": columns @ psi + noise})
    problem = identification_problem(wheel.machine, [log], smoothing=Fourier(period=40.0, harmonics=12))
    rows = problem.experiments[0].known[:, 0]
    estimates = [identify(problem, "qp", seed=seed) for seed in range(6)]
    estimate = estimates[0]
    unbounded = np.linalg.lstsq(columns[rows], (columns @ psi + noise)[rows], rcond=None)[0][1]
    sigma = (
        np.sqrt(estimate.correlation_time[0] * np.linalg.inv(columns[rows].T @ columns[rows])[1, 1]) * estimate.sigma[0]
    )
    exact = truncnorm(-unbounded / sigma, np.inf, loc=unbounded, scale=sigma)
    k = NAMES.index("drive.tau_coulomb")
    assert np.mean([e.std[k] for e in estimates]) == pytest.approx(exact.std(), rel=0.06)
    low, high = np.mean([e.ci95[k] for e in estimates], axis=0)
    np.testing.assert_allclose(exact.cdf([low, high]), [0.025, 0.975], atol=0.01)


@pytest.mark.slow
def test_an_active_inequality_keeps_its_intervals(noisy: IdentificationProblem, noisy_estimate: Estimate) -> None:
    """A half-space that cuts off the most probable point is sampled up to its edge."""
    limit = noisy_estimate["boom.m"].value + noisy_estimate["stick.m"].value - 300
    cut = identify(noisy.subject_to("light", lambda p: p["boom.m"] + p["stick.m"] <= limit), "sdp")
    assert "light" in cut.active
    assert np.isfinite(cut.std[cut.problem.parameters.index("boom.m")])
    assert cut["boom.m"].value + cut["stick.m"].value < limit


@pytest.mark.slow
def test_slow_chains_have_the_spread_of_ones_that_run_long(monkeypatch: pytest.MonkeyPatch) -> None:
    """Slender bodies whose centres of mass are widely uncertain: few warm-ups against thirty, with twenty times the
    samples."""
    sketch = Sketch(KINDS["loader"], {})
    while (question := sketch.open) is not None:
        sketch = sketch.answered(question, "")
    model = Model(read_machine(machine_text(sketch)))
    log = simulate(model, random_trajectory(model, duration=40, rate=25, seed=31), random_truth(model, seed=3), seed=1)
    problem = identification_problem(model.machine, [log])
    found = identify(problem).posterior
    assert found is not None
    assert found.converged
    monkeypatch.setattr(posterior, "ROUNDS", 30)
    monkeypatch.setattr(posterior, "SWEEPS", 200)
    monkeypatch.setattr(posterior, "MEMORY", -1.0)
    long = identify(problem).posterior
    assert long is not None
    spread = long.samples.std(axis=0)
    moving = spread > 0
    assert np.mean(found.samples.std(axis=0)[moving] / spread[moving]) == pytest.approx(1, abs=0.03)
    low, high = found.interval()[1][moving].T
    inside = np.mean((long.samples[:, moving] >= low) & (long.samples[:, moving] <= high), axis=0)
    assert np.mean(inside) == pytest.approx(0.95, abs=0.01)
    assert np.min(inside) > 0.9
