"""The 69 URDF files of the package example-robot-data: they load or are refused with a true reason, as Pinocchio has
them. The package is not a dependency: ``pip install --no-deps example-robot-data``."""

from __future__ import annotations

from importlib.metadata import PackageNotFoundError, files
from pathlib import Path

import numpy as np
import pytest

from fixtures.tiers import tiered
from fixtures.tools import Package
from hydroopt.errors import MachineError
from hydroopt.machine.machine_file import load_machine
from hydroopt.model.model import Model
from oracles.pinocchio_urdf import PinocchioUrdf

REASONS = {
    "alex_psyonic_hands": r"joint 'Left_index_q2': it mimics 'index_q1', which is not a joint",
    "centauro": r"joint 'j_wheel_1': its limits are missing",
    "double_pendulum": r"joint 'joint1': the lower limit, 0, is not below the upper one, 0",
    "double_pendulum_simple": r"joint 'joint1': the lower limit, 0, is not below the upper one, 0",
    "iris_simple": r"no joint moves",
    "quadruped": r"joint '\w+': its limits are missing",
    "quadrotor_base": r"it has no joints",
    "ur3": r"it has no joints",
}
"""What is wrong with the other files."""


def robots() -> list[Path]:
    try:
        return sorted(Path(str(file.locate())) for file in files("example-robot-data") or () if file.suffix == ".urdf")
    except PackageNotFoundError:
        return []


ROBOTS = robots()
pytestmark = pytest.mark.needs(Package("example-robot-data"))
QUICK = ("panda", "ur5_robot", "talos_left_arm", "kinova", "z1")


def test_all_files_are_there() -> None:
    assert len(ROBOTS) == 69
    assert len([path for path in ROBOTS if path.stem not in REASONS]) >= 60


@pytest.mark.parametrize("path", tiered(ROBOTS, lambda path: path.stem in QUICK or path.stem in REASONS),
                         ids=lambda path: path.stem)
def test_robot(path: Path) -> None:
    """Mass of all that moves, and torques at random motions, are Pinocchio's."""
    if path.stem in REASONS:
        with pytest.raises(MachineError, match=REASONS[path.stem]):
            load_machine(path)
        return
    machine, oracle = load_machine(path), PinocchioUrdf(path)
    moved = sum(link.body.m for link in machine.links if link.body)
    assert moved == pytest.approx(oracle.mass(), rel=1e-12)
    model, rng = Model(machine), np.random.default_rng(8)
    ranges = machine.ranges
    q, qd, qdd = rng.uniform(*ranges.T, (3, len(ranges))), *rng.uniform(-2, 2, (2, 3, len(ranges)))
    expected = np.array([oracle.torques(machine, *row) for row in zip(q, qd, qdd, strict=True)])
    (found,) = model.over(model.inverse_dynamics, q, qd, qdd, np.tile(model.parameters.nominal, (3, 1)))
    np.testing.assert_allclose(found[:, :, 0], expected, rtol=1e-9, atol=1e-9 * np.abs(expected).max())
