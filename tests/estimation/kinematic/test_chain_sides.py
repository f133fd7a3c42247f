"""Distances from both sides of the closed chain: which side a wrong sensor spoils, and where they are reported."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hydroopt.estimation.kinematic.calibration import calibrate
from hydroopt.estimation.kinematic.problem import calibration_problem
from hydroopt.estimation.kinematic.residuals import chain_sides
from hydroopt.logs.poses import Poses
from hydroopt.machine.machine import Machine
from hydroopt.machine.machine_file import load_machine
from hydroopt.machine.sensors import Sensor
from hydroopt.model.closed_chain import KinematicModel
from hydroopt.report.calibration import render
from hydroopt.simulation import postures
from studies import closed_postures

TAPES = ("stick.distance", "grapple.distance")


@pytest.fixture(scope="module")
def machine() -> Machine:
    stated = load_machine("cat215b")
    return stated.model_copy(update={"sensors": (*stated.sensors, Sensor(channels=TAPES, accuracy=5e-3))})


@pytest.fixture(scope="module")
def taped(machine: Machine) -> Poses:
    """19 poses as in Section 3.8.1, the machine's resolvers and the tape read, without noise."""
    model = KinematicModel(machine)
    q = closed_postures.random_postures(model, machine.stages[1], 19, geometry=model.parameters.nominal,
                                 fixture=machine.fixtures[0])
    joints = ("swing", "boom", "stick", "grapple", "yoke", "upper_arm", "forearm")
    return postures.record(model, q, ["boom_moves"] * 19, ["ball"] * 19, geometry=model.parameters.nominal, seed=None,
                           channels=[*(f"{joint}.q" for joint in joints), *TAPES])


def rms(machine: Machine, poses: Poses, **wrong: float) -> dict[tuple[str, str, str], float]:
    channels = dict(poses.channels)
    for joint, angle in wrong.items():
        channels[f"{joint}.q"] = channels[f"{joint}.q"] + angle
    problem = calibration_problem(machine, replace(poses, channels=channels))
    return {(sides.link, *pair): fit.rms for sides in chain_sides(problem, problem.start, "nominal", "train")
            for pair, fit in sides.fits.items()}


def test_perfect_readings_agree_from_both_sides_and_with_the_tape(machine: Machine, taped: Poses) -> None:
    found = rms(machine, taped)
    pairs = {("machine", "tape"), ("calibrator", "tape"), ("machine", "calibrator")}
    assert {key for key in found if key[0] in ("stick", "grapple")} == {
        (link, *pair) for link in ("stick", "grapple") for pair in pairs}
    assert max(found.values()) < 1e-9


@pytest.mark.parametrize(("joint", "right", "wrong"), [("yoke", "machine", "calibrator"),
                                                       ("boom", "calibrator", "machine")])
def test_a_wrong_sensor_spoils_its_own_side(machine: Machine, taped: Poses, joint: str, right: str,
                                            wrong: str) -> None:
    found = rms(machine, taped, **{joint: 0.02})
    assert found["stick", right, "tape"] < 1e-9
    assert found["stick", wrong, "tape"] > 1e-3
    assert found["stick", "machine", "calibrator"] == pytest.approx(found["stick", wrong, "tape"])


def test_a_tape_alone_tells_of_the_machine_s_side_only(machine: Machine, taped: Poses) -> None:
    names = [f"{joint}.q" for joint in ("swing", "boom", "stick")]
    free = Poses("tapes", taped.stage, tape=np.full(19, "ball"),
                 channels={name: taped.channels[name] for name in (*names, "stick.distance")})
    assert rms(machine, free) == {("stick", "machine", "tape"): pytest.approx(0, abs=1e-9)}


@pytest.mark.slow
def test_the_answer_reports_both_sides(machine: Machine, taped: Poses) -> None:
    """Without the machine's resolvers stages tell of no distance; held-out poses with them do."""
    model = KinematicModel(machine)
    q = [closed_postures.random_postures(model, stage, 12, geometry=model.parameters.nominal,
                                         fixture=machine.fixtures[0], seed=k) for k, stage in enumerate(machine.stages)]
    labels = [stage.name for stage in machine.stages for _ in range(12)]
    poses = postures.record(model, np.concatenate(q), labels, ["ball"] * 36, geometry=model.parameters.nominal)
    solved = calibrate(calibration_problem(machine, poses, taped, fixed={"ball.y": 0.0}))
    assert {(sides.role, sides.geometry) for sides in solved.sides} == {("validation", "nominal"),
                                                                       ("validation", "calibrated")}
    assert {entry["link"] for entry in solved.details()["sides"]} >= {"stick", "grapple"}
    rows = solved.files()["sides.csv"].splitlines()
    assert rows[0].startswith("data,row,link,tape [m],machine_nominal [m]")
    assert "stick to the fixture (calibrated, validation), machine against tape" in str(solved)
    assert "Both sides of the chain" in render(solved)
