from __future__ import annotations

from itertools import combinations, product

import numpy as np
import pytest

import hydroopt
from fixtures.sheets import says_what_people_keep
from fixtures.tiers import tiered
from hydroopt.errors import ProblemError
from hydroopt.estimation.kinematic.maximum_likelihood import maximum_likelihood
from hydroopt.estimation.kinematic.problem import calibration_problem
from hydroopt.excitation.selection.candidate_postures import candidate_postures, in_passes
from hydroopt.excitation.selection.exchange import PASSES, fedorov_exchange
from hydroopt.excitation.selection.pose_problem import expected_uncertainty, pose_problem
from hydroopt.logs.poses import read_poses
from hydroopt.machine.machine import Machine
from hydroopt.machine.machine_file import load_machine
from hydroopt.machine.sensors import Sensor
from hydroopt.machine.survey import Tracker
from hydroopt.model.closed_chain import KinematicModel
from hydroopt.results.answer import load
from hydroopt.simulation import postures

WHOLE = load_machine("cat215b")
CREEPING = WHOLE.model_copy(update={"sensors": tuple(sensor for sensor in WHOLE.sensors
                                                     if "boom_cylinder.length" not in sensor.channels)})
"""As in the thesis: only the calibrator's joints are read."""
CAT = CREEPING.model_copy(update={"stages": tuple(stage.model_copy(update={"drift": 0.0})
                                                  for stage in CREEPING.stages)})
MODEL = KinematicModel(CAT)
FIXTURE = np.array(CAT.fixtures[0].position)
NOMINAL = MODEL.parameters.nominal
GEOMETRY = dict(zip(MODEL.parameters.names, map(float, NOMINAL), strict=True))
PINS = {name: value for name, value in GEOMETRY.items() if "cylinder" in name}
FIXED = {"ball.y": 0.0, **PINS}
ONE = FIXED | {name: value for name, value in GEOMETRY.items() if name.startswith(("swing", "boom"))} | {
    "ball.x": FIXTURE[0], "ball.z": FIXTURE[2], "swing.locked.stick_moves": 0.0, "boom.locked.stick_moves": -0.485}
"""Leaves the stick, and the grapple's swing behind it."""
STAGES = [stage.name for stage in CAT.stages]


def plan_poses(machine, count, *, candidates, seed=0, **options):
    return fedorov_exchange(pose_problem(machine, count, **options), candidates=candidates, seed=seed)


@pytest.fixture(scope="module")
def plan():
    return plan_poses(CAT, 15, candidates=200, fixed=FIXED)


def log_det(seen):
    return np.linalg.slogdet((seen.information + seen.prior) * np.outer(seen.scale, seen.scale))[1]


def with_strokes(*changes):
    """The excavator with other cylinders."""
    return CAT.model_copy(update={"cylinders": tuple(
        cylinder.model_copy(update=change) for cylinder, change in zip(CAT.cylinders, changes, strict=True))})


def informed(plan, **options):
    return expected_uncertainty(plan.machine, plan.q, plan.stage, plan.fixture, **options)


@pytest.mark.slow
def test_plan_beats_random_choices(plan):
    assert log_det(informed(plan, fixed=FIXED)) == pytest.approx(plan.log_det, abs=1e-3)
    assert list(plan.stage) == np.repeat(STAGES, 15).tolist()
    for seed in range(50):  # that keep the same reserves: others may tell more
        rng = np.random.default_rng(seed)
        q = np.concatenate([candidate_postures(plan.problem, group, 15, rng)[0] for group in plan.problem.groups])
        seen = expected_uncertainty(CAT, q, plan.stage, plan.fixture, fixed=FIXED)
        assert log_det(seen) < plan.log_det
        assert np.sum((seen.std / seen.scale) ** 2) > np.sum((plan.std / seen.scale) ** 2)


@pytest.mark.parametrize(("focus", "seed"), tiered(product(((), ("stick.a", "stick.beta")), (0, 1, 2)),
                                                  lambda focus, seed: seed == len(focus)))
@pytest.mark.slow
def test_plan_is_the_best_of_all_subsets(focus, seed):
    size, count = 10, 4
    options = {"stages": ["stick_moves"], "candidates": size, "fixed": ONE, "focus": focus, "seed": seed}
    all_of_them = plan_poses(CAT, size, **options)
    one = [expected_uncertainty(CAT, q[None], all_of_them.stage[:1], all_of_them.fixture[:1], fixed=ONE)
           for q in all_of_them.q]
    scale = one[0].scale
    places = [one[0].names.index(name) for name in focus]

    def criterion(subset):
        scaled = sum(one[k].information for k in subset) * np.outer(scale, scale)
        return np.trace(np.linalg.inv(scaled)[np.ix_(places, places)]) if focus else -np.linalg.slogdet(scaled)[1]

    best = min(combinations(range(size), count), key=criterion)
    np.testing.assert_array_equal(plan_poses(CAT, count, **options).q, all_of_them.q[list(best)])


@pytest.mark.slow
def test_poses_close_within_limits_and_strokes(plan):
    short = with_strokes({"stroke": 0.9}, {"dead_length": 2.2, "stroke": 0.7})
    low, high = MODEL.ranges.T
    for machine, each in ((CAT, plan), (short, plan_poses(short, 15, candidates=200, fixed=FIXED))):
        gap = MODEL.over(MODEL.closure, NOMINAL, each.q, FIXTURE)[0]
        assert np.max(np.abs(gap)) < 1e-9
        assert np.all((each.q >= low) & (each.q <= high))
        for k, cylinder in enumerate(machine.cylinders):
            stroke = each.lengths[:, k] - cylinder.dead_length
            assert np.all((stroke >= 0) & (stroke <= cylinder.stroke))
        for stage in machine.stages:
            rows = each.stage == stage.name
            for name, angle in stage.locked.items():
                np.testing.assert_array_equal(each.q[rows, MODEL.joints.index(name)], angle)
            assert np.all(np.diff(each.q[rows, MODEL.joints.index(stage.moves[0])]) >= 0), "driven back and forth"
    assert np.ptp(each.lengths[:, 1]) < 0.7 < np.ptp(plan.lengths[:, 1])


@pytest.mark.slow
def test_std_is_that_of_finite_differences(plan):
    """Information of each pose's gap, AᵀPA with P = S⁻¹ − S⁻¹b(bᵀS⁻¹b)⁻¹bᵀS⁻¹, b the moving joint's column."""
    names, step, sigma = plan.names, 1e-6, CAT.sensor("yoke.q").std
    own = [k for k, name in enumerate(MODEL.parameters.names) if name in names]
    information = np.zeros((len(names), len(names)))

    def slopes(at, which):
        """Of the gap by the geometry, the angles or the ball: argument `which`."""
        changed = [[x + sign * step * e if k == which else x for k, x in enumerate(at)]
                   for e in np.eye(len(at[which])) for sign in (1, -1)]
        gaps = np.array([np.asarray(MODEL.closure(*arguments)).ravel() for arguments in changed])
        return (gaps[::2] - gaps[1::2]).T / (2 * step)

    for q, stage in zip(plan.q, plan.stage, strict=True):
        by_g, by_q, by_ball = (slopes((NOMINAL, q, FIXTURE), which) for which in range(3))
        a = np.zeros((3, len(names)))
        a[:, [names.index(MODEL.parameters.names[k]) for k in own]] = by_g[:, own]
        a[:, [names.index("ball.x"), names.index("ball.z")]] = by_ball[:, [0, 2]]
        for k, name in enumerate(names):  # an angle holds from the stage where it was locked until its joint moves
            joint_name, kind, since = (*name.split("."), "")[:3]
            moved = [s.name for s in CAT.stages if joint_name in s.moves]
            if kind == "locked" and STAGES.index(since) <= STAGES.index(stage) and not any(
                    STAGES.index(since) < STAGES.index(m) <= STAGES.index(stage) for m in moved):
                a[:, k] += by_q[:, MODEL.joints.index(joint_name)]
        weight = np.linalg.inv(sigma**2 * by_q[:, 4:] @ by_q[:, 4:].T)
        b = weight @ by_q[:, STAGES[::-1].index(stage)]
        information += a.T @ (weight - np.outer(b, b) / (by_q[:, STAGES[::-1].index(stage)] @ b)) @ a
    np.testing.assert_allclose(plan.std, np.sqrt(np.diag(np.linalg.inv(information))), rtol=1e-3)


@pytest.mark.slow
def test_std_is_the_scatter_of_the_joint_estimator():
    plan, errors = plan_poses(CAT, 20, candidates=200, fixed=FIXED), []
    for seed in range(30):
        poses = postures.record(MODEL, plan.q, plan.stage, plan.fixture, geometry=NOMINAL, seed=seed)
        problem = calibration_problem(CAT, poses, fixed=FIXED, priors=False)
        theta = maximum_likelihood(problem, problem.start, plan.q)[0]
        errors.append(((theta - problem.parameters.nominal)[problem.free]) / plan.std)
    assert np.sqrt(np.mean(np.square(errors))) == pytest.approx(1, rel=0.1)
    np.testing.assert_allclose(np.sqrt(np.mean(np.square(errors), axis=0)), 1, atol=0.4)  # ± 3 / √(2·30)


@pytest.mark.slow
def test_same_seed_same_plan(plan):
    again, other = (plan_poses(CAT, 15, candidates=200, fixed=FIXED, seed=seed) for seed in (0, 1))
    np.testing.assert_array_equal(plan.q, again.q)
    assert again.sheet() == plan.sheet()
    assert not np.array_equal(plan.q, other.q)


@pytest.mark.slow
def test_what_no_pose_identifies_does_not_matter(plan):
    """The ball's y with the locked swing leaves the choice as it is; no reading touches the pins."""
    everything = plan_poses(CAT, 15, candidates=60)
    assert {name for name, value in zip(everything.names, everything.std, strict=True) if np.isinf(value)} > {*PINS}
    free = plan_poses(CAT, 15, candidates=200, fixed=PINS)
    np.testing.assert_array_equal(free.q, plan.q)
    std = dict(zip(free.names, free.std, strict=True))
    blind = {name for name, value in std.items() if np.isinf(value)}
    assert blind == {"ball.y", "swing.locked.stick_moves"}
    for name in ("swing.a", "boom.a", "boom.d", "ball.x"):
        assert std[name] == pytest.approx(plan.std[plan.names.index(name)], rel=1e-6)
    assert free.observability.condition_number > 1
    assert free.observability.noise_amplification_index > 0


def test_focus_pays_for_its_parameters(plan):
    focus = ("swing.a", "boom.d")
    sharp = plan_poses(CAT, 15, candidates=200, fixed=FIXED, focus=focus)
    assert sharp.log_det < plan.log_det
    scale = informed(plan, fixed=FIXED).scale
    places = [plan.names.index(name) for name in focus]
    assert np.sum((sharp.std / scale)[places] ** 2) < np.sum((plan.std / scale)[places] ** 2)


def test_priors_count_if_wanted():
    plan = plan_poses(CAT, 5, candidates=100, priors=True)
    seen = informed(plan, priors=True)
    assert np.all(plan.std**2 * np.diag(seen.prior) <= 1 + 1e-9)
    np.testing.assert_array_equal(plan.std, seen.std)


@pytest.mark.slow
def test_drift_is_separated_from_motion_by_driving_out_and_back(plan):
    creeping = plan_poses(CREEPING, 15, candidates=200, fixed=FIXED)
    ways = []
    for stage in CREEPING.stages:
        angle = creeping.q[creeping.stage == stage.name, MODEL.joints.index(stage.moves[0])]
        ways.append(1 + int(np.sum(np.diff(np.sign(np.diff(angle))) != 0)))
        order = np.argsort(angle)
        back = [np.concatenate([order[k::count][:: -1 if k % 2 else 1] for k in range(count)]) for count in PASSES]
        assert any(np.array_equal(each, np.arange(15)) for each in back)
    assert len(set(ways)) == 1
    # no other number of ways there and back serves the criterion better
    groups = creeping.q.reshape(3, 15, -1)
    first = [MODEL.joints.index(stage.moves[0]) for stage in CREEPING.stages]
    for count in PASSES:
        q = np.concatenate([each[in_passes(each[:, k], count)] for each, k in zip(groups, first, strict=True)])
        other = expected_uncertainty(CREEPING, q, creeping.stage, creeping.fixture, fixed=FIXED)
        assert log_det(other) < log_det(creeping.observability) + 1e-3
    one_way = expected_uncertainty(CREEPING, plan.q, plan.stage, plan.fixture, fixed=FIXED)
    k, j = one_way.names.index("stick.a"), plan.names.index("stick.a")
    assert one_way.std[k] > 1.5 * creeping.std[k] > 1.5 * plan.std[j]


def test_sheet_states_what_to_do(plan):
    sheet = plan.sheet()
    says_what_people_keep(sheet, plan.watch)
    parts = sheet.split("\n\n")
    assert parts[1].startswith(f"- Keep everyone {plan.watch.distance:.1f} m away")
    assert parts[2].splitlines() == [plan.left_out.sentence, plan.ways]
    head, *read = parts[3].splitlines()[2:]
    assert parts[3].splitlines()[:2] == ["stage 'stick_moves', fixture 'ball'",
                                         "  lock: swing at 0.0 deg, boom at -27.8 deg, grapple_swing at 42.9 deg"]
    assert head == "  move: stick"
    assert read[0].startswith("  read: sensors of the joints -> ")
    title, *rows = parts[6].splitlines()
    assert " ".join(title.split()) == ("pose boom [deg] boom_cylinder [mm] grapple [deg] yoke [deg] upper_arm [deg] "
                                       "forearm [deg]")
    values = np.array([row.split() for row in rows], dtype=float)
    own = plan.stage == "boom_moves"
    np.testing.assert_array_equal(values[:, 0], np.flatnonzero(own) + 1)
    np.testing.assert_allclose(values[:, 2], 1e3 * plan.lengths[own, 0], atol=0.5)
    np.testing.assert_allclose(values[:, [1, 3, 4, 5, 6]], np.degrees(plan.q[own][:, [1, 4, 5, 6, 7]]), atol=0.0501)
    assert "cylinder [mm]" not in parts[8].splitlines()[0], "a motor moves the swing"
    assert parts[9].startswith("Stop at once beyond these values.")


def test_plan_can_be_read_back(plan, tmp_path):
    plan.postures.write(tmp_path / "plan.csv")
    poses = read_poses(tmp_path / "plan.csv")
    assert list(poses.stage) == list(plan.stage)
    assert list(poses.fixture) == list(plan.fixture)
    np.testing.assert_array_equal(np.column_stack([poses.channels[f"{name}.q"] for name in plan.joints]), plan.q)


@pytest.mark.slow
def test_arms_that_sense_all_joints():
    panda = load_machine("panda_mukca")
    model = KinematicModel(panda)
    plan = plan_poses(panda, 20, candidates=100)
    assert list(plan.fixture) == np.repeat([fixture.name for fixture in panda.fixtures], 20).tolist()
    assert set(plan.stage) == {""}
    for fixture in panda.fixtures:
        own = plan.q[plan.fixture == fixture.name]
        gap = model.over(model.closure, model.parameters.nominal, own, np.array(fixture.position))[0]
        assert np.max(np.abs(gap)) < 1e-9
    assert "move: all joints" in plan.sheet()
    tip = Sensor(channels=("tip.x", "tip.y", "tip.z"), accuracy=1e-4, distribution="gaussian")
    tracked = panda.model_copy(update={"fixtures": (), "distances": (), "tracker": Tracker(),
                                       "sensors": (*panda.sensors, tip)})
    plan = plan_poses(tracked, 30, candidates=100)
    assert plan.problem.channels[-3:] == tip.channels
    assert np.isfinite(plan.std[plan.names.index("panda_joint3.a")])


@pytest.mark.parametrize(("options", "where", "what", "remedy"), [
    ({"count": 2}, "pose plan", "2 poses of each stage have 12 rows for 16 parameters", "3 poses or more"),
    ({"count": 0}, "pose plan", "0 poses cannot be planned", "at least one"),
    ({"count": 51}, "pose plan", "cannot be chosen from 50", "more candidates"),
    ({"stages": ["arm_moves"]}, "stage 'arm_moves'", "no such stage", "stick_moves"),
    ({"focus": ["stick.b"]}, "parameter 'stick.b'", "no parameter", "stick.beta"),
    ({"focus": ["ball.y"]}, "focus 'ball.y'", "fixed", "leave it out"),
    ({"focus": ["ball.y"], "fixed": PINS}, "focus 'ball.y'", "no pose identifies it", "fix one of"),
    ({"fixed": {"ball.w": 0.0}}, "parameter 'ball.w'", "no parameter", "ball.x"),
    ({"machine": CAT.model_copy(update={"calibrator": None, "fixtures": ()})}, "machine 'cat215b'", "nothing holds",
     "calibrator"),
    ({"machine": CAT.model_copy(update={"sensors": ()})}, "machine 'cat215b'", "no sensor", "accuracy"),
    ({"stages": ["stick_moves"], "fixed": ONE | dict.fromkeys(
        ("stick.a", "stick.alpha", "stick.beta", "grapple_swing.locked.stick_moves"), 0.0)}, "pose plan",
     "no pose identifies any", "fix fewer"),
    ({"machine": with_strokes({"stroke": 0.01}, {})}, "stage 'stick_moves'", "within their limits", "strokes"),
])
def test_bad_input_names_place_and_remedy(options, where, what, remedy):
    with pytest.raises(ProblemError) as caught:
        plan_poses(**({"machine": CAT, "count": 5, "candidates": 50, "fixed": FIXED} | options))
    assert caught.value.where.startswith(where)
    assert what in caught.value.what
    assert remedy in caught.value.remedy


def test_plan_is_an_answer_that_can_be_saved_and_loaded(plan, tmp_path):
    problem = pose_problem(CAT, 5)
    answer = hydroopt.solve(problem, candidates=100, seed=2)
    answer.save(tmp_path)
    loaded = load(tmp_path)
    assert {file.name for file in tmp_path.iterdir()} == {"plan.json", "sheet.txt", "poses.csv", "postures.csv",
                                                           "parameters.csv"}
    assert (loaded.job, loaded.status, loaded.method) == (answer.job, "ok", "exchange, D criterion")
    assert loaded.parameters == answer.parameters
    assert loaded.diagnostics == answer.diagnostics
    assert set(loaded.diagnostics[0].subject) == {"ball.y", "swing.locked.stick_moves", *PINS}
    assert answer.parameters["boom.a"].std == answer.std[answer.names.index("boom.a")]
    prior = CAT.notes["boom.joint.a"].spread(CAT.link("boom").joint.a)
    assert answer.parameters["boom.a"].prior_std == pytest.approx(prior)
    assert loaded.details() == answer.details()
    unfilled = read_poses(tmp_path / "poses.csv")
    assert "yoke.q" in unfilled.channels
    assert "stick.q" not in unfilled.channels, "no sensor reads it"
    assert all(np.all(np.isnan(values)) for values in unfilled.channels.values()), "what is planned is no reading"
    for table, words in ((unfilled, "no reading is filled in"), (answer.postures, "they are planned, not measured")):
        with pytest.raises(ProblemError, match=words):
            hydroopt.solve(hydroopt.calibration_problem(CAT, table))
    np.testing.assert_array_equal(answer.postures.channels["stick.q"], answer.q[:, answer.joints.index("stick")])


def test_problem_prints_itself_and_has_no_program():
    problem = pose_problem(CAT, 5, focus=("swing.a",), fixed=FIXED)
    text = str(problem)
    for part in ("15 poses in 3 groups", "5 postures of stage 'stick_moves', fixture 'ball'",
                 "minimise the sum of the variances, of swing.a only", "held at 0", "in focus", "yoke.q"):
        assert part in text
    for program in (problem.nlp, problem.cvxpy):
        with pytest.raises(ProblemError, match="combinatorial"):
            program()


def test_poses_of_a_stage_that_the_file_does_not_state_are_refused():
    with pytest.raises(ProblemError, match=r"no such stage or fixture; use \('stick_moves', 'ball'\)"):
        expected_uncertainty(CAT, np.zeros((1, 8)), ["arm_moves"], ["ball"])


@pytest.mark.slow
def test_readings_of_lengths_identify_pins():
    """Of a machine that nothing holds or tracks, too; without them poses of such a machine identify nothing."""
    machine = load_machine("excavator_bucket")
    plan = plan_poses(machine, 12, candidates=100, priors=True)
    assert {"bucket.q", "bucket_cylinder.length"} <= set(plan.problem.channels)
    std = dict(zip(plan.names, plan.std, strict=True))
    assert std["stick_cylinder.rod.x"] < 0.25 * machine.notes["stick_cylinder.rod.pin"].sigma
    assert std["bucket_linkage.x"] < 0.8 * machine.notes["bucket_linkage.to.pin"].sigma
    assert "bucket_cylinder [mm]" in plan.sheet()
    blind = machine.model_copy(update={"sensors": tuple(sensor for sensor in machine.sensors
                                                        if "bucket_cylinder.length" not in sensor.channels)})
    with pytest.raises(ProblemError, match="no cylinder's length is read"):
        pose_problem(blind, 12)


def test_planned_poses_can_be_reached_with_pins_as_uncertain_as_the_file_says():
    assert WHOLE.notes["boom_cylinder.barrel.pin"].sigma
    plan = plan_poses(WHOLE, 5, candidates=100, fixed={"ball.y": 0.0})
    rng, model = np.random.default_rng(0), KinematicModel(WHOLE)
    stroke = np.array([cylinder.stroke for cylinder in WHOLE.cylinders])
    for _ in range(20):
        geometry = model.parameters.nominal + model.parameters.scale * rng.standard_normal(len(model.parameters))
        out = model.over(model.strokes, geometry, plan.q)[0][:, :, 0]
        assert np.all((out >= 0) & (out <= stroke))


def test_lengths_of_cylinders_behind_the_calibrator_are_left_out():
    """The calibrator sits on the stick: where nothing reads the bucket, its cylinder's length tells nothing."""
    machine = load_machine("cat215b_bucket")
    data = machine.model_dump(exclude={"notes"})
    data["sensors"] = [each | {"channels": [name for name in each["channels"] if name != "bucket.q"]}
                       for each in data["sensors"]]
    unread = Machine.model_validate(data | {"notes": machine.notes})
    for each, there in ((machine, True), (unread, False)):
        plan = pose_problem(each, 5)
        assert {"boom_cylinder.length", "stick_cylinder.length"} <= set(plan.channels)
        assert ("bucket_cylinder.length" in plan.channels) == ("bucket.q" in plan.channels) == there
        assert len(plan.parameters)


def test_the_sheet_says_where_a_joint_stands_that_a_linkage_moves():
    """A sensor reads the basket's angle; the dynamic model computes it by its own closed form."""
    machine = load_machine("level_keeping_lift")
    plan = plan_poses(machine, 6, candidates=20, priors=True)
    head, *rows = [line.split("  ") for line in
                   plan.sheet().partition("  pose  ")[2].partition("\n\n")[0].splitlines()]
    printed = [float(row[-1]) for row in rows]
    model = hydroopt.Model(machine)
    expected = model.over(model.dependent_positions, plan.q)[0][:, machine.dependent_joints.index("basket"), 0]
    assert head[-1] == "basket [deg]"
    assert np.ptp(printed) > 10
    np.testing.assert_allclose(printed, np.degrees(expected), atol=0.0501)
