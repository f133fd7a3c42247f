"""A motion that `excite` designs is one that `control` accepts."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.optimize import brentq
from typer.testing import CliRunner

from hydroopt import Model, Plant, excitation_problem, load_machine, read_log, read_machine, solve
from hydroopt.cli import app
from hydroopt.control.reference import Reference, refuse_flow
from hydroopt.errors import ProblemError
from hydroopt.excitation.motion.basis import Fourier
from hydroopt.limits.limits import Limits
from hydroopt.limits.reserves import Reserves
from hydroopt.logs.table import write_columns
from hydroopt.model.hydraulics import demanded_flow
from hydroopt.simulation.reference_motion import reference_motion
from hydroopt.simulation.simulate import Trajectory

CAT = (Path(__file__).parents[2] / "models/cat215b.toml").read_text("utf-8")


@pytest.mark.slow
def test_a_motion_at_the_limit_of_the_pump_is_accepted_at_any_rate_of_the_controller(tmp_path: Path) -> None:
    """Read again from its file; a motion that is faster by the reserve of a design and one per cent more is refused."""
    machine = read_machine(CAT.replace('"300 L/min"', '"60 L/min"'))
    problem = excitation_problem(machine, Fourier(8.0, 3, 1, 2.0), rate=50.0, resting={"swing": 0.0})
    found = solve(problem, starts=1, search_seconds=4.0, seed=1)
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
    assert np.max(demanded_flow(machine, speed)) == pytest.approx(0.9e-3, rel=0.01)  # the pump limits this motion
    much = 1.02 / 0.9
    faster = Trajectory(motion.t / much, motion.q, much * motion.qd, much**2 * motion.qdd)
    with pytest.raises(ProblemError, match="61 L/min of a pump that gives 60 L/min"):
        refuse_flow(plant, faster)


COMPLETE = ("backhoe", "cat215b", "cat215b_bucket", "cat215b_link4", "excavator_bucket", "excavator_imu",
            "forestry_crane", "knuckle_boom_crane", "level_keeping_lift", "mini_excavator", "patu655", "patu655_lift",
            "scissor_lift", "stewart_platform", "tampere_manipulator", "wheel_loader")
"""Bundled machines that state valves for all that moves them, and their supply."""
OPTIONS = {"patu655_lift": ("--rate", "200")}
"""What a machine's refusal asks for, of loops that are hardly damped at the rate of its sensors."""


@pytest.mark.parametrize("name", ["cat215b", "patu655_lift"])
def test_the_limit_of_a_valve_is_where_it_is_fully_open(name: str) -> None:
    """In steady motion, found by the plant itself: at the limit it opens its valve by the part that a design uses."""
    model = Model(load_machine(name))
    plant, limits = Plant(model), Limits(model, Reserves(flow=0.1, certainty=0.5))
    rng, psi, theta = np.random.default_rng(1), model.parameters.nominal, Plant(model).parameters.nominal
    rows = [k for k, row in enumerate(limits.rows) if " valve " in row.name]
    assert len(rows) == 2 * len(plant.actuators)
    low, high = model.machine.ranges.T
    compared = 0
    for _ in range(20):
        q, way = rng.uniform(low, high), rng.choice([-1.0, 1.0], len(low))

        def excess(pace: float, q: np.ndarray = q, way: np.ndarray = way) -> float:
            values = limits.values(q[None], pace * way[None], 0 * q[None])[:, rows]
            return float(np.max(values - limits.upper[rows]))

        if excess(1e-3) >= 0 or excess(3.0) <= 0:
            continue
        pace = brentq(excess, 1e-3, 3.0, xtol=1e-10)
        speed = plant.actuator_motion(q, pace * way)[1].full().ravel()
        force = model.over(model.inverse_dynamics, q[None], pace * way[None], 0 * q[None], psi)[0].ravel()
        opened = [float(each.opening_for(force[k], speed[k], plant.supply, plant.value(each, theta))[0])
                  for k, each in enumerate(plant.actuators)]
        assert max(np.abs(opened)) == pytest.approx(0.9, rel=1e-6)
        compared += 1
    assert compared >= 5


@pytest.mark.slow
@pytest.mark.parametrize("name", COMPLETE)
def test_what_excite_designs_of_a_bundled_machine_control_accepts(name: str, tmp_path: Path) -> None:
    designed = CliRunner().invoke(app, ["excite", name, "-o", str(tmp_path / "drive"), "--starts", "1", "--quiet",
                                        "--processes", "1"])
    assert designed.exit_code == 0, designed.exception
    followed = CliRunner().invoke(app, ["control", name, "--motion", str(tmp_path / "drive/trajectory.csv"), "-o",
                                        str(tmp_path / "control"), "--controller", "feedforward", "--quiet",
                                        *OPTIONS.get(name, ())])
    assert followed.exit_code == 0, followed.exception
