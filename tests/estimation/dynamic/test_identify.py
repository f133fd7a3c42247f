"""What `solve` does around the estimators: weights, robustness, memory, missing channels, admitted ignorance."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pytest
from scipy.signal import lfilter

from fixtures.tiers import tiered
from hydroopt.errors import IdentifiabilityError, LogError, ProblemError, SolverError
from hydroopt.estimation.dynamic import regressor_qr
from hydroopt.estimation.dynamic.estimate import Estimate
from hydroopt.estimation.dynamic.experiment import Experiment
from hydroopt.estimation.dynamic.identify import METHODS, identify
from hydroopt.estimation.dynamic.problem import IdentificationProblem, identification_problem
from hydroopt.logs.forces_from_pressures import force_noise
from hydroopt.logs.log import Log
from hydroopt.logs.smoothing import Fourier, Motion
from hydroopt.machine.machine_file import load_machine
from hydroopt.model.model import Model
from hydroopt.results.diagnostic import of_kind
from hydroopt.simulation.simulate import Trajectory, random_trajectory, random_truth, simulate
from hydroopt.solving import solve

PERIODIC = Fourier(period=33.28, harmonics=20)


# --- weights


@pytest.mark.slow
def test_noise_of_each_actuator_is_found(cat215b: Model, exact_logs: list[Log]) -> None:
    rng = np.random.default_rng(0)
    # pressures of stated accuracy 25 psi, in truth noisier by 40, 15 and 4 bar
    truth = {"swing_motor.p_a": 4e5, "boom_cylinder.p_head": 15e5, "stick_cylinder.p_rod": 40e5}
    logs = [replace(log, channels={c: x + rng.normal(0, truth.get(c, 0.0), x.size) for c, x in log.channels.items()})
            for log in exact_logs]
    estimate = identify(identification_problem(cat215b.machine, logs, smoothing=PERIODIC), "wls")
    _, stick_rod = cat215b.machine.cylinders[1].areas
    boom_head, _ = cat215b.machine.cylinders[0].areas
    motor = cat215b.machine.motors[0]
    expected = [4e5 * motor.torque_per_pressure * motor.gear, 15e5 * boom_head, 40e5 * stick_rod]
    np.testing.assert_allclose(estimate.sigma, expected, rtol=0.05)
    np.testing.assert_allclose(estimate.correlation_time, 1, atol=0.35)


@pytest.fixture(scope="module")
def turning(wheel: Model) -> Any:
    """The wheel with torque noise given sample by sample; 20 000 samples of a motion of three sines."""
    t = np.arange(20_000) * 0.02
    omega = 2 * np.pi / 400 * np.array([10, 25, 45])
    size, angle = np.array([1.0, 0.5, 0.3]), np.outer(t, omega)
    q, qd, qdd = np.sin(angle) @ size, np.cos(angle) @ (size * omega), -np.sin(angle) @ (size * omega**2)
    psi = np.array([0.5, 5.0, 3.0, 2.0])
    torque = np.column_stack([np.ones_like(t), np.sign(qd), qd, qdd]) @ psi

    def problem(noise: np.ndarray) -> IdentificationProblem:
        log = Log("turning", t, {"wheel.q": q, "wheel.tau": torque + noise})
        return identification_problem(wheel.machine, [log], smoothing=Fourier(period=400.0, harmonics=50))
    return problem


@pytest.mark.parametrize("a", [0.0, 0.5, 0.8, 0.95])
def test_correlation_time_of_an_autoregressive_noise(turning: Any, a: float) -> None:
    noise = lfilter([1], [1, -a], np.random.default_rng(1).standard_normal(20_000))
    estimate = identify(turning(noise), "wls")
    assert estimate.correlation_time[0] == pytest.approx((1 + a) / (1 - a), rel=0.2)
    assert estimate.sigma[0] == pytest.approx(1 / np.sqrt(1 - a**2), rel=0.05)


@pytest.mark.slow
def test_correlated_noise_widens_what_is_told(turning: Any) -> None:
    """The spread of estimates over many noises is the standard deviation that each of them tells."""
    rng, a = np.random.default_rng(2), 0.9
    estimates = [identify(turning(lfilter([1], [1, -a], rng.standard_normal(20_000))), "wls") for _ in range(16)]
    spread = np.std([e.value[0] for e in estimates])
    assert np.mean([e.std[0] for e in estimates]) == pytest.approx(spread, rel=0.5)


# --- outliers


@pytest.mark.parametrize("loss", tiered(["huber", "student_t"], lambda loss: loss == "huber"))
@pytest.mark.slow
def test_gross_outliers_are_resisted(cat215b: Model, noisy: IdentificationProblem, loss: Any) -> None:
    rng = np.random.default_rng(3)
    logs = []
    for data in noisy.experiments:
        hit = {c: np.where(rng.random(x.size) < 0.03, rng.uniform(0, 3e7, x.size), x) if ".p_" in c else x
               for c, x in data.log.channels.items()}
        logs.append(replace(data.log, channels=hit))
    dirty = identification_problem(cat215b.machine, logs, [noisy.validation[0].log], smoothing=PERIODIC)
    plain, robust = (identify(dirty.with_loss(one), "sdp", intervals=False) for one in ("squares", loss))
    for actuator in ("swing_motor", "boom_cylinder", "stick_cylinder"):
        assert robust.fit["validation"][actuator].rms < plain.fit["validation"][actuator].rms
    assert robust.fit["validation"]["all"].relative < 0.5 * plain.fit["validation"]["all"].relative


def test_names_of_losses_and_methods_are_checked(noisy: IdentificationProblem) -> None:
    with pytest.raises(ProblemError, match="'median' is not a loss; use squares, huber or student_t"):
        noisy.with_loss("median")  # type: ignore[arg-type]
    with pytest.raises(ProblemError, match=f"'lsq' is not a method; use one of {', '.join(METHODS)}"):
        identify(noisy, "lsq")  # type: ignore[arg-type]


# --- streaming


@pytest.mark.parametrize("chunk", [37, 200, 10**6])
def test_chunks_fold_into_what_one_factorisation_gives(
    noisy: IdentificationProblem, monkeypatch: pytest.MonkeyPatch, chunk: int
) -> None:
    monkeypatch.setattr("hydroopt.estimation.dynamic.experiment.ROWS", chunk)
    folded = regressor_qr.compress(noisy.experiments)
    for i in range(3):
        whole = []
        for data in noisy.experiments:
            motion = data.motion
            K = noisy.model.over(noisy.model.regressor, motion.q, motion.qd, motion.qdd)[0][:, i]
            whole.append(np.column_stack([K, data.force[:, i]])[data.inside & data.known[:, i]])
        rows = np.concatenate(whole)
        gram = rows.T @ rows
        norm = np.sqrt(np.diag(gram))
        norm = np.maximum(norm, 1e-10 * norm.max())  # a column may be the rounding of what cancels
        size = np.outer(norm, norm)
        np.testing.assert_allclose((folded.triangles[i].T @ folded.triangles[i]) / size, gram / size, atol=1e-12)
        assert folded.samples[i] == len(rows)


def test_two_logs_are_one_log_of_both(noisy: IdentificationProblem) -> None:
    one, other = noisy.experiments
    joined = {key: np.concatenate([getattr(one.motion, key), getattr(other.motion, key)])
              for key in ("t", "q", "qd", "qdd", "segment", "interior")}
    motion = Motion(**joined, bandwidth=one.motion.bandwidth, passes=one.motion.passes, notes=())
    both = Experiment(one.model, one.log, motion,
                      np.concatenate([one.force, other.force]), np.concatenate([one.known, other.known]))
    sigma = np.array([700.0, 800.0, 900.0])
    (R, r, _), (S, s, _) = (regressor_qr.compress(parts).weighted(sigma)
                            for parts in ((one, other), (both,)))
    lengths = np.maximum(np.linalg.norm(R, axis=0), 1e-9)
    np.testing.assert_allclose(
        (R.T @ R) / np.outer(lengths, lengths), (S.T @ S) / np.outer(lengths, lengths), atol=1e-12
    )
    np.testing.assert_allclose(R.T @ r / lengths, S.T @ s / lengths, rtol=1e-9, atol=1e-9 * np.linalg.norm(r))


# --- priors


def test_priors_fill_in_what_no_motion_shows(noisy: IdentificationProblem) -> None:
    """The calibrated machine gets them, and the answer names them as stated; the data alone have no value."""
    told = identify(noisy.with_prior("drawing", "swing.I_xx", value=12_345.0, sigma=1.0), intervals=False)
    assert told.psi[told.problem.parameters.index("swing.I_xx")] == pytest.approx(12_345, abs=5)
    assert told["swing.I_xx"].identifiability == "stated"
    assert identify(noisy, "wls")["swing.I_xx"].value is None


@pytest.mark.slow
def test_two_sources_are_better_than_one(noisy: IdentificationProblem, cat_truth: np.ndarray) -> None:
    """Unseen forces: data with the file's confidences beat the data alone and the file alone."""
    both, data = identify(noisy, "sdp", intervals=False), identify(noisy, "wls")
    file = replace(both, psi=noisy.parameters.nominal)
    best = both.fit["validation"]["all"].relative
    assert best < data.fit["validation"]["all"].relative
    assert best < 0.3 * file.fit["validation"]["all"].relative


# --- standstill and missing channels


def test_standstill_takes_no_part(wheel: Model) -> None:
    """While the wheel rests, dry friction may be anything: any reading there must not change the estimate."""
    rng = np.random.default_rng(4)
    t = np.arange(0, 30, 0.01)
    phase = np.clip(np.where(t < 15, (t - 2) / 8, (26 - t) / 8), 0, 1)
    q = 2 * phase**3 * (10 - 15 * phase + 6 * phase**2)
    qd, qdd = np.gradient(q, t), np.gradient(np.gradient(q, t), t)
    psi = np.array([0.5, 5.0, 3.0, 2.0])
    resting = (t < 2) | ((t > 10) & (t < 18)) | (t > 26)
    estimates = []
    for stuck in (-4.5, 4.5):
        torque = np.column_stack([np.ones_like(t), np.sign(qd), qd, qdd]) @ psi + 0.05 * rng.standard_normal(t.size)
        torque[resting] = stuck
        log = Log("stop and go", t, {"wheel.q": q + 1e-5 * rng.standard_normal(t.size), "wheel.tau": torque})
        problem = identification_problem(wheel.machine, [log])
        assert not np.any(problem.experiments[0].known[resting])
        assert np.mean(problem.experiments[0].known[~resting]) > 0.6
        estimates.append(identify(problem, "wls"))
    for estimate in estimates:
        assert estimate["drive.tau_coulomb"].value == pytest.approx(5, rel=0.02)
    np.testing.assert_allclose(estimates[0].value, estimates[1].value, rtol=0.05)


@pytest.mark.slow
def test_cylinder_length_stands_in_for_a_missing_angle(cat215b: Model, exact_logs: list[Log],
                                                       noisy: IdentificationProblem,
                                                       noisy_estimate: Estimate) -> None:
    def without_angles(log: Log) -> Log:
        return replace(log, channels={c: x for c, x in log.channels.items() if c not in ("boom.q", "stick.q")})

    exactly = identification_problem(cat215b.machine, [without_angles(exact_logs[0])], smoothing=PERIODIC).experiments[
        0
    ]
    angles = np.column_stack([exact_logs[0].channel(f"{joint}.q") for joint in cat215b.machine.joints])
    np.testing.assert_allclose(exactly.motion.q, angles, atol=1e-9)
    measured = identification_problem(cat215b.machine, [without_angles(e.log) for e in noisy.experiments],
                                      [e.log for e in noisy.validation], smoothing=PERIODIC)
    by_length, by_angle = identify(measured), noisy_estimate
    far = np.abs(by_length.psi - by_angle.psi) / np.hypot(by_length.std, by_angle.std)
    assert np.nanmax(far) < 3
    bare = replace(exact_logs[0], channels={c: x for c, x in without_angles(exact_logs[0]).channels.items()
                                            if not c.endswith(".length")})
    with pytest.raises(LogError, match=r"there is no channel 'boom\.q'"):
        identification_problem(cat215b.machine, [bare])


def test_force_channel_stands_in_for_missing_pressures(cat215b: Model, exact_logs: list[Log]) -> None:
    log = exact_logs[0]
    head, rod = cat215b.machine.cylinders[0].areas
    force = head * log.channel("boom_cylinder.p_head") - rod * log.channel("boom_cylinder.p_rod")
    channels = {c: x for c, x in log.channels.items() if not c.startswith("boom_cylinder.p_")}
    direct = replace(log, channels=channels | {"boom_cylinder.force": force})
    one, other = (
        identification_problem(cat215b.machine, [x], smoothing=PERIODIC).experiments[0] for x in (log, direct)
    )
    np.testing.assert_allclose(one.force, other.force, rtol=1e-12)


# --- what it admits not to know


@pytest.fixture(scope="module")
def stiff_stick(cat215b: Model, cat_truth: np.ndarray) -> IdentificationProblem:
    """The excavator turns and lifts, its stick stands still."""
    moving = random_trajectory(cat215b, duration=33.28, rate=12.5, seed=1)
    resting = np.array([1.0, 1.0, 0.0])
    motion = Trajectory(moving.t, np.where(resting, moving.q, 1.4), moving.qd * resting, moving.qdd * resting)
    logs = [simulate(cat215b, motion, cat_truth, seed=1)]
    return identification_problem(cat215b.machine, logs, smoothing=PERIODIC)


@pytest.mark.slow
def test_a_joint_that_stands_still_is_not_excited(stiff_stick: IdentificationProblem) -> None:
    names = stiff_stick.parameters.names
    by_data, by_both = identify(stiff_stick, "wls"), identify(stiff_stick, "sdp")
    for name in ("stick_cylinder.f_coulomb", "stick_cylinder.n_barrel", "stick_cylinder.n_rod", "stick.tau_coulomb"):
        k = names.index(name)
        if by_data.structural.category[k] == "none":
            continue
        assert by_data.category(k) == "not excited", name
        assert np.isnan(by_data.value[k])
        assert np.isnan(by_data.std[k])
        assert np.isnan(by_both.std[k])
        assert np.all(np.isnan(by_both.ci95[k]))
    assert by_data.category(names.index("boom_cylinder.f_coulomb")) != "not excited"
    assert of_kind(by_data.diagnostics, "not excited")


@pytest.mark.parametrize("noise", [False, True], ids=["perfect", "noisy"])
def test_a_log_of_a_single_posture_is_refused(cat215b: Model, noise: bool) -> None:
    t = np.arange(1000) / 20
    still = Trajectory(t, np.tile([0.1, -0.3, 1.4], (1000, 1)), np.zeros((1000, 3)), np.zeros((1000, 3)))
    problem = identification_problem(cat215b.machine, [simulate(cat215b, still, noise=noise)])
    assert np.max(np.mean(problem.experiments[0].known, axis=0)) < 0.01
    with pytest.raises(IdentifiabilityError, match="joints move"):
        identify(problem, "sdp")


@pytest.mark.slow
def test_a_slow_lift_does_not_tell_friction_from_gravity() -> None:
    model = Model(load_machine("patu655_lift"))
    t = np.arange(0, 27, 0.02)
    s = t / 27
    path = s**3 * (10 - 15 * s + 6 * s**2)
    speed, growth = (30 * s**2 * (1 - s) ** 2) / 27, (60 * s * (1 - s) * (1 - 2 * s)) / 27**2
    low, high = np.radians([0.9, 48.0])
    motion = Trajectory(
        t, *((x * (high - low) + shift)[:, None] for x, shift in ((path, low), (speed, 0.0), (growth, 0.0)))
    )
    log = simulate(model, motion, random_truth(model, 1), seed=1)
    estimate = identify(identification_problem(model.machine, [log]), "sdp")
    named = {name for one in estimate.confounded for name in (one.name, *one.partners)}
    assert "lift_cylinder.f_coulomb" in named
    effects = [found.evidence["effects"] for found in of_kind(estimate.diagnostics, "not separable in this motion")]
    assert any("Coulomb friction" in each and "gravity" in each for each in effects)


def test_force_noise_is_that_of_the_sensors(cat215b: Model) -> None:
    """Quadrature sum of two uniform errors of ±25 psi and their quantisation in steps of 5000 psi / 4096."""
    psi = 6894.757293168
    one = psi * np.hypot(25 / np.sqrt(3), 5000 / 4096 / np.sqrt(12))
    inch = 0.0254**2
    expected = [
        0.089 * 307 / psi * np.hypot(one, one),
        np.hypot(31.8, 19.92) * inch * one,
        np.hypot(23.75, 14.13) * inch * one,
    ]
    np.testing.assert_allclose(force_noise(cat215b), expected, rtol=1e-6)


def test_the_same_samples_twice_are_refused(noisy: IdentificationProblem) -> None:
    machine, log = noisy.model.machine, noisy.experiments[0].log
    for train, held_out in (([log, log], []), ([log], [log])):
        with pytest.raises(ProblemError, match="same samples are given twice"):
            identification_problem(machine, train, held_out)


@pytest.mark.slow
def test_rounding_errors_taken_for_information_are_no_estimate(noisy: IdentificationProblem) -> None:
    with pytest.raises(SolverError, match=r"condition number|stationarity"):
        identify(noisy, "wls", tolerance=0.0)


def test_functions_of_one_name_are_not_confused(cat215b: Model) -> None:
    x = ca.SX.sym("x")
    one, two = ca.Function("f", [x], [x]), ca.Function("f", [x], [2 * x])
    values = np.arange(3.0)[:, None]
    np.testing.assert_array_equal(cat215b.over(one, values)[0].ravel(), [0, 1, 2])
    np.testing.assert_array_equal(cat215b.over(two, values)[0].ravel(), [0, 2, 4])


@pytest.mark.slow
def test_a_link_in_all_weighs_what_its_bodies_were_weighed_to(noisy: IdentificationProblem,
                                                            noisy_estimate: Estimate) -> None:
    bodies = ("boom", "boom_cylinder.rod", "stick_cylinder.barrel")
    weighed = {total.link: total for total in identify(noisy.with_total_mass("scale", bodies, 2100.0)).total_masses}
    free = {total.link: total for total in noisy_estimate.total_masses}
    assert weighed["boom"].bodies == free["boom"].bodies == bodies
    assert weighed["boom"].low == pytest.approx(2100, abs=1e-5)
    assert weighed["boom"].high == pytest.approx(2100, abs=1e-5)
    assert free["boom"].low < free["boom"].value < free["boom"].high
    assert free["stick"].bodies == ("stick", "stick_cylinder.rod")
    assert np.isnan(free["swing"].value)  # no motion shows the swing's mass


@pytest.mark.parametrize("statement", ["lift.m + tilt.m == {} kg", *(
    pytest.param(each, marks=pytest.mark.slow) for each in (
    "lift.m + tilt.m = {} +- 20 kg", "lift.m + tilt.m >= {} kg", "lift.m = {}"))])
def test_statements_determine_what_no_motion_does_and_are_refuted_by_the_rest(statement: str, tmp_path: Path) -> None:
    """No motion shows the mass of a boom that turns about a fixed pin: a statement on a sum gives it."""
    model = Model(load_machine("patu655"))
    truth = random_truth(model, seed=3)
    log = simulate(model, random_trajectory(model, duration=20, rate=50, seed=3), truth, seed=3)
    at = dict(zip(model.parameters.names, truth, strict=True))
    right = at["lift.m"] + (at["tilt.m"] if "tilt" in statement else 0.0)

    def solved(value: float) -> Estimate:
        problem = identification_problem(model, [log])
        text = statement.format(value)
        if "kg" not in text:
            return solve(problem.fix("lift.m", value))
        return solve(problem.with_prior("sum", text) if "+-" in text else problem.subject_to("sum", text))

    found = solved(right)
    assert not found.refuted_statements
    if ">=" not in statement:  # a bound determines nothing
        assert found["lift.m"].value == pytest.approx(at["lift.m"], abs=3 * (found["lift.m"].std or 1.0))
        assert found.parameters["lift.m"].identifiability in ("stated", "fixed")
        found.save(tmp_path)
        written = load_machine(tmp_path / "patu655.toml")
        numbers = dict(zip(model.parameters.names, Model(written).parameters.nominal, strict=True))
        total = numbers["lift.m"] + (numbers["tilt.m"] if "tilt" in statement else 0.0)
        assert total == pytest.approx(right, abs=60 if "+-" in statement else 1e-6 * right)
        source = written.notes[written.numbers["lift.m"].path].source or ""
        assert source.startswith(("from the constraint or prior 'sum'", "held at a value chosen by the user"))
    [named] = [each for each in solved(2.5 * right).diagnostics if each.kind == "statement contradicted"]
    assert named.evidence["z"] > 4
    assert "standard deviations" in named.text
