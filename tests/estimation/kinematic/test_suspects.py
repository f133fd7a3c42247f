"""What is said of poses that do not fit: one cause that the data decide for, all that they leave, or nothing."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from hydroopt import load_machine, pose_problem, solve
from hydroopt.errors import SolverError
from hydroopt.estimation.kinematic.calibration import Calibration, calibrate
from hydroopt.estimation.kinematic.problem import calibration_problem
from hydroopt.logs.poses import Poses
from hydroopt.machine.machine import Machine
from hydroopt.machine.machine_file import read_machine
from hydroopt.model.closed_chain import KinematicModel
from hydroopt.results.diagnostic import of_kind
from hydroopt.results.status import Status
from hydroopt.simulation import postures
from hydroopt.simulation.pose_table import simulate_poses

POSES = 100


@pytest.fixture(scope="module")
def sound() -> Poses:
    """Angles and cylinder lengths of the excavator, read with the sensors' noise."""
    machine = load_machine("cat215b")
    model, rng = KinematicModel(machine), np.random.default_rng(3)
    q = np.zeros((POSES, len(model.joints)))
    for name in ("boom", "stick"):
        q[:, model.joints.index(name)] = rng.uniform(*machine.link(name).joint.range, POSES)
    return postures.record(model, q, ["all"] * POSES, [""] * POSES, geometry=model.parameters.nominal, seed=0,
                           channels=["boom.q", "stick.q", "boom_cylinder.length", "stick_cylinder.length"])


def solved(poses: Poses, **errors: np.ndarray | float) -> Calibration:
    """The calibration with errors added to some channels, of which ``__`` stands for the dot."""
    names = {key.replace("__", "."): error for key, error in errors.items()}
    channels = {name: x + names.get(name, 0.0) for name, x in poses.channels.items()}
    return calibrate(calibration_problem(load_machine("cat215b"), Poses(
        name="odd", stage=poses.stage, fixture=poses.fixture, channels=channels)))


def test_sound_poses_raise_no_suspicion(sound: Poses) -> None:
    calibration = solved(sound)
    assert not calibration.suspects
    assert calibration.status is Status.OK


@pytest.mark.parametrize(("kind", "name", "first", "errors"), [
    ("offset", "boom_cylinder", 60, {"boom_cylinder__length": 0.03 * (np.arange(POSES) >= 60)}),
    ("offset", "stick", 30, {"stick__q": np.radians(1.5) * (np.arange(POSES) >= 30)}),
    ("pose", "41", 40, {"boom__q": np.radians(6.0) * (np.arange(POSES) == 40)})])
def test_one_fault_is_named(sound: Poses, kind: str, name: str, first: int, errors: dict[str, np.ndarray]) -> None:
    calibration = solved(sound, **errors)
    found = [(suspect.kind, suspect.name, suspect.decided) for suspect in calibration.suspects]
    assert found == [(kind, name, True)]
    assert abs(int(np.argmax(calibration.suspects[0].poses)) - first) <= 1
    assert calibration.status is (Status.OK if kind == "pose" else Status.SUSPECT)
    (written,) = (text for name, text in calibration.files().items() if name.endswith(".toml"))
    assert bool(read_machine(written).suspect) == (calibration.status is Status.SUSPECT)


def test_what_the_data_do_not_decide_is_left_open(sound: Poses) -> None:
    """A transducer that is not linear looks like an eccentric resolver: pins and angles absorb nearly all of both."""
    reading = sound.channels["stick_cylinder.length"]
    calibration = solved(sound, stick_cylinder__length=0.05 * (2 * (reading - reading.mean()) / np.ptp(reading)) ** 2)
    (suspect,) = calibration.suspects
    assert not suspect.decided
    (diagnostic,) = of_kind(calibration.diagnostics, "cause of the contradiction undecided")
    assert "do not decide between: " in diagnostic.text
    assert suspect.rivals[0].phrase in diagnostic.text
    assert calibration.status is Status.SUSPECT


def test_a_fault_of_absurd_size_explains_nothing(sound: Poses) -> None:
    calibration = solved(sound, boom_cylinder__length=0.06 * (np.arange(POSES) >= 70))
    assert all(suspect.size < 0.2 for suspect in calibration.suspects)


@pytest.fixture(scope="module")
def sockets() -> Poses:
    """Planned postures of an arm whose ball goes from the first 20 to the second 20 in a socket 50 mm beside."""
    return solve(pose_problem(load_machine("panda_mukca"), 20), candidates=50).postures


def stating(machine: Machine, length: float) -> Machine:
    """The machine with another distance [m] between its sockets."""
    return machine.model_copy(update={"distances": tuple(
        each.model_copy(update={"length": length}) for each in machine.distances)})


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 1])
def test_a_wrong_distance_is_told_from_a_zero_that_changed_if_sockets_alternate(sockets: Poses, seed: int) -> None:
    """The line between the sockets lies along their way about the first axis: one socket after the other, a zero of
    the first joint that changed in between looks the same. The machine file is made to state 53 mm."""
    machine = load_machine("panda_mukca")
    poses = simulate_poses(KinematicModel(machine), sockets, seed=seed).poses
    alternating = poses.select(np.arange(40).reshape(2, 20).T.ravel())
    one, other = (solve(calibration_problem(stating(machine, 0.053), each)) for each in (poses, alternating))
    for calibration in (one, other):
        (suspect,) = calibration.suspects
        assert (suspect.kind, suspect.name, suspect.decided) == ("distance", "sockets", calibration is other)
        assert suspect.size == pytest.approx(0.003, abs=1e-4)
    (rival,) = one.suspects[0].rivals
    assert (rival.kind, rival.name, int(np.argmax(rival.poses))) == ("offset", "panda_joint1", 20)
    true = solve(calibration_problem(machine, poses))
    assert not true.suspects


@pytest.mark.slow
def test_a_wrong_distance_leaves_the_link_by_link_method_beside_the_optimum(sockets: Poses) -> None:
    """Readings without noise, from which that method finds the true arm; its compliances, which it cannot keep from
    being negative, are stated."""
    machine = load_machine("panda_mukca")
    made = simulate_poses(KinematicModel(machine), sockets, random=True, noise=False, seed=0)
    stiffness = {name: value for name, value in made.truth.items() if name.endswith("compliance")}
    right, wrong = (solve(calibration_problem(stating(machine, length), made.poses, fixed=stiffness), "hierarchical")
                    for length in (0.05, 0.053))
    assert not of_kind(right.diagnostics, "link by link off the optimum")
    assert of_kind(wrong.diagnostics, "link by link off the optimum")
    assert wrong.status is Status.SUSPECT


def test_limits_give_way_to_poses_and_intervals_are_held_against_others(sound: Poses) -> None:
    machine = load_machine("cat215b")
    lower, upper = machine.link("boom").joint.range
    short = machine.with_joint_limits({"boom": (lower + 0.2, upper)})
    even = np.arange(POSES) % 2 == 0
    calibration = calibrate(calibration_problem(short, sound.select(even), sound.select(~even)))
    (widened,) = of_kind(calibration.diagnostics, "joint limits widened")
    assert widened.subject == ("boom",)
    angle = calibration.q[:, calibration.problem.model.joints.index("boom")]
    assert calibration.machine.link("boom").joint.range[0] <= np.min(angle) + 0.01
    assert 0.88 < calibration.tested.coverage <= 1
    assert calibration.tested.ratio == pytest.approx(1, abs=0.15)
    assert not of_kind(calibration.diagnostics, "held-out poses beyond their intervals")


@cache
def few(name: str, count: int) -> Poses:
    """Planned postures of a machine."""
    return solve(pose_problem(load_machine(name), count, priors=True), candidates=10).postures


def read_by(name: str, planned: Poses, seed: int, **wrong: tuple[int, float]) -> Calibration:
    """The calibration of a drawn machine from what it reads in planned postures; single rows are off by amounts."""
    machine = load_machine(name)
    table = simulate_poses(KinematicModel(machine), planned, random=True, seed=seed).poses
    channels = dict(table.channels)
    for channel, (row, amount) in wrong.items():
        channels[channel.replace("__", ".")] = channels[channel.replace("__", ".")] + amount * (
            np.arange(len(table)) == row)
    return calibrate(calibration_problem(machine, replace(table, channels=channels)))


@pytest.mark.parametrize("seed", range(5))
def test_few_sound_poses_raise_no_suspicion(seed: int) -> None:
    assert not read_by("tampere_manipulator", few("tampere_manipulator", 4), seed).suspects


@pytest.mark.parametrize("row", range(4))
def test_a_gross_error_among_few_poses_is_named(row: int) -> None:
    found = read_by("tampere_manipulator", few("tampere_manipulator", 4), 1, lift_cylinder__length=(row, 0.1))
    assert [int(np.argmax(each.poses)) for each in found.suspects if each.kind == "pose"] == [row]


@pytest.mark.slow
@pytest.mark.parametrize("row", range(2))
def test_a_reading_that_opens_a_linkage_is_named_by_its_row(row: int) -> None:
    with pytest.raises(SolverError, match=rf"data row {row + 1}: the steps .* farthest from what the machine file"):
        read_by("backhoe", few("backhoe", 6), 6, bucket_cylinder__length=(row, 0.2))
