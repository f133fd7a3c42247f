"""A table is planned or measured as a whole: it is asked once, whatever is left out or held out afterwards."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hydroopt import Poses, calibration_problem, load_machine, pose_problem, solve
from hydroopt.errors import ProblemError
from hydroopt.estimation.kinematic.calibration import calibrate, without_suspects

MACHINE = load_machine("panda_mukca")


@pytest.fixture(scope="module")
def planned() -> Poses:
    return solve(pose_problem(MACHINE, 25), candidates=60, seed=1).postures


def disturbed(planned: Poses, some: np.ndarray) -> Poses:
    """Exact readings but for some poses, which are off by a degree in two joints."""
    rng, off = np.random.default_rng(3), np.radians(1)
    return replace(planned, channels=planned.channels | {name: planned.channels[name] + np.where(
        some, off * rng.choice([-1.0, 1.0], len(planned)), 0.0) for name in ("panda_joint5.q", "panda_joint6.q")})


def test_what_is_left_of_measured_poses_may_be_exact(planned: Poses) -> None:
    some = np.arange(len(planned)) % 8 == 3
    table = disturbed(planned, some)
    found = calibrate(calibration_problem(MACHINE, table))
    assert np.all(found.suspicious == some)
    assert len(without_suspects(found).problem.poses) == np.sum(~some)
    held_out = calibrate(calibration_problem(MACHINE, table.select(~some), table.select(some)))
    assert held_out.fit["validation"]


def test_what_is_exact_as_a_whole_is_planned(planned: Poses) -> None:
    some = np.arange(len(planned)) % 8 == 3
    for poses in ((planned,), (planned.select(~some), planned.select(some))):
        with pytest.raises(ProblemError, match="planned, not measured"):
            calibrate(calibration_problem(MACHINE, *poses))
