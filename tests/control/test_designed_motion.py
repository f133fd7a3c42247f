"""A motion that `excite` designs is one that `control` accepts."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from hydroopt import Model, Plant, excitation_problem, read_log, read_machine, solve
from hydroopt.control.feasibility import refuse_flow
from hydroopt.control.reference import Reference
from hydroopt.errors import ProblemError
from hydroopt.excitation.motion.basis import Fourier
from hydroopt.logs.table import write_columns
from hydroopt.model.flow_demand import demanded_flow
from hydroopt.simulation.reference_motion import reference_motion
from hydroopt.simulation.simulate import Trajectory

CAT = (Path(__file__).parents[2] / "models/cat215b.toml").read_text("utf-8")


@pytest.mark.slow
def test_a_motion_at_the_limit_of_the_pump_is_accepted_at_any_rate_of_the_controller(tmp_path: Path) -> None:
    """Read again from its file; a motion that is one per cent faster is refused."""
    machine = read_machine(CAT.replace('"300 L/min"', '"60 L/min"'))
    problem = excitation_problem(machine, Fourier(8.0, 3, 1, 2.0), rate=50.0, resting={"swing": 0.0})
    found = solve(problem, starts=1, seconds=4.0, seed=1)
    path, joints = found.trajectory, machine.joints
    write_columns(tmp_path / "trajectory.csv", {"t [s]": path.t} | {
        f"{joint}.{order} [{unit}]": values[:, k] for k, joint in enumerate(joints)
        for order, unit, values in (("q", "rad", path.q), ("qd", "rad/s", path.qd), ("qdd", "rad/s^2", path.qdd))},
        "trajectory")
    motion = reference_motion(machine, read_log(tmp_path / "trajectory.csv"))
    np.testing.assert_allclose(motion.qd, path.qd, rtol=1e-9, atol=1e-12)
    plant = Plant(Model(machine))
    for rate in (20.0, 50.0, 333.0):
        refuse_flow(plant, Reference(motion).at(np.arange(0, motion.t[-1], 1 / rate)))
    speed = plant.model.over(plant.actuator_motion, motion.q, motion.qd)[1][:, :, 0]
    assert np.max(demanded_flow(machine, speed)) == pytest.approx(1e-3, rel=0.01)  # the pump limits this motion
    faster = Trajectory(motion.t / 1.02, motion.q, 1.02 * motion.qd, 1.02**2 * motion.qdd)
    with pytest.raises(ProblemError, match="61 L/min of a pump that gives 60 L/min"):
        refuse_flow(plant, faster)
