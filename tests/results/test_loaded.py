"""An answer that is saved and loaded is of the same class and says the same: one of every kind."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import hydroopt as ho
from hydroopt.checks.motion import check_motion
from hydroopt.checks.postures import check_postures
from hydroopt.control.comparison import compare
from hydroopt.control.setting import ModelVariant, Setting, truth
from hydroopt.excitation.motion.basis import Fourier
from hydroopt.results.answer import KINDS, Answer
from hydroopt.simulation.pose_table import simulate_poses

LIFT = "patu655_lift"
SAYS = ("job", "machine_id", "machine_name", "method", "status", "verdict", "headline", "diagnostics", "findings",
        "contradictions", "refuted", "parameters", "fit", "fit_by_model", "inputs")
"""Attributes of every answer."""


def log(seed: int = 1, machine: str = LIFT, duration: float = 20, rate: float = 20) -> ho.Log:
    return ho.simulate(machine, ho.random_trajectory(machine, duration=duration, rate=rate, seed=seed), seed=seed)


def identification() -> Answer:
    return ho.solve(ho.identification_problem(LIFT, log(1), log(2)), seed=3)


def ridge() -> Answer:
    return ho.solve(ho.identification_problem(LIFT, log(1)), "ridge")


def calibration() -> Answer:
    machine = ho.load_machine("panda_mukca")
    plan = ho.solve(ho.pose_problem(machine, 20), candidates=50)
    poses = simulate_poses(ho.KinematicModel(machine), plan.postures, random=True, noise=False).poses
    return ho.solve(ho.calibration_problem(machine, poses, priors=False))


def sensors() -> Answer:
    return ho.solve(ho.sensor_problem("excavator_imu", [log(1, "excavator_imu", 5, 25)]))


def valves() -> Answer:
    plant, t = ho.Plant(LIFT), np.arange(160) / 50
    driven = ho.drive(plant, t, 5.7 + np.cos(2 * t)[:, None], np.array([0.2]), seed=1)
    return ho.solve(ho.hydraulic_problem(plant.machine, [driven]))


def combined() -> Answer:
    return ho.solve(ho.combined_problem("mini_excavator", log(1, "mini_excavator", 20, 25)))


def excitation() -> Answer:
    return ho.solve(ho.excitation_problem(LIFT, Fourier(period=6.0, harmonics=2)), starts=1, seed=2)


def pose_plan() -> Answer:
    return ho.solve(ho.pose_problem("panda_mukca", 8), candidates=30)


def measure_up() -> Answer:
    machine = ho.load_machine(Path(__file__).parents[2] / "docs/how-to/measure_up.toml")
    return ho.solve(ho.measure_up_problem(machine, tip=0.05))


def calibrator() -> Answer:
    problem = ho.calibrator_problem("cat215b", 6, links=(4, 4))
    return ho.solve(problem, starts=1, effort=0.02)


def what_next() -> Answer:
    return ho.solve(ho.what_next_problem(LIFT, targets={"force": 0.01}))


def change() -> Answer:
    return ho.compare(LIFT, [log(1), log(2)])


def history() -> Answer:
    return ho.compare(LIFT, [log(seed) for seed in range(4)])


def payload() -> Answer:
    return ho.payload(LIFT, [log(1)], [log(2)], link="lift")


def weighing() -> Answer:
    known, empty = (log(seed, duration=30, rate=50) for seed in (1, 2))
    scale = ho.scale(LIFT, known, ho.CarriedLoad("lift", (3.0, 0.0, 0.0), (0.05, 0.05, 0.05), full_scale=1000.0))
    return ho.weigh(scale, empty, tare=10.0)


def comparison() -> Answer:
    plant = ho.Plant(LIFT)
    motion = ho.random_trajectory(plant.model, duration=14, rate=20, seed=1, slowest=0.05, fastest=0.15)
    true = truth("nominal", plant, seed=0)
    setting = Setting(plant, motion, true.variant, true.theta, plant.parameters.nominal, rate=50)
    return compare(setting, [ModelVariant("complete", "the machine file", plant.model, true.variant.psi)],
                   ["feedforward"])


def log_check() -> Answer:
    return ho.check_logs(LIFT, [log(1)])


def motion_check() -> Answer:
    return check_motion(LIFT, log(1))


def posture_check() -> Answer:
    q = {"swing.q": [0.0, 0.0], "boom.q": [-0.5, 0.4], "stick.q": [1.4, 1.4]}
    return check_postures("cat215b", ho.Poses("two", channels={name: np.array(x) for name, x in q.items()}))


SOLVED: dict[str, tuple[Callable[[], Answer], ...]] = {
    "Estimate": (identification, ridge), "CombinedEstimate": (combined,), "Calibration": (calibration,),
    "SensorCalibration": (sensors,), "HydraulicEstimate": (valves,), "Excitation": (excitation,),
    "PosePlan": (pose_plan,), "MeasureUpPlan": (measure_up,), "CalibratorDesign": (calibrator,),
    "WhatNext": (what_next,), "SessionComparison": (change, history), "Payload": (payload,),
    "Weighing": (weighing,), "Comparison": (comparison,), "LogCheck": (log_check,), "MotionCheck": (motion_check,),
    "PostureCheck": (posture_check,)}
LONG = (calibration, calibrator, combined, comparison, excitation, measure_up, sensors, weighing,
        what_next)


def same(one: Any, other: Any) -> bool:
    """Whether two values are equal, NaN to NaN."""
    if isinstance(one, np.ndarray | float):
        return bool(np.array_equal(one, other, equal_nan=True))
    return bool(one == other)


def test_every_kind_is_tried() -> None:
    assert SOLVED.keys() == KINDS.keys()


@pytest.mark.parametrize("solved", [
    pytest.param(each, id=each.__name__, marks=[pytest.mark.slow] if each in LONG else [])
    for made in SOLVED.values() for each in made])
def test_what_is_loaded_is_of_the_same_class_and_says_the_same(solved: Callable[[], Answer], tmp_path: Path) -> None:
    answer = solved()
    answer.save(tmp_path / "out", wall_s=1.5)
    before = {file: file.read_bytes() for file in tmp_path.rglob("*") if file.is_file()}
    loaded = ho.load(tmp_path / "out")
    assert isinstance(loaded, type(answer))
    assert (repr(loaded), str(loaded)) == (repr(answer), str(answer))
    for name in SAYS:
        assert getattr(loaded, name) == getattr(answer, name), name
    assert loaded.claims == answer.verdict.claims
    assert {*loaded.next_steps} <= {*answer.verdict.next_steps}
    assert loaded.details() == json.loads(json.dumps(answer.details()))
    assert loaded.to_frame().equals(answer.to_frame())
    assert loaded.fit_to_frame().equals(answer.fit_to_frame())
    if solved is ridge:
        for each in (answer, loaded):
            with pytest.raises(ho.ProblemError):
                _ = each.machine
    else:
        assert ho.dump_machine(loaded.machine) == ho.dump_machine(answer.machine)
        assert loaded.plot.machine().axes
        assert loaded.view().machine_name == answer.machine_name
    fields = [name for name in type(answer).__dataclass_fields__ if name != "machine"]
    held = [name for name in fields if hasattr(loaded, name)]
    assert all(same(getattr(loaded, name), getattr(answer, name)) for name in held)
    for name in {*fields} - {*held}:  # never the default of the class
        with pytest.raises(AttributeError, match="solve the problem again"):
            getattr(loaded, name)
    assert loaded.card().html() == answer.card().html()
    loaded.save(tmp_path / "again", wall_s=1.5)
    assert {file.name: file.read_bytes() for file in (tmp_path / "again").rglob("*")} == {
        file.name: file.read_bytes() for file in (tmp_path / "out").rglob("*")}
    assert all(file.read_bytes() == content for file, content in before.items())


def test_numbers_that_json_lacks_come_back(tmp_path: Path) -> None:
    answer = replace(ridge(), seed=7)
    answer.save(tmp_path)
    loaded = ho.load(tmp_path)
    assert loaded.seed == 7
    assert np.isnan(loaded.std).any()
    assert loaded.psi.dtype == float
    assert loaded.notes == answer.notes
