"""What changed between two sessions: exactly without noise, as often as stated with it."""

from __future__ import annotations

import functools
from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from fixtures.periodic import PERIODIC as CAT_PERIODIC
from fixtures.two_sessions import PERIOD, PERIODIC, PLANAR, RATE, SPATIAL, TORQUE_NOISE, recorded
from hydroopt.errors import IdentifiabilityError, ProblemError
from hydroopt.estimation.dynamic.change import detect_change, detectable, holm, named_parts
from hydroopt.estimation.dynamic.comparison import two_session_problem, wald
from hydroopt.estimation.dynamic.experiment import experiment
from hydroopt.estimation.dynamic.stored_information import StoredInformation, stored_information
from hydroopt.model.model import Model
from hydroopt.results.diagnostic import of_kind
from hydroopt.results.wording import Kind
from hydroopt.simulation.simulate import random_trajectory

NAMES = PLANAR.parameters.names
PARTS = named_parts(PLANAR.parameters, ["friction", "offset"])


def moved(model: Model, **steps: float) -> np.ndarray:
    psi = model.parameters.nominal.copy()
    for name, step in steps.items():
        psi[model.parameters.index(name.replace("__", "."))] += step
    return psi


def test_a_change_of_an_excavators_friction_is_found_exactly(cat215b, cat_truth, record):
    new = cat_truth.copy()
    new[cat215b.parameters.index("swing_motor.tau_coulomb")] += 812.0
    new[cat215b.parameters.index("stick_cylinder.f_offset")] -= 350.0
    found = detect_change(cat215b.machine, record(cat215b, cat_truth, (1, 2)), record(cat215b, new, (3, 5)),
                          smoothing=CAT_PERIODIC, intervals=False)
    truth = {"swing_motor.tau_coulomb": 812.0, "stick_cylinder.f_offset": -350.0}
    told = [one for one in found.differences if np.isfinite(one.std)]
    assert len(told) >= 9
    for one in told:
        assert one.value == pytest.approx(truth.get(one.name, 0.0), abs=1e-8 * 1000)
        assert one.changed == (one.name in truth)
    for one in found.differences:
        if one not in told:
            assert one.finding.kind is Kind.CHANGE_CONFOUNDED
            assert np.isnan(one.value)
            assert one.name.startswith("boom")  # its pins turn as its joint does
    assert found.difference("swing_motor.tau_coulomb").finding.text.startswith("swing_motor.tau_coulomb rose by 812")
    assert found.difference("stick_cylinder.f_offset").finding.text.startswith("stick_cylinder.f_offset fell by 350")
    assert of_kind(found.findings, Kind.NO_SINGLE_CHANGE)


def test_intervals_do_not_move_an_exact_answer():
    found = detect_change(PLANAR.machine, [recorded(PLANAR, moved(PLANAR), 1)],
                          [recorded(PLANAR, moved(PLANAR, fore_drive__tau_viscous=0.7), 2)], smoothing=PERIODIC)
    values = {one.name: one.value for one in found.differences}
    assert values.pop("fore_drive.tau_viscous") == pytest.approx(0.7, abs=1e-8)
    assert np.allclose(list(values.values()), 0, atol=1e-8)


def test_a_change_seen_by_all_together_is_put_down_to_one():
    new = moved(PLANAR, fore_drive__tau_viscous=1.0)
    found = detect_change(PLANAR.machine, [recorded(PLANAR, moved(PLANAR), 1, TORQUE_NOISE)],
                          [recorded(PLANAR, new, 2, TORQUE_NOISE)], smoothing=PERIODIC, intervals=False)
    assert found.p_value < 1e-3
    likeliest = found.single_changes[0]
    assert likeliest.text.startswith("A change of fore_drive.tau_viscous alone explains it: rose by ")
    assert found.findings[0].text.startswith("A change is detected: all 6 parameters together, F(6, ")


@pytest.mark.slow
def test_part_of_a_body_changes_and_the_rest_does_not():
    """A ring of 0.5 kg on the fore arm's own axis: its mass alone changes, its moments do not."""
    new = moved(SPATIAL, fore__m=0.5)
    found = detect_change(SPATIAL.machine, [recorded(SPATIAL, moved(SPATIAL), s) for s in (1, 2)],
                          [recorded(SPATIAL, new, s) for s in (3, 4)], parts=["fore.m", "fore_drive"],
                          smoothing=PERIODIC)
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
    information = PLANAR.parameters.information
    N = sum(row.T @ row for row in rows)
    N[:p, :p] += information
    g = sum(row.T @ y for row, y in zip(rows, right, strict=True))
    g[:p] += information @ PLANAR.parameters.nominal
    # Jacobi scaling, then the inverse of the normal matrix
    d = 1 / np.sqrt(np.diag(N))
    inverse = np.linalg.inv(N * np.outer(d, d)) * np.outer(d, d)
    x = inverse @ g
    problem = two_session_problem(PLANAR, PARTS)
    A, b, freedom = problem.rows(*sessions)
    test = wald(problem, A, b, freedom)
    assert np.allclose(test.value, x[p:], rtol=1e-6, atol=1e-9)
    assert np.allclose(test.std, np.sqrt(np.diag(inverse)[p:]), rtol=1e-6)
    W = x[p:] @ np.linalg.solve(inverse[p:, p:], x[p:])
    # Hotelling's
    assert test.statistic * test.rank * (test.freedom + test.rank - 1) / test.freedom == pytest.approx(W, rel=1e-6)
    assert test.rank == len(PARTS)


def drawn(psi: np.ndarray, motion: int, rng: np.random.Generator) -> StoredInformation:
    """A session in which the torques of a motion are measured anew; angles are exact and σ is known."""
    triangles = []
    for K in regressors(motion):
        force = K @ psi + TORQUE_NOISE * rng.standard_normal(len(K))
        triangles.append(np.linalg.qr(np.column_stack([K, force]) / TORQUE_NOISE, mode="r"))
    return StoredInformation(np.array(triangles), np.full((2, len(NAMES) + 1), np.inf), 1.0, True,
                             np.full(2, TORQUE_NOISE),
                             np.ones(2), np.full(2, RATE * PERIOD), ())


@functools.cache
def regressors(motion: int) -> list[np.ndarray]:
    path = random_trajectory(PLANAR, duration=PERIOD, rate=RATE, seed=motion, slowest=0.1, fastest=0.5)
    return list(PLANAR.over(PLANAR.regressor, path.q, path.qd, path.qdd)[0].transpose(1, 0, 2).copy())


def wald_of(before: StoredInformation, after: StoredInformation):
    problem = two_session_problem(PLANAR, PARTS)
    return wald(problem, *problem.rows(before, after))


@pytest.mark.slow
def test_false_alarms_are_as_rare_as_stated_and_intervals_hold():
    truth, rng = moved(PLANAR), np.random.default_rng(5)
    tests = [wald_of(drawn(truth, 2 * (k % 20), rng), drawn(truth, 2 * (k % 20) + 1, rng)) for k in range(600)]
    p_values = np.array([test.p_value for test in tests])
    inside = [np.abs(test.value) <= stats.t.ppf(0.975, test.freedoms) * test.std for test in tests]
    assert 0.03 <= np.mean(p_values < 0.05) <= 0.07
    assert np.mean([np.nanmin(holm(test.single())) < 0.05 for test in tests]) <= 0.07
    assert stats.kstest(p_values, "uniform").pvalue > 0.01
    assert 0.94 <= np.mean(inside) <= 0.96


@pytest.mark.slow
def test_the_smallest_detectable_change_is_detected_as_often_as_stated():
    name, rng = "upper_drive.tau_viscous", np.random.default_rng(6)
    place = PARTS.index(name)
    test = wald_of(drawn(moved(PLANAR), 1, rng), drawn(moved(PLANAR), 2, rng))
    step = detectable(test, 0.05)[place]
    changed = moved(PLANAR, upper_drive__tau_viscous=step)
    seen = [wald_of(drawn(moved(PLANAR), 1, rng), drawn(changed, 2, rng)).single()[place] * len(PARTS) < 0.05
            for _ in range(300)]
    assert 0.92 <= np.mean(seen) <= 0.98


def test_holm():
    """The worked example of the R documentation's kind: 0.01, 0.02, 0.03, 0.04 of four give 0.04, 0.06, 0.06, 0.06."""
    assert holm(np.array([0.04, 0.01, 0.03, 0.02])) == pytest.approx([0.06, 0.04, 0.06, 0.06])
    assert holm(np.array([0.5, np.nan, 0.9])) == pytest.approx([1.0, np.nan, 1.0], nan_ok=True)


def test_parts():
    assert named_parts(PLANAR.parameters, ["offset"]) == ("upper_drive.tau_offset", "fore_drive.tau_offset")
    assert named_parts(PLANAR.parameters, ["upper"]) == tuple(name for name in NAMES if name.startswith("upper."))
    with pytest.raises(ProblemError, match=r"'fore_driv'.*did you mean fore_drive"):
        named_parts(PLANAR.parameters, ["fore_driv"])


def test_a_session_in_which_a_joint_rests_tells_nothing_of_it():
    log = recorded(PLANAR, moved(PLANAR), 1, TORQUE_NOISE)
    still = replace(log, channels=dict(log.channels) | {"fore.q": np.full(len(log.t), 0.4)})
    found = detect_change(PLANAR.machine, [log], [still], smoothing=PERIODIC, intervals=False)
    one = found.difference("fore_drive.tau_viscous")
    assert np.isnan(one.std)
    assert one.finding.kind is Kind.CHANGE_NOT_IDENTIFIABLE
    assert np.isfinite(found.difference("upper_drive.tau_viscous").std)
    with pytest.raises(IdentifiabilityError, match="do not identify a change"):
        detect_change(PLANAR.machine, [log], [still], parts=["fore_drive.tau_viscous"], smoothing=PERIODIC)


@pytest.mark.parametrize("level", [0.0, 1.0, float("nan")])
def test_level(level):
    with pytest.raises(ProblemError, match="level of significance must be between 0 and 1"):
        detect_change(PLANAR.machine, [], [], level=level)


def test_friction_that_is_not_linear_is_refused():
    drives = [drive.model_copy(update={"friction": drive.friction.model_copy(
        update={"stribeck": 1.0, "stribeck_speed": 0.1})}) for drive in PLANAR.machine.drives]
    machine = PLANAR.machine.model_copy(update={"drives": tuple(drives)})
    with pytest.raises(ProblemError, match=r"not linear.*leave 'stribeck' and 'stribeck_speed' out"):
        detect_change(machine, [], [])
