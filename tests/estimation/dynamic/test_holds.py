"""Joints at rest: gravity from holds, and dry friction that is only known to lie within its bounds."""

from __future__ import annotations

import warnings
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from fixtures.tiers import tiered
from hydroopt.estimation.dynamic import friction_sign
from hydroopt.estimation.dynamic.friction_sign import Phases, SpeedLimits
from hydroopt.estimation.dynamic.holds import Hold, HoldEquations, Holds
from hydroopt.estimation.dynamic.identify import identify
from hydroopt.estimation.dynamic.problem import identification_problem
from hydroopt.logs.log import Log
from hydroopt.logs.smoothing import STANDSTILL, Motion
from hydroopt.machine.machine import Machine
from hydroopt.machine.machine_file import load_machine
from hydroopt.model.model import Model
from hydroopt.simulation.simulate import Trajectory, simulate

COUNT, SAMPLES, RATE = 12, 75, 25.0
FRICTION = 1500.0
CRANE = load_machine("patu655_lift")


def crane(coulomb: float | None, *, offset: bool = False) -> Model:
    """The crane with another dry friction, and with an unknown offset of its force reading."""
    cylinder = CRANE.cylinders[0]
    friction = cylinder.friction.model_copy(update={"coulomb": coulomb, "offset": 0.0 if offset else None})
    notes = {path: note for path, note in CRANE.notes.items() if coulomb or not path.endswith("friction.coulomb")}
    return Model(CRANE.model_copy(update={"notes": notes, "cylinders": (
        cylinder.model_copy(update={"friction": friction}),)}))


def twelve_holds() -> Trajectory:
    """Twelve postures for three seconds each; what is between them is not recorded."""
    t = np.concatenate([13.0 * k + np.arange(SAMPLES) / RATE for k in range(COUNT)])
    q = np.repeat(np.radians(np.linspace(0.0, 70.0, COUNT)), SAMPLES)[:, None]
    return Trajectory(t, q, 0 * q, 0 * q)


def with_friction(log: Log, machine: Machine, friction: np.ndarray) -> Log:
    """A log in whose holds dry friction (holds,) [N] acts against the load."""
    cylinder = machine.cylinders[0]
    channel = cylinder.chambers[0]
    added = log.channel(channel) + np.repeat(friction, SAMPLES) / cylinder.areas[0]
    return replace(log, channels=dict(log.channels) | {channel: added})


@pytest.mark.parametrize(("coulomb", "offset"), [(None, False), (None, True), (210.0, True)])
def test_holds_without_noise_give_gravity_exactly(coulomb: float | None, offset: bool) -> None:
    model = crane(coulomb, offset=offset)
    log = simulate(model, twelve_holds(), model.parameters.nominal, noise=False)
    log = with_friction(log, model.machine, np.full(COUNT, FRICTION * (coulomb is not None)))  # as if it were an offset
    estimate = identify(identification_problem(model, [log]).by_data_alone(), "wls")
    found = estimate.identifiability
    names = model.parameters.names
    gravity = [i for i, k in enumerate(found.basis) if not names[k].endswith("offset")]
    assert len(gravity) == 2
    truth = found.grouping @ model.parameters.nominal
    assert estimate.base_value[gravity] == pytest.approx(truth[gravity], rel=1e-6)
    inertias = [k for k, name in enumerate(names) if ".I_" in name]
    assert {found.category[k] for k in inertias} == {"none"}
    assert np.all(np.isnan(estimate.value[inertias]))


@pytest.mark.slow
def test_holds_reach_the_bound_and_inertias_have_no_estimate() -> None:
    model, errors, stated = crane(None), [], []
    for seed in range(12):
        problem = identification_problem(model, [simulate(model, twelve_holds(), model.parameters.nominal, seed=seed)])
        estimate = identify(problem.by_data_alone(), "wls")
        errors.append(estimate.base_value - estimate.identifiability.grouping @ model.parameters.nominal)
        stated.append(estimate.base_std)
    motion = twelve_holds()
    K = model.over(model.regressor, motion.q, motion.qd, motion.qdd)[0][:, 0, list(estimate.identifiability.basis)]
    bound = problem.force_std[0] * np.sqrt(np.diag(np.linalg.inv(K.T @ K)))
    rms = np.sqrt(np.mean(np.square(errors), axis=0))
    assert np.all(rms < 1.55 * bound)  # χ² of 12 at 0.3 %
    assert np.all(rms > 0.5 * bound)
    assert np.median(stated, axis=0) == pytest.approx(1.13 * bound, rel=0.15)  # Student's t of ten differences
    by_default = identify(problem, seed=1)
    inertias = [row for row in by_default.parameters.rows if ".I_" in row.name]
    assert all(row.value is None and row.ci95 is None for row in inertias)
    payload = next(row for row in by_default.parameters.rows if row.name == "payload.mc_x")
    assert payload.std is not None
    assert payload.prior_std is not None
    assert payload.std < 0.3 * payload.prior_std


@pytest.mark.parametrize("at_rest", tiered(["zero", "uniform", "one side", "either side"],
                                           lambda at_rest: at_rest == "one side"))
def test_friction_at_rest_does_not_bias_gravity(at_rest: str) -> None:
    """Whatever friction does within its bounds, the interval of gravity holds the truth."""
    model, scaled = crane(1000.0), []
    for seed in range(6):
        rng = np.random.default_rng(seed)
        friction = {"zero": np.zeros(COUNT), "uniform": rng.uniform(-FRICTION, FRICTION, COUNT), "one side": np.full(
            COUNT, FRICTION), "either side": rng.choice([-FRICTION, FRICTION], COUNT)}[at_rest]
        psi = model.parameters.nominal * np.where([n.endswith("coulomb") for n in model.parameters.names], 0.0, 1.0)
        log = with_friction(simulate(model, twelve_holds(), psi, seed=seed), model.machine, friction)
        estimate = identify(identification_problem(model, [log]).by_data_alone(), "wls")
        scaled.append((estimate.base_value - estimate.identifiability.grouping @ psi) / estimate.base_std)
    assert np.max(np.abs(scaled)) < 1.96
    assert len(np.unique(np.array(scaled)[:, 0])) == 6


@pytest.mark.parametrize("count", [0, 1, 2, 3, 40])
def test_differences_are_what_a_qr_leaves_beside_the_mean(count: int) -> None:
    means = 1e4 + np.random.default_rng(count).standard_normal((count, 4))
    found = HoldEquations(np.arange(3), means, 1.0, 1.0).differences
    across = np.linalg.qr(np.column_stack([np.ones(count), np.eye(count)[:, 1:]]))[0][:, 1:] if count else means
    wanted = across.T @ means if count else means
    assert found.shape == (max(count - 1, 0), 4)
    np.testing.assert_allclose(np.abs(found), np.abs(wanted), rtol=0, atol=1e-10)
    np.testing.assert_allclose(found.T @ found, wanted.T @ wanted, rtol=0, atol=1e-9)


def swing_and_rest() -> Trajectory:
    """Three swings of four seconds each, and two seconds of rest after each of them."""
    t = np.arange(0, 18, 1 / RATE)
    share = np.clip(t % 6 / 4, 0.0, 1.0)
    begin, size, phase = np.radians(10 + 20 * (t // 6)), np.radians(20), 2 * np.pi * share
    q = begin + size * (share - np.sin(phase) / (2 * np.pi)) - size * np.sin(phase) ** 2 / 4
    qd, qdd = (np.gradient(of, t) for of in (q, np.gradient(q, t)))
    return Trajectory(t, q[:, None], qd[:, None], qdd[:, None])


@pytest.mark.parametrize("moves", [True, False])
def test_least_squares_take_the_size_of_friction_from_the_file_only_where_nothing_moves(moves: bool) -> None:
    motion, answers = swing_and_rest() if moves else twelve_holds(), []
    for stated in (2000.0, 20.0):
        path, machine = f"{CRANE.cylinders[0].name}.friction.coulomb", CRANE
        notes = dict(machine.notes) | {path: machine.notes[path].model_copy(update={"sigma": stated})}
        model = Model(machine.model_copy(update={"notes": notes}))
        log = simulate(model, motion, model.parameters.nominal, seed=3)
        answers.append(identify(identification_problem(model, [log]).by_data_alone(), "wls"))
    assert ("the dry friction of lift_cylinder: its size at rest is taken from the machine file"
            in " ".join(answers[0].notes)) is not moves
    one, other = (np.linalg.norm(answer.weighted_residuals.holds[0][-1]) for answer in answers)
    assert other / one == pytest.approx(1.0, rel=0.05) if moves else other > 5 * one  # the mean over all holds


def test_one_hold_is_one_equation_however_long_it_is() -> None:
    model = crane(1000.0)
    log = simulate(model, twelve_holds(), model.parameters.nominal, seed=3)
    bands = identification_problem(model, [log]).experiments[0].bands()
    assert bands.holds.counts.tolist() == [COUNT]
    assert bands.samples.tolist() == [0]
    assert bands.holds.samples.tolist() == [COUNT * SAMPLES]
    (equations,) = bands.holds.equations([np.outer(model.parameters.nominal, model.parameters.nominal)], np.zeros(1))
    assert equations.bound == pytest.approx(1000.0**2)  # the lever of a cylinder's own friction is 1
    assert len(equations.differences) == COUNT - 1
    dense = np.linalg.lstsq(np.column_stack([np.ones(COUNT), equations.means[:, :-1]]), equations.means[:, -1],
                            rcond=1e-12)[0][1:]
    alone = np.linalg.lstsq(equations.differences[:, :-1], equations.differences[:, -1], rcond=1e-12)[0]
    assert alone == pytest.approx(dense, rel=1e-6, abs=1e-9)  # what all holds have in common is free


def test_few_holds_have_the_variance_that_friction_may_have() -> None:
    means = np.column_stack([[1.0, 2.0, 4.0], [5.0, 7.0, 11.0]])
    few = HoldEquations(np.array([0]), means, bound=300.0, noise=0.0)
    channel = few.channel(3)
    assert channel.counts.tolist() == [5.0, 0.0, 0.0]  # two differences, and three that one column leaves lacking
    assert channel.rows[0][-1].tolist() == [0.0, pytest.approx(np.sqrt(3 * 100.0))]
    assert few.mean(30.0) == pytest.approx(means.mean(axis=0)[None] / np.sqrt(300.0 + 10.0))


def test_pieces_of_a_hold_are_one() -> None:
    one, two = Holds([np.array([0])]), Holds([np.array([0])])
    first = Hold(1, 100, 0.0, 0.99, 100, np.array([100.0, 500.0]), np.ones(1))
    one.append(0, first, 0.01)
    two.append(0, Hold(101, 150, 1.0, 1.49, 50, np.array([50.0, 250.0]), np.ones(1)), 0.01)
    two.append(0, Hold(300, 310, 2.99, 3.09, 11, np.array([11.0, 55.0]), np.ones(1)), 0.01)
    one.add(two, 0.01)
    assert [(hold.first, hold.last, hold.samples) for hold in one.holds[0]] == [(1, 150, 150), (300, 310, 11)]
    assert one.counts.tolist() == [1]  # the second one is too short
    assert one.holds[0][0].total.tolist() == [150.0, 750.0]
    assert first.samples == 100


def test_an_actuator_without_dry_friction_keeps_all_samples() -> None:
    model = crane(None)
    log = simulate(model, twelve_holds(), model.parameters.nominal, seed=3)
    (data,) = identification_problem(model, [log]).experiments
    assert np.all(data.known)
    assert np.all(data.inside)
    assert not np.any(data.motion.qd)
    assert not np.any(data.motion.qdd)


def test_a_stop_is_calm_and_a_reversal_is_not() -> None:
    t = np.arange(1000) / 100
    position = np.where(t < 4, np.sin(1.5 * t), np.sin(6.0))[:, None]  # reverses at 1.05 and 3.14 s, rests from 4 s on
    speed = np.where(t < 4, 1.5 * np.cos(1.5 * t), 0.0)[:, None]
    noisy = position + np.random.default_rng(1).normal(0, 1e-4, position.shape)
    motion = Motion(t, position, speed, 0 * speed, np.zeros(1000, int), t >= 0, np.array([5.0]), np.ones(1, int), ())
    phases = Phases.of(noisy, motion, SpeedLimits.of(noisy, motion))
    assert not np.any(phases.calm[t < 4.5])
    assert np.all(phases.rest[t > 4.51])
    assert np.all(phases.calm[t > 4.51])


EVEN = np.arange(500) / 50


@pytest.mark.parametrize("t", [EVEN, 1e9 + EVEN, np.cumsum(np.random.default_rng(3).exponential(0.05, 500)),
                               np.delete(EVEN, np.s_[100:300]), EVEN[:1], EVEN[:0]],
                         ids=["even", "late", "uneven", "gap", "one sample", "none"])
def test_phases_are_those_of_each_window_alone(t: np.ndarray) -> None:
    rng = np.random.default_rng(len(t))
    place = np.arange(len(t))
    # sluggish, constant, always fast, unknown
    angles = np.column_stack([np.sin(place / 80) * (place < 250), 0 * t, 0.1 * place, 0 * t]).repeat(2, axis=1)[:, ::2]
    angles += [1e-3, 0.0, 1e-3, 1e-3] * rng.standard_normal(angles.shape)
    speeds = np.column_stack([np.where(place % 97 < 5, 1.0, 0.01), 0 * t, 1.0 + 0 * t, np.nan * t])
    shifts = np.array([-0.5 - 1e-9, -0.25, 0.0, 0.25, 0.5 + 1e-9])
    slow, apart = np.array([0.1, 0.1, 0.1, 0.1]), np.array([5e-3, 0.0, 5e-3, 5e-3])
    with np.errstate(invalid="ignore"), warnings.catch_warnings():
        warnings.simplefilter("ignore")  # means of no samples
        found = friction_sign._phases(t, angles, speeds, shifts, slow, apart)
    same, moving, calm = (np.zeros(angles.shape, bool) for _ in range(3))
    for i, now in enumerate(t):
        parts = [(t >= now + a) & (t < now + b) for a, b in pairwise(shifts)]
        means = np.array([angles[part].mean(axis=0) for part in parts if np.any(part)])
        fewest = min(np.count_nonzero(part) for part in parts if np.any(part))
        same[i] = np.ptp(means, axis=0) <= np.maximum(apart * np.sqrt(2 / fewest), STANDSTILL)
        moving[i] = (np.abs(speeds[i]) > slow) & ~same[i]
    for i, now in enumerate(t):
        calm[i] = ~np.any(moving[(t >= now + shifts[0]) & (t < now + shifts[-1])], axis=0)
    for made, wanted in zip(found, (moving, calm, same), strict=True):
        np.testing.assert_array_equal(made, wanted)
