"""What changed over several sessions: exactly without noise, false alarms of the whole comparison as stated with it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest
from estimation.dynamic.test_change import NAMES, PARTS, moved, regressors
from scipy import stats

from fixtures.two_sessions import PERIOD, PLANAR, RATE, TORQUE_NOISE
from hydroopt.errors import ProblemError
from hydroopt.estimation.dynamic.change_history import ChangeHistory, Course, change_history, detect_changes
from hydroopt.estimation.dynamic.change_space import Shape
from hydroopt.estimation.dynamic.session_scan import session_scan
from hydroopt.estimation.dynamic.session_scatter import random_amounts
from hydroopt.estimation.dynamic.stored_information import StoredInformation
from hydroopt.report.change_history import render_history
from hydroopt.results.diagnostic import of_kind
from hydroopt.results.wording import Kind

NAME = "upper_drive.tau_viscous"
PLACE = PARTS.index(NAME)
SESSIONS = 5


def measured(psi: np.ndarray, motion: int, noise: np.random.Generator | None = None, *, split_half: float = 1.0,
             without: Sequence[int] = (), same: tuple[int, int] | None = None) -> StoredInformation:
    """A session in which the torques of a motion are measured; angles are exact and σ is known.

    Some columns of the regressor may have no effect, or the first of two that of the second.
    """
    triangles = []
    for nominal in regressors(motion):
        K = nominal.copy()
        K[:, list(without)] = 0.0
        if same:
            K[:, same[0]] = K[:, same[1]]
        force = K @ psi + (TORQUE_NOISE * noise.standard_normal(len(K)) if noise else 0.0)
        triangles.append(np.linalg.qr(np.column_stack([K, force]) / TORQUE_NOISE, mode="r"))
    return StoredInformation(np.array(triangles), np.full((2, len(NAMES) + 1), np.inf), split_half, split_half == 1,
                             np.full(2, TORQUE_NOISE), np.ones(2), np.full(2, RATE * PERIOD), ())


def over_sessions(size: float, shape: Shape, rng: np.random.Generator | None = None, first: int = 0,
                  **other) -> list[StoredInformation]:
    """Sessions in which one parameter follows a shape."""
    return [measured(moved(PLANAR, **{NAME.replace(".", "__"): size * part}), (first + k) % 60, rng, **other)
            for k, part in enumerate(shape.course(SESSIONS))]


def compared(sessions: Sequence[StoredInformation]) -> ChangeHistory:
    return change_history(PLANAR, PARTS, sessions, 0.05)


@pytest.mark.parametrize("session", [2, 3, 4, 5])
def test_a_step_is_found_exactly_at_its_session(session):
    found = compared(over_sessions(0.9, Shape(session)))
    assert found[NAME].value == pytest.approx(0.9, abs=1e-8)
    one = found.history(NAME)
    assert (one.course, one.session) == (Course.STEP, session)
    assert [value.change for value in one.values] == pytest.approx(0.9 * Shape(session).course(SESSIONS), abs=1e-8)
    assert one.finding.text.startswith(f"{NAME} rose by 0.90")
    assert {other.course for other in found.histories if other is not one} == {Course.AGREES}
    assert [alternative.shape for alternative in found.together] == [Shape(session)]
    assert "p < 1e-15" in found.findings[0].text
    assert "&lt; 1e-15" in render_history(found)


def test_a_drift_is_told_from_a_step():
    found = compared(over_sessions(-1.5, Shape(None)))
    assert found[NAME].value == pytest.approx(-1.5, abs=1e-8)
    assert found.history(NAME).course is Course.DRIFT
    assert found.history(NAME).finding.text.startswith(f"{NAME} drifted: it fell by 1.50")


def test_neither_step_nor_drift_is_said_to_vary():
    steps = [0.0, 2.0, 0.0, 2.0, 0.0]
    found = compared([measured(moved(PLANAR, upper_drive__tau_viscous=step), k) for k, step in enumerate(steps)])
    assert found.history(NAME).course is Course.VARIES
    assert [value.change for value in found.history(NAME).values] == pytest.approx(steps, abs=1e-8)


def test_values_are_those_of_one_dense_least_squares():
    """Independent of projections: every session has friction and offsets of its own, in one matrix."""
    sessions, p, c = over_sessions(0.6, Shape(3), np.random.default_rng(3)), len(NAMES), len(PARTS)
    places, rows, right = [NAMES.index(name) for name in PARTS], [], []
    for k, session in enumerate(sessions):
        K, f = session.triangles[:, :, :p].reshape(-1, p), session.triangles[:, :, p].ravel()
        own = np.zeros((len(K), c * (SESSIONS - 1)))
        if k:
            own[:, (k - 1) * c : k * c] = K[:, places]
        rows.append(np.hstack([K, own]))
        right.append(f)
    A, b = np.vstack(rows), np.concatenate(right)
    information = np.zeros((A.shape[1], A.shape[1]))
    information[:p, :p] = PLANAR.parameters.information
    N = A.T @ A + information
    d = 1 / np.sqrt(np.diag(N))
    inverse = np.linalg.inv(N * np.outer(d, d)) * np.outer(d, d)
    x = (inverse @ (A.T @ b + information[:, :p] @ PLANAR.parameters.nominal))[p:].reshape(SESSIONS - 1, c)
    std = np.sqrt(np.diag(inverse))[p:].reshape(SESSIONS - 1, c)
    scan = session_scan(PLANAR, PARTS, sessions).residual
    for j in range(c):
        value, spread, _ = scan.values(j)
        assert value[1:] == pytest.approx(x[:, j], rel=1e-6, abs=1e-9)
        assert spread[1:] == pytest.approx(std[:, j], rel=1e-6)
    W = x.ravel() @ np.linalg.solve(inverse[p:, p:], x.ravel())
    assert scan.sums @ scan.sums == pytest.approx(W, rel=1e-6)
    assert scan.whole.p_value == pytest.approx(stats.chi2.sf(W, len(scan.sums)), rel=1e-3)


def test_a_session_in_which_a_joint_rests_is_named():
    places = [NAMES.index(name) for name in PARTS if name.startswith("fore_drive")]
    sessions = over_sessions(0.0, Shape(2), np.random.default_rng(4))
    sessions[-1] = measured(moved(PLANAR), 4, np.random.default_rng(5), without=places)
    found = compared(sessions)
    one = found.history("fore_drive.tau_viscous")
    assert np.isinf(one.detectable[-1])
    assert np.all(np.isfinite(one.detectable[:-1]))
    assert "at any session but 5 would have been detected" in one.finding.text
    assert np.isnan(one.values[-1].change)
    assert np.all(np.isfinite(found.history(NAME).detectable))


def test_changes_that_look_alike_are_not_distinguished():
    pair = "fore_drive.tau_offset", "fore_drive.tau_coulomb"
    same = NAMES.index(pair[0]), NAMES.index(pair[1])
    truth = [moved(PLANAR, fore_drive__tau_coulomb=step) for step in (0, 0, 0, 2.0, 2.0)]
    found = compared([measured(psi, k, same=same) for k, psi in enumerate(truth)])
    for name, other in (pair, pair[::-1]):
        assert found.history(name).course is Course.NOT_IDENTIFIABLE
        assert found.history(name).partners == (other,)
    assert len(of_kind(found.diagnostics, Kind.CHANGE_CONFOUNDED)) == 2
    assert found.detected
    assert {one.name for one in found.single} == set(pair)  # either alone explains it, at the right session
    assert {(one.session, round(one.value, 6)) for one in found.single} == {(4, 2.0)}
    assert "if this parameter alone changed" in render_history(found)


def test_what_the_named_parameters_leave_is_told_with_its_likeliest_cause():
    pair = "fore_drive.tau_offset", "fore_drive.tau_coulomb"
    same = NAMES.index(pair[0]), NAMES.index(pair[1])
    truth = [moved(PLANAR, fore_drive__tau_coulomb=step, upper_drive__tau_viscous=step) for step in (0, 0, 0, 2.0, 2.0)]
    found = compared([measured(psi, k, same=same) for k, psi in enumerate(truth)])
    assert found.history(NAME).course is Course.STEP
    assert len(of_kind(found.findings, Kind.MORE_CHANGED)) == 1
    assert "alone explains the rest, with a step at session 4" in of_kind(found.findings, Kind.SINGLE_COURSE)[0].text


def test_logs_that_differ_within_themselves_hold_the_sessions_to_that():
    sound, unsteady = (compared(over_sessions(0.5, Shape(3), np.random.default_rng(6), split_half=phi))
                       for phi in (1.0, 30.0))
    assert sound.detected
    assert not unsteady.detected
    assert unsteady.p_value > 0.05 > sound.p_value


def test_sessions_that_scatter_hold_steps_to_that():
    rng, truth = np.random.default_rng(6), PLANAR.parameters.nominal
    friction = PLANAR.parameters.matching("friction")
    sound, scattered = [], []
    for k, session in enumerate(over_sessions(0.5, Shape(3), rng)):
        disorder = np.zeros(len(truth))
        disorder[friction] = 0.3 * truth[friction] * rng.standard_normal(len(friction))
        sound.append(session)
        scattered.append(measured(moved(PLANAR, upper_drive__tau_viscous=0.5 * (k >= 2)) + disorder, k, rng))
    one, other = compared(sound), compared(scattered)
    assert one.detected
    assert not of_kind(one.findings, Kind.SESSIONS_SCATTER)
    assert not other.detected
    assert 3 * one.scatter < other.scatter < 0.3
    assert len(of_kind(other.findings, Kind.SESSIONS_SCATTER)) == 1
    assert Course.SCATTERS in {history.course for history in other.histories}
    assert np.all(np.array(other.history(NAME).detectable) > 2 * np.array(one.history(NAME).detectable))


def test_fewer_than_three_sessions_are_refused():
    with pytest.raises(ProblemError, match=r"need at least three, not 2; .*`detect_change`"):
        detect_changes(PLANAR.machine, ["a", "b"])


@pytest.mark.slow
@pytest.mark.parametrize("scatter", [0.0, 0.05])
def test_false_alarms_over_the_whole_comparison_are_as_rare_as_stated(scatter):
    """Also where the friction of each session is off by random amounts, those of some parameters larger than others."""
    rng, places = np.random.default_rng(12), [NAMES.index(name) for name in PARTS]
    amounts = scatter * random_amounts(PLANAR, places, over_sessions(0.0, Shape(2)))
    p_values = []
    for k in range(200):
        sizes = amounts * np.exp(rng.standard_normal(len(places)) / 2)
        sessions = []
        for motion in range(SESSIONS):
            psi = moved(PLANAR)
            psi[places] += sizes * rng.standard_normal(len(places))
            sessions.append(measured(psi, (5 * k + motion) % 60, rng))
        p_values.append(session_scan(PLANAR, PARTS, sessions).p_value)
    assert np.sum(np.array(p_values) < 0.05) <= stats.binom(200, 0.05).ppf(0.995)
    # κ is not known: p-values are larger than uniform ones, never smaller
    assert stats.kstest(p_values, "uniform", alternative="greater").pvalue > 0.01


@pytest.mark.slow
def test_no_other_parameter_is_named_and_the_detectable_step_is_detected_as_often_as_stated():
    rng = np.random.default_rng(13)
    named, alarm = (sizes[PLACE, 1] for sizes in session_scan(
        PLANAR, PARTS, over_sessions(0.0, Shape(3), rng)).detectable(0.05))
    of_alarm = [session_scan(PLANAR, PARTS, over_sessions(alarm, Shape(3), rng)) for _ in range(200)]
    assert 0.9 <= np.mean([scan.p_value < 0.05 for scan in of_alarm]) <= 0.985
    of_named = [session_scan(PLANAR, PARTS, over_sessions(named, Shape(3), rng)) for _ in range(200)]
    assert np.mean([scan.p_values[PLACE] < 0.05 for scan in of_named]) >= 0.9
    wrong = [np.nanmin(np.delete(scan.p_values, PLACE)) < 0.05 for scan in (*of_alarm, *of_named)]
    assert np.sum(wrong) <= stats.binom(len(wrong), 0.05).ppf(0.995)
