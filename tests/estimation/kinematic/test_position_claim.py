"""The verdict of a calibration claims a position error of the tip: it holds on machines whose geometry is drawn."""

from __future__ import annotations

import numpy as np
import pytest

from hydroopt.estimation.kinematic.accuracy import machine_end
from hydroopt.estimation.kinematic.calibration import calibrate
from hydroopt.estimation.kinematic.problem import calibration_problem
from hydroopt.excitation.selection.exchange import fedorov_exchange
from hydroopt.excitation.selection.pose_problem import pose_problem
from hydroopt.machine.machine_file import load_machine
from hydroopt.model.closed_chain import KinematicModel
from hydroopt.results.verdict import Purpose, Usable
from hydroopt.simulation.pose_table import simulate_poses


@pytest.mark.slow
def test_the_tip_lies_within_the_figure() -> None:
    """95 % are claimed of the worst posture, so that on average over all postures more hold."""
    machine = load_machine("panda_mukca")
    model = KinematicModel(machine)
    plan = fedorov_exchange(pose_problem(machine, 20), candidates=200, seed=1)
    low, high = model.ranges.T
    within, dimensions = [], []
    for seed in range(12):
        made = simulate_poses(model, plan.postures, random=True, seed=seed)
        found = calibrate(calibration_problem(machine, made.poses), "joint", seed=seed)
        (claim,) = [claim for claim in found.verdict.claims if claim.purpose is Purpose.POSITION]
        assert claim.bound is not None
        names = found.problem.parameters.names
        true = np.array([made.truth.get(name, value) for name, value in zip(names, found.theta, strict=True)])
        q = np.random.default_rng(seed).uniform(low, high, (100, len(low)))
        own = found.problem.model
        count, (_, function) = len(own.parameters), machine_end(own)
        tip, truth = (own.over(function, theta[:count], q)[0][:, :, 0] for theta in (found.theta, true))
        within.append(float(np.mean(np.linalg.norm(tip - truth, axis=1) <= claim.bound)))
        dimensions += [abs(found.theta[names.index(each.subject)] - made.truth[each.subject]) <= each.figure
                       for each in found.verdict.claims if each.purpose is Purpose.LENGTH
                       and each.usable is Usable.YES and each.figure and each.subject in made.truth]
    assert np.mean(within) >= 0.95
    assert len(dimensions) > 100
    assert np.mean(dimensions) >= 0.9
