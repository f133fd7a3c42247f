"""Friction that changes within a log or from log to log, and rows by frequency against plain sums of squares."""

from __future__ import annotations

import numpy as np
import pytest

from hydroopt.estimation.dynamic.frequency_bands import ActuatorBands
from hydroopt.estimation.dynamic.identify import identify
from hydroopt.estimation.dynamic.problem import IdentificationProblem, identification_problem
from hydroopt.estimation.dynamic.regressor_qr import compress, compressed
from hydroopt.estimation.dynamic.session_comparison import SessionComparison, compare
from hydroopt.logs.log import Log
from hydroopt.logs.smoothing import Fourier
from hydroopt.model.model import Model

RATE, DURATION = 50.0, 40.0
TRUTH = np.array([0.5, 5.0, 3.0, 2.0])
"""Offset, Coulomb and viscous friction, inertia of the wheel."""


def turning(seed: int, *, coulomb: float = 0.0, later: float = 0.0) -> Log:
    """A log of the wheel whose Coulomb friction is off by `coulomb`, and in the second half by `later` more."""
    rng = np.random.default_rng(seed)
    t = np.arange(int(DURATION * RATE)) / RATE
    omega = 2 * np.pi * np.arange(2, 9) / DURATION
    angle = np.outer(t, omega) + rng.uniform(0, 2 * np.pi, len(omega))
    size = 0.3 * rng.uniform(0.5, 1.5, len(omega))
    q, qd, qdd = np.sin(angle) @ size, np.cos(angle) @ (size * omega), -np.sin(angle) @ (size * omega**2)
    torque = np.column_stack([np.ones_like(t), np.sign(qd), qd, qdd]) @ TRUTH
    torque += np.sign(qd) * (coulomb + later * (t >= DURATION / 2)) + 0.5 * rng.normal(size=len(t))
    return Log(f"turning {seed}", t, {"wheel.q": q, "wheel.tau": torque})


def problem(wheel: Model, logs: list[Log]) -> IdentificationProblem:
    return identification_problem(wheel, logs, smoothing=Fourier(period=DURATION, harmonics=10))


def test_rows_by_frequency_have_the_sums_of_squares_of_all_samples(noisy: IdentificationProblem) -> None:
    plain = compress(noisy.experiments)
    bands = compressed(ActuatorBands.together([data.bands() for data in noisy.experiments]))
    np.testing.assert_array_equal(bands.samples, plain.samples)
    for one, other in zip(bands.triangles, plain.triangles, strict=True):
        gram = other.T @ other
        size = np.sqrt(np.outer(np.diag(gram), np.diag(gram)))
        np.testing.assert_allclose(one.T @ one / np.where(size > 0, size, 1), gram / np.where(size > 0, size, 1),
                                   atol=1e-12)


def test_bands_count_every_residual_once(noisy: IdentificationProblem) -> None:
    for data in noisy.experiments:
        bands = data.bands()
        np.testing.assert_allclose(bands.counts.sum(axis=1), bands.samples)


def test_friction_that_changes_within_a_log_is_said(wheel: Model) -> None:
    steady, changed = (identify(problem(wheel, [turning(1, later=later)]), "wls") for later in (0.0, 1.0))
    (phi,), (much,) = steady.weighted_residuals.split_half, changed.weighted_residuals.split_half
    assert phi.phi < 3.0
    assert phi.p_value > 0.01
    assert much.p_value < 1e-4
    assert much.phi > 5.0
    assert not [one for one in steady.diagnostics if one.kind == "halves of a log differ"]
    (said,) = (one for one in changed.diagnostics if one.kind == "halves of a log differ")
    assert said.subject == ("turning 1",)
    assert changed.details()["split_half"][0]["phi"] == pytest.approx(much.phi)


def test_sessions_are_held_against_the_halves_of_their_logs(wheel: Model) -> None:
    """Friction that rises by 1 within one log, and in the other is that of its end, changes by no more."""
    def compared(before: Log, after: Log) -> SessionComparison:
        return compare(wheel.machine, [before, after], smoothing=Fourier(period=DURATION, harmonics=10))

    drifting = compared(turning(1, later=1.0), turning(2, coulomb=1.0))
    assert not drifting.steady
    assert [one.kind for one in drifting.findings] == ["no change detected", "sessions differ without any order"]
    assert "Halves of single logs differ as well" in drifting.findings[1].text
    assert not any(one.changed for one in drifting.differences)
    stepped = compared(turning(1), turning(2, coulomb=0.7))
    assert stepped.steady
    assert stepped.findings[0].kind == "change detected"
    assert stepped.difference("drive.tau_coulomb").changed


def test_friction_that_changes_from_log_to_log_widens_the_interval_of_its_mean(wheel: Model) -> None:
    off = [0.8, -0.9, 0.3, -0.2]
    alike = identify(problem(wheel, [turning(k) for k in range(4)]), "wls")
    apart = identify(problem(wheel, [turning(k, coulomb=x) for k, x in enumerate(off)]), "wls")
    k = wheel.parameters.index("drive.tau_coulomb")
    spread = float(np.std(off, ddof=1)) / 2
    assert alike.weighted_residuals.between_logs.std < 0.02
    assert apart.weighted_residuals.between_logs.std > 0.03
    assert 0.6 * spread < apart.std[k] < 3 * spread
    assert apart.std[k] > 4 * alike.std[k]
    assert abs(apart.value[k] - TRUTH[1]) < 2.5 * apart.std[k]


@pytest.mark.slow
def test_intervals_of_the_mean_hold_over_many_sets_of_logs(wheel: Model) -> None:
    k, inside = wheel.parameters.index("drive.tau_coulomb"), []
    rng = np.random.default_rng(8)
    for trial in range(60):
        logs = [turning(1000 + 4 * trial + j, coulomb=0.7 * rng.normal()) for j in range(4)]
        found = identify(problem(wheel, logs), "wls")
        inside.append(found.ci95[k, 0] <= TRUTH[1] <= found.ci95[k, 1])
    assert np.mean(inside) > 0.87  # 95 % expected of 60
