"""Compliant joints chosen by held-out poses: found where they give way, not where they are stiff."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from hydroopt.cli import app
from hydroopt.errors import ProblemError
from hydroopt.estimation.kinematic.calibration import calibrate
from hydroopt.estimation.kinematic.compliance_choice import choose_compliance, compliant, with_compliance
from hydroopt.estimation.kinematic.problem import calibration_problem
from hydroopt.excitation.selection.exchange import fedorov_exchange
from hydroopt.excitation.selection.pose_problem import pose_problem
from hydroopt.logs.poses import Poses
from hydroopt.machine.machine import Machine
from hydroopt.machine.machine_file import load_machine
from hydroopt.model.closed_chain import KinematicModel
from hydroopt.results.answer import load
from hydroopt.results.status import Status
from hydroopt.results.verdict import Action
from hydroopt.simulation.pose_table import simulate_poses
from hydroopt.spatial.inertia import Array

SOFT = "panda_joint2"
COMPLIANCE = 1e-4
"""Of the soft joint [rad/(N·m)]: about 0.3 degrees under the arm's weight."""


@pytest.fixture(scope="module")
def machine() -> Machine:
    return load_machine("panda_mukca")


@pytest.fixture(scope="module")
def planned(machine: Machine) -> Poses:
    return fedorov_exchange(pose_problem(machine, 30), candidates=60).postures


def measured(machine: Machine, planned: Poses, compliance: float, seed: int) -> Poses:
    stiff = with_compliance(machine, {SOFT: COMPLIANCE}).with_values({f"{SOFT}.compliance": compliance})
    return simulate_poses(KinematicModel(stiff), planned, seed=seed).poses


def sensed(chain: KinematicModel, poses: Poses) -> Array:
    return np.column_stack([poses.channels[f"{joint}.q"] for joint in chain.joints])


@pytest.mark.slow
def test_a_soft_joint_is_found(machine: Machine, planned: Poses) -> None:
    choice = choose_compliance(machine, measured(machine, planned, COMPLIANCE, 1))
    assert choice.joints == (SOFT,)
    assert choice.candidates[1].difference < 0
    assert choice.candidates[1].evidence > 4
    assert not choice.candidates[-1].chosen
    assert choice.detectable[SOFT] < np.radians(0.15)
    assert f"{SOFT} from 0.1" in str(choice)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [4, 5, 6])
def test_a_sag_that_would_show_is_found(machine: Machine, planned: Poses, seed: int) -> None:
    """The least one that is said to show: squared errors alone would have to be twice as clear."""
    poses = measured(machine, planned, 4.6e-5, seed)
    choice = choose_compliance(machine, poses)
    chain = KinematicModel(machine)
    torques = chain.over(chain.gravity_torque, chain.parameters.nominal, sensed(chain, poses))[0][:, 1, 0]
    assert 4.6e-5 * np.abs(torques).max() == pytest.approx(choice.detectable[SOFT], rel=0.1)
    assert SOFT in choice.joints


@pytest.mark.slow
def test_a_stiff_arm_is_left_stiff(machine: Machine, planned: Poses) -> None:
    poses = measured(machine, planned, 0.0, 1)
    choice = choose_compliance(machine, poses)
    assert with_compliance(load_machine("cat215b"), {}).source == "cat215b"
    assert choice.joints == ()
    chosen = compliant(machine, poses, choice.joints)
    assert not [name for name in KinematicModel(chosen).parameters.names if name.endswith("compliance")]


def test_chosen_joints_are_parameters(machine: Machine, planned: Poses) -> None:
    poses = measured(machine, planned, COMPLIANCE, 1)
    problem = calibration_problem(compliant(machine, poses, [SOFT]), poses)
    assert [name for name in problem.parameters.names if name.endswith("compliance")] == [f"{SOFT}.compliance"]
    with pytest.raises(ProblemError, match="no joint 'elbow'"):
        compliant(machine, poses, ["elbow"])


@pytest.mark.slow
def test_a_sag_that_was_left_out_is_taken_in_next(machine: Machine, planned: Poses) -> None:
    stiff, poses = with_compliance(machine, {}), measured(machine, planned, COMPLIANCE, 1)
    answer = calibrate(calibration_problem(stiff, poses))
    assert answer.status is Status.SUSPECT
    assert answer.next_steps[0].text.startswith("Take in joints that give way under gravity")
    assert not any(step.action is Action.USE for step in answer.next_steps)
    right = calibrate(calibration_problem(compliant(stiff, poses, [SOFT]), poses))
    assert right.status is Status.OK
    assert right.next_steps[-1].action is Action.USE


def test_bodies_are_needed(machine: Machine, planned: Poses) -> None:
    poses = measured(machine, planned, 0.0, 1)
    with pytest.raises(ProblemError, match="gravity loads no joint"):
        choose_compliance(with_compliance(machine, {}).model_copy(update={"gravity": 0.0}), poses)


@pytest.mark.slow
def test_the_command_says_what_it_chose(machine: Machine, planned: Poses, tmp_path: Path) -> None:
    table = tmp_path / "poses.csv"
    table.write_bytes(measured(machine, planned, COMPLIANCE, 1).encoded())
    run = CliRunner().invoke(app, ["calibrate", "panda_mukca", str(table), "--compliance", "auto", "-o",
                                   str(tmp_path / "out")])
    assert f"* {SOFT}" in run.output
    saved = load(tmp_path / "out")
    assert saved.details()["compliance_choice"]["joints"] == [SOFT]
    assert float(saved.parameters[f"{SOFT}.compliance"]) == pytest.approx(COMPLIANCE, rel=0.3)
    assert not [name for name, _ in saved.parameters.items() if name.endswith("compliance") and SOFT not in name]
