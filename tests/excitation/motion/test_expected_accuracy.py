"""What a motion is said to tell, against what identifications of simulated logs do tell."""

from __future__ import annotations

import numpy as np
import pytest

from hydroopt import Model, excitation_problem, load_machine
from hydroopt.cli.excite import _basis
from hydroopt.estimation.dynamic.identify import identify
from hydroopt.estimation.dynamic.problem import identification_problem
from hydroopt.estimation.inference.identifiability import structural
from hydroopt.excitation.motion.design import design
from hydroopt.excitation.motion.excitation import Excitation
from hydroopt.excitation.motion.expected_accuracy import ExpectedAccuracy, expected_accuracy, measured_information
from hydroopt.excitation.motion.random_motion import shrunk
from hydroopt.logs import spline
from hydroopt.machine.machine import Machine
from hydroopt.simulation.simulate import Trajectory, random_trajectory, simulate

Array = np.ndarray


@pytest.fixture(scope="module")
def lift() -> Model:
    return Model(load_machine("patu655_lift"))


@pytest.fixture(scope="module")
def motion(lift: Model) -> Trajectory:
    return random_trajectory(lift, duration=20, rate=50, seed=1)


@pytest.fixture(scope="module")
def expectation(lift: Model, motion: Trajectory) -> ExpectedAccuracy:
    return expected_accuracy(lift, motion, structural(lift))


@pytest.mark.parametrize(("uneven", "bandwidth", "passes"),
                         [(False, 2.0, 1), (True, 2.0, 1), (True, 0.5, spline.SHARP)], ids=["even", "uneven", "sharp"])
def test_pull_back_is_the_derivative_by_each_sample(uneven: bool, bandwidth: float, passes: int) -> None:
    """A spline of the same weight is fitted again with one sample after the other changed."""
    rng = np.random.default_rng(3)
    t = 5 + np.linspace(0, 4, 60) + uneven * rng.uniform(-0.03, 0.03, 60)
    y = np.sin(2 * t) + 0.05 * rng.standard_normal(60)
    basis, chosen = spline.fit(t, y, 0.05, bandwidth)
    rows = [rng.standard_normal((4, 60)) for _ in range(3)]

    def told(y: Array) -> Array:
        return np.sum([row @ each for row, each in zip(rows, basis.smoothed(y, chosen), strict=True)], axis=0)

    assert chosen.passes == passes
    step = 0.5
    slopes = np.column_stack([(told(y + step * e) - told(y - step * e)) / (2 * step) for e in np.eye(60)])
    np.testing.assert_allclose(basis.pull_back(rows, chosen), slopes, rtol=0, atol=1e-9 * np.max(np.abs(slopes)))


def identified(model: Model, motion: Trajectory, runs: int) -> tuple[tuple[int, ...], Array, Array]:
    """Basis and grouping that all logs of a motion show, and the base parameters (runs, r) found in each."""
    found = [identify(identification_problem(model.machine, [simulate(model, motion, seed=1000 + seed)]), "wls")
             for seed in range(runs)]
    assert len({one.identifiability.basis for one in found}) == 1
    of = found[0].identifiability
    return of.basis, of.grouping, np.array([one.base_value for one in found])


@pytest.mark.slow
def test_std_is_the_scatter_of_identifications(lift: Model, motion: Trajectory, expectation: ExpectedAccuracy) -> None:
    basis, _, found = identified(lift, motion, 60)
    assert basis == structural(lift).basis
    assert np.all(np.isfinite(expectation.base))
    ratio = found.std(axis=0, ddof=1) / expectation.base
    assert 0.85 < np.exp(np.mean(np.log(ratio))) < 1.15, ratio
    assert np.all((ratio > 0.7) & (ratio < 1.4)), ratio  # 60 runs tell a standard deviation to 9 %


@pytest.mark.slow
def test_std_is_the_scatter_where_several_joints_move() -> None:
    """Those base parameters that the logs' own basis groups in the same way; what no log shows is not told."""
    model = Model(load_machine("cat215b"))
    motion = random_trajectory(model, duration=33.28, rate=12.5, seed=1)
    structure = structural(model)
    said = expected_accuracy(model, motion, structure).base
    basis, grouping, found = identified(model, motion, 12)
    assert np.all(np.isinf(said[[k for k, column in enumerate(structure.basis) if column not in basis]]))
    same = [(k, basis.index(column)) for k, column in enumerate(structure.basis) if column in basis
            and np.allclose(structure.grouping[k], grouping[basis.index(column)], rtol=0, atol=1e-6)]
    own, other = np.array(same).T
    assert len(own) > 0.9 * len(structure.basis)
    assert np.all(np.isfinite(said[own]))
    ratio = found.std(axis=0, ddof=1)[other] / said[own]
    assert 0.85 < np.exp(np.mean(np.log(ratio))) < 1.15, ratio


def test_information_of_a_log_is_what_its_identification_reports(lift: Model, motion: Trajectory) -> None:
    log = simulate(lift, motion, seed=5)
    estimate = identify(identification_problem(lift.machine, [log]), "wls")
    basis = list(structural(lift).basis)
    assert estimate.identifiability.basis == tuple(basis)
    information = measured_information(lift.machine, [log])
    np.testing.assert_allclose(information, information.T, rtol=0, atol=1e-9 * np.max(np.abs(information)))
    scale = np.sqrt(np.diag(information)[basis])
    covariance = np.linalg.inv(information[np.ix_(basis, basis)] / np.outer(scale, scale)) / np.outer(scale, scale)
    np.testing.assert_allclose(np.sqrt(np.diag(covariance)), estimate.base_std, rtol=1e-6)


def test_logs_measured_before_count(lift: Model, motion: Trajectory, expectation: ExpectedAccuracy) -> None:
    """What is known before is the inverse of the file's information and the logs' own together."""
    before = random_trajectory(lift, duration=20, rate=50, seed=2)
    known = measured_information(lift.machine, [simulate(lift, before, seed=5)])
    with_log = expected_accuracy(lift, motion, structural(lift), known)
    scale = lift.parameters.scale
    total = (lift.parameters.information + known) * np.outer(scale, scale)
    np.testing.assert_allclose(with_log.before, scale * np.sqrt(np.diag(np.linalg.inv(total))), rtol=1e-6)
    assert np.all(with_log.before <= expectation.before * (1 + 1e-9))
    assert np.all(with_log.after <= expectation.after * (1 + 1e-9))
    payload = lift.parameters.index("payload.m")
    assert with_log.before[payload] < 0.5 * expectation.before[payload]
    np.testing.assert_array_equal(with_log.base, expectation.base)  # of the motion alone


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("rate", [5, 50])
def test_motion_takes_nothing_away_from_what_is_known(lift: Model, seed: int, rate: float) -> None:
    said = expected_accuracy(lift, random_trajectory(lift, duration=20, rate=rate, seed=seed), structural(lift))
    assert np.all(said.after <= said.before * (1 + 1e-9))
    assert np.any(said.after < 0.5 * said.before)


def test_samples_that_come_faster_tell_more(lift: Model, expectation: ExpectedAccuracy) -> None:
    fast = expected_accuracy(lift, random_trajectory(lift, duration=20, rate=200, seed=1), structural(lift))
    ratio = fast.base / expectation.base
    assert np.all((ratio > 0.3) & (ratio < 0.8)), ratio  # four times the samples: half the deviation


SENSED = {"name": "sensed", "links": [
    {"name": "post", "parent": "base", "joint": {"type": "revolute", "lower": -3.0, "upper": 3.0, "max_speed": 2.0},
     "body": {"m": 5.0, "mc": (1.0, 0.2, 0.1), "inertia": (1.0, 0.0, 0.0, 2.0, 0.0, 3.0)}},
    {"name": "slide", "parent": "post", "joint": {"type": "prismatic", "lower": -0.5, "upper": 0.5, "max_speed": 0.5}}],
    "drives": [{"name": "turn", "joint": "post", "friction": {"coulomb": 5.0, "viscous": 3.0}},
               {"name": "lift", "joint": "slide", "friction": {"coulomb": 5.0, "viscous": 3.0}}],
    "sensors": [{"channels": ("post.q",), "accuracy": 1e-3, "distribution": "gaussian"},
                {"channels": ("post.tau",), "accuracy": 0.2, "distribution": "gaussian"},
                {"channels": ("slide.tau",), "accuracy": 0.2, "distribution": "gaussian"}]}
"""A post that turns about the vertical, and friction of which the file gives no confidence."""


def test_what_nothing_tells_has_an_infinite_deviation() -> None:
    model = Model(Machine.model_validate(SENSED))
    structure, names = structural(model), model.parameters.names
    seen = ("post.I_zz", "turn.tau_coulomb", "turn.tau_viscous", "lift.tau_coulomb", "lift.tau_viscous")
    assert {names[k] for k in structure.basis} == set(seen)
    moving = random_trajectory(model, duration=20, rate=50, seed=1)
    said = expected_accuracy(model, moving, structure)
    friction = np.array([".tau_" in name for name in names])
    np.testing.assert_array_equal(np.isinf(said.before), friction)
    assert np.all(np.isfinite(said.base))
    assert np.all(np.isfinite(said.after))
    for k, name in enumerate(names):  # what the motion does not show stays as it is
        assert (said.after[k] < 0.1 * said.before[k]) == (name in seen), name
        assert (said.after[k] == pytest.approx(said.before[k])) == (name not in seen), name
    # one joint rests: what drives it is not told, and nothing of the other changes
    still = Trajectory(moving.t, *(part * [1.0, 0.0] for part in (moving.q, moving.qd, moving.qdd)))
    alone = expected_accuracy(model, still, structure)
    rests = np.array([names[k].startswith("lift.") for k in structure.basis])
    np.testing.assert_array_equal(np.isinf(alone.base), rests)
    np.testing.assert_allclose(alone.base[~rests], said.base[~rests], rtol=0.25)
    np.testing.assert_array_equal(np.isinf(alone.after), [name.startswith("lift.") for name in names])


def test_forces_without_stated_accuracy_are_presumed_to_have_noise() -> None:
    """A part of a typical force: ten times the friction of the slide, which has no other force, is ten times that."""
    bare = Machine.model_validate(SENSED | {"sensors": SENSED["sensors"][:1]})
    model = Model(bare)
    said = expected_accuracy(model, random_trajectory(model, duration=20, rate=50, seed=1), structural(model))
    assert np.all(said.sigma > 0)
    assert np.all(np.isfinite(said.base))
    loud = Model(bare.model_copy(update={"drives": tuple(
        drive.model_copy(update={"friction": drive.friction.model_copy(update={"coulomb": 50.0, "viscous": 30.0})})
        for drive in bare.drives)}))
    more = expected_accuracy(loud, random_trajectory(loud, duration=20, rate=50, seed=1), structural(loud))
    assert more.sigma[1] / said.sigma[1] == pytest.approx(10)


@pytest.mark.slow
def test_machines_without_joint_sensors_have_an_expected_accuracy() -> None:
    """Designs on machines with IMUs alone were refused; nothing is added by angles that nothing reads."""
    model = Model(load_machine("excavator_imu"))
    driven = random_trajectory(model, duration=20, rate=50, seed=1)
    said = expected_accuracy(model, driven, structural(model))
    assert np.all(np.isfinite(said.sigma))
    assert np.all(said.bias == 0)
    known = np.isfinite(said.base)
    assert np.mean(known) > 0.5
    assert np.all(said.after <= said.before * (1 + 1e-9))


@pytest.mark.slow
@pytest.mark.parametrize("duration", [20.0, 33.0])
def test_a_slow_machine_is_known_better_than_by_multisines_with_what_smoothing_takes(duration: float) -> None:
    """Noise and bias together, median over base parameters, against ten multisines in the middle of the range."""
    machine = load_machine("patu655_lift")
    problem = excitation_problem(machine, _basis(duration, None, None, None, None, machine.bandwidth))
    found = design(problem, starts=4)

    def error(motion: Excitation) -> np.ndarray:
        return np.hypot(motion.accuracy.base, motion.accuracy.bias)

    still, rng = problem.posture(problem.mean), np.random.default_rng(0)
    for _ in range(10):
        phase = dict(zip(range(1, problem.basis.harmonics + 1), rng.uniform(0, 2 * np.pi, 20), strict=False))
        wave = np.array([0.0 if name == "mean" else 3 * (np.sin if name[:3] == "sin" else np.cos)(phase[int(name[3:])])
                         for name in problem.basis.names])
        assert np.median(error(Excitation(problem, shrunk(problem, still + wave, still))) / error(found)) > 1
