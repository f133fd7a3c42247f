"""Pins and lengths of a linkage from poses of the tip, joint angles and cylinder lengths."""

import numpy as np
import pytest

from fixtures.loops import survey
from hydroopt.estimation.kinematic.calibration import calibrate
from hydroopt.estimation.kinematic.problem import calibration_problem
from hydroopt.machine.joint_limits import within_strokes
from hydroopt.machine.machine_file import dump_machine, read_machine
from hydroopt.model.closed_chain import KinematicModel
from hydroopt.model.model import Model
from hydroopt.simulation import postures

CHANNELS = (*(f"{joint}.q" for joint in ("swing", "boom", "stick", "bucket")), "tip.x", "tip.y", "tip.z",
            *(f"{name}_cylinder.length" for name in ("boom", "stick", "bucket")))


@pytest.fixture(scope="module")
def kinematics():
    return KinematicModel(survey())


def drawn(kinematics, count, seed):
    return np.random.default_rng(seed).uniform(*kinematics.ranges.T, (count, 4))


def test_lengths_are_those_of_the_dynamic_model(kinematics):
    q, model = drawn(kinematics, 20, 1), Model(survey())
    lengths = kinematics.over(kinematics.lengths, kinematics.parameters.nominal, q)[0]
    np.testing.assert_allclose(lengths, model.over(model.cylinder_kinematics, q, 0 * q, 0 * q)[0], rtol=1e-14)


@pytest.mark.parametrize("name", ["rocker.a", "coupler.a", "bucket_linkage.x", "rocker.pin.y"])
def test_derivatives_by_pins_and_lengths_of_the_linkage(kinematics, name):
    q, g, k, step = drawn(kinematics, 5, 2), kinematics.parameters.nominal, kinematics.parameters.index(name), 1e-6
    place = np.zeros((5, kinematics.place_size))
    by_g = kinematics.over(kinematics.observed_jacobians, g, q, place)[1][:, :, k]
    sides = [kinematics.over(kinematics.observed, g + h * np.eye(len(g))[k], q, place)[0][:, :, 0]
             for h in (step, -step)]
    np.testing.assert_allclose(by_g, (sides[0] - sides[1]) / (2 * step), atol=1e-8)
    assert np.max(np.abs(by_g)) > 0.1


def test_pins_off_by_a_centimetre_come_back(kinematics):
    q, rng = drawn(kinematics, 100, 3), np.random.default_rng(4)
    truth = kinematics.parameters.nominal + rng.choice([-0.01, 0.01], len(kinematics.parameters))
    unseen = drawn(kinematics, 200, 5)

    def errors(theta):
        here, there = (kinematics.over(kinematics.tip, g, unseen)[0][:, :, 0] for g in (theta, truth))
        lengths = [kinematics.over(kinematics.lengths, g, unseen)[0][:, 2, 0] for g in (theta, truth)]
        return np.sqrt(np.mean(np.sum((here - there)**2, axis=1))), np.sqrt(np.mean((lengths[0] - lengths[1])**2))

    before = errors(kinematics.parameters.nominal)
    assert before[0] > 0.01
    poses = postures.record(kinematics, q, [""] * 100, [""] * 100, geometry=truth, channels=CHANNELS, seed=6)
    found = calibrate(calibration_problem(survey(), poses))
    after = errors(found.theta[:len(truth)])
    assert after[0] < 0.002  # sensors of ±3 mm and ±0.1 degrees
    assert after[1] < 0.001
    again = read_machine(dump_machine(found.machine))
    assert again.loops[0].to.pin != survey().loops[0].to.pin


def test_limits_are_narrowed_to_what_the_stroke_allows_through_the_linkage():
    short = survey().with_values({"bucket_cylinder.dead_length": 2.1})
    narrowed, changes = within_strokes(short)
    (change,) = changes
    assert (change.joint, change.cylinder) == ("bucket", "bucket_cylinder")
    assert change.after[0] == change.before[0]
    model = Model(narrowed)
    q = np.array([[0.0, 0.0, -1.0, change.after[1]]])
    length = model.over(model.cylinder_kinematics, q, 0 * q, 0 * q)[0][0, 2, 0]
    assert 2.1 < length < 2.1 + 1e-5
