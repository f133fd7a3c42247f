"""Noisy angles: fitted motion, instruments and channels that err together, each against a derivation of its own."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.interpolate import BSpline
from scipy.optimize import least_squares

from hydroopt.errors import LogError, ProblemError
from hydroopt.estimation.dynamic import fitted_motion
from hydroopt.estimation.dynamic.identify import identify
from hydroopt.estimation.dynamic.problem import IdentificationProblem, identification_problem
from hydroopt.estimation.dynamic.regressor_qr import compress_instrumented, compress_jointly
from hydroopt.estimation.dynamic.weighted_residuals import weighted_residuals
from hydroopt.estimation.inference.least_squares import base_least_squares
from hydroopt.logs.log import Log
from hydroopt.logs.smoothing import Butterworth, SmoothingSpline
from hydroopt.machine.machine import Machine
from hydroopt.model.model import Model
from hydroopt.simulation.simulate import random_trajectory, simulate

EXACT = {"tolerance": 1e-9, "intervals": False}
TRUTH = np.array([0.7, 5.0, 3.0, 2.0])
"""Offset, Coulomb and viscous friction, rotor inertia of the wheel."""
NOISE, TORQUE_NOISE = 0.03, 0.5


@pytest.fixture(scope="module")
def sensed(wheel: Model) -> Model:
    """The wheel with a coarse encoder."""
    sensors = [{"channels": ["wheel.q"], "accuracy": NOISE, "distribution": "gaussian"},
               {"channels": ["wheel.tau"], "accuracy": TORQUE_NOISE, "distribution": "gaussian"}]
    return Model(Machine.model_validate({**wheel.machine.model_dump(), "sensors": sensors, "bandwidth": 2.0}))


@pytest.fixture(scope="module")
def recorded(sensed: Model) -> Callable[[int], tuple[Log, Log]]:
    def record(seed: int) -> tuple[Log, Log]:
        motion = random_trajectory(sensed, duration=20, rate=40, seed=5, slowest=0.1, fastest=0.6)
        return (simulate(sensed, motion, TRUTH, seed=seed), simulate(sensed, motion, TRUTH, noise=False))
    return record


def test_fitted_motion_is_the_optimum_of_the_whole_problem(sensed: Model, recorded: Any) -> None:
    """Against SciPy on all coefficients and parameters at once, with splines and their penalty reckoned by SciPy."""
    data = identification_problem(sensed.machine, [recorded(1)[0]]).experiments[0]
    covariance = np.array([[TORQUE_NOISE**2]])

    def least(R: np.ndarray, r: np.ndarray) -> np.ndarray:
        return base_least_squares(R, r, sensed.parameters.names)[0]

    start = fitted_motion.initial_guess(sensed, [data])
    found = fitted_motion.fit(sensed, start, covariance, None, TRUTH, least, "test")
    (one,) = found.motion(found.psi)
    (stretch,) = one.stretches
    count = len(stretch.path.coefficients) - 5
    t = data.log.t
    spacing = (t[-1] - t[0]) / count
    knots = t[0] + spacing * np.arange(-5, count + 6)
    points, weights = np.polynomial.legendre.leggauss(5)
    inner = (np.arange(count)[:, None] * spacing + spacing * (1 + points) / 2).ravel()
    root = np.sqrt(np.tile(weights * spacing / 2, count))
    taken = data.known[:, 0]

    def residuals(x: np.ndarray) -> np.ndarray:
        spline, (offset, coulomb, viscous, inertia) = BSpline(knots, x[:-4], 5), x[-4:]
        speed = spline(t, 1)
        torque = offset + coulomb * np.sign(speed) + viscous * speed + inertia * spline(t, 2)
        return np.concatenate([
            (data.log.channels["wheel.q"] - spline(t)) / NOISE, one.stiffness[0] * root * spline(t[0] + inner, 3),
            (data.force[:, 0] - torque)[taken] / TORQUE_NOISE])

    answer = least_squares(residuals, np.append(stretch.path.coefficients.ravel(), TRUTH), x_scale="jac", xtol=1e-14,
                           ftol=1e-15, gtol=1e-14)
    spread = np.sqrt(np.diag(np.linalg.inv(answer.jac.T @ answer.jac))[-4:])
    np.testing.assert_allclose(np.linalg.inv(found.R.T @ found.R).diagonal() ** 0.5, spread, rtol=1e-3)
    assert np.max(np.abs(found.psi - answer.x[-4:]) / spread) < 1e-3
    assert 2 * answer.cost == pytest.approx(found.rest, rel=1e-6)


@pytest.fixture(scope="module")
def errors(sensed: Model, recorded: Any) -> dict[str, np.ndarray]:
    """Errors (seeds, 4) of each way over the stated σ of the last."""
    found: dict[str, list] = {}
    for seed in range(60):
        log, reference = recorded(seed)
        filtered = identification_problem(sensed.machine, [log], smoothing=Butterworth(2.0))
        smooth = identification_problem(sensed.machine, [log], smoothing=SmoothingSpline(bandwidth=2.0))
        for name, problem in (("filter", filtered), ("instruments", filtered.with_instruments([reference])),
                              ("fitted", smooth.with_fitted_motion())):
            estimate = identify(problem, "wls")
            found.setdefault(name, []).append(estimate.value - TRUTH)
            found.setdefault(f"{name} std", []).append(estimate.std)
    return {name: np.array(some) for name, some in found.items()}


@pytest.mark.slow
@pytest.mark.parametrize("better", ["instruments", "fitted"])
def test_bias_of_the_inertia_shrinks(better: str, errors: dict[str, np.ndarray]) -> None:
    """Least squares on noisy accelerations finds too little inertia; neither of the better ways does."""
    assert np.mean(errors["filter"][:, 3]) < -0.2
    assert abs(np.mean(errors[better][:, 3])) < 0.2 * abs(np.mean(errors["filter"][:, 3]))


@pytest.mark.slow
def test_intervals_of_the_fitted_motion_are_honest(errors: dict[str, np.ndarray]) -> None:
    scatter = errors["fitted"] / errors["fitted std"]
    assert 0.85 < np.sqrt(np.mean(scatter**2)) < 1.15  # 240 numbers
    assert np.mean(np.abs(scatter) < 1.96) > 0.9


def test_instruments_solve_their_own_equations(noisy: IdentificationProblem, exact_logs: list[Log]) -> None:
    """Two-stage least squares makes residuals perpendicular to the instruments projected rows: ``K̂ᵀ·(f − K·ψ) = 0``."""
    model, experiments = noisy.model, noisy.experiments
    problem = noisy.with_instruments(exact_logs[:2])
    sigma = noisy.force_std
    R, r, _ = compress_instrumented(model, experiments, problem.instruments, sigma)
    rows: dict[str, list] = {"Z": [], "K": [], "f": []}
    for data, other in zip(experiments, problem.instruments, strict=True):
        taken = (data.inside[:, None] & data.known).ravel()
        for name, motion in (("Z", other), ("K", data.motion)):
            K = model.over(model.regressor, motion.q, motion.qd, motion.qdd)[0] / sigma[:, None]
            rows[name].append(K.reshape(-1, K.shape[2])[taken])
        rows["f"].append((data.force / sigma).ravel()[taken])
    Z, K, f = (np.concatenate(rows[name]) for name in ("Z", "K", "f"))
    projected = Z @ np.linalg.lstsq(Z, K, rcond=1e-10)[0]
    size = np.linalg.norm(projected, axis=0) + 1e-9
    scaled = projected / size
    np.testing.assert_allclose(R.T @ R / np.outer(size, size), scaled.T @ scaled, atol=1e-8)
    np.testing.assert_allclose(R.T @ r / size, projected.T @ f / size, atol=1e-7 * np.linalg.norm(f))


def test_channels_that_err_together_are_weighted_as_generalised_least_squares(noisy: IdentificationProblem) -> None:
    model, experiments = noisy.model, noisy.experiments
    covariance = np.array([[4.0, 1.5, -0.5], [1.5, 9.0, 2.0], [-0.5, 2.0, 1.0]]) * 1e6
    R, r, rest = compress_jointly(model, experiments, covariance)
    information, right, squares = np.zeros_like(R), np.zeros_like(r), 0.0
    for data in experiments:
        K = model.over(model.regressor, data.motion.q, data.motion.qd, data.motion.qdd)[0]
        for k in np.flatnonzero(data.inside):
            here = np.flatnonzero(data.known[k])
            if here.size:
                inverse = np.linalg.inv(covariance[np.ix_(here, here)])
                information += K[k, here].T @ inverse @ K[k, here]
                right += K[k, here].T @ inverse @ data.force[k, here]
                squares += data.force[k, here] @ inverse @ data.force[k, here]
    size = np.sqrt(np.diag(information)) + 1e-12
    np.testing.assert_allclose(R.T @ R / np.outer(size, size), information / np.outer(size, size), atol=1e-11)
    np.testing.assert_allclose(R.T @ r / size, right / size, rtol=1e-9, atol=1e-9 * np.max(right / size))
    assert r @ r + rest == pytest.approx(squares, rel=1e-11)


def test_correlation_of_channels_is_found(cat215b: Model, cat_truth: np.ndarray, noisy: IdentificationProblem) -> None:
    rng = np.random.default_rng(3)
    mixed = rng.standard_normal((3, len(noisy.experiments[0].force), 2))
    common = [replace(e, force=e.force + 2000 * np.outer(mixed[0, :, k], [0.3, 1.0, -1.0]))
              for k, e in enumerate(noisy.experiments)]
    correlated = replace(noisy, experiments=tuple(common)).with_correlated_channels()
    weighted = weighted_residuals(correlated, 1e-7, lambda R, r: r)
    assert weighted.correlation[1, 2] < -0.3
    assert np.all(np.linalg.eigvalsh(weighted.correlation) > 0)


@pytest.mark.parametrize("way", ["instruments", "correlated"])
def test_perfect_sensors_give_back_the_truth(way: str, exact: IdentificationProblem, exact_logs: list[Log],
                                             cat_truth: np.ndarray) -> None:
    problem = exact.with_instruments(exact_logs[:-1]) if way == "instruments" else exact.with_correlated_channels()
    estimate = identify(problem, "wls", **EXACT)
    assert max(fit.relative for fit in estimate.fit["validation"].values()) < 1e-9
    base = estimate.identifiability.grouping @ cat_truth
    np.testing.assert_allclose(estimate.base_value, base, rtol=1e-6, atol=1e-12 * np.max(np.abs(base)))


def test_lengths_stand_in_for_a_reference(cat215b: Model, noisy: IdentificationProblem) -> None:
    with pytest.raises(ProblemError, match="joint 'swing' has no second reading; give a log of the motion"):
        noisy.with_instruments()


def test_ways_exclude_one_another(noisy: IdentificationProblem, exact_logs: list[Log]) -> None:
    with pytest.raises(ProblemError, match="choose one"):
        noisy.with_fitted_motion().with_instruments(exact_logs[:2])
    with pytest.raises(ProblemError, match="choose one"):
        noisy.with_instruments(exact_logs[:2]).with_fitted_motion()
    with pytest.raises(ProblemError, match="one for each training log"):
        noisy.with_instruments(exact_logs[:1])
    with pytest.raises(LogError, match="covers"):
        noisy.with_instruments([exact_logs[0].slice(5, 100), exact_logs[1]])
