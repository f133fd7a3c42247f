"""Machines stand upright in their side view."""

import numpy as np
import pytest

from hydroopt.machine.machine_file import load_machine
from hydroopt.model.model import Model
from hydroopt.model.vertical_plane import vertical_plane
from hydroopt.report.drawing import View, drawn


@pytest.mark.parametrize(("name", "q", "joint", "tip"), [
    # by hand: the boom raised by 30 deg, the stick 90 deg down from it; the lift level; the arm at its zero
    ("cat215b", [0.7, -np.pi / 6, np.pi / 2], "stick",
     (0.34 + 5.18 * np.cos(np.pi / 6) + 1.8 * 0.5, 5.18 * 0.5 - 1.8 * np.cos(np.pi / 6))),
    ("patu655_lift", [-np.radians(0.301921052)], "lift", (2.87503992, 0.0)),
    ("kr300", [0.4, 0.0, 0.0, 0.0, 0.0, 0.0], "axis2", (0.35, 0.675 + 1.15)),
    ("stewart_platform", [0.1, 0.0, 2.3, 0.05, 0.0, 0.0], "platform", (0.1, 2.3)),  # slides turn no plane
])
def test_machine_stands_upright(name: str, q: list[float], joint: str, tip: tuple[float, float]) -> None:
    model = Model(load_machine(name))
    pose = np.array([q])
    plane = vertical_plane(model, pose[0])
    pose[:, list(plane.zeroed)] = 0.0
    assert abs(plane.across[2]) < 1e-9
    graph = model.scene_graph
    end = graph.poses(dict(zip(graph.columns, graph.tree_positions(pose)[0], strict=True)))[joint] @ np.array(
        [*np.asarray(model.geometry.far_end(joint).origin).ravel(), 1.0])
    view = View.side(plane)
    np.testing.assert_allclose(view.of(end[:3])[0], tip, atol=1e-6)
    shown = drawn(graph, graph.tree_positions(pose), view)
    lengths = np.asarray(model.cylinder_kinematics(pose[0], 0 * pose[0], 0 * pose[0])[0]).ravel()
    struts = [part.corners for part in shown.first.parts if part.kind in ("cylinder", "gas")]
    if name != "stewart_platform":  # whose legs stand across the plane
        np.testing.assert_allclose([np.linalg.norm(pins[-1] - pins[0]) for pins in struts], lengths, rtol=1e-9)
