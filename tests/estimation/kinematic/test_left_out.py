"""Places that are predicted without their own poses: as by solving again, and a bound that holds at further places."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from hydroopt import Calibration, Poses, calibration_problem, load_machine, read_pose_files, solve
from hydroopt.estimation.kinematic.left_out import left_out
from hydroopt.estimation.kinematic.observability import linearise
from hydroopt.estimation.kinematic.residuals import predicted
from hydroopt.results.verdict import About, Purpose

MUKCA = Path(__file__).parents[3] / "data/mukca_panda_2"
TRAINED = ("back_left", "front_center", "front_right", "mid_left")
OTHERS = ("back_right", "front_left", "mid-high", "mid_right")


@pytest.fixture(scope="module")
def poses() -> Poses:
    return read_pose_files(sorted(MUKCA.glob("*/hole_*.csv")), mapping=MUKCA / "map.toml")


@pytest.fixture(scope="module")
def solved(poses: Poses) -> Calibration:
    found = solve(calibration_problem(load_machine("panda_mukca"), poses.select(np.isin(poses.stage, TRAINED))))
    assert isinstance(found, Calibration)
    return found


def test_a_place_is_predicted_as_by_solving_again_without_it(poses: Poses, solved: Calibration) -> None:
    by_places, left = left_out(solved.problem, solved.linearised)
    assert by_places
    without = solve(calibration_problem(load_machine("panda_mukca"), poses.select(np.isin(poses.stage, TRAINED[1:]))))
    assert isinstance(without, Calibration)
    fresh, theta, q = predicted(without.problem, without.theta, poses.select(poses.stage == TRAINED[0]))
    squares = float(linearise(fresh, theta, q).pose_square.sum())
    assert left.squares[0, 0] == pytest.approx(squares, rel=0.02)


def test_the_claim_holds_at_real_places_that_took_no_part(poses: Poses, solved: Calibration) -> None:
    """The scatter of the ball's centre about its mean in each socket, by forward kinematics alone."""
    claim, = (each for each in solved.claims if each.purpose is Purpose.POSITION and each.about is About.READING)
    assert claim.tested
    assert "other heights are not covered" in claim.condition
    model, actual = solved.problem.model, []
    for place in OTHERS:
        there = poses.select(poses.stage == place)
        angles = np.stack([there.channels[f"{joint}.q"] for joint in model.joints], axis=1)
        tip = model.over(model.tip, solved.theta[: len(model.parameters)], angles)[0][:, :, 0]
        mean = {hole: tip[there.fixture == hole].mean(axis=0) for hole in set(there.fixture)}
        away = tip - np.array([mean[hole] for hole in there.fixture])
        actual.append(float(np.sqrt(np.mean(np.sum(away**2, axis=1)))))
    assert claim.bound is not None
    assert max(actual) < claim.bound
    assert np.median(actual) > 0.3 * claim.bound  # it is not true because it is wide


def test_where_one_place_was_measured_blocks_of_it_are_left_out(poses: Poses) -> None:
    one = solve(calibration_problem(load_machine("panda_mukca"), poses.select(poses.stage == "mid_left")))
    assert isinstance(one, Calibration)
    claim, = (each for each in one.claims if each.purpose is Purpose.POSITION and each.about is About.READING)
    assert "blocks of poses" in claim.condition
    assert "other places and heights are not covered" in claim.condition
