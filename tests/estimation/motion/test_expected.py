"""What is said of IMUs and surveys before anything is measured, against what measurements then give."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

import hydroopt as ho
from hydroopt.cli import app
from hydroopt.estimation.kinematic.mobility import mobility
from hydroopt.estimation.motion.sensor_calibration import expected_calibration
from tests.estimation.motion.test_motion_fit import arm, simulated, truth

SURVEY = Path(__file__).parents[3] / "docs/how-to/survey.toml"


def test_expected_standard_deviations_are_those_of_a_measured_log() -> None:
    """Of the same motion, driven by a machine whose units sit elsewhere, with noise."""
    machine = arm()
    course, log = simulated(truth(machine, 1), 2)
    determined = expected_calibration(machine, course)
    found = ho.solve(ho.sensor_problem(machine, [log], geometry=False))
    expected = {name.rpartition(" ")[2]: each.std for name, each in determined.parameters.items()}
    measured = {name.rpartition(" ")[2]: each.std for name, each in found.parameters.items()}
    assert expected.keys() == measured.keys()
    ratio = np.array([expected[name] / measured[name] for name in expected])
    assert np.all((ratio > 0.8) & (ratio < 1.25))


def test_the_command_says_which_joint_stays_uncertain(capsys) -> None:
    """The angle between the last link and its unit, and the heading of the swing."""
    app(["show", "excavator_imu", "--json"], standalone_mode=False)
    facts = json.loads(capsys.readouterr().out)["imus"]
    spread = {each["joint"]: each["std"] for each in facts["joints"]}
    assert spread["boom"] < np.radians(0.1) > spread["stick"]
    assert spread["bucket"] > np.radians(2.0)
    assert spread["swing"] > np.radians(60.0)
    determined = {each["name"]: each["determined"] for each in facts["numbers"]}
    assert (determined["boom_imu.yaw"], determined["bucket_imu.yaw"]) == ("yes", "partly")
    assert determined["bias of boom_imu.gyro_x"] == "yes"


def test_mobility_knows_targets_datums_tapes_and_inclination() -> None:
    """The bucket's edge is measured: without instruments and datums its own targets and their poses have no trace."""
    machine = ho.load_machine(SURVEY)
    found = mobility(machine)
    assert not found.obstacles
    assert found.surveyed is not None
    assert {"stick_prism.x", "plate.z", "stick_unit.bias_x", "stick.a"} <= {*found.surveyed.full}
    assert "poses measured by station, plate, rail, tape" in found.lines()[0]
    bare = machine.model_copy(update={"instruments": (), "datums": (), "distances": ()})
    less = mobility(type(machine).model_validate(bare.model_dump(exclude={"notes", "sensors"}) | {
        "notes": {path: note for path, note in machine.notes.items()
                  if not path.startswith(("station", "plate", "rail", "tape", "targets"))},
        "sensors": tuple(one for one in machine.sensors if not any(
            name.startswith(("station.", "plate.", "rail.", "tape.")) for name in one.channels))}))
    assert less.surveyed is None or "stick_prism.x" not in less.surveyed.full
