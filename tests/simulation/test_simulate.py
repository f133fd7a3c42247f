"""Made-up logs: motions within limits, derivatives that belong together, noise as stated, truths that can exist."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import truncnorm

from hydroopt.errors import IdentifiabilityError, ProblemError
from hydroopt.machine.links import Note
from hydroopt.machine.machine import Machine
from hydroopt.machine.machine_file import load_machine
from hydroopt.model.model import Model
from hydroopt.simulation.simulate import Trajectory, forces, random_trajectory, random_truth, simulate
from hydroopt.spatial import inertia

MACHINES = ("cat215b", "kr300", "patu655_lift")
INCH, PSI = 0.0254, 6894.757293168


@pytest.fixture(scope="module", params=MACHINES)
def model(request: pytest.FixtureRequest) -> Model:
    return Model(load_machine(request.param))


@pytest.fixture(scope="module")
def excavator() -> Model:
    return Model(load_machine("cat215b"))


def spectrum(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Fourier coefficients of a periodic signal (N, n), and multiples of the base frequency."""
    return np.fft.rfft(x, axis=0), np.arange(len(x) // 2 + 1)[:, None]


def dense(x: np.ndarray, finer: int) -> np.ndarray:
    """The same periodic signal between its samples too, by its Fourier series."""
    return np.fft.irfft(np.fft.rfft(x, axis=0), finer * len(x), axis=0) * finer


@pytest.mark.parametrize("rate", [5.0, 0.8])
@pytest.mark.parametrize("seed", range(3))
def test_limits_hold_between_the_samples_too(model: Model, seed: int, rate: float) -> None:
    motion = random_trajectory(model, duration=40.0, rate=rate, seed=seed)
    for k, joint in enumerate(model.machine.joints):
        limits = model.machine.link(joint).joint
        q, qd, qdd = (dense(x[:, [k]], 40) for x in (motion.q, motion.qd, motion.qdd))
        assert limits.lower <= q.min()
        assert q.max() <= limits.upper
        middle, room = (limits.lower + limits.upper) / 2, min((limits.upper - limits.lower) / 2, np.pi / 3)
        used = [np.max(np.abs(q - middle)) / room, np.max(np.abs(qd)) / (limits.max_speed or np.inf),
                np.max(np.abs(qdd)) / (limits.max_acceleration or np.inf)]
        assert max(used) <= 1 + 1e-9
        assert max(used) > 0.6, "hardly uses what the machine can do"


def test_velocity_and_acceleration_are_derivatives_of_a_periodic_motion(model: Model) -> None:
    motion = random_trajectory(model, duration=33.28, rate=12.5, seed=4, harmonics=6)
    assert len(motion.t) == 416
    assert np.ptp(motion.t) == pytest.approx(33.28 - 0.08)
    (Q, k), (V, _), (A, _) = (spectrum(x) for x in (motion.q, motion.qd, motion.qdd))
    omega = 2 * np.pi / 33.28 * k
    np.testing.assert_allclose(V, 1j * omega * Q, atol=1e-9 * np.max(np.abs(V)))
    np.testing.assert_allclose(A, -(omega**2) * Q, atol=1e-9 * np.max(np.abs(A)))
    strong = np.abs(Q[1:]) > 1e-9 * np.max(np.abs(Q[1:]))
    assert np.all(strong.sum(axis=0) == 6)  # periodic over its duration: whole multiples, nothing leaks
    present = np.flatnonzero(strong.any(axis=1)) + 1
    assert present.min() / 33.28 >= 0.02
    assert present.max() / 33.28 <= 0.3


def test_seeds_reproduce_and_differ(excavator: Model) -> None:
    one, same, other = (random_trajectory(excavator, duration=20.0, rate=5.0, seed=seed) for seed in (1, 1, 2))
    np.testing.assert_array_equal(one.q, same.q)
    assert not np.any(one.q == other.q)
    np.testing.assert_array_equal(random_truth(excavator, 5), random_truth(excavator, 5))
    assert np.any(random_truth(excavator, 5) != random_truth(excavator, 6))
    logs = [simulate(excavator, one, seed=seed) for seed in (1, 1, 2)]
    for name, values in logs[0].channels.items():
        np.testing.assert_array_equal(values, logs[1].channels[name])
        assert np.any(values != logs[2].channels[name])


@pytest.mark.parametrize(("duration", "rate"), [(0.0, 10.0), (-1.0, 10.0), (10.0, 0.0), (10.0, 0.1), (1e9, 1e3),
                                                (float("nan"), 10.0)])
def test_motions_without_samples_or_end_are_refused(excavator: Model, duration: float, rate: float) -> None:
    with pytest.raises(ProblemError, match="simulation"):
        random_trajectory(excavator, duration=duration, rate=rate, seed=0)


def test_truths_can_exist_and_respect_bounds(model: Model) -> None:
    parameters = model.parameters
    for seed in range(3):
        psi = random_truth(model, seed)
        assert np.all(psi >= parameters.lower)
        assert np.all(psi <= parameters.upper)
        for k, name in enumerate(parameters.names):
            if name.endswith(".m"):
                assert inertia.smallest_eigenvalue(psi[k:k + 10]) > 0


def test_truths_are_spread_as_the_file_says() -> None:
    data = load_machine("patu655_lift").model_dump()
    data["cylinders"][0]["friction"]["offset"] = 40.0
    for link in data["links"][1:]:
        link["body"] = None
    data["notes"] |= {"lift_cylinder.friction.offset": Note(sigma=30.0), "lift.body.m": Note(sigma=0.02, relative=True),
                      "lift.body.com": Note(sigma=0.01)}
    model = Model(Machine.model_validate(data))
    drawn = np.array([random_truth(model, seed, tries=200) for seed in range(400)])
    index = model.parameters.index
    offset = drawn[:, index("lift_cylinder.f_offset")]
    assert offset.mean() == pytest.approx(40, abs=4 * 30 / 20)
    assert offset.std() == pytest.approx(30, rel=4 / np.sqrt(800))
    # Coulomb friction 210 ± 2000 N cannot be negative: a normal distribution cut at zero
    exact = truncnorm(-210 / 2000, np.inf, loc=210, scale=2000)
    coulomb = drawn[:, index("lift_cylinder.f_coulomb")]
    assert coulomb.mean() == pytest.approx(exact.mean(), abs=4 * exact.std() / 20)
    assert coulomb.std() == pytest.approx(exact.std(), rel=0.15)
    mass = drawn[:, index("lift.m")]
    assert mass.mean() == pytest.approx(124.565967, abs=4 * 0.02 * 124.6 / 20)
    assert mass.std() == pytest.approx(0.02 * 124.565967, rel=0.15)


@pytest.mark.slow
def test_a_body_far_from_possible_has_no_truth() -> None:
    data = load_machine("patu655_lift").model_dump()
    data["links"][0]["body"] = {"m": 100.0, "mc": (100.0, 0.0, 0.0), "inertia": (1.0, 0, 0, 1.0, 0, 1.0)}
    data["notes"] = {f"lift.body.{key}": Note(sigma=0.01, relative=True) for key in ("m", "mc", "inertia")}
    with pytest.raises(IdentifiabilityError, match=r"lift\.m"):
        random_truth(Model(Machine.model_validate(data)), 0)


def test_forces_come_back_from_noise_free_pressures(excavator: Model) -> None:
    motion = random_trajectory(excavator, duration=20.0, rate=25.0, seed=2)
    psi = random_truth(excavator, 2)
    log = simulate(excavator, motion, psi, noise=False)
    expected = forces(excavator, motion, psi)
    p = {channel: log.channel(channel) for channel in log.channels if ".p_" in channel}
    assert min(values.min() for values in p.values()) >= 0
    found = np.column_stack([
        0.089 * 307 / PSI * (p["swing_motor.p_a"] - p["swing_motor.p_b"]),
        INCH**2 * (31.8 * p["boom_cylinder.p_head"] - 19.92 * p["boom_cylinder.p_rod"]),
        INCH**2 * (23.75 * p["stick_cylinder.p_head"] - 14.13 * p["stick_cylinder.p_rod"])])
    np.testing.assert_allclose(found, expected, rtol=1e-6, atol=1e-6 * np.max(np.abs(expected)))
    for k, joint in enumerate(excavator.machine.joints):
        np.testing.assert_array_equal(log.channel(f"{joint}.q"), motion.q[:, k])
    # Table 3 and Table 11: the law of cosines with the sides 0.625 m and 2.000 m
    side = np.sqrt(0.625**2 + 2.0**2 - 2 * 0.625 * 2.0 * np.cos(motion.q[:, 1] - np.radians(78.6)))
    np.testing.assert_allclose(log.channel("boom_cylinder.length"), side, atol=1e-4)


def test_nominal_parameters_without_truth(excavator: Model) -> None:
    motion = random_trajectory(excavator, duration=5.0, rate=10.0, seed=2)
    one, other = (simulate(excavator, motion, psi, noise=False) for psi in (None, excavator.parameters.nominal))
    for channel, values in one.channels.items():
        np.testing.assert_array_equal(values, other.channels[channel])


def test_noise_has_the_sensors_standard_deviation(excavator: Model) -> None:
    motion = random_trajectory(excavator, duration=400.0, rate=25.0, seed=3)
    true, read = (simulate(excavator, motion, noise=noise, seed=8) for noise in (False, True))
    for channel, values in true.channels.items():
        sensor = excavator.machine.sensor(channel)
        assert sensor is not None
        error = read.channel(channel) - values
        assert error.std() == pytest.approx(sensor.std, rel=0.03), channel
        assert abs(error.mean()) < 5 * sensor.std / np.sqrt(error.size)
        assert np.max(np.abs(error)) <= sensor.accuracy + sensor.resolution / 2 + 1e-9 * np.max(np.abs(values))
    errors = np.array([read.channel(c) - true.channels[c] for c in true.channels])
    assert np.max(np.abs(np.corrcoef(errors) - np.eye(len(errors)))) < 0.05


def test_chunks_of_samples_do_not_show(excavator: Model) -> None:
    rng = np.random.default_rng(0)
    count = 4096 + 3
    motion = Trajectory(np.arange(count) / 10, *rng.uniform(-0.3, 0.3, (3, count, 3)))
    whole = forces(excavator, motion, excavator.parameters.nominal)
    for k in (0, 4095, 4096, count - 1):
        one = excavator.inverse_dynamics(motion.q[k], motion.qd[k], motion.qdd[k], excavator.parameters.nominal)
        np.testing.assert_allclose(whole[k], np.asarray(one).ravel(), rtol=1e-9)


def test_random_truths_are_refused_where_they_would_contradict_the_file() -> None:
    data = load_machine("cat215b").model_dump()
    data["total_masses"] = [{"name": "scale", "bodies": ["boom", "stick"], "value": 2500.0}]
    with pytest.raises(ProblemError, match="random parameters do not satisfy what the file states: scale"):
        random_truth(Model(Machine.model_validate(data)), 0)


@pytest.mark.slow
def test_identical_parts_are_drawn_alike_with_all_that_is_stated_of_them() -> None:
    data = load_machine("stewart_platform").model_dump()
    data["identical"] = [{"name": "rods", "bodies": tuple(f"leg{leg}.rod" for leg in range(1, 7))}]
    model = Model(Machine.model_validate(data))
    places, drawn = model.parameters.bodies, [random_truth(model, seed) for seed in range(60)]
    for psi in drawn[:3]:
        for leg in range(2, 7):
            np.testing.assert_array_equal(psi[places[f"leg{leg}.rod"]], psi[places["leg1.rod"]])
    rod = places["leg1.rod"]
    alone = np.sqrt(np.linalg.inv(model.parameters.information[rod, rod])[0, 0])
    assert 0.75 < np.std([psi[rod.start] for psi in drawn]) / (alone / np.sqrt(6)) < 1.3
