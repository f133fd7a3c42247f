"""Held-out poses against stated errors: as expected where these hold, contradicted where something is wrong."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from hydroopt import Calibration, Poses, calibration_problem, load_machine, read_pose_files, solve
from hydroopt.estimation.kinematic.accuracy import prediction_test
from hydroopt.model.closed_chain import KinematicModel
from hydroopt.results.diagnostic import of_kind
from hydroopt.results.status import Status
from hydroopt.results.verdict import About, Purpose
from hydroopt.simulation import postures
from studies import closed_postures

CAT = load_machine("cat215b")
MUKCA = Path(__file__).parents[3] / "data/mukca_panda_2"
COUNT = 14
CALIBRATOR = ("grapple", "yoke", "upper_arm", "forearm")
LENGTHS = ("boom_cylinder.length", "stick_cylinder.length")


def measured(seed: int) -> Poses:
    """Poses of the chain closed by a ball, of a machine drawn with its file's confidences."""
    model = KinematicModel(CAT)
    away = np.random.default_rng(seed).standard_normal(len(model.parameters))
    geometry = model.parameters.nominal + away * model.parameters.scale * np.array(
        [information > 0 for information in model.parameters.information.diagonal()])
    fixture = np.array(CAT.fixtures[0].position)
    q = [closed_postures.random_postures(model, stage, COUNT, geometry=geometry, fixture=fixture, seed=seed + k)
         for k, stage in enumerate(CAT.stages)]
    stages = [stage.name for stage in CAT.stages for _ in range(COUNT)]
    return postures.record(model, np.concatenate(q), stages, ["ball"] * len(stages), geometry=geometry, seed=seed,
                           channels=[*(f"{joint}.q" for joint in CALIBRATOR), *LENGTHS])


def calibrated(poses: Poses, aside: np.ndarray, changed: dict[str, float] | None = None) -> Calibration:
    """The calibration without the poses `aside`, whose readings are changed before they test it."""
    held_out = poses.select(aside)
    channels = {name: x + (changed or {}).get(name, 0.0) for name, x in held_out.channels.items()}
    held_out = Poses(name="held out", stage=held_out.stage, fixture=held_out.fixture, channels=channels)
    found = solve(calibration_problem(CAT, poses.select(~aside), held_out))
    assert isinstance(found, Calibration)
    return found


@pytest.mark.slow
def test_errors_that_are_stated_give_what_is_expected() -> None:
    """Over truths: any stage that is held out has the errors stated for it, though training tells it worse."""
    chances, ratios, covered = [], [], []
    for seed in range(0, 100, 10):
        poses = measured(seed)
        for stage in dict.fromkeys(map(str, poses.stage)):
            found = calibrated(poses, poses.stage == stage).tested
            assert found is not None
            chances.append(found.chance)
            ratios.append(found.ratio)
            covered.append(found.coverage)
    assert np.mean(covered) > 0.93
    assert np.mean(ratios) == pytest.approx(1, abs=0.1)
    assert np.mean(np.array(chances) < 0.1) < 0.25
    assert 0.35 < np.mean(chances) < 0.65


@pytest.mark.slow
def test_a_stage_that_the_others_hardly_tell_is_no_contradiction() -> None:
    """Four times the error of the training poses: the intervals say so."""
    poses = measured(0)
    found = calibrated(poses, poses.stage == "swing_moves")
    ratio = found.fit["validation"]["gap"].rms / found.fit["train"]["gap"].rms
    assert ratio > 2
    assert found.status is Status.OK
    assert not of_kind(found.diagnostics, "held-out poses beyond their intervals",
                       "held-out poses fit worse than training poses")
    (place,) = (claim for claim in found.claims if claim.purpose is Purpose.POSITION and claim.about is About.TRUTH)
    assert "errors of held-out poses 1" in place.condition
    assert "times those stated" in place.condition


@pytest.mark.slow
@pytest.mark.parametrize("changed", [{"boom_cylinder.length": 0.03}, {"yoke.q": np.radians(3.0)}])
def test_a_sensor_that_reads_otherwise_in_held_out_poses_contradicts(changed: dict[str, float]) -> None:
    poses = measured(0)
    found = calibrated(poses, np.arange(len(poses)) % 4 == 3, changed)
    (diagnostic,) = of_kind(found.diagnostics, "held-out poses beyond their intervals")
    assert diagnostic.evidence["ratio"] > 2
    assert found.status is Status.SUSPECT


@pytest.mark.slow
def test_a_real_place_that_differs_from_the_others_contradicts() -> None:
    """The place `high`, which others have found to be inconsistent, held out; then each sound place."""
    machine = load_machine("panda_mukca")
    poses = read_pose_files(sorted(MUKCA.glob("*/hole_*.csv")), mapping=MUKCA / "map.toml")
    sound = poses.stage != "high"
    for place in ("high", "back_left", "front_center", "mid-high"):
        here = poses.stage == place
        found = solve(calibration_problem(machine, poses.select(sound & ~here), poses.select(here)))
        assert bool(of_kind(found.diagnostics, "held-out poses beyond their intervals")) is (place == "high")
        assert found.status is (Status.SUSPECT if place == "high" else Status.OK)


@pytest.mark.slow
def test_machines_drawn_from_the_intervals_have_even_chances() -> None:
    """Geometry from the calibration's covariance, few angles and lengths read anew: every chance is as likely."""
    model, rng = KinematicModel(CAT), np.random.default_rng(3)
    q = np.zeros((60, len(model.joints)))
    for name in ("boom", "stick"):
        q[:, model.joints.index(name)] = rng.uniform(*CAT.link(name).joint.range, len(q))

    def read(q: np.ndarray, geometry: np.ndarray) -> Poses:
        return postures.record(model, q, ["all"] * len(q), [""] * len(q), geometry=geometry,
                               seed=int(rng.integers(1 << 30)),
                               channels=["boom.q", "stick.q", *LENGTHS])

    chances = []
    for _ in range(10):  # the noise that each training set shows differs
        found = solve(calibration_problem(CAT, read(q, model.parameters.nominal)))
        assert isinstance(found, Calibration)
        free = [found.problem.parameters.names.index(name) for name in found.observability.names]
        half = np.linalg.cholesky(found.observability.covariance + 1e-18 * np.eye(len(free)))
        for _ in range(10):
            theta = found.theta.copy()
            theta[free] += half @ rng.standard_normal(len(free))
            few = rng.choice(len(q), 4, replace=False)
            chances.append(prediction_test(found, read(q[few], theta[:len(model.parameters)])).chance)
    assert np.mean(chances) == pytest.approx(0.5, abs=0.1)
    assert np.quantile(chances, (0.1, 0.9)) == pytest.approx((0.1, 0.9), abs=0.1)
