"""A laser on the stick that reads the distance to the ground: its readings, what poses tell of it, and refusals."""

from __future__ import annotations

import re

import numpy as np
import pytest

from hydroopt.errors import MachineError, ProblemError
from hydroopt.estimation.kinematic.calibration import calibrate
from hydroopt.estimation.kinematic.problem import CalibrationProblem, calibration_problem
from hydroopt.excitation.selection.pose_problem import pose_problem
from hydroopt.logs.poses import Poses
from hydroopt.machine.machine_file import dump_machine, read_machine
from hydroopt.model.closed_chain import KinematicModel
from hydroopt.simulation import postures
from hydroopt.simulation.pose_table import simulate_poses
from hydroopt.solving import solve

TEXT = """
name = "levelled"
ground = "-0.5 m"

[[links]]
name = "swing"
joint = { type = "revolute", lower = "-170 deg", upper = "170 deg", d = "1.1 m", alpha = "90 deg", a = "0.3 m" }
[[links]]
name = "boom"
[links.joint]
type = "revolute"
lower = "-10 deg"
upper = "60 deg"
a = "3.2 m"
theta = { value = "0 deg", sigma = "1 deg" }
[[links]]
name = "stick"
joint = { type = "revolute", lower = "-150 deg", upper = "-30 deg", a = "1.7 m" }

[[drives]]
name = "swing_drive"
joint = "swing"
[[drives]]
name = "boom_drive"
joint = "boom"
[[drives]]
name = "stick_drive"
joint = "stick"

[[rangefinders]]
name = "laser"
link = "stick"
position = { value = ["0.4 m", "0.2 m", "0 m"], sigma = "2 cm" }
direction = { value = [1, 0, 0.2], sigma = 0.02 }
accuracy = "2 mm"
range = "8 m"

[[sensors]]
channels = ["swing.q", "boom.q", "stick.q"]
accuracy = "0.02 deg"
distribution = "gaussian"
"""
ASIDE = {"laser.z": 0.0}
"""Along the joints' axis, which is level: no distance to the ground depends on it."""
TRUTH = {"boom.theta": np.radians(0.7), "laser.x": 0.415, "laser.y": 0.188, "laser.z": 0.0,
         "laser.direction.y": 0.013, "laser.direction.z": 0.185}
MODEL = KinematicModel(read_machine(TEXT))


def read(count: int = 40) -> tuple[np.ndarray, Poses]:
    """Random postures (N, 3), and what the machine of `TRUTH` reads there."""
    low, high = MODEL.ranges.T
    q = np.random.default_rng(0).uniform(low, high, (count, 3))
    geometry = np.array([TRUTH[name] for name in MODEL.parameters.names])
    return q, postures.record(MODEL, q, [""] * count, [""] * count, geometry=geometry, seed=None,
                              channels=postures.measured_channels(MODEL))


def problem_of(poses: Poses) -> CalibrationProblem:
    return calibration_problem(MODEL.machine, poses, fixed=ASIDE, priors=False)


def test_a_reading_is_that_computed_by_hand() -> None:
    """With the boom at 20 deg and the stick 100 deg below it, the stick points 80 deg down, and 0.2 aside."""
    root = np.array([0.3 + 3.2 * np.cos(np.radians(20)), 1.1 + 3.2 * np.sin(np.radians(20))])
    along = np.array([np.cos(np.radians(-80)), np.sin(np.radians(-80))])
    height = (root + 0.4 * along + 0.2 * np.array([-along[1], along[0]]))[1] + 0.5
    expected = height / (np.sin(np.radians(80)) / np.hypot(1, 0.2))
    q = np.radians([[35.0, 20.0, -100.0]])
    found = postures.record(MODEL, q, [""], [""], geometry=MODEL.parameters.nominal, channels=["laser.length"],
                            seed=None)
    assert found.channels["laser.length"][0] == pytest.approx(expected, abs=1e-12)


def test_it_reads_where_the_beam_hits_the_ground_within_its_range() -> None:
    q, poses = read(400)
    seen, angle = np.isfinite(poses.channels["laser.length"]), q[:, 1] + q[:, 2]
    assert 0.3 < np.mean(seen) < 0.99
    assert not np.any(seen & (angle > np.radians(-1)))
    assert np.all(poses.channels["laser.length"][seen] <= 8)
    assert np.all(poses.channels["laser.length"][seen] > 0)
    assert np.all(seen[np.abs(angle + np.pi / 2) < np.radians(40)])


def test_mount_and_joint_offset_are_found_without_noise() -> None:
    solved = calibrate(problem_of(read()[1]))
    for name, value in TRUTH.items():
        assert solved[name].value == pytest.approx(value, abs=1e-8), name
    assert solved.fit["train"]["laser.length"].rms < 1e-9


def test_its_jacobian_agrees_with_differences() -> None:
    q, poses = read()
    problem = problem_of(poses)
    theta = problem.start + 0.01 * np.random.default_rng(1).standard_normal(len(problem.parameters))
    _, by_theta, by_q = problem.rows(theta, q)
    assert np.all(np.any(by_theta != 0, axis=(0, 1)) == [name != "laser.z" for name in problem.parameters.names])
    for k, step in enumerate(1e-6 * np.eye(len(theta))):
        slope = (problem.rows(theta + step, q)[0] - problem.rows(theta - step, q)[0]) / 2e-6
        np.testing.assert_allclose(by_theta[:, :, k], slope, rtol=1e-6, atol=1e-7)
    for k, step in enumerate(1e-6 * np.eye(3)):
        slope = (problem.rows(theta, q + step)[0] - problem.rows(theta, q - step)[0]) / 2e-6
        np.testing.assert_allclose(by_q[:, :, k], slope, rtol=1e-6, atol=1e-7)


def test_poses_are_planned_simulated_and_calibrated_with_it() -> None:
    plan = solve(pose_problem(MODEL.machine, 12, fixed=ASIDE), candidates=100)
    assert np.all(np.isfinite(plan.std))
    assert "sensor laser: length -> laser.length [mm]" in plan.sheet()
    found = simulate_poses(MODEL, plan.postures, random=True, noise=False, seed=2)
    assert np.mean(np.isfinite(found.poses.channels["laser.length"])) > 0.5  # the truth may lie beyond its range
    truth = {name: value for name, value in found.truth.items() if name != "laser.z"}
    solved = calibrate(problem_of(found.poses))
    assert {name: solved[name].value for name in truth} == pytest.approx(truth, abs=1e-7)
    assert read_machine(dump_machine(solved.machine)).rangefinders[0].direction == pytest.approx(
        (1, truth["laser.direction.y"], truth["laser.direction.z"]), abs=1e-7)


@pytest.mark.parametrize(("before", "after", "sentence"), [
    ('ground = "-0.5 m"', "", "the beam of 'laser' ends at the ground, whose height is not stated"),
    ('accuracy = "2 mm"\n', "", "rangefinders[laser].accuracy: this key is missing"),
    ("[1, 0, 0.2]", "[0, 0, 0]", "rangefinders[laser].direction: the beam of 'laser' has no direction"),
    ('link = "stick"', 'link = "stik"', "rangefinders[laser].link: 'laser' is attached to 'stik', which does not"),
    ('link = "stick"', 'link = "base"', "the beam of 'laser' cannot hit the ground, which is at -0.5 m"),
    ("[1, 0, 0.2]", "[0, 0, 1]", "the ground, which is at -0.5 m, within its range of 8 m, wherever its link stands;"),
    ("[1, 0, 0.2]", "[-1, 0, 0]", "cannot hit the ground"),
    ('range = "8 m"', 'range = "5 cm"', "cannot hit the ground, which is at -0.5 m, within its range of 0.05 m"),
    ('ground = "-0.5 m"', 'ground = "-20 m"', "cannot hit the ground, which is at -20 m")])
def test_bad_statements_are_refused(before: str, after: str, sentence: str) -> None:
    assert TEXT.count(before) == 1
    with pytest.raises(MachineError, match=re.escape(sentence)):
        read_machine(TEXT.replace(before, after))


def test_a_reading_where_the_beam_points_away_is_refused() -> None:
    _, poses = read()
    length = poses.channels["laser.length"]
    row = int(np.argmax(~np.isfinite(length)))
    length = np.where(np.arange(len(length)) == row, 4.0, length)
    q = {name: values.copy() for name, values in poses.channels.items()}
    q["boom.q"][row], q["stick.q"][row] = np.radians([60.0, -31.0])
    wrong = Poses("t", channels={**q, "laser.length": length}, units=poses.units)
    with pytest.raises(ProblemError, match=re.escape("its beam cannot hit the ground in this pose")):
        calibrate(problem_of(wrong))
