"""What changed over sessions: exactly without noise; false alarms, power and intervals as stated with it."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from fixtures.periodic import PERIODIC as CAT_PERIODIC
from fixtures.two_sessions import PERIOD, PERIODIC, PLANAR, RATE, SPATIAL, TORQUE_NOISE, recorded
from hydroopt.errors import IdentifiabilityError, ProblemError
from hydroopt.estimation.dynamic.experiment import experiment
from hydroopt.estimation.dynamic.session_comparison import SessionComparison, compare, named_parts, session_comparison
from hydroopt.estimation.dynamic.session_model import Shape, random_amounts, session_model
from hydroopt.estimation.dynamic.stored_information import StoredInformation, stored_information
from hydroopt.model.model import Model
from hydroopt.report.page import prose
from hydroopt.report.sessions import render_comparison
from hydroopt.results.diagnostic import of_kind
from hydroopt.simulation.simulate import random_trajectory

NAMES = PLANAR.parameters.names
PARTS = named_parts(PLANAR.parameters, ["friction", "offset"])
NAME = "upper_drive.tau_viscous"
PLACE = PARTS.index(NAME)
SESSIONS = 5


def moved(model: Model, **steps: float) -> np.ndarray:
    psi = model.parameters.nominal.copy()
    for name, step in steps.items():
        psi[model.parameters.index(name.replace("__", "."))] += step
    return psi


@functools.cache
def regressors(motion: int) -> list[np.ndarray]:
    path = random_trajectory(PLANAR, duration=PERIOD, rate=RATE, seed=motion, slowest=0.1, fastest=0.5)
    return list(PLANAR.over(PLANAR.regressor, path.q, path.qd, path.qdd)[0].transpose(1, 0, 2).copy())


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
                  count: int = SESSIONS, **other) -> list[StoredInformation]:
    """Sessions in which one parameter follows a shape."""
    return [measured(moved(PLANAR, **{NAME.replace(".", "__"): size * part}), (first + k) % 60, rng, **other)
            for k, part in enumerate(shape.course(count))]


def scattered(amounts: np.ndarray, rng: np.random.Generator, first: int, count: int = SESSIONS,
              step: float = 0.0) -> list[StoredInformation]:
    """Sessions whose parameters are off by random amounts; one steps at session 3."""
    places, sessions = PLANAR.parameters.select(PARTS), []
    for k in range(count):
        psi = moved(PLANAR, **{NAME.replace(".", "__"): step * (k >= 2)})
        psi[places] += amounts * rng.standard_normal(len(places))
        sessions.append(measured(psi, (first + k) % 60, rng))
    return sessions


def compared(sessions: Sequence[StoredInformation]) -> SessionComparison:
    return session_comparison(PLANAR, PARTS, sessions, 0.05)


def test_a_change_of_an_excavators_friction_is_found_exactly(cat215b, cat_truth, record):
    new = cat_truth.copy()
    new[cat215b.parameters.index("swing_motor.tau_coulomb")] += 812.0
    new[cat215b.parameters.index("stick_cylinder.f_offset")] -= 350.0
    found = compare(cat215b.machine, [record(cat215b, cat_truth, (1, 2)), record(cat215b, new, (3, 5))],
                    smoothing=CAT_PERIODIC)
    truth = {"swing_motor.tau_coulomb": 812.0, "stick_cylinder.f_offset": -350.0}
    told = [one for one in found.differences if one.identifiable]
    assert len(told) >= 9
    for one in told:
        assert one.value == pytest.approx(truth.get(one.name, 0.0), abs=1e-8 * 1000)
        assert one.changed == (one.name in truth)
    (alike,) = of_kind(found.diagnostics, "change not separable")
    assert set(alike.subject) == {one.name for one in found.differences if not one.identifiable}
    assert all(name.startswith("boom") for name in alike.subject)  # its pins turn as its joint does
    (said,) = found.findings
    assert said.text.startswith("Changed by a step at session 2")
    assert "swing_motor.tau_coulomb rose by 812" in said.text
    assert "stick_cylinder.f_offset fell by 350" in said.text


def test_a_body_may_change():
    """A ring of 0.5 kg on the fore arm's own axis: its mass alone changes, its moments do not."""
    found = compare(SPATIAL.machine, [[recorded(SPATIAL, moved(SPATIAL), s) for s in (1, 2)],
                                      [recorded(SPATIAL, moved(SPATIAL, fore__m=0.5), s) for s in (3, 4)]],
                    parts=["fore.m", "fore_drive"], smoothing=PERIODIC)
    assert found["fore.m"].value == pytest.approx(0.5, abs=1e-8)
    assert {one.name for one in found.differences} == {"fore.m", "fore_drive.tau_offset", "fore_drive.tau_coulomb",
                                                      "fore_drive.tau_viscous"}


def test_value_and_spread_are_those_of_one_dense_least_squares():
    """Independent of projections and scaling: the information of both sessions about the least squares of every sample,
    and the priors, in one matrix.
    """
    sessions, rows, right, p = [], [], [], len(NAMES)
    places = [NAMES.index(name) for name in PARTS]
    for k, psi in enumerate((moved(PLANAR), moved(PLANAR, upper_drive__tau_coulomb=1.0))):
        log = recorded(PLANAR, psi, 10 + k, TORQUE_NOISE)
        sessions.append(stored_information(PLANAR, [log], PERIODIC))
        data = experiment(PLANAR, log, PERIODIC)
        K = PLANAR.over(PLANAR.regressor, data.motion.q, data.motion.qd, data.motion.qdd)[0]
        for i in range(2):
            taken = data.inside & data.known[:, i]
            nearest = np.linalg.lstsq(K[taken, i], data.force[taken, i], rcond=1e-12)[0]
            score = sessions[k].triangles[i][:-1, :-1]
            rows.append(np.hstack([score, k * score[:, places]]))
            right.append(score @ nearest)
    x, inverse = dense(np.vstack(rows), np.concatenate(right))
    found = session_model(PLANAR, PARTS, sessions)
    fixed = found.shapes[Shape(2)]
    value, std, _ = fixed.along(fixed.units)
    phi = found.within
    assert np.allclose(value, x[p:], rtol=1e-6, atol=1e-9)
    assert np.allclose(std, np.sqrt(phi * np.diag(inverse)[p:]), rtol=1e-6)
    W = x[p:] @ np.linalg.solve(inverse[p:, p:], x[p:]) / phi
    test = fixed.joint  # Hotelling's
    assert test.statistic * test.rank * (test.freedom + test.rank - 1) / test.freedom == pytest.approx(W, rel=1e-6)
    assert test.rank == len(PARTS)


def dense(A: np.ndarray, b: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Least squares with the priors on the first parameters, by scaled normal equations, and its covariance."""
    p = len(NAMES)
    information = np.zeros((A.shape[1], A.shape[1]))
    information[:p, :p] = PLANAR.parameters.information
    N = A.T @ A + information
    d = 1 / np.sqrt(np.diag(N))
    inverse = np.linalg.inv(N * np.outer(d, d)) * np.outer(d, d)
    return inverse @ (A.T @ b + information[:, :p] @ PLANAR.parameters.nominal), inverse


def test_values_of_each_session_are_those_of_one_dense_least_squares():
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
    x, inverse = dense(np.vstack(rows), np.concatenate(right))
    model = session_model(PLANAR, PARTS, sessions)
    values, spread = model.values
    assert values[:, 1:].T.ravel() == pytest.approx(x[p:], rel=1e-6, abs=1e-9)
    assert spread[:, 1:].T.ravel() == pytest.approx(np.sqrt(np.diag(inverse)[p:]), rel=1e-6)
    W = x[p:] @ np.linalg.solve(inverse[p:, p:], x[p:])
    assert model.mixed.sums @ model.mixed.sums == pytest.approx(W, rel=1e-6)


@pytest.mark.parametrize("session", [2, 3, 4, 5])
def test_a_step_is_found_exactly_at_its_session(session):
    found = compared(over_sessions(0.9, Shape(session)))
    one = found.difference(NAME)
    assert one.value == pytest.approx(0.9, abs=1e-6)
    assert found.shape == Shape(session)
    assert found.shapes[0][1] > 0.95
    assert [change for change, _ in one.sessions] == pytest.approx(0.9 * Shape(session).course(SESSIONS), abs=1e-8)
    (said,) = found.findings  # once, and nothing else
    assert said.text.startswith(f"Changed by a step at session {session}: {NAME} rose by 0.90")
    assert [other.name for other in found.differences if other.changed] == [NAME]
    for other in found.differences:
        assert (other.ci95[0] <= 0 <= other.ci95[1]) != other.changed


def test_a_drift_is_told_from_a_step():
    found = compared(over_sessions(-1.5, Shape(None)))
    assert found[NAME].value == pytest.approx(-1.5, abs=1e-6)
    assert found.shape == Shape(None)
    assert found.findings[0].text.startswith(f"Changed by a drift over all sessions: {NAME} fell by 1.50")


def test_neither_step_nor_drift_is_scatter():
    steps = [0.0, 2.0, 0.0, 2.0, 0.0]
    found = compared([measured(moved(PLANAR, upper_drive__tau_viscous=step), k) for k, step in enumerate(steps)])
    assert [one.kind for one in found.findings] == ["no change detected", "sessions differ without any order"]
    assert found.findings[1].subject == (NAME,)
    assert found.scatter_ci95[0] > 0
    assert [change for change, _ in found.difference(NAME).sessions] == pytest.approx(steps, abs=1e-8)


def test_a_session_in_which_a_joint_rests_is_named():
    places = [NAMES.index(name) for name in PARTS if name.startswith("fore_drive")]
    sessions = over_sessions(0.0, Shape(2), np.random.default_rng(4))
    sessions[-1] = measured(moved(PLANAR), 4, np.random.default_rng(5), without=places)
    found = compared(sessions)
    one = found.difference("fore_drive.tau_viscous")
    assert np.isinf(one.detectable[-1])
    assert np.all(np.isfinite(one.detectable[:-1]))
    assert np.isnan(one.sessions[-1][0])
    assert np.all(np.isfinite(found.difference(NAME).detectable))
    assert str(prose(found.findings[0].text)) in render_comparison(found)


@pytest.mark.parametrize("count", [2, 5])
def test_changes_that_look_alike_are_not_distinguished(count):
    pair = "fore_drive.tau_offset", "fore_drive.tau_coulomb"
    same = NAMES.index(pair[0]), NAMES.index(pair[1])
    found = compared([measured(moved(PLANAR, fore_drive__tau_coulomb=2.0 * (k >= count - 2 + (count == 2))), k,
                               same=same) for k in range(count)])
    assert not any(found.difference(name).identifiable for name in pair)
    (alike,) = of_kind(found.diagnostics, "change not separable")
    assert alike.subject == pair
    assert found.detected
    assert {one.name for one in found.single} == set(pair)  # either alone explains it
    assert [round(one.value, 5) for one in found.single] == [2.0, 2.0]
    assert f"one alone explains it: {found.single[0].name} rose by 2.0" in found.findings[0].text


def test_what_the_named_parameters_leave_is_told_with_its_likeliest_cause():
    pair = "fore_drive.tau_offset", "fore_drive.tau_coulomb"
    same = NAMES.index(pair[0]), NAMES.index(pair[1])
    truth = [moved(PLANAR, fore_drive__tau_coulomb=step, upper_drive__tau_viscous=step) for step in (0, 0, 0, 2.0, 2.0)]
    found = compared([measured(psi, k, same=same) for k, psi in enumerate(truth)])
    assert found.findings[0].subject == (NAME,)
    assert "of the others, one alone explains it" in found.findings[0].text


def test_logs_that_differ_within_themselves_hold_the_sessions_to_that():
    sound, unsteady = (compared(over_sessions(0.5, Shape(3), np.random.default_rng(6), split_half=phi))
                       for phi in (1.0, 30.0))
    assert sound.detected
    assert not unsteady.detected
    assert unsteady.p_value > 0.05 > sound.p_value


def test_sessions_that_scatter_hold_steps_to_that():
    rng = np.random.default_rng(6)
    amounts = 0.1 * random_amounts(PLANAR, PLANAR.parameters.select(PARTS), over_sessions(0.0, Shape(2)))
    one = compared(over_sessions(0.5, Shape(3), rng))
    other = compared(scattered(amounts, rng, 0, step=0.5))
    assert one.detected
    assert not of_kind(one.findings, "sessions differ without any order")
    assert not other.detected
    assert 0.05 < other.scatter < 0.2
    assert other.scatter_ci95[0] < 0.1 < other.scatter_ci95[1]
    assert len(of_kind(other.findings, "sessions differ without any order")) == 1
    assert np.all(np.array(other.difference(NAME).detectable) > 2 * np.array(one.difference(NAME).detectable))


def test_a_session_in_which_a_joint_rests_tells_nothing_of_it():
    log = recorded(PLANAR, moved(PLANAR), 1, TORQUE_NOISE)
    still = replace(log, channels=dict(log.channels) | {"fore.q": np.full(len(log.t), 0.4)})
    found = compare(PLANAR.machine, [log, still], smoothing=PERIODIC)
    one = found.difference("fore_drive.tau_viscous")
    assert not one.identifiable
    assert one.name in of_kind(found.diagnostics, "change not identifiable")[0].subject
    assert found.difference("upper_drive.tau_viscous").identifiable
    with pytest.raises(IdentifiabilityError, match="do not identify a change"):
        compare(PLANAR.machine, [log, still], parts=["fore_drive.tau_viscous"], smoothing=PERIODIC)


@pytest.mark.parametrize("count", [2, 3, 5])
@pytest.mark.parametrize("split_half", [1.0, 30.0])
def test_what_residuals_put_far_apart_is_never_called_equal(count, split_half):
    """An offset that is 4.2 standard deviations or more off in one session, as `identify` states them."""
    rng, name, apart = np.random.default_rng(8), "fore_drive.tau_offset", 0
    for k in range(20):
        off = rng.integers(count)
        sessions = [measured(moved(PLANAR, fore_drive__tau_offset=0.35 * (j == off)), 5 * k + j, rng,
                             split_half=split_half) for j in range(count)]
        found = compared(sessions)
        z = max(abs(change) / std for change, std in found.difference(name).sessions[1:])
        apart += z >= 4.2
        assert z < 4.2 or found.detected or of_kind(found.findings, "sessions differ without any order")
    assert apart >= 10


def test_two_sessions_ask_for_a_third():
    found = compared(over_sessions(2.0, Shape(2), np.random.default_rng(1), count=2))
    assert found.detected
    assert np.isnan(found.scatter)
    assert any("third session" in step.text for step in found.next_steps)


@pytest.mark.slow
@pytest.mark.parametrize("count", [2, 3, 5])
@pytest.mark.parametrize("scatter", [0.0, 0.05])
def test_false_alarms_are_as_rare_as_stated(count, scatter):
    """Also where the friction of each session is off by random amounts, those of some parameters larger than others,
    which two sessions cannot show."""
    if scatter and count == 2:
        pytest.skip("two sessions do not show how much sessions differ")
    rng = np.random.default_rng(12)
    amounts = scatter * random_amounts(PLANAR, PLANAR.parameters.select(PARTS), over_sessions(0.0, Shape(2)))
    found = [compared(scattered(amounts * np.exp(rng.standard_normal(len(PARTS)) / 2), rng, 5 * k, count))
             for k in range(200)]
    alarms = sum(one.detected for one in found)
    if not scatter:
        said = sum(bool(of_kind(one.findings, "sessions differ without any order")) for one in found)
        assert said <= stats.binom(200, 0.05).ppf(0.995)
    assert alarms <= stats.binom(200, 0.05).ppf(0.995)
    # κ is not known: p-values are larger than uniform ones, never smaller
    assert stats.kstest([one.p_value for one in found], "uniform", alternative="greater").pvalue > 0.01


@pytest.mark.slow
@pytest.mark.parametrize(("count", "scatter"), [(2, 0.0), (5, 0.0), (5, 0.02)])
def test_intervals_of_a_change_hold_and_no_other_parameter_is_named(count, scatter):
    """95 % for all parameters together, where the step is found at its session."""
    rng, size = np.random.default_rng(14), 3.0
    amounts = scatter * random_amounts(PLANAR, PLANAR.parameters.select(PARTS), over_sessions(0.0, Shape(2)))
    inside, wrong = [], []
    for k in range(200):
        sessions = (scattered(amounts, rng, 5 * k, count, step=size) if count > 2 else
                    over_sessions(size, Shape(2), rng, 5 * k, count))
        found = compared(sessions)
        if found.shape != Shape(min(count, 3)) or not found.detected:
            continue
        truth = np.where(np.array(PARTS) == NAME, size, 0.0)
        inside.append(all(one.ci95[0] <= true <= one.ci95[1]
                          for one, true in zip(found.differences, truth, strict=True)))
        wrong.append(any(one.changed for one in found.differences if one.name != NAME))
    assert len(inside) > 100
    assert np.sum(~np.array(inside)) <= stats.binom(len(inside), 0.05).ppf(0.995)
    assert np.sum(wrong) <= stats.binom(len(wrong), 0.05).ppf(0.995)


@pytest.mark.slow
@pytest.mark.parametrize("count", [2, 3, 5])
def test_the_detectable_step_is_detected_as_often_as_stated(count):
    rng, at = np.random.default_rng(13), Shape(min(count, 3))
    sound = over_sessions(0.0, at, rng, count=count)
    size = session_model(PLANAR, PARTS, sound).detectable(0.05)[PLACE, at.session - 2]
    found = [session_model(PLANAR, PARTS, over_sessions(size, at, rng, count=count)).p_value for _ in range(200)]
    # three sessions leave κ uncertain, which the stated size takes as estimated from them
    assert (0.8 if count == 3 else 0.9) <= np.mean(np.array(found) < 0.05) <= 0.985


def test_parts():
    assert named_parts(PLANAR.parameters, ["offset"]) == ("upper_drive.tau_offset", "fore_drive.tau_offset")
    assert named_parts(PLANAR.parameters, ["upper"]) == tuple(name for name in NAMES if name.startswith("upper."))
    with pytest.raises(ProblemError, match=r"'fore_driv'.*did you mean fore_drive"):
        named_parts(PLANAR.parameters, ["fore_driv"])


@pytest.mark.parametrize("level", [0.0, 1.0, float("nan")])
def test_level(level):
    with pytest.raises(ProblemError, match="level of significance must be between 0 and 1"):
        compare(PLANAR.machine, [[], []], level=level)


def test_one_session_is_refused():
    with pytest.raises(ProblemError, match="one session has nothing to be compared with"):
        compare(PLANAR.machine, ["a"])


def test_friction_that_is_not_linear_is_refused():
    drives = [drive.model_copy(update={"friction": drive.friction.model_copy(
        update={"stribeck": 1.0, "stribeck_speed": 0.1})}) for drive in PLANAR.machine.drives]
    machine = PLANAR.machine.model_copy(update={"drives": tuple(drives)})
    with pytest.raises(ProblemError, match=r"not linear.*leave 'stribeck' and 'stribeck_speed' out"):
        compare(machine, [[], []])
