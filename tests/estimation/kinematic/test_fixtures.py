"""Fixtures that are no balls, and tapes that end at a fixture which does not hold the tip."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hydroopt.errors import HydrooptError, ProblemError
from hydroopt.estimation.kinematic import link_by_link
from hydroopt.estimation.kinematic.calibration import calibrate
from hydroopt.estimation.kinematic.maximum_likelihood import maximum_likelihood
from hydroopt.estimation.kinematic.mobility import mobility
from hydroopt.estimation.kinematic.problem import CalibrationProblem, calibration_problem
from hydroopt.logs.poses import Poses
from hydroopt.machine.calibration_chain import CLOSES, Fixture
from hydroopt.machine.links import Note
from hydroopt.machine.machine import Machine
from hydroopt.machine.machine_file import load_machine
from hydroopt.machine.sensors import Sensor
from hydroopt.model.closed_chain import KinematicModel
from hydroopt.simulation import postures
from hydroopt.spatial.poses import roll_pitch_yaw

MIDDLE = np.array([0.2, 0.4, -0.1, -2.2, 0.1, 2.5, 0.6])
FREE = ("panda_joint3.d", "panda_joint4.theta", "panda_joint6.theta")
TAPE = Sensor(channels=("panda_joint7.distance",), accuracy=1e-3, distribution="gaussian")


def arm(*fixtures: Fixture, sensors: tuple[Sensor, ...] = ()) -> Machine:
    """The bundled arm in other fixtures, whose places are not known."""
    machine = load_machine("panda_mukca")
    notes = {f"{each.name}.{key}": Note(sigma=0.05) for each in fixtures for key in ("position", "orientation")}
    return machine.model_copy(update={"fixtures": fixtures, "distances": (), "notes": {**machine.notes, **notes},
                                      "sensors": (*machine.sensors, *sensors)})


def stands(kind: str) -> Fixture:
    """Where the tool is in the middle posture."""
    model = KinematicModel(arm(Fixture(name="bench", kind=kind, position=(0, 0, 0))))
    g = model.parameters.nominal
    tip, turn = np.asarray(model.tip(g, MIDDLE)).ravel(), np.asarray(model.moved_tip(g, MIDDLE, np.zeros(6))[1])
    angles = np.arctan2(turn[2, 1], turn[2, 2]), -np.arcsin(turn[2, 0]), np.arctan2(turn[1, 0], turn[0, 0])
    np.testing.assert_allclose(np.asarray(roll_pitch_yaw(angles)), turn, atol=1e-12)
    return Fixture(name="bench", kind=kind, position=tuple(tip), orientation=angles)


def measured(kind: str, count: int = 40) -> tuple[CalibrationProblem, np.ndarray, np.ndarray]:
    """Poses without noise, of which a few numbers and the fixture's place are unknown; the truth; joint vectors."""
    fixture = stands(kind)
    model = KinematicModel(machine := arm(fixture))
    start = MIDDLE + np.random.default_rng(0).normal(0, 0.4, (2 * count, 7))
    q, good = postures.close(model, model.parameters.nominal, start, range(7), fixture)
    q = q[good][:count]
    assert len(q) == count
    poses = postures.record(model, q, [""] * count, ["bench"] * count, geometry=model.parameters.nominal, seed=None)
    problem = calibration_problem(machine, poses, priors=False)
    held = {name: problem.start[k] for k, name in enumerate(problem.parameters.names)
            if name not in FREE and not name.startswith("bench")}
    if kind == "plane":  # a point of it, and the turn about its normal
        held |= {name: problem.start[problem.parameters.index(name)] for name in ("bench.x", "bench.y", "bench.yaw")}
    if kind == "hinge":
        held |= {"bench.yaw": problem.start[problem.parameters.index("bench.yaw")]}
    return problem.fixing(**held), problem.start, q


@pytest.mark.parametrize("kind", ["hinge", "rigid", "plane"])
def test_a_fixture_of_any_kind_gives_back_the_arm_and_its_own_place(kind: str) -> None:
    problem, truth, q = measured(kind)
    assert problem.layout.present[:, : problem.model.loop_rows].sum() == len(q) * len(CLOSES[kind])
    off = np.where(np.array(problem.parameters.units) == "m", 0.01, 0.03) * problem.free
    found, angles = maximum_likelihood(problem, truth + off, problem.layout.reading)
    np.testing.assert_allclose(found[problem.free], truth[problem.free], rtol=0, atol=1e-7)
    np.testing.assert_allclose(angles, q, rtol=0, atol=1e-7)


@pytest.mark.parametrize("kind", ["hinge", "rigid", "plane"])
def test_jacobians_of_a_fixture_agree_with_differences(kind: str) -> None:
    problem, truth, q = measured(kind, count=3)
    theta, angles = truth + 0.01, q + 0.02
    _, by_theta, by_q = problem.rows(theta, angles)
    for k in range(len(theta)):
        step = 1e-6 * np.eye(len(theta))[k]
        slope = (problem.rows(theta + step, angles)[0] - problem.rows(theta - step, angles)[0]) / 2e-6
        np.testing.assert_allclose(by_theta[:, :, k], slope, atol=1e-8)
    for k in range(7):
        step = 1e-6 * np.eye(7)[k]
        slope = (problem.rows(theta, angles + step)[0] - problem.rows(theta, angles - step)[0]) / 2e-6
        np.testing.assert_allclose(by_q[:, :, k], slope, atol=1e-8)


@pytest.mark.parametrize(("kind", "freedoms"), [("ball", 3), ("hinge", 1), ("rigid", 0), ("plane", 5)])
def test_mobility_counts_the_fixture_s_freedoms(kind: str, freedoms: int) -> None:
    """Eq. 3.5 for seven joints, against the rank of the loop."""
    fixture = stands("hinge").model_copy(update={"kind": kind} | ({"orientation": (0, 0, 0)} if kind == "ball" else {}))
    stage = mobility(arm(fixture)).stages[0]
    assert (stage.grubler, stage.rank_mobility) == (7 + freedoms - 6, 7 + freedoms - 6)


def test_the_answer_tells_the_turn_s_residual() -> None:
    problem, _, q = measured("hinge")
    noisy = postures.record(problem.model, q, [""] * len(q), ["bench"] * len(q),
                            geometry=problem.model.parameters.nominal, seed=1)
    solved = calibrate(calibration_problem(problem.model.machine, noisy, priors=False).fixing(**problem.fixed))
    assert solved.fit["train"]["turn"].unit == "rad"
    assert 1e-5 < solved.fit["train"]["turn"].rms < 1e-2
    assert set(solved.residuals[0].after) == {"gap", "turn"}
    assert 0.8 < solved.noise_scale < 1.2


def test_link_by_link_knows_balls_only() -> None:
    problem, truth, _ = measured("hinge")
    with pytest.raises(ProblemError, match="knows balls only"):
        link_by_link.sequential_least_squares(problem, truth, problem.layout.reading)


@pytest.mark.parametrize(("stated", "sentence"), [
    ({"kind": "ball", "orientation": (0.1, 0, 0)}, "has no orientation"),
    ({"kind": "plane", "tilt": 0.1}, "holds no turn")])
def test_a_fixture_states_what_its_kind_has(stated: dict[str, object], sentence: str) -> None:
    with pytest.raises((HydrooptError, ValueError), match=sentence):
        Fixture.model_validate({"name": "bench", "position": (0.0, 0.0, 0.0)} | stated)


@pytest.mark.parametrize("held", ["", "one"])
def test_a_tape_ends_at_its_own_fixture_whether_or_not_that_holds_the_tip(held: str) -> None:
    """Without a ball in any socket the tape alone tells where it ends; with one it tells about another fixture."""
    one, two = (Fixture(name=name, position=place) for name, place in (("one", (0.5, 0.1, 0.3)), ("two", (0, 1, 0))))
    model = KinematicModel(machine := arm(one, two, sensors=(TAPE,)))
    g = model.parameters.nominal
    q = MIDDLE + np.random.default_rng(0).normal(0, 0.4, (60, 7))
    if held:
        q, good = postures.close(model, g, q, range(7), one)
        q = q[good]
    count = len(q)
    poses = postures.record(model, q, [""] * count, [held] * count, tape=["two"] * count, geometry=g, seed=None,
                            channels=[*(f"{name}.q" for name in model.joints), "panda_joint7.distance"])
    problem = calibration_problem(machine, poses, priors=False)
    assert bool(problem.layout.present[:, :3].any()) == bool(held)
    problem = problem.fixing(**{name: problem.start[k] for k, name in enumerate(model.parameters.names)})
    names = [name for name, free in zip(problem.parameters.names, problem.free, strict=True) if free]
    assert names == [f"{name}.{axis}" for name in ([held] if held else []) + ["two"] for axis in "xyz"]
    found, _ = maximum_likelihood(problem, problem.start + 0.05 * problem.free, problem.layout.reading)
    np.testing.assert_allclose(found, problem.start, rtol=0, atol=1e-7)


def test_a_tape_without_an_end_is_refused() -> None:
    one, two = (Fixture(name=name, position=(0.5, 0.1, 0.3)) for name in ("one", "two"))
    machine = arm(one, two, sensors=(TAPE,))
    angles = {f"panda_joint{k}.q": np.zeros(1) for k in range(1, 8)}
    poses = Poses("tapes", channels={**angles, "panda_joint7.distance": np.array([0.4])})
    with pytest.raises(ProblemError, match="does not say at which fixture it ends"):
        calibration_problem(machine, poses)
    assert calibration_problem(machine, replace(poses, tape=np.array(["two"]))).layout.place[0, -1] >= 0
