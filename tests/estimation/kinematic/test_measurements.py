"""Instruments, tapes between targets, and datums as measurements of poses."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from hydroopt.errors import MachineError, ProblemError
from hydroopt.estimation.kinematic.calibration import calibrate, optimum
from hydroopt.estimation.kinematic.observability import linearise, observability
from hydroopt.estimation.kinematic.pose_checks import FLIP
from hydroopt.estimation.kinematic.problem import calibration_problem
from hydroopt.logs.poses import Poses
from hydroopt.machine.machine_file import dump_machine, read_machine
from hydroopt.model.closed_chain import KinematicModel
from hydroopt.simulation import postures
from tests.fixtures.surveyed import EVERYWHERE, STANDING, TEXT, measured, measured_and_true, surveyed, truth


def test_every_measurement_gives_back_the_geometry_without_noise() -> None:
    machine, _ = surveyed()
    geometry = truth(1)
    problem = calibration_problem(machine, measured(geometry), priors=False)
    solved = calibrate(problem)
    np.testing.assert_allclose(solved.theta[: len(geometry)], geometry, rtol=0, atol=1e-6)
    for (name, setup), stands in STANDING.items():
        at = problem.parameters.index(f"{name}.{setup}.x")
        np.testing.assert_allclose(solved.theta[at : at + 6], stands, rtol=0, atol=1e-6)
    assert set(solved.fit["train"]) == {"station.prism", "station.peg", "station.stone", "laser.tip", "camera.marker",
                                        "camera.marker.turn", "floor.tip", "edge.prism", "wire.length",
                                        "cab.inclination", "boom_unit.accel", "stick_unit.inclination"}
    assert solved.fit["train"]["camera.marker.turn"].unit == "rad"
    assert set(solved.residuals[0].after) == set(solved.fit["train"])


def test_jacobians_of_every_measurement_agree_with_differences() -> None:
    machine, _ = surveyed()
    problem = calibration_problem(machine, measured(truth(1)), priors=False)
    rng = np.random.default_rng(0)
    theta = problem.start + 0.01 * rng.standard_normal(len(problem.parameters))
    q = problem.layout.reading + 0.01 * rng.standard_normal(problem.layout.reading.shape)
    q[:, :2] += 0.03
    _, by_theta, by_q = problem.rows(theta, q)
    for k, step in enumerate(1e-6 * np.eye(len(theta))):
        slope = (problem.rows(theta + step, q)[0] - problem.rows(theta - step, q)[0]) / 2e-6
        np.testing.assert_allclose(by_theta[:, :, k], slope, atol=2e-8)
    for k, step in enumerate(1e-6 * np.eye(q.shape[1])):
        slope = (problem.rows(theta, q + step)[0] - problem.rows(theta, q - step)[0]) / 2e-6
        np.testing.assert_allclose(by_q[:, :, k], slope * problem.layout.present, atol=2e-8)


def frames(g: dict[str, float], q: np.ndarray) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Rotations and origins of links' frames P_i in the base frame, by hand and SciPy's rotations."""
    def turned(axis: str, angle: float) -> np.ndarray:
        return Rotation.from_euler(axis, angle).as_matrix()

    pitch, roll, *q = q
    base = turned("y", pitch) @ turned("x", roll)
    found = {"ground": (np.eye(3), np.zeros(3)), "base": (base, np.zeros(3))}
    swing = base @ turned("z", q[0])
    found["swing"] = (swing, base @ [0, 0, 1.1])
    seat, root = swing @ turned("x", np.pi / 2), found["swing"][1] + swing @ [0.3, 0, 0]
    boom = seat @ turned("z", q[1] + g["boom.theta"])
    found["boom"] = (boom, root)
    found["stick"] = (boom @ turned("z", q[2]), root + boom @ [g["boom.a"], 0, 0])
    return found


def test_rows_agree_with_rotations_of_scipy() -> None:
    """Every predicted reading once more, from Denavit-Hartenberg by hand and SciPy's quaternions."""
    machine, model = surveyed()
    geometry = truth(2)
    poses, q = measured_and_true(geometry)
    g = dict(zip(model.parameters.names, geometry.tolist(), strict=True))
    value = {number.name: number.value for number in machine.geometry_numbers} | g

    def vector(name: str) -> np.ndarray:
        return np.array([value[f"{name}.{axis}"] for axis in "xyz"])

    def angles(name: str) -> np.ndarray:
        return np.array([value[f"{name}.{axis}"] for axis in ("yaw", "pitch", "roll")])

    links = {"prism": "stick", "marker": "boom", "peg": "ground", "stone": "ground", "hook": "base"}
    for row in range(len(poses)):
        at = frames(g, q[row])
        where = {name: at[link][1] + at[link][0] @ vector(name) for name, link in links.items()}
        stick = at["stick"]
        where["tip"] = stick[1] + stick[0] @ np.add(vector("tip"), [1.7, 0, 0])
        turn = at["boom"][0] @ Rotation.from_euler("ZYX", angles("marker")).as_matrix()
        for (name, setup), stands in STANDING.items():
            if setup != poses.setup[row]:
                continue
            turned = Rotation.from_rotvec(stands[3:])
            for target in ("prism", "peg", "stone") if name == "station" else ("marker",):
                read = [poses.channels[f"{name}.{target}.{axis}"][row] for axis in "xyz"]
                np.testing.assert_allclose(turned.apply(read) + stands[:3], where[target], atol=1e-9)
            if name == "camera":
                read = Rotation.from_rotvec([poses.channels[f"camera.marker.r{axis}"][row] for axis in "xyz"])
                np.testing.assert_allclose((turned * read).as_matrix(), turn, atol=1e-9)
        laser = Rotation.from_euler("ZYX", angles("laser"))
        read = [poses.channels[f"laser.tip.{axis}"][row] for axis in "xyz"]
        np.testing.assert_allclose(laser.apply(read) + vector("laser"), where["tip"], atol=1e-9)
        np.testing.assert_allclose(poses.channels["wire.length"][row], np.linalg.norm(where["hook"] - where["prism"]),
                                   atol=1e-9)
        up = Rotation.from_euler("ZYX", [0, np.radians(-2), np.radians(1)]).inv().apply([0, 0, 1])
        felt = (at["boom"][0] @ Rotation.from_euler("ZYX", angles("boom_unit")).as_matrix()).T @ up * 9.80665
        np.testing.assert_allclose([poses.channels[f"boom_unit.accel_{axis}"][row] for axis in "xyz"], felt, atol=1e-9)
        for unit, link in (("cab", "base"), ("stick_unit", "stick")):
            world = Rotation.from_euler("ZYX", [0, np.radians(-2), np.radians(1)]).as_matrix() @ at[link][0]
            _, pitch, roll = Rotation.from_matrix(
                world @ Rotation.from_euler("ZYX", angles(unit)).as_matrix()).as_euler("ZYX")
            np.testing.assert_allclose([poses.channels[f"{unit}.{angle}"][row] for angle in ("roll", "pitch")],
                                       [roll, pitch], atol=1e-9)
        if np.isfinite(poses.channels["floor.tip.z"][row]):
            normal = Rotation.from_euler("YX", [value["floor.pitch"], value["floor.roll"]]).apply([0, 0, 1])
            assert abs(normal @ (where["tip"] - [0, 0, -1 + value["floor.z"]])) < 1e-9
        if np.isfinite(poses.channels["edge.prism.y"][row]):
            stated = Rotation.from_euler("z", np.radians(80))
            along = (stated * Rotation.from_euler("ZY", [value["edge.yaw"], value["edge.pitch"]])).apply([1, 0, 0])
            off = where["prism"] - [3, 0, 0.2] - stated.apply([0, value["edge.y"], value["edge.z"]])
            assert np.linalg.norm(off - along * (along @ off)) < 1e-9


def test_a_quaternion_reads_as_the_rotation_vector_does() -> None:
    machine, _ = surveyed()
    poses = measured(truth(1))
    turn = Rotation.from_rotvec(np.stack([poses.channels[f"camera.marker.r{axis}"] for axis in "xyz"], axis=1))
    channels = {name: values for name, values in poses.channels.items() if ".marker.r" not in name}
    x, y, z, w = -1.001 * turn.as_quat().T
    quaternion = {f"camera.marker.q{axis}": values for axis, values in zip("wxyz", (w, x, y, z), strict=True)}
    other = replace(poses, channels=channels | quaternion, units={})
    one, two = (calibration_problem(machine, each).layout.given for each in (poses, other))
    np.testing.assert_allclose(Rotation.from_rotvec(one[:, -3:]).as_matrix(),
                               Rotation.from_rotvec(two[:, -3:]).as_matrix(), atol=1e-9)




def changed(poses: Poses, **channels: np.ndarray) -> Poses:
    """The poses with other readings, or labels `setup`."""
    named = {name.replace("__", "."): values for name, values in channels.items() if name != "setup"}
    setup = channels.get("setup", poses.setup)
    return Poses(poses.name, setup=setup, channels={**poses.channels, **named})


def refused(poses: Poses, *, priors: bool = True) -> str:
    with pytest.raises(ProblemError) as error:
        calibrate(calibration_problem(surveyed()[0], poses, priors=priors))
    return str(error.value)


@cache
def poses_of_the_truth() -> Poses:
    return measured(truth(1))


def camera(change: Callable[[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]) -> Poses:
    """The poses with what a change makes of the camera's rotations (N, 3, 3) and positions (N, 3)."""
    poses = poses_of_the_truth()
    position, vector = (np.stack([poses.channels[f"camera.marker.{k}{axis}"] for axis in "xyz"], axis=1)
                        for k in ("", "r"))
    turn, position = change(Rotation.from_rotvec(vector).as_matrix(), position)
    vector = Rotation.from_matrix(turn).as_rotvec()
    return changed(poses, **{f"camera__marker__{axis}": position[:, k] for k, axis in enumerate("xyz")},
                   **{f"camera__marker__r{axis}": vector[:, k] for k, axis in enumerate("xyz")})


def test_a_set_up_seen_too_seldom() -> None:
    setup = poses_of_the_truth().setup.copy()
    setup[3] = "C"
    poses = changed(poses_of_the_truth(), setup=setup)
    off = {f"station__{target}__{axis}": np.where(setup == "C", np.nan, poses.channels[f"station.{target}.{axis}"])
           for target in ("peg", "stone") for axis in "xyz"}
    assert "'station' in set-up 'C' sees targets at 1 place only" in refused(changed(poses, **off))


@pytest.mark.parametrize(("change", "sentence"), [
    (lambda turn, at: (turn.transpose(0, 2, 1), -np.einsum("nji,nj->ni", turn, at)), "instrument in the target's fra"),
    (lambda turn, at: (FLIP @ turn, at), "other axes of the instrument"),
    (lambda turn, at: (turn @ FLIP, at), "the target's axes seem to be flipped"),
    (lambda turn, at: (turn, at * [1, -1, 1]), "mirrored"),
    (lambda turn, at: (turn, 1e3 * at), "mm given as m"),
    (lambda turn, at: (Rotation.from_quat(np.roll(Rotation.from_matrix(turn).as_quat(), -1, axis=1)).as_matrix(), at),
     "scalar last")])
def test_a_camera_in_another_convention(
        change: Callable[[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]], sentence: str) -> None:
    assert sentence in refused(camera(change))


@pytest.mark.slow
def test_a_flip_that_only_turns_the_camera_is_none() -> None:
    """Which way the axes of a camera point does not matter while it is the same for places and turns."""
    poses = camera(lambda turn, at: (FLIP @ turn, at @ FLIP))
    solved = calibrate(calibration_problem(surveyed()[0], poses, priors=False))
    np.testing.assert_allclose(solved.theta[: len(truth(1))], truth(1), rtol=0, atol=1e-6)


def test_bad_orientations_are_refused_at_their_row() -> None:
    poses = poses_of_the_truth()
    plain = {name: values for name, values in poses.channels.items() if ".marker.r" not in name}
    long = Poses("t", setup=poses.setup, channels=plain | {
        f"camera.marker.q{axis}": np.full(len(poses), 0.6) for axis in "wxyz"})
    assert "t, data row 1: the quaternion 'camera.marker.qw' to '.qz' has the length 1.2, not 1" in refused(long)
    part = Poses("t", setup=poses.setup, channels={**plain, "camera.marker.rx": np.zeros(len(poses))})
    assert "'camera.marker.ry' is not stated" in refused(part)
    both = Poses("t", setup=poses.setup, channels=dict(poses.channels) | {
        f"camera.marker.q{axis}": np.full(len(poses), 0.5) for axis in "wxyz"})
    assert "as a rotation vector and as a quaternion" in refused(both)
    hidden = Poses("t", setup=poses.setup, channels={**poses.channels, "station.marker.x": np.zeros(len(poses))})
    assert "the accuracy of 'station.marker.x' is not stated" in refused(hidden)


def test_a_line_touched_too_seldom() -> None:
    poses = poses_of_the_truth()
    few = {f"edge.prism.{axis}": poses.channels[f"edge.prism.{axis}"].copy() for axis in "yz"}
    for values in few.values():
        values[np.flatnonzero(np.isfinite(values))[2:]] = np.nan
    assert "the line 'edge', whose place is not known, is touched 2 times only" in refused(
        Poses("t", setup=poses.setup, channels={**poses.channels, **few}), priors=False)


@pytest.mark.parametrize(("before", "after", "sentence"), [
    ('link = "stick"\nposition = {', 'link = "stik"\nposition = {', "'prism' is attached to 'stik', which does"),
    ('between = ["hook", "prism"]', 'between = ["hook", "prsm"]', "starts or ends at 'prsm', which is not a target"),
    ('name = "laser"\nposition = { value = ["6 m", "-5 m", "1.5 m"], sigma = "10 cm" }', 'name = "laser"',
     "states its orientation, but not its position"),
    ('["0 deg", "0 deg", "120 deg"]', '["0 deg", "90 deg", "120 deg"]', "roll and yaw are the same turn"),
    ('"floor.tip.z", "edge', '"floor.tip.x", "edge', "a sensor reads 'floor.tip.x', which this machine does not have")])
def test_bad_statements_are_refused(before: str, after: str, sentence: str) -> None:
    assert TEXT.count(before) == 1
    with pytest.raises(MachineError, match=sentence):
        read_machine(TEXT.replace(before, after))


@pytest.mark.slow
def test_the_calibrated_machine_keeps_its_measurements() -> None:
    machine, _ = surveyed()
    assert read_machine(dump_machine(machine)) == machine
    solved = calibrate(calibration_problem(machine, measured(truth(1), seed=1)))
    assert abs(solved.machine.targets[0].position[0] - truth(1)[solved.problem.parameters.index("prism.x")]) < 0.01
    assert solved.machine.datums[0].offset[2] != 0
    assert solved.status == "ok"


@pytest.mark.parametrize(("change", "sentence"), [
    (lambda a: -a, "signs of 'boom_unit.accel_x' to 'accel_z' seem to be reversed"),
    (lambda a: a[[1, 2, 0]], "axes of 'boom_unit.accel_x' to 'accel_z' seem to be exchanged for z, x, y"),
    (lambda a: a / 9.80665, "magnitude 1 m/s^2, not that of gravity, 9.81 m/s^2; they seem to be g given as m/s^2")])
def test_an_accelerometer_in_another_convention(change: Callable[[np.ndarray], np.ndarray], sentence: str) -> None:
    text = TEXT.replace('base_motion = { roll = { lower = "-5 deg", upper = "5 deg" }, pitch = { lower = "-5 deg", '
                        'upper = "5 deg" } }\n', "")
    machine = read_machine(text)
    model = KinematicModel(machine)
    low, high = model.ranges.T
    q = np.random.default_rng(0).uniform(low, high, (20, 3))
    channels = [name for name in EVERYWHERE if not name.startswith(("laser", "cab"))]
    poses = postures.record(model, q, [""] * 20, [""] * 20, geometry=model.parameters.nominal, channels=channels,
                            setup=["A"] * 20, seed=1)
    felt = change(np.array([poses.channels[f"boom_unit.accel_{axis}"] for axis in "xyz"]))
    poses = Poses("t", setup=poses.setup, units=poses.units, channels={
        **poses.channels, **{f"boom_unit.accel_{axis}": felt[k] for k, axis in enumerate("xyz")}})
    with pytest.raises(ProblemError, match=re.escape(sentence)):
        calibrate(calibration_problem(machine, poses))


def test_what_no_pose_measures_keeps_its_stated_numbers() -> None:
    poses = poses_of_the_truth()
    few = {name: values for name, values in poses.channels.items() if not name.startswith(("camera", "boom_unit"))}
    problem = calibration_problem(surveyed()[0], Poses("t", setup=poses.setup, channels=few))
    assert {name.partition(".")[0] for name in problem.fixed} == {"marker", "boom_unit"}
    assert problem.fixed["boom_unit.roll"] == pytest.approx(np.pi / 2)


@pytest.mark.slow
def test_intervals_of_all_measurements_together_cover_the_truth() -> None:
    """Truths drawn with the file's confidences, noise, a slope that varies: 95 % lie within their intervals."""
    machine, model = surveyed()
    within: list[np.ndarray] = []
    for draw in range(30):
        geometry = truth(1000 + draw)
        problem = calibration_problem(machine, measured(geometry, seed=draw, draw=draw))
        found = optimum(problem, "joint", problem.start)
        std = observability(problem, linearise(problem, found.theta, found.q)).std
        stands = {f"{name}.{setup}.{axis}": value for (name, setup), pose in STANDING.items()
                  for axis, value in zip(("x", "y", "z", "rx", "ry", "rz"), pose, strict=True)}
        known = dict(zip(model.parameters.names, geometry.tolist(), strict=True)) | stands
        error = np.array([found.theta[k] - known.get(name, 0.0) for k, name in enumerate(problem.parameters.names)])
        within.append(np.abs(error) < 1.959964 * std)
    assert 0.93 < np.mean(within) < 0.97
    assert np.min(np.mean(within, axis=0)) > 0.75


@pytest.mark.parametrize("moves", [False, True])
def test_an_instrument_that_moves_within_a_set_up_is_named(moves: bool) -> None:
    """By 15 mm and a turn of 2 mrad, in the middle of set-up A."""
    machine, _ = surveyed()
    poses = measured(truth(2), count=40, seed=4)
    own = np.flatnonzero((poses.setup == "A") & np.isfinite(poses.channels["station.prism.x"]))
    late = own[len(own) // 2 :]
    channels = dict(poses.channels)
    turned = Rotation.from_rotvec([0, 0, 2e-3])
    for target in ("prism", "peg", "stone") if moves else ():
        names = [f"station.{target}.{axis}" for axis in "xyz"]
        seen = np.stack([channels[name] for name in names], axis=1)
        seen[late] = turned.inv().apply(seen[late] - [0.012, -0.008, 0.004])
        channels |= dict(zip(names, seen.T, strict=True))
    found = calibrate(calibration_problem(machine, replace(poses, channels=channels)))
    moved = [each for each in found.diagnostics if each.kind == "instrument moved"]
    if not moves:
        assert not moved
        return
    assert [each.subject for each in moved] == [("station.A",)]
    assert moved[0].evidence["size"] == pytest.approx(15.0, abs=2.0)
    assert moved[0].evidence["place"].startswith(f"row {poses.row[late[0]]}")
    assert found.status == "suspect"
