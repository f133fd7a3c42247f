"""The approach leads from where a machine stands to a motion, within limits, and says where it cannot."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from hydroopt import Model, load_machine
from hydroopt.cli import app
from hydroopt.errors import ProblemError
from hydroopt.excitation.motion.approach import approach, start_of
from hydroopt.limits.limits import Limits
from hydroopt.machine.environment import Obstacle

CAT = load_machine("cat215b")
GOAL = np.array([0.5, -0.3, 2.0])


def kept(limits: Limits, path: object, slack: float = 0.0) -> bool:
    values = limits.values(path.q, path.qd, path.qdd)
    return bool(np.max(limits.excess(values)) <= slack)


def test_an_approach_rests_at_both_ends_and_keeps_all_limits() -> None:
    limits = Limits(Model(CAT))
    found = approach(limits, np.array([-0.5, -0.5, 2.2]), GOAL, 50.0)
    path = found.trajectory
    assert not found.short
    assert kept(limits, path, 1e-9)
    np.testing.assert_allclose(path.q[[0, -1]], [[-0.5, -0.5, 2.2], GOAL], atol=1e-12)
    np.testing.assert_allclose(path.qd[[0, -1]], 0, atol=1e-12)
    np.testing.assert_allclose(np.gradient(path.q, path.t, axis=0)[1:-1], path.qd[1:-1], atol=2e-3)


def test_an_approach_goes_round_an_obstacle() -> None:
    """In a straight line the stick would pass through a ball that stands beside the machine."""
    start, goal = np.array([-0.8, -0.5, 2.3]), np.array([0.9, -0.5, 2.3])
    model = Model(CAT)
    tip = model.over(model.forward_kinematics, (start + goal)[None] / 2)[-1][0, :3, 3]
    ball = Obstacle(name="tree", link="base", centre=tuple(tip.tolist()), radius=0.5)
    limits = Limits(Model(CAT.model_copy(update={"obstacles": (*CAT.obstacles, ball)})))
    straight = start + np.linspace(0, 1, 60)[:, None] * (goal - start)
    assert np.max(limits.excess(limits.values(straight, 0 * straight, 0 * straight))) > 0
    found = approach(limits, start, goal, 20.0, seed=1)
    assert len(found.postures) > 2
    assert not found.short
    assert kept(limits, found.trajectory, 1e-9)


def test_a_machine_on_the_ground_leaves_it_without_coming_nearer() -> None:
    """Its tip stands 0.15 m above the ground, half of the reserve."""
    limits, model = Limits(Model(CAT)), Model(CAT)
    q = np.column_stack([np.zeros(400), np.linspace(-0.6, 0.0, 400), np.full(400, 1.5)])
    heights = model.over(model.forward_kinematics, q)[-1][:, 2, 3] - CAT.ground
    start = q[np.argmin(np.abs(heights - 0.15))]
    found = approach(limits, start, GOAL, 50.0)
    assert "stick above ground" in found.short
    height = model.over(model.forward_kinematics, found.trajectory.q)[-1][:, 2, 3] - CAT.ground
    assert height[0] == pytest.approx(0.15, abs=0.02)
    assert np.min(height) >= height[0] - 0.005
    assert height[-1] >= 0.3


def test_what_a_start_breaks_is_named() -> None:
    under = np.array([0.0, 0.3, 1.4])
    with pytest.raises(ProblemError, match=r"where the machine stands, .*stick above ground is beyond its limit by"):
        approach(Limits(Model(CAT)), under, GOAL, 50.0)
    with pytest.raises(ProblemError, match=r"joint 'boom' cannot stand at 114\.6 deg"):
        start_of(CAT, {"boom": 2.0}, GOAL)
    with pytest.raises(ProblemError, match="'bom' is not a moving joint"):
        start_of(CAT, {"bom": 0.0}, GOAL)


@pytest.mark.slow
def test_excite_writes_a_slow_motion_an_approach_and_a_sheet(tmp_path: Path) -> None:
    """What is designed passes the check of motions, with the reserves that were stated; more would not."""
    run = CliRunner().invoke
    done = run(app, ["excite", "cat215b", "-o", str(tmp_path), "--starts", "1", "--processes", "1", "--duration", "12",
                     "--harmonics", "3", "--start", "boom=-30 deg", "--speed", "50 %", "--quiet"])
    assert done.exit_code == 0, done.exception
    sheet = (tmp_path / "sheet.html").read_text("utf-8")
    assert "Stop at once" in sheet
    assert "Drive approach.csv" in sheet
    last = (tmp_path / "trajectory.csv").read_text("utf-8").splitlines()[-1]
    assert float(last.split(",")[0]) == pytest.approx(24.0, abs=0.05)
    for name in ("trajectory.csv", "approach.csv"):
        checked = run(app, ["check", "cat215b", str(tmp_path / name), "--quiet"])
        assert checked.exit_code == 0, checked.exception
    checked = run(app, ["check", "cat215b", str(tmp_path / "trajectory.csv"), "--reserve", "tipping=60 %"])
    assert "uses the reserve of tipping" in " ".join(checked.output.split())


@pytest.mark.parametrize(("options", "named"), [
    (["--reserve", "100 %"], "leaves nothing"), (["--speed", "0 %"], "cannot be driven"),
    (["--speed", "120 %"], "cannot be driven"), (["--start", "boom"], "is not JOINT=POSITION")])
def test_impossible_options_are_refused(options: list[str], named: str, tmp_path: Path) -> None:
    done = CliRunner().invoke(app, ["excite", "cat215b", "-o", str(tmp_path / "out"), *options])
    assert isinstance(done.exception, ProblemError)
    assert named in str(done.exception)
    assert not (tmp_path / "out").exists() or not list((tmp_path / "out").iterdir())


def test_a_reserve_of_what_is_not_limited_is_refused(tmp_path: Path) -> None:
    for reserve, named in (("clearance=0.5 m", "neither ground nor obstacles"), ("tipping=20 %", "no footprint")):
        done = CliRunner().invoke(app, ["excite", "wheel_loader", "-o", str(tmp_path / "out"), "--reserve", reserve])
        assert named in str(done.exception)


@pytest.mark.slow
def test_the_sheet_waits_until_a_grapple_hangs_still(tmp_path: Path) -> None:
    """The motion is checked from rest, and the grapple swings at the end of an approach."""
    done = CliRunner().invoke(app, [
        "excite", "forestry_crane", "-o", str(tmp_path), "--starts", "1", "--processes", "1", "--search-seconds", "1",
        "--duration", "15", "--harmonics", "2", "--quiet"])
    assert done.exit_code == 0, done.exception
    assert "Wait until swing and sway hang still" in (tmp_path / "sheet.html").read_text("utf-8")
