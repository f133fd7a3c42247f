"""Tables of poses that read rockers and cylinders' lengths instead of the joints that move by themselves."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from hydroopt.errors import ProblemError
from hydroopt.estimation.kinematic.calibration import calibrate
from hydroopt.estimation.kinematic.pose_layout import depends
from hydroopt.estimation.kinematic.problem import calibration_problem
from hydroopt.logs.poses import Poses
from hydroopt.machine.links import Note
from hydroopt.machine.machine import Machine
from hydroopt.machine.machine_file import load_machine, read_machine
from hydroopt.model.closed_chain import KinematicModel
from hydroopt.model.model import Model
from hydroopt.simulation import postures

TIP = ("tip.x", "tip.y", "tip.z")
LENGTHS = tuple(f"{name}_cylinder.length" for name in ("boom", "stick", "bucket"))
LEGS = tuple(f"leg{k}.length" for k in range(1, 7))
TILT = ("lift_cylinder.length", "tilt_cylinder.length")
COUNT = 40


@cache
def surveyed(name: str, *channels: str) -> KinematicModel:
    """A bundled machine whose end is surveyed, with sensors of these channels alone."""
    machine = load_machine(name)
    accuracy = {"length": 1e-3, "q": 2e-3, "x": 3e-3, "y": 3e-3, "z": 3e-3, "rx": 1e-3, "ry": 1e-3, "rz": 1e-3}
    pins = [f"leg{k}.{part}" for k in range(1, 7) for part in ("rod.pin", "barrel.pin", "dead_length")]
    return KinematicModel(Machine.model_validate(machine.model_dump(exclude={"notes", "instruments"}) | {
        "calibrator": {"parent": machine.tip}, "tracker": {},
        "sensors": [{"channels": [each], "accuracy": accuracy[each.rpartition(".")[2]], "distribution": "gaussian"}
                    for each in channels],
        "notes": dict(machine.notes) | (dict.fromkeys(pins, Note(sigma=0.005)) if name == "stewart_platform" else {})}))


def drawn(model: KinematicModel, count: int, seed: int) -> np.ndarray:
    every = range(len(model.joints))
    return postures.closed_postures(
        model, count, np.random.default_rng(seed), geometry=model.parameters.nominal, turning=every,
        within_limits=every, locked={}, held=None, batch=1000, give_up=lambda _, tried: tried > 200_000,
        within_strokes=model.parameters.scale)[0]


def truth(model: KinematicModel, seed: int) -> np.ndarray:
    off = np.random.default_rng(seed).standard_normal(len(model.parameters)) * model.parameters.scale
    return np.maximum(model.parameters.nominal + off, model.parameters.lower)


def table(model: KinematicModel, geometry: np.ndarray, seed: int | None) -> Poses:
    return postures.record(model, drawn(model, COUNT, 1), [""] * COUNT, [""] * COUNT, geometry=geometry,
                           channels=postures.measured_channels(model), seed=seed)


@pytest.mark.parametrize(("name", "channels"), [
    ("excavator_bucket", ("swing.q", "boom.q", "stick.q", "rocker.q", *LENGTHS, *TIP)),
    ("excavator_bucket", (*LENGTHS, *TIP)),
    ("wheel_loader", ("bellcrank.q", *TILT, *TIP)),
    pytest.param("stewart_platform", (*LEGS, *TIP, "tip.rx", "tip.ry", "tip.rz"), marks=pytest.mark.slow),
])
def test_without_noise_unseen_poses_are_predicted_exactly(name: str, channels: tuple[str, ...]) -> None:
    model = surveyed(name, *channels)
    true, unseen = truth(model, 2), drawn(model, 100, 3)
    found = calibrate(calibration_problem(model.machine, table(model, true, None), priors=False)).theta[:len(true)]

    def apart(geometry: np.ndarray) -> float:
        lengths = (model.over(model.lengths, g, unseen)[0][:, :, 0] for g in (geometry, true))
        return float(np.max(np.abs(np.subtract(*lengths))))

    assert apart(model.parameters.nominal) > 5e-3
    assert apart(found) < 1e-5  # transducers of 1 mm


@pytest.mark.slow
@pytest.mark.parametrize(("name", "channels"), [
    ("excavator_bucket", ("swing.q", "boom.q", "stick.q", "rocker.q", *LENGTHS, *TIP)),
    ("wheel_loader", ("bellcrank.q", *TILT, *TIP)),
])
def test_covariance_is_that_of_repeated_tables(name: str, channels: tuple[str, ...]) -> None:
    """Machines drawn from the file's confidences: of what the poses tell, errors are as large as stated."""
    model, count = surveyed(name, *channels), len(surveyed(name, *channels).parameters)
    held, errors = [], []
    for seed in range(60):
        true = truth(model, 100 + seed)
        found = calibrate(calibration_problem(model.machine, table(model, true, seed)))
        told = found.std[:count] < 0.8 * model.parameters.scale
        low, high = np.array(found.ci95)[:count].T
        errors.append(((found.theta[:count] - true) / found.std[:count])[told])
        held.append(((low <= true) & (true <= high))[told])
    assert len(np.concatenate(held)) > 10 * 60
    assert 0.93 < np.mean(np.concatenate(held)) < 0.97
    assert np.sqrt(np.mean(np.concatenate(errors) ** 2)) == pytest.approx(1.0, abs=0.06)


def test_positions_of_dependent_joints_are_those_of_the_dynamic_model() -> None:
    """Within half a turn; and by finite differences of its pins."""
    model = surveyed("excavator_bucket", "rocker.q", *LENGTHS, *TIP)
    q, row = drawn(model, 20, 4), model.channels.index("rocker.q")
    dynamic = Model(model.machine)
    there = dynamic.over(dynamic.dependent_positions, q)[0][:, model.machine.dependent_joints.index("rocker"), 0]
    place, g = np.zeros((20, model.place_size)), model.parameters.nominal
    here = model.over(model.observed, g, q, place)[0][:, row, 0]
    np.testing.assert_allclose(np.angle(np.exp(1j * (here - there))), 0, atol=1e-12)
    k, step = model.parameters.index("coupler.a"), 1e-6
    sides = [model.over(model.observed, g + h * np.eye(len(g))[k], q, place)[0][:, row, 0] for h in (step, -step)]
    slopes = model.over(model.observed_jacobians, g, q, place)[1][:, row, k]
    np.testing.assert_allclose(slopes, (sides[0] - sides[1]) / (2 * step), atol=1e-7)
    assert np.max(np.abs(slopes)) > 0.1


def test_a_rocker_read_wrongly_once_is_named() -> None:
    model = surveyed("wheel_loader", "bellcrank.q", *TILT, *TIP)
    poses = table(model, truth(model, 5), 6)
    wrong = poses.channels["bellcrank.q"] + np.radians(6.0) * (np.arange(COUNT) == 7)
    found = calibrate(calibration_problem(
        model.machine, replace(poses, channels={**poses.channels, "bellcrank.q": wrong})))
    assert any(text.text.startswith("Pose 8 (row 8) contradicts the others") for text in found.diagnostics)


def test_joints_that_nothing_tells_are_refused_by_name_and_row() -> None:
    model = surveyed("excavator_bucket", *LENGTHS, *TIP)
    poses = table(model, model.parameters.nominal, None)
    lost = poses.channels["stick_cylinder.length"].copy()
    lost[4] = np.nan
    calibration_problem(model.machine, replace(poses, channels={**poses.channels, "stick_cylinder.length": lost}))
    few = {**poses.channels, "stick_cylinder.length": lost, "tip.y": lost, "tip.z": lost}
    with pytest.raises(ProblemError, match=r"data row 5: the joint 'swing' is neither sensed.*record 'swing.q' or a "
                                           r"length that determines it"):
        calibration_problem(model.machine, replace(poses, channels=few))


def test_a_rocker_without_a_stated_accuracy_is_refused() -> None:
    model = surveyed("excavator_bucket", "rocker.q", *LENGTHS, *TIP)
    unstated = surveyed("excavator_bucket", *LENGTHS, *TIP)
    with pytest.raises(ProblemError, match=r"the accuracy of 'rocker.q' is not stated.*state a sensor"):
        calibration_problem(unstated.machine, table(model, model.parameters.nominal, None))


@pytest.mark.parametrize(("roll", "matters"), [("0 deg", False), ("3 deg", True)])
def test_inclination_depends_on_a_joint_unless_it_is_vertical(roll: str, matters: bool) -> None:
    machine = read_machine(f'based_on = "excavator_imu"\norientation = ["{roll}", "0 deg", "0 deg"]')
    model = KinematicModel(machine)
    found = depends(model)
    rows = [k for k, name in enumerate(model.channels) if name.startswith("stick_imu.accel")]
    swing, boom, bucket = (model.joints.index(name) for name in ("swing", "boom", "bucket"))
    assert found[rows, swing].any() == matters
    assert found[rows, boom].any()
    assert not found[rows, bucket].any()
