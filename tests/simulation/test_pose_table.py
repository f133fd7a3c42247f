"""Planned poses of instruments, datums and inclinations, their simulated table, and what it gives back."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from hydroopt.cli import app
from hydroopt.errors import ProblemError
from hydroopt.estimation.kinematic.calibration import calibrate
from hydroopt.estimation.kinematic.problem import calibration_problem
from hydroopt.excitation.selection.exchange import fedorov_exchange
from hydroopt.excitation.selection.pose_plan import PosePlan
from hydroopt.excitation.selection.pose_problem import pose_problem
from hydroopt.logs.poses import read_poses
from hydroopt.machine.machine_file import load_machine
from hydroopt.model.closed_chain import KinematicModel
from hydroopt.simulation.pose_table import simulate_poses
from tests.fixtures.surveyed import TEXT, surveyed


@pytest.fixture(scope="module")
def plan() -> PosePlan:
    return fedorov_exchange(pose_problem(surveyed()[0], 6, setups=("A", "B"), priors=True), candidates=30)


def test_set_ups_and_datums_are_groups_of_a_plan(plan: PosePlan) -> None:
    assert [str(group) for group in plan.problem.groups] == [
        f"set-up '{setup}'{touch}" for setup in "AB"
        for touch in ("", ", touching 'floor.tip'", ", touching 'edge.prism'")]
    assert np.all(np.isfinite(plan.std))
    value = plan.problem.model.over(plan.problem.model.observed, plan.problem.model.parameters.nominal, plan.q,
                                    np.zeros((len(plan.q), plan.problem.model.place_size)))[0][:, :, 0]
    row = plan.problem.model.channels.index("floor.tip.z")
    np.testing.assert_allclose(value[plan.driven.touch == "floor.tip", row], 0, atol=1e-10)


def test_the_sheet_leaves_empty_what_no_sensor_reads(plan: PosePlan) -> None:
    poses, drive = plan.poses, plan.postures
    assert "base_roll.q" not in poses.channels
    assert np.all(np.isnan(poses.channels["station.prism.x"]))
    assert np.all(np.isnan(poses.channels["boom.q"])), "what is planned is no reading"
    np.testing.assert_array_equal(np.isfinite(poses.channels["floor.tip.z"]), plan.driven.touch == "floor.tip")
    assert np.all(np.isfinite(drive.channels["base_roll.q"]))
    assert set(drive.setup) == {"A", "B"}


def test_simulated_poses_give_back_the_truth(plan: PosePlan) -> None:
    machine, model = surveyed()
    found = simulate_poses(model, plan.postures, random=True, noise=False, seed=3)
    assert "base_roll.q" not in found.poses.channels
    solved = calibrate(calibration_problem(machine, found.poses, priors=False))
    names = [name for name in solved.problem.parameters.names if "bias" not in name and "unit" not in name]
    for name in names:  # the accelerometer's bias is drawn, and what is known of it counts
        assert solved[name].value == pytest.approx(found.truth[name], abs=1e-4), name


def test_commands_plan_and_simulate_poses(tmp_path: Path) -> None:
    (tmp_path / "own.toml").write_text(TEXT)

    def run(*arguments: object) -> str:
        done = CliRunner().invoke(app, [*map(str, arguments)], catch_exceptions=False)
        assert done.exit_code == 0, done.output
        return done.stdout

    run("plan-poses", tmp_path / "own.toml", "-n", 4, "--setup", "A", "--candidates", 20, "--priors",
        "-o", tmp_path / "plan")
    printed = run("simulate", tmp_path / "own.toml", "--postures", tmp_path / "plan" / "postures.csv",
                  "--truth", "random", "-o", tmp_path / "log")
    assert "12 poses" in printed
    assert set(read_poses(tmp_path / "log" / "poses.csv").setup) == {"A"}
    assert (tmp_path / "log" / "truth.json").exists()
    with pytest.raises(ProblemError, match="'base_pitch\\.q' is not stated"):
        run("simulate", tmp_path / "own.toml", "--postures", tmp_path / "log" / "poses.csv", "-o", tmp_path / "more")
    with pytest.raises(ProblemError, match="poses are at rest"):
        run("simulate", tmp_path / "own.toml", "--postures", tmp_path / "log" / "poses.csv", "--driven",
            "-o", tmp_path / "rest")


def test_the_survey_of_the_documentation_states_every_measurement() -> None:
    machine = load_machine(Path(__file__).parents[2] / "docs" / "how-to" / "survey.toml")
    assert [each.name for each in KinematicModel(machine).measurements] == [
        *(f"station.{target}" for target in ("stick_prism", "bucket_prism", "mark_1", "mark_2", "mark_3")), "plate.tip",
        "rail.tip", "tape.length", "chassis_tilt.inclination", "stick_unit.accel"]
    assert machine.link("chassis").parent == "base_roll"


@pytest.mark.slow
def test_the_table_is_filled_in_in_the_units_of_the_sheet(plan: PosePlan, tmp_path: Path) -> None:
    """A person writes degrees and millimetres where the header says so, which does not change the calibration."""
    factors = {"deg": 180 / np.pi, "mm": 1e3, "m/s^2": 1.0}
    machine, model = surveyed()
    read = simulate_poses(model, plan.postures, random=True, noise=False, seed=3).poses
    plan.save(tmp_path)
    with (tmp_path / "poses.csv").open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    units = {header.partition(" [")[0]: header.partition(" [")[2].rstrip("]") for header in rows[0] if " [" in header}
    assert set(units.values()) == {"deg", "mm", "m/s^2"}
    for channel, unit in units.items():
        assert f"{channel} [{unit}]" in plan.sheet(), "what is to be read stands on the sheet"
        for row, value in zip(rows, read.channels.get(channel, np.full(len(rows), np.nan)), strict=True):
            row[f"{channel} [{unit}]"] = "" if np.isnan(value) else repr(float(factors[unit] * value))
    with (tmp_path / "filled.csv").open("w", encoding="utf-8", newline="") as file:
        writer = csv.DictWriter(file, rows[0])
        writer.writeheader()
        writer.writerows(rows)
    filled = read_poses(tmp_path / "filled.csv")
    for channel in read.channels:
        np.testing.assert_allclose(filled.channels[channel], read.channels[channel], rtol=1e-12)
    ours, theirs = (calibrate(calibration_problem(machine, poses)) for poses in (filled, read))
    assert ours["boom.a"].value == pytest.approx(theirs["boom.a"].value, abs=1e-9)
