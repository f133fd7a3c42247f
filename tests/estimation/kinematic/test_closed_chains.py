"""Kinematic calibration: recovery, statistics, other measurements, and what is told about data that do not fit."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hydroopt import load_machine
from hydroopt.errors import ProblemError
from hydroopt.estimation.kinematic import link_by_link
from hydroopt.estimation.kinematic.calibration import calibrate
from hydroopt.estimation.kinematic.initial_guesses import guess_unsensed
from hydroopt.estimation.kinematic.maximum_likelihood import maximum_likelihood
from hydroopt.estimation.kinematic.observability import linearise, observability, spread
from hydroopt.estimation.kinematic.problem import CalibrationProblem, calibration_problem
from hydroopt.estimation.kinematic.residuals import predicted
from hydroopt.estimation.kinematic.solution import METHODS
from hydroopt.logs.poses import Poses, joined
from hydroopt.machine.links import Note
from hydroopt.machine.machine import Machine
from hydroopt.machine.machine_file import dump_machine, read_machine
from hydroopt.machine.sensors import Sensor
from hydroopt.machine.survey import Tracker
from hydroopt.model.closed_chain import KinematicModel
from hydroopt.simulation import postures
from studies import closed_postures

PER_STAGE = 40


def without_drift(machine: Machine) -> Machine:
    return machine.model_copy(update={"stages": tuple(s.model_copy(update={"drift": 0.0}) for s in machine.stages)})


@pytest.fixture(scope="module")
def machine() -> Machine:
    return without_drift(load_machine("cat215b"))


@pytest.fixture(scope="module")
def model(machine: Machine) -> KinematicModel:
    return KinematicModel(machine)


@pytest.fixture(scope="module")
def closed(machine: Machine, model: KinematicModel) -> tuple[np.ndarray, list[str]]:
    """Joint vectors of closed chains, and their stages."""
    at = np.array(machine.fixtures[0].position)
    q = [closed_postures.random_postures(model, stage, PER_STAGE, geometry=model.parameters.nominal, fixture=at, seed=k)
         for k, stage in enumerate(machine.stages)]
    return np.concatenate(q), [stage.name for stage in machine.stages for _ in range(PER_STAGE)]


def read(model: KinematicModel, closed: tuple[np.ndarray, list[str]], seed: int | None, extra: tuple[str, ...] = (),
         name: str = "simulated") -> Poses:
    channels = [f"{model.joints[k]}.q" for k in postures.sensed_joints(model)]
    return postures.record(model, closed[0], closed[1], ["ball"] * len(closed[0]), name=name,
                           geometry=model.parameters.nominal, seed=seed, channels=[*channels, *extra])


def held(problem: CalibrationProblem) -> CalibrationProblem:
    """Without the cylinders' pins and with a base frame that points at the ball."""
    pins = {name: problem.parameters.nominal[k] for k, name in enumerate(problem.parameters.names)
            if "cylinder" in name}
    return problem.fixing(**pins, **{"ball.y": 0.0})


def off(problem: CalibrationProblem, seed: int) -> np.ndarray:
    """A start 10 % (or 3 cm) and 5° off in every free parameter."""
    rng = np.random.default_rng(seed)
    parameters = problem.parameters
    away = np.where(np.array(parameters.units) == "rad", np.radians(5),
                    np.maximum(0.1 * np.abs(parameters.nominal), 0.03))
    return parameters.nominal + rng.choice([-1, 1], len(parameters)) * away * problem.free


def test_closed_postures_close(model: KinematicModel, closed: tuple[np.ndarray, list[str]], machine: Machine) -> None:
    gap = model.over(model.closure, model.parameters.nominal, closed[0], np.array(machine.fixtures[0].position))[0]
    assert np.max(np.abs(gap)) < 1e-10


@pytest.mark.parametrize("seed", range(3))
def test_without_noise_the_truth_comes_back(model: KinematicModel, closed: tuple[np.ndarray, list[str]],
                                            machine: Machine, seed: int) -> None:
    problem = held(calibration_problem(machine, read(model, closed, None), priors=False))
    start = off(problem, seed)
    theta, q = maximum_likelihood(problem, start, guess_unsensed(problem, start))
    np.testing.assert_allclose(theta, problem.parameters.nominal, atol=1e-8)
    chain = [k for k, name in enumerate(model.joints) if name in ("stick", "boom", "swing")]
    moving = problem.layout.moving[:, chain]
    turns = np.where(moving, (q - closed[0])[:, chain], 0.0) / (2 * np.pi)
    np.testing.assert_allclose(turns, np.round(turns), atol=1e-8)


@pytest.mark.slow
def test_two_solved_geometries_without_a_calibrated_bias(model: KinematicModel, machine: Machine,
                                                         closed: tuple[np.ndarray, list[str]]) -> None:
    """A machine that differs from the file, not just a start that does."""
    names = model.parameters.names
    truth = model.parameters.nominal.copy()
    truth[names.index("boom.a")] += 0.04
    truth[names.index("stick.beta")] += np.radians(0.4)
    truth[names.index("swing.a")] -= 0.02
    fixture = np.array(machine.fixtures[0].position)
    q, good = postures.close(model, truth, closed[0], postures.sensed_joints(model), fixture)
    assert good.mean() > 0.9
    stages = [name for name, fine in zip(closed[1], good, strict=True) if fine]
    poses = postures.record(model, q[good], stages, ["ball"] * len(stages), geometry=truth, seed=None)
    for method in METHODS:
        solved = calibrate(held(calibration_problem(machine, poses, priors=False)), method)
        np.testing.assert_allclose([solved["boom.a"].value, solved["stick.beta"].value, solved["swing.a"].value],
                                   truth[[names.index(n) for n in ("boom.a", "stick.beta", "swing.a")]], atol=1e-8)


def test_derivatives_are_those_of_differences(model: KinematicModel, machine: Machine,
                                              closed: tuple[np.ndarray, list[str]]) -> None:
    extra = ("boom_cylinder.length", "stick.distance")
    tape = Sensor(channels=("stick.distance",), accuracy="5 mm")
    problem = calibration_problem(machine.model_copy(update={"sensors": (*machine.sensors, tape)}),
                                  read(model, closed, None, extra))
    theta, own = problem.start, closed[0]
    _, jacobian, by_q = problem.rows(theta, problem.angles(theta, own))
    step = 1e-6
    for k in range(len(theta)):
        high, low = theta.copy(), theta.copy()
        high[k] += step
        low[k] -= step
        slope = (problem.rows(high, problem.angles(high, own))[0] - problem.rows(low, problem.angles(low, own))[0])
        np.testing.assert_allclose(jacobian[:, :, k], slope / (2 * step), atol=2e-8)
    for k in range(own.shape[1]):
        q = problem.angles(theta, own)
        q[:, k] += step
        above = problem.rows(theta, q)[0]
        q[:, k] -= 2 * step
        np.testing.assert_allclose(by_q[:, :, k], (above - problem.rows(theta, q)[0]) / (2 * step), atol=2e-8)


def test_bound_is_the_inverse_of_the_whole_programs_information(model: KinematicModel, machine: Machine,
                                                                closed: tuple[np.ndarray, list[str]]) -> None:
    """The Schur complement of all angles, dense and brute, against the projection pose by pose."""
    few = (closed[0][::8], closed[1][::8])
    problem = held(calibration_problem(machine, read(model, few, None), priors=False))
    q = problem.angles(problem.start, few[0])
    seen = observability(problem, linearise(problem, problem.start, q))
    _, jacobian, by_q = problem.rows(problem.start, q)
    free = np.flatnonzero(problem.free)
    count, n = q.shape
    # unknowns: parameters, then all angles; loops closed by their null space
    loops = np.zeros((3 * count, len(free) + count * n))
    information = np.zeros(len(free) + count * n)
    for j in range(count):
        loops[3 * j : 3 * j + 3, : len(free)] = jacobian[j, :3][:, free]
        for k in range(n):
            place = len(free) + j * n + k
            if problem.layout.sensed[j, k]:
                information[place] = 1 / problem.angle_sigma[k] ** 2
                loops[3 * j : 3 * j + 3, place] = by_q[j, :3, k]
            elif problem.layout.moving[j, k]:
                loops[3 * j : 3 * j + 3, place] = by_q[j, :3, k]
    used = np.flatnonzero(np.any(loops != 0, axis=0))
    scale = np.where(information[used] > 0, 1 / np.sqrt(np.maximum(information[used], 1e-12)), 1.0)
    _, s, right = np.linalg.svd(loops[:, used] * scale)
    null = right[np.sum(s > 1e-10 * s[0]) :].T
    reduced = null.T @ (null * (information[used] * scale**2)[:, None])
    covariance = null @ np.linalg.inv(reduced) @ null.T
    np.testing.assert_allclose(seen.std, np.sqrt(np.diag(covariance))[: len(free)] * scale[: len(free)], rtol=1e-5)


@pytest.mark.slow
def test_scatter_is_the_bound_and_intervals_hold(model: KinematicModel, machine: Machine,
                                                 closed: tuple[np.ndarray, list[str]]) -> None:
    exact = held(calibration_problem(machine, read(model, closed, None), priors=False))
    least = observability(exact, linearise(exact, exact.start, exact.angles(exact.start, closed[0]))).std
    errors, inside = [], []
    for seed in range(20):
        solved = calibrate(held(calibration_problem(machine, read(model, closed, seed), priors=False)))
        free = solved.problem.free
        truth = solved.problem.parameters.nominal[free]
        errors.append((solved.theta[free] - truth) / least)
        inside.append((solved.ci95[free][:, 0] < truth) & (truth < solved.ci95[free][:, 1]))
    assert 0.85 < np.sqrt(np.mean(np.square(errors))) < 1.1
    assert np.mean(inside) > 0.9


def test_the_free_direction_of_the_base_is_named(model: KinematicModel, machine: Machine,
                                                 closed: tuple[np.ndarray, list[str]]) -> None:
    problem = calibration_problem(machine, read(model, closed, None), priors=False)
    problem = problem.fixing(**{n: 0.0 for n in problem.parameters.names if "cylinder" in n})
    seen = observability(problem, linearise(problem, problem.start, problem.angles(problem.start, closed[0])))
    assert seen.combinations == (("ball.y", "swing.locked.stick_moves"),)
    assert not np.isfinite(seen.std[seen.names.index("ball.y")])
    assert np.isfinite(seen.std[seen.names.index("boom.a")])


@pytest.mark.slow
def test_other_measurements_help(model: KinematicModel, machine: Machine,
                                 closed: tuple[np.ndarray, list[str]]) -> None:
    tape = Sensor(channels=("stick.distance",), accuracy="5 mm")
    stated = machine.model_copy(update={"sensors": (*machine.sensors, tape)}).with_values({"boom.a": 5.185})
    std = []
    for extra in ((), ("stick.distance",), ("boom.q", "stick.q")):
        poses = read(model, closed, None, extra)
        problem = held(calibration_problem(stated, poses, priors=False))
        solved = calibrate(problem)
        np.testing.assert_allclose(solved["boom.a"].value, 5.18, atol=1e-8)
        std.append(solved.std[problem.parameters.index("boom.a")])
    assert std[1] < 0.9 * std[0]
    assert std[2] < 0.9 * std[0]


def test_triangles_come_from_angles_and_lengths(machine: Machine, model: KinematicModel) -> None:
    """Pins 2 cm off: lengths are reproduced, and what a planar triangle shows, its sides, comes back."""
    truth = model.parameters.nominal.copy()
    rng = np.random.default_rng(0)
    # the boom's axis is the y of the swing's frame and the z of its own
    lateral = {"boom_cylinder.barrel.y", "boom_cylinder.rod.z", "stick_cylinder.barrel.z", "stick_cylinder.rod.z"}
    pins = [k for k, name in enumerate(model.parameters.names) if "cylinder" in name and name not in lateral]
    truth[pins] += rng.uniform(-0.02, 0.02, len(pins))
    q = np.zeros((60, len(model.joints)))
    for name in ("boom", "stick"):
        q[:, model.joints.index(name)] = rng.uniform(*machine.link(name).joint.range, len(q))
    channels = ["boom.q", "stick.q", "boom_cylinder.length", "stick_cylinder.length"]
    poses = postures.record(model, q, ["angles"] * 60, [""] * 60, geometry=truth, channels=channels, seed=None)
    problem = calibration_problem(machine, poses, priors=False)
    solved = calibrate(problem.fixing(**{name: problem.start[k] for k, name in enumerate(problem.parameters.names)
                                         if name in lateral or "cylinder" not in name}))
    assert solved.fit["nominal"]["boom_cylinder.length"].rms > 1e-3
    assert solved.fit["train"]["boom_cylinder.length"].rms < 1e-9
    start = model.parameters.names.index("boom_cylinder.rod.x")
    side = np.hypot(*solved.theta[start : start + 2])
    np.testing.assert_allclose(side, np.hypot(*truth[start : start + 2]), atol=1e-7)
    dead = model.parameters.names.index("stick_cylinder.dead_length")
    assert solved.theta[dead] == pytest.approx(truth[dead], abs=1e-8)
    assert "boom_cylinder.rod.x" in {name for group in solved.observability.combinations for name in group}


def test_tracked_points_and_an_unknown_tracker(machine: Machine) -> None:
    tracked = machine.model_copy(update={
        "tracker": Tracker(position=(1.0, 2.0, 0.5), orientation=(0.1, -0.2, 0.3)), "fixtures": (),
        "sensors": (*machine.sensors, Sensor(channels=("tip.x", "tip.y", "tip.z"), accuracy="1 mm"))})
    notes = dict(machine.notes) | {"tracker.position": Note(sigma=1.0), "tracker.orientation": Note(sigma=0.5)}
    model = KinematicModel(tracked.model_copy(update={"notes": notes}))
    truth = model.parameters.nominal.copy()
    for name, change in (("tracker.x", 0.3), ("tracker.yaw", -0.2), ("tracker.roll", 0.1), ("boom.a", 0.03)):
        truth[model.parameters.names.index(name)] += change
    low, high = model.ranges.T
    q = np.random.default_rng(0).uniform(low, high, (80, len(low)))
    everything = [f"{name}.q" for name in model.joints if name != "grapple_swing"]
    q[:, model.joints.index("grapple_swing")] = np.radians(42.9)
    stage = tracked.stages[0].model_copy(update={"name": "free", "moves": (), "locked": {
        "grapple_swing": np.radians(42.9)}})
    there = model.machine.model_copy(update={"stages": (stage,)})
    poses = postures.record(model, q, ["free"] * 80, [""] * 80, geometry=truth, seed=None,
                            channels=[*everything, "tip.x", "tip.y", "tip.z"])
    problem = calibration_problem(there, poses, priors=False)
    pins = {n: problem.parameters.nominal[k] for k, n in enumerate(problem.parameters.names) if "cylinder" in n}
    solved = calibrate(problem.fixing(**pins))
    assert solved.fit["nominal"]["tip"].rms > 0.05
    assert solved.fit["train"]["tip"].rms < 1e-8
    np.testing.assert_allclose(solved["boom.a"].value, 5.21, atol=1e-7)
    np.testing.assert_allclose(solved["tracker.x"].value, truth[model.parameters.names.index("tracker.x")], atol=1e-6)


@pytest.mark.slow
def test_drift_is_found_and_would_hurt(model: KinematicModel, machine: Machine) -> None:
    """The stick creeps while frozen, through two stages; the file says that it may."""
    fixture, geometry = np.array(machine.fixtures[0].position), model.parameters.nominal
    q, labels, crept = [], [], 0.0
    for k, stage in enumerate(machine.stages):
        part = closed_postures.random_postures(model, stage, PER_STAGE, geometry=geometry, fixture=fixture, seed=k)
        if "stick" in stage.locked:
            part[:, model.joints.index("stick")] += crept + np.radians(0.3) * np.linspace(0, 1, len(part))
            crept += np.radians(0.3)
            part, good = postures.close(model, geometry, part, postures.sensed_joints(model), fixture)
            assert good.all()
        q.append(part)
        labels += [stage.name] * len(part)
    poses = postures.record(model, np.concatenate(q), labels, ["ball"] * len(labels), geometry=geometry, seed=None)
    creeping = machine.model_copy(update={"stages": tuple(
        s.model_copy(update={"drift": np.radians(0.3)}) for s in machine.stages)})
    ignored = calibrate(held(calibration_problem(machine, poses, priors=False)))
    known = calibrate(held(calibration_problem(creeping, poses, priors=False)))
    assert np.degrees(known["stick.drift.boom_moves"].value) == pytest.approx(0.3, abs=0.01)
    late = known.problem.parameters.index("stick.drift.swing_moves")
    assert abs(np.degrees(known.theta[late]) - 0.3) < 2 * np.degrees(known.std[late])
    assert abs(known["swing.a"].value - 0.34) < 0.003 < abs(ignored["swing.a"].value - 0.34)


def test_compliance_is_what_gravity_bends(machine: Machine) -> None:
    """The boom gives way: a torque of its own, computed here from the links' moments, against the model's angles."""
    machine = machine.model_copy(update={"cylinders": tuple(each.model_copy(update={
        end: getattr(each, end).model_copy(update={"body": None}) for end in ("barrel", "rod")})
        for each in machine.cylinders)})
    soft = machine.model_copy(update={"links": tuple(
        link.model_copy(update={"joint": link.joint.model_copy(update={"compliance": 1e-7})}) if link.name == "boom"
        else link for link in machine.links)})
    stiff, model = KinematicModel(machine), KinematicModel(soft)
    q = np.zeros((1, len(model.joints)))
    q[0, 1:3] = np.radians([-20, 70])
    geometry = stiff.parameters.nominal
    bodies = {link.name: link.body for link in machine.links}
    c, s = np.cos(q[0, 1]), np.sin(q[0, 1])
    boom_reach = bodies["boom"].com[0] * c - bodies["boom"].com[1] * s
    both = q[0, 1] + q[0, 2]
    stick_reach = 5.18 * c + bodies["stick"].com[0] * np.cos(both) - bodies["stick"].com[1] * np.sin(both)
    # z of the boom points left, so gravity turns it by +m·g·reach
    torque = machine.gravity * (bodies["boom"].m * boom_reach + bodies["stick"].m * stick_reach)
    bent = q.copy()
    bent[0, 1] += 1e-7 * torque
    np.testing.assert_allclose(model.over(model.tip, geometry, q)[0], stiff.over(stiff.tip, geometry, bent)[0],
                               atol=1e-9)


@pytest.mark.parametrize("loss", ["huber", "student_t"])
@pytest.mark.slow
def test_robust_losses_bear_a_few_wild_poses(model: KinematicModel, machine: Machine,
                                             closed: tuple[np.ndarray, list[str]], loss: str) -> None:
    poses = read(model, closed, 0)
    channels = {name: x.copy() for name, x in poses.channels.items()}
    channels["yoke.q"][::15] += np.radians(2.0)
    wild = Poses(name="wild", stage=poses.stage, fixture=poses.fixture, channels=channels)
    problem = held(calibration_problem(machine, wild, priors=False))
    plain, robust = calibrate(problem), calibrate(problem.with_loss(loss))
    free = problem.free
    error = [np.linalg.norm((c.theta - problem.parameters.nominal)[free] / c.std[free]) for c in (plain, robust)]
    assert error[1] < 0.7 * np.linalg.norm((plain.theta - problem.parameters.nominal)[free] / robust.std[free])
    named = {int(s.poses.argmax()) for s in robust.suspects if s.kind == "pose"}
    assert set(range(0, len(poses), 15)) <= named | {int(i) for s in robust.suspects for i in np.flatnonzero(s.poses)}


def test_a_slipped_sensor_is_named(model: KinematicModel, machine: Machine,
                                   closed: tuple[np.ndarray, list[str]]) -> None:
    poses = read(model, closed, 0)
    channels = {name: x.copy() for name, x in poses.channels.items()}
    channels["yoke.q"][poses.stage == "boom_moves"] += np.radians(1.0)
    solved = calibrate(held(calibration_problem(machine, Poses(
        name="slipped", stage=poses.stage, fixture=poses.fixture, channels=channels), priors=True)))
    named = [(s.kind, s.name) for s in solved.suspects]
    assert ("offset", "yoke") in named or ("stage", "boom_moves") in named, named


@pytest.mark.slow
def test_sound_data_raise_no_alarm(model: KinematicModel, machine: Machine,
                                   closed: tuple[np.ndarray, list[str]]) -> None:
    for seed in range(5):
        solved = calibrate(held(calibration_problem(machine, read(model, closed, seed), priors=False)))
        assert not solved.suspects, [s.diagnostic.text for s in solved.suspects]
        assert solved.noise_scale == pytest.approx(1, abs=0.2)


@pytest.mark.slow
def test_a_bad_stretch_is_named_by_row_and_left_out(model: KinematicModel, machine: Machine,
                                                    closed: tuple[np.ndarray, list[str]]) -> None:
    poses = read(model, closed, 0)
    channels = {name: x.copy() for name, x in poses.channels.items()}
    rng = np.random.default_rng(0)
    bad = slice(PER_STAGE + 10, PER_STAGE + 20)
    channels["grapple.q"][bad] += rng.choice([-1, 1], 10) * np.radians(1.5)
    problem = held(calibration_problem(machine, Poses(name="bad", stage=poses.stage, fixture=poses.fixture,
                                                      channels=channels), priors=False))
    solved = calibrate(problem)
    stretches = [s for s in solved.suspects if s.kind == "stretch"]
    assert stretches, [s.diagnostic.text for s in solved.suspects]
    assert stretches[0].name == "boom_moves"
    caught = np.any([s.poses for s in solved.suspects if s.kind in ("stretch", "pose")], axis=0)
    assert caught[bad].sum() >= 7
    assert caught.sum() <= 14
    again = calibrate(problem.without(caught))
    assert len(again.problem.poses) == len(poses) - caught.sum()
    assert again.noise_scale < 0.7 * solved.noise_scale


def test_held_out_poses_are_predicted(model: KinematicModel, machine: Machine,
                                      closed: tuple[np.ndarray, list[str]]) -> None:
    poses = read(model, closed, 0)
    even = np.arange(len(poses)) % 2 == 0
    solved = calibrate(held(calibration_problem(machine, poses.select(even), poses.select(~even), priors=False)))
    train, unseen = solved.fit["train"]["gap"], solved.fit["validation"]["gap"]
    assert train.rms < unseen.rms < 2 * train.rms
    assert unseen.vaf > 0.999


@pytest.mark.slow
def test_several_starts_say_whether_the_answer_is_one(model: KinematicModel, machine: Machine,
                                                      closed: tuple[np.ndarray, list[str]]) -> None:
    problem = held(calibration_problem(machine, read(model, closed, 0), priors=False))
    unique = calibrate(problem, starts=3).uniqueness
    assert (unique.starts, unique.same, unique.failed, unique.worse) == (3, 3, 0, 0)
    assert str(unique) == "3 of 3 initial guesses lead to the same solution"
    assert not calibrate(problem).uniqueness.examined


def test_the_calibrated_machine_is_a_machine_file(model: KinematicModel, machine: Machine,
                                                  closed: tuple[np.ndarray, list[str]]) -> None:
    solved = calibrate(held(calibration_problem(machine, read(model, closed, 0), priors=False)))
    made = solved.machine
    assert made.link("boom").joint.a == pytest.approx(solved["boom.a"].value, abs=1e-12)
    assert made.fixtures[0].position[0] == pytest.approx(solved["ball.x"].value, abs=1e-12)
    assert made.notes["boom.joint.a"].sigma == pytest.approx(
        solved.std[solved.problem.parameters.index("boom.a")])
    assert read_machine(dump_machine(made)) == made


def test_tip_uncertainty_is_the_scatter_of_the_tip(model: KinematicModel, machine: Machine,
                                                   closed: tuple[np.ndarray, list[str]]) -> None:
    problem = held(calibration_problem(machine, read(model, closed, None), priors=False))
    seen = observability(problem, linearise(problem, problem.start, problem.angles(problem.start, closed[0])))
    at = closed[0][:3]
    by_geometry = model.over(model.observed_jacobians, model.parameters.nominal, at, np.zeros(3))[1][:, :3]
    stated = spread(model, seen, by_geometry)
    rng = np.random.default_rng(0)
    draws = rng.multivariate_normal(np.zeros(len(seen.names)), seen.covariance, 4000, method="eigh")
    own = [model.parameters.names.index(name) for name in seen.names if name in model.parameters.names]
    columns = [k for k, name in enumerate(seen.names) if name in model.parameters.names]
    tips = []
    for draw in draws:
        g = model.parameters.nominal.copy()
        g[own] += draw[columns]
        tips.append(np.asarray(model.over(model.tip, g, at)[0][:, :, 0]))
    scatter = np.sqrt(np.sum(np.var(tips, axis=0), axis=1))
    np.testing.assert_allclose(stated, scatter, rtol=0.05)


def test_bad_poses_are_refused(model: KinematicModel, machine: Machine,
                               closed: tuple[np.ndarray, list[str]]) -> None:
    poses = read(model, closed, 0)

    def table(**changed: object) -> Poses:
        return Poses(**{"name": "bad", "stage": poses.stage, "fixture": poses.fixture,
                        "channels": poses.channels} | changed)  # type: ignore[arg-type]

    with pytest.raises(ProblemError, match="no fixture 'bull'"):
        calibration_problem(machine, table(fixture=np.full(len(poses), "bull")))
    with pytest.raises(ProblemError, match="the machine has no stage 'elsewhere'"):
        calibration_problem(machine, table(stage=np.full(len(poses), "elsewhere")))
    with pytest.raises(ProblemError, match=r"no channel 'arm\.q'"):
        calibration_problem(machine, table(channels={**poses.channels, "arm.q": poses.channels["yoke.q"]}))
    with pytest.raises(ProblemError, match=r"the accuracy of 'stick\.distance' is not stated"):
        calibration_problem(machine, table(channels={**poses.channels, "stick.distance": np.ones(len(poses))}))
    with pytest.raises(ProblemError, match="did you mean"):
        calibration_problem(machine, poses, fixed={"bom.a": 1.0})
    with pytest.raises(ProblemError, match="equations of all poses are too few"):
        calibrate(held(calibration_problem(machine, poses.select(np.arange(3)), priors=False)))
    with pytest.raises(ProblemError, match="not a method"):
        calibrate(held(calibration_problem(machine, poses)), "guessing")
    assert len(joined([poses.select([0, 1]), poses.select([2])])) == 3


def changed(poses: Poses, **channels: np.ndarray) -> Poses:
    return Poses(name="odd", stage=poses.stage, fixture=poses.fixture, channels={**poses.channels, **channels})


def test_degrees_given_as_radians_are_recognised(model: KinematicModel, machine: Machine,
                                                 closed: tuple[np.ndarray, list[str]]) -> None:
    poses = read(model, closed, 0)
    odd = changed(poses, **{"yoke.q": np.degrees(poses.channels["yoke.q"])})
    with pytest.raises(ProblemError, match=r"values of 'yoke\.q' seem to be degrees given as radians"):
        calibrate(held(calibration_problem(machine, odd)))


def test_exchanged_columns_are_recognised(model: KinematicModel, machine: Machine,
                                          closed: tuple[np.ndarray, list[str]]) -> None:
    poses = read(model, closed, 0)
    odd = changed(poses, **{"yoke.q": poses.channels["grapple.q"], "grapple.q": poses.channels["yoke.q"]})
    with pytest.raises(ProblemError, match=r"'grapple\.q' and 'yoke\.q' seem to be exchanged"):
        calibrate(held(calibration_problem(machine, odd)))


@pytest.mark.parametrize(("factor", "words"), [
    (-1.0, "have the other sign"), (180 / np.pi, "be degrees given as radians"),
    (np.pi / 180, "be radians given as degrees")])
def test_another_sign_or_unit_of_all_angles_is_recognised(arm: CalibrationProblem, factor: float, words: str) -> None:
    angles = [name for name in arm.poses.channels if name.endswith(".q")]
    odd = changed(arm.poses, **{name: factor * arm.poses.channels[name] for name in angles})
    with pytest.raises(ProblemError, match=rf"values of '{angles[0]}', .* seem to {words}"):
        calibrate(calibration_problem(arm.model.machine, odd))


def test_a_start_far_off_is_no_exchange(model: KinematicModel, machine: Machine,
                                        closed: tuple[np.ndarray, list[str]]) -> None:
    far = machine.model_copy(update={"links": tuple(
        link.model_copy(update={"joint": link.joint.model_copy(update={"a": 1.1 * link.joint.a})})
        for link in machine.links)})
    solved = calibrate(held(calibration_problem(far, read(model, closed, None), priors=False)))
    assert solved["boom.a"].value == pytest.approx(5.18, abs=1e-8)


def test_no_length_scale_is_refused(model: KinematicModel, machine: Machine,
                                    closed: tuple[np.ndarray, list[str]]) -> None:
    notes = dict(machine.notes)
    assert machine.calibrator is not None
    for link in (*machine.links, *machine.calibrator.links):
        notes |= {f"{link.name}.joint.a": Note(sigma=0.1), f"{link.name}.joint.d": Note(sigma=0.1)}
    loose = machine.model_copy(update={"notes": notes})
    with pytest.raises(ProblemError, match="no length scale"):
        calibrate(calibration_problem(loose, read(model, closed, 1), priors=False))


def test_a_fixture_that_moved_is_named(model: KinematicModel, machine: Machine,
                                       closed: tuple[np.ndarray, list[str]]) -> None:
    """The ball is pushed 30 mm along the machine in the middle of the last stage."""
    q = closed[0].copy()
    late = slice(2 * PER_STAGE + PER_STAGE // 2, None)
    moved = np.array(machine.fixtures[0].position) + np.array([0.03, 0.0, 0.0])
    q[late], good = postures.close(model, model.parameters.nominal, q[late], postures.sensed_joints(model), moved)
    assert good.all()
    solved = calibrate(held(calibration_problem(machine, read(model, (q, closed[1]), 0), priors=False)))
    named = [s for s in solved.suspects if s.kind == "fixture"]
    assert named, [s.diagnostic.text for s in solved.suspects]
    assert named[0].name == "ball"
    assert abs(int(np.argmax(named[0].poses)) - (2 * PER_STAGE + PER_STAGE // 2)) <= 6


def test_poses_in_one_plane_are_named(model: KinematicModel, machine: Machine) -> None:
    """Only parallel axes turn: the stick, sweeping, with the yoke and forearm of a calibrator that starts straight."""
    stage = machine.stages[0].model_copy(update={"locked": {**machine.stages[0].locked, "grapple_swing": 0.0}})
    flat = machine.model_copy(update={"stages": (stage,)})
    assert flat.calibrator is not None
    links = tuple(link.model_copy(update={"joint": link.joint.model_copy(update={
        "alpha": {"grapple_swing": -np.pi / 2, "grapple": np.pi / 2}.get(link.name, 0.0), "d": 0.0,
        "a": {"yoke": 2.0, "upper_arm": 2.0, "forearm": 1.5}.get(link.name, 0.0)})}) for link in flat.calibrator.links)
    flat = flat.model_copy(update={"calibrator": flat.calibrator.model_copy(update={"links": links})})
    planar = KinematicModel(flat)
    fixture = np.array([2.16, -0.11, -0.84])
    q = np.zeros((30, len(planar.joints)))
    q[:, 1:3] = np.column_stack([np.full(30, np.radians(-27.8)), np.radians(np.linspace(60, 110, 30))])
    q[:, 5:] = np.radians([20, 30, -40])
    free = [planar.joints.index(name) for name in ("yoke", "upper_arm", "forearm")]
    q, good = postures.close(planar, planar.parameters.nominal, q, free, fixture)
    assert good.sum() > 20
    flat = flat.model_copy(update={"fixtures": (flat.fixtures[0].model_copy(update={
        "position": tuple(fixture), "play": 0.001}),)})
    planar = KinematicModel(flat)
    poses = postures.record(planar, q[good], ["stick_moves"] * good.sum(), ["ball"] * good.sum(),
                            geometry=planar.parameters.nominal, seed=0)
    solved = calibrate(calibration_problem(flat, poses))
    assert [s.kind for s in solved.suspects][:1] == ["plane"]


@pytest.fixture(scope="module")
def arm() -> CalibrationProblem:
    """Noise-free poses of the bundled arm in its two sockets at three places."""
    machine = load_machine("panda_mukca")
    model = KinematicModel(machine)
    rng = np.random.default_rng(0)
    middle = np.array([0.2, 0.4, -0.1, -2.2, 0.1, 2.5, 0.6])
    q, stages, fixtures = [], [], []
    truth = arm_truth(model)
    for place in range(3):
        first = np.asarray(model.tip(truth, middle + rng.normal(0, 0.3, 7))).ravel()
        for hole, at in (("hole_0", first), ("hole_1", first + np.array([0.03, 0.04, 0.0]))):
            start = middle + rng.normal(0, 0.5, (60, 7))
            closed, good = postures.close(model, truth, start, range(7), at)
            q.append(closed[good])
            stages += [f"place_{place}"] * good.sum()
            fixtures += [hole] * good.sum()
    poses = postures.record(model, np.concatenate(q), stages, fixtures, geometry=truth, seed=None)
    return calibration_problem(machine, poses, priors=False)


def arm_truth(model: KinematicModel) -> np.ndarray:
    """The nominal arm, whose joints give way a little: away from the bound at zero."""
    soft = np.char.endswith(model.parameters.names, ".compliance")
    return np.where(soft, 2e-5, model.parameters.nominal)


def recovered(arm: CalibrationProblem, method: str) -> np.ndarray:
    """Errors of the arm's geometry, from a start 10 % (or 5 mm) and 5° off."""
    rng = np.random.default_rng(1)
    parameters = arm.parameters
    away = np.where(np.array(parameters.units) == "rad", np.radians(5),
                    np.maximum(0.1 * np.abs(parameters.nominal), 0.005))
    away[np.char.endswith(parameters.names, ".compliance")] = 1e-5
    away[np.char.startswith(parameters.names, "hole")] = 0.02
    start = np.maximum(parameters.nominal + rng.choice([-1, 1], len(parameters)) * away * arm.free, parameters.lower)
    if method == "hierarchical":  # which knows no bounds
        arm = replace(arm, parameters=replace(parameters, lower=np.full(len(parameters), -np.inf)))
    theta, *_ = (maximum_likelihood if method == "joint" else link_by_link.sequential_least_squares)(
        arm, start, arm.layout.reading)
    return np.abs(theta[: len(arm.model.parameters)] - arm_truth(arm.model))


@pytest.mark.slow
@pytest.mark.parametrize("method", METHODS)
def test_the_bundled_arm_comes_back(arm: CalibrationProblem, method: str) -> None:
    assert np.max(recovered(arm, method)) < 1e-8


@pytest.mark.slow
def test_play_in_a_joint_is_named(model: KinematicModel, machine: Machine) -> None:
    """The forearm's resolver lags by 1.5° on the side from which it comes."""
    stage, fixture = machine.stages[0], np.array(machine.fixtures[0].position)
    path = np.radians(90 + 40 * np.sin(np.linspace(0, 6 * np.pi, 90)))[:, None]
    q = closed_postures.sweep(model, stage, path, geometry=model.parameters.nominal, fixture=fixture)
    rest = [closed_postures.random_postures(model, s, PER_STAGE, geometry=model.parameters.nominal, fixture=fixture,
                                            seed=k) for k, s in enumerate(machine.stages[1:])]
    labels = [stage.name] * len(q) + [s.name for s in machine.stages[1:] for _ in range(PER_STAGE)]
    poses = read(model, (np.concatenate([q, *rest]), labels), 0)
    forearm = poses.channels["forearm.q"]
    going = np.sign(np.diff(forearm, prepend=forearm[0]))
    odd = changed(poses, **{"forearm.q": forearm + np.where(poses.stage == stage.name, going, 0) * np.radians(0.75)})
    solved = calibrate(held(calibration_problem(machine, odd, priors=False)))
    texts = [s.diagnostic.text for s in solved.suspects]
    assert ("backlash", "forearm") in [(s.kind, s.name) for s in solved.suspects], texts


def test_held_out_poses_of_one_stage_take_its_locked_angles(model: KinematicModel, machine: Machine,
                                                            closed: tuple[np.ndarray, list[str]]) -> None:
    """Alone, the boom's stage would give the swing's angle a name of its own and fit it to what it should predict."""
    poses = read(model, closed, 0)
    last = (poses.stage == "boom_moves") & (np.arange(len(poses)) % 4 == 0)
    solved = calibrate(held(calibration_problem(machine, poses.select(~last), poses.select(last), priors=False)))
    fresh, theta, _ = predicted(solved.problem, solved.theta, poses.select(last))
    assert not np.any(fresh.free)
    late = fresh.parameters.index("swing.locked.boom_moves")
    assert theta[late] == pytest.approx(solved["swing.locked.stick_moves"].value, abs=1e-12)
