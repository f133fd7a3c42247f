"""Measure-ups: what is planned reaches the accuracy, cannot do with less, and comes true."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

import hydroopt
from fixtures.sheets import says_what_people_keep
from hydroopt.cli import app
from hydroopt.errors import ProblemError
from hydroopt.estimation.kinematic.accuracy import machine_end
from hydroopt.estimation.kinematic.observability import linearise, observability, spread
from hydroopt.excitation.selection.measure_up import MeasureUpPlan, fewest_readings, measure_up_problem
from hydroopt.machine.machine_file import load_machine
from hydroopt.model.closed_chain import KinematicModel
from hydroopt.results.answer import load
from hydroopt.simulation.pose_table import simulate_poses

FILE = Path(__file__).parents[3] / "docs" / "how-to" / "measure_up.toml"


@cache
def plan(tip: float = 0.02) -> MeasureUpPlan:
    return fewest_readings(measure_up_problem(load_machine(FILE), tip=tip), candidates=20)


def tip_std(done: MeasureUpPlan, taken: np.ndarray) -> float:
    """Of the tip [m] over another sample of the workspace, by a calibration of a table with these readings alone."""
    machine = load_machine(FILE)
    model = KinematicModel(machine)
    made = simulate_poses(model, done.postures, noise=False, seed=0)
    channels = dict(made.poses.channels)
    for r, each in enumerate(done.readings):
        for name in each.channels:
            channels[name] = np.where(taken[:, r], channels[name], np.nan)
    problem = hydroopt.calibration_problem(machine, replace(made.poses, channels=channels))
    seen = observability(problem, linearise(problem, problem.parameters.nominal, done.q))
    q = np.random.default_rng(5).uniform(*model.ranges.T, (2000, len(model.joints)))
    by_g = model.over(machine_end(model)[1], model.parameters.nominal, q)[1]
    return float(np.sqrt(np.mean(spread(model, seen, by_g) ** 2)))


@pytest.mark.slow
def test_the_accuracy_is_that_of_a_calibration_of_the_filled_in_table() -> None:
    done = plan()
    assert done.tip <= done.target < done.tip_before
    assert tip_std(done, done.taken) == pytest.approx(done.tip, rel=0.05)  # another sample of the workspace


@pytest.mark.slow
def test_no_reading_is_superfluous() -> None:
    done = plan()
    by_hand = np.array([each.by_hand for each in done.readings])
    touch = [each.name for each in done.readings].index("plate.tip")
    for k, r in np.argwhere(done.taken & by_hand):
        fewer = done.taken.copy()
        fewer[k, r] = False
        fewer[k] &= r != touch  # the machine stands there for the sake of the plate
        assert tip_std(done, fewer) > 0.98 * done.target  # 2 % for the other sample of the workspace


@pytest.mark.slow
def test_a_better_tip_takes_more_and_readings_that_cost_nothing_come_first() -> None:
    assert plan(0.01).minutes > plan(0.02).minutes
    machine = load_machine(FILE)
    free = fewest_readings(measure_up_problem(machine, tip=0.02, minutes={"station.stick_prism": 30.0}), candidates=20)
    assert not free.taken[:, [each.name for each in free.readings].index("station.stick_prism")].any()


def test_the_sheet_names_what_is_read_along() -> None:
    assert "In every posture, record along: swing.q, boom.q, stick.q, bucket.q.\n" in plan().sheet()
    free = measure_up_problem(load_machine(FILE), tip=0.02, minutes={"tape.length": 0.0})
    assert "bucket.q, tape.length.\n" in fewest_readings(free, candidates=20).sheet()


def test_the_sheet_keeps_people_safe() -> None:
    """Distances, machine at rest, and the values beyond which no one may go, as on all sheets of measurements."""
    done = plan()
    says_what_people_keep(done.sheet(), done.watch)


@pytest.mark.slow
def test_same_seed_same_plan() -> None:
    again = fewest_readings(measure_up_problem(load_machine(FILE), tip=0.02), candidates=20)
    np.testing.assert_array_equal(again.q, plan().q)
    np.testing.assert_array_equal(again.taken, plan().taken)


@pytest.mark.parametrize("seed", range(3))
def test_readings_of_a_plan_make_a_sound_calibration(seed: int) -> None:
    """Few readings, and a plate that is touched once or twice, are neither refused nor suspect."""
    done, machine = plan(), load_machine(FILE)
    made = simulate_poses(KinematicModel(machine), done.postures, random=True, seed=seed)
    channels = dict(made.poses.channels)
    for taken, each in zip(done.taken.T, done.readings, strict=True):
        channels |= {name: np.where(taken, channels[name], np.nan) for name in each.channels}
    answer = hydroopt.solve(hydroopt.calibration_problem(machine, replace(made.poses, channels=channels)))
    assert not answer.suspects


@pytest.mark.slow
def test_a_datum_is_touched_only_where_it_is_read() -> None:
    done = plan(0.01)
    touched = done.taken[:, [each.name for each in done.readings].index("plate.tip")]
    np.testing.assert_array_equal(done.driven.touch == "plate.tip", touched)
    np.testing.assert_array_equal(np.isfinite(done.poses.channels["plate.tip.z"]), touched)


@pytest.mark.slow
def test_the_plan_can_be_saved_loaded_and_read_by_calibrate(tmp_path: Path) -> None:
    ran = CliRunner().invoke(app, ["measure-up", str(FILE), "--tip-std", "10 mm", "-o", str(tmp_path)],
                             catch_exceptions=False)
    assert ran.exit_code == 0
    assert "readings in" in ran.output
    assert load(tmp_path).details()["target_m"] == 0.01
    poses, planned = (hydroopt.read_poses(tmp_path / f"{name}.csv") for name in ("poses", "postures"))
    assert set(poses.channels) >= set(planned.channels)
    for table, words in ((poses, "no reading is filled in"), (planned, "they are planned, not measured")):
        with pytest.raises(ProblemError, match=words):
            hydroopt.solve(hydroopt.calibration_problem(load_machine(FILE), table))


@pytest.mark.parametrize(("machine", "tip", "options", "sentence"), [
    ("cat215b", 0.01, {}, "machine 'cat215b': a fixture holds its tip; plan the poses with plan-poses"),
    ("excavator_imu", 0.01, {}, "nothing is read by hand; state targets with an instrument"),
    ("excavator_bucket", 0.01, {}, "states the tip to 0 mm already; state a 'sigma' for every length"),
    (FILE, 0.0, {}, "tip: the accuracy 0 m of the tip is not positive; give a positive length"),
    (FILE, 1e-5, {}, "leave the tip to .* mm; ask for less, state more accurate sensors"),
    (FILE, 0.01, {"minutes": {"tap": 1.0}}, "minutes of 'tap': the machine states no such reading; use "),
    (FILE, 0.01, {"minutes": {"tape.length": -1.0}}, "-1 min is not a duration")])
def test_bad_input_is_refused_in_one_sentence(machine: object, tip: float, options: dict, sentence: str) -> None:
    with pytest.raises(ProblemError, match=sentence):
        fewest_readings(measure_up_problem(load_machine(machine), tip=tip, **options), candidates=4)


def test_a_machine_of_which_only_the_instruments_place_is_unknown_is_refused() -> None:
    machine = hydroopt.read_machine((FILE.parent / "crane.toml").read_text() + """
[calibrator]
parent = "jib"
[[instruments]]
name = "station"
[[sensors]]
channels = ["lift.q", "jib.q"]
accuracy = "0.1 deg"
[[sensors]]
channels = ["station.tip.x", "station.tip.y", "station.tip.z"]
accuracy = "3 mm"
""")
    with pytest.raises(ProblemError, match="states the tip to 0 mm already; state a 'sigma' for every length"):
        fewest_readings(measure_up_problem(machine, tip=0.01), candidates=4)
