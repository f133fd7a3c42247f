"""`hydroopt control` from the command line: what the folder holds, and that its parts agree."""

from __future__ import annotations

import csv
import json
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from fixtures.bad_control_cases import path
from fixtures.pages import data_of, stands_alone
from hydroopt import cli, load_machine
from hydroopt.logs.log_files import read_log
from hydroopt.results.answer import load
from hydroopt.results.json_file import Job
from hydroopt.results.status import Status


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    place = tmp_path_factory.mktemp("control")
    (place / "path.csv").write_text(path(duration=6.0))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sys, "argv", ["hydroopt", "control", "patu655_lift", "--motion", str(place / "path.csv"),
                                    "-o", str(place / "out"), "--seed", "3", "--quiet",
                                    "--controller", "pi", "--controller", "feedforward", "--controller", "lqg"])
        with pytest.raises(SystemExit) as ended:
            cli.main()
        assert ended.value.code == 0
    return place / "out"


@pytest.fixture(scope="module")
def content(folder: Path) -> dict:
    return json.loads((folder / "control.json").read_text("utf-8"))


def test_every_candidate_was_tried_and_the_best_is_named(content: dict) -> None:
    names = [one["name"] for one in content["candidates"]]
    assert names == ["PI with gravity compensation", "PI with gravity and speeds", "feedforward reduced",
                     "feedforward complete", "feedforward true", "LQG"]
    best = min((one for one in content["candidates"] if one["parameters"] != "true"), key=lambda one: one["tip"]["rms"])
    assert content["winner"] == best["name"]
    assert content["machine"]["name"] == "patu655_lift"
    assert content["rate"] == 100.0
    assert all(one["stopped"] is None for one in content["candidates"])
    for one in content["candidates"]:
        assert 0 < one["lowest_supply"] <= 9.2e6 < 2 * one["peak_pressure"]
        for loop in one["loops"]:
            assert loop["least_gain_margin"]["gain_margin_db"] > 6
            assert loop["least_phase_margin"]["phase_margin_deg"] > 45
            assert loop["least_disk_margin"]["disk_margin"] > 0.5
            assert loop["least_damping_margin"]["damping"] > 0
    lost = {one["parameter"]: one for one in content["lost_margins"]}
    assert 0 < lost["lift_cylinder.rated_flow"]["lost"] < lost["lift_cylinder.rated_flow"]["disk"] < 2


def test_tables_say_what_the_runs_show(folder: Path, content: dict) -> None:
    """RMS errors again from the columns of runs.csv."""
    with (folder / "runs.csv").open(encoding="utf-8") as file:
        header, *rows = csv.reader(file)
    columns = dict(zip(header, np.array(rows, float).T, strict=True))
    wanted = columns["lift.q [rad]"]
    with (folder / "tracking.csv").open(encoding="utf-8") as file:
        table = {row["controller"]: float(row["rms"]) for row in csv.DictReader(file)}
    for one in content["candidates"]:
        run = columns[f"{one['name'].replace(' ', '_')}.lift.q [rad]"]
        rms = float(np.sqrt(np.mean((run - wanted) ** 2)))
        assert rms == pytest.approx(one["joints"][0]["rms"], rel=1e-6)
        assert rms == pytest.approx(table[one["name"]], rel=1e-6)
        commands = columns[f"{one['name'].replace(' ', '_')}.lift_cylinder.u [V]"]
        assert np.all((commands >= 3.9) & (commands <= 7.5))
    asked = read_log(folder.parent / "path.csv")
    # a log is smoothed before it is followed, well within what its sensor is off
    assert np.max(np.abs(np.interp(columns["t [s]"], asked.t, asked.channel("lift.q")) - wanted)) < np.radians(0.1)
    with (folder / "margins.csv").open(encoding="utf-8") as file:
        margins = list(csv.DictReader(file))
    assert {row["controller"] for row in margins} == set(table)
    assert {row["loop"] for row in margins} == {load_machine("patu655_lift").actuators[0].name}


def test_the_report_needs_nothing_else(folder: Path, content: dict) -> None:
    page = (folder / "report.html").read_text("utf-8")
    assert stands_alone(page)
    drawn = data_of(page)
    assert {chart["kind"] for chart in drawn["charts"]} == {"time", "curves", "plane"}
    # errors, pressures and command, Bode, Nyquist, step, poles of the cascade and of LQG
    assert len(drawn["charts"]) == 2 + 2 + 2 + 1 + 1 + 2
    assert drawn["scene"]["replayed"] == ["lift.q"]
    assert re.findall(r"<h2>(.*?)</h2>", page)[-3:] == ["Tracking", "Loops", "On the machine"]
    for one in content["candidates"]:
        assert one["name"] in page


def test_the_exported_feedforward_tests_itself(folder: Path) -> None:
    done = subprocess.run(["make", "check", "CFLAGS=-O0"], cwd=folder / "c", capture_output=True, text=True,
                          timeout=120, check=False)
    assert done.returncode == 0, done.stderr
    assert "self-test passed" in done.stdout
    assert "valve_feedforward" in (folder / "c" / "patu655_lift.h").read_text("utf-8")


def test_the_answer_is_loaded(folder: Path, content: dict) -> None:
    answer = load(folder)
    assert answer.job == Job.CONTROL
    assert answer.status is Status.OK
    assert answer["lift_cylinder.position_gain"].value > 0
    for one in content["candidates"]:
        assert answer.fit[one["name"]]["lift.q"].rms == pytest.approx(one["joints"][0]["rms"])
    assert answer.details()["winner"] == content["winner"]
    assert {"tracking.csv", "margins.csv", "runs.csv"} <= answer.files().keys()
