"""The page of a machine: picture, lever arms and transmission ratios, tables."""

import numpy as np
from typer.testing import CliRunner

from fixtures.pages import data_of
from hydroopt.cli import app
from hydroopt.machine.machine_file import load_machine
from hydroopt.model.model import Model
from hydroopt.model.over_range import lever_arms, transmission_ratios
from hydroopt.model.vertical_plane import limit_postures


def test_show_draws_the_machine_with_its_linkage(tmp_path):
    answer = CliRunner().invoke(app, ["show", "wheel_loader", "-o", str(tmp_path / "out")])
    assert answer.exit_code == 0, answer.output
    assert answer.output.endswith("machine.html\n")
    page = (tmp_path / "out" / "machine.html").read_text("utf-8")
    assert {chart["title"] for chart in data_of(page)["charts"]} >= {"tilt_cylinder: lever arm [m]",
                                                                     "speed ratio bellcrank / bucket"}
    for text in ("bellcrank", "tilt_cylinder: lever arm [m]", "speed ratio bellcrank / bucket", "middle of all ranges",
                 "bellcrank / bucket from -0.376 to -0.231"):
        assert text in page


def test_loops_close_in_every_posture():
    model = Model(load_machine("wheel_loader"))
    graph, side = model.scene_graph, limit_postures(model)
    assert len(side.q) == 1 + 2 * 2  # the middle, and both limits of lift and bucket
    (bar,) = (each for each in graph.closings if each.name == "z_bar")
    for row in graph.tree_positions(side.q):
        poses = graph.poses(dict(zip(graph.columns, row, strict=True)))
        one, other = (poses[body] @ [*at, 1.0] for body, at in (bar.one, bar.other))
        np.testing.assert_allclose(one, other, atol=1e-9)


def test_passive_joints_hang():
    """A grapple is drawn below its boom in every posture: gravity turns none of its hinges."""
    model = Model(load_machine("forestry_crane"))
    machine = model.machine
    passive = [k for k, joint in enumerate(machine.joints) if machine.link(joint).joint.passive]
    assert len(passive) == 2
    for q in limit_postures(model).q:
        torques = np.array(model.gravity_torques(q, model.parameters.nominal)).ravel()
        inside = [k for k in passive
                  if min(abs(q[k] - limit) for limit in machine.link(machine.joints[k]).joint.range) > 1e-9]
        assert np.all(np.abs(torques[inside]) < 1e-3 * np.abs(torques).max())


def test_lever_arms_are_the_slopes_of_lengths():
    model = Model(load_machine("wheel_loader"))
    lift, tilt = lever_arms(model)
    (ratio,) = transmission_ratios(model)
    assert (lift.joint, tilt.joint, ratio.subject, ratio.joint) == ("lift", "bucket", "bellcrank", "bucket")
    q = np.tile([np.radians(2.5), 0.0], (len(tilt.position), 1))
    q[:, 1] = tilt.position
    length = model.over(model.cylinder_kinematics, q, 0 * q, 0 * q)[0][:, 1, 0]
    np.testing.assert_allclose(np.gradient(length, tilt.position)[1:-1], tilt.value[1:-1], atol=2e-4)
    assert ratio.value.max() < 0, "a Z-bar's bellcrank turns against the bucket"


def test_show_takes_a_machine_without_bodies_and_friction(tmp_path):
    """What a new file states first: geometry alone."""
    (tmp_path / "arm.toml").write_text(
        'name = "arm"\n[[links]]\nname = "lift"\n'
        'joint = { type = "revolute", a = "1 m", lower = "0 deg", upper = "9 deg" }\n'
        '[[drives]]\nname = "drive"\njoint = "lift"\n', encoding="utf-8")
    answer = CliRunner().invoke(app, ["show", str(tmp_path / "arm.toml"), "-o", str(tmp_path / "out")])
    assert answer.exit_code == 0, answer.output
    assert "Of 0 parameters" in answer.output
