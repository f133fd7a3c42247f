"""What a page holds of a machine moves as the model does, and pins never part."""

import math
import re
from types import SimpleNamespace

import numpy as np
import pytest

from fixtures.tiers import machines
from hydroopt.machine.machine_file import load_machine
from hydroopt.model.model import Model
from hydroopt.model.scene_graph import SceneBody, SceneGraph
from hydroopt.report.samples import Recording, joined, kept, packed, unpacked
from hydroopt.report.scene import SceneView

TOLERANCE = 1e-4
"""How far pins may part on screen [m]."""
MATH = SimpleNamespace(abs=abs, min=min, max=max, pow=pow, sign=np.sign, **{
    name: getattr(math, name) for name in ("sin", "cos", "tan", "asin", "acos", "atan", "atan2", "sqrt", "exp", "log")})


def run(script: str, q: list[float], count: int) -> list[float]:
    """What a closure's script computes, with Python in the place of the browser."""
    tree = [math.nan] * count
    lines = [re.sub(r"^const ", "", line).rstrip(";") for line in script.splitlines()]
    exec("\n".join(lines), {"Math": MATH, "q": q, "tree": tree})
    return tree


def places(payload: dict, tree: list[float]) -> dict[str, np.ndarray]:
    """Poses (4, 4) of all bodies as the page computes them from its own data."""
    base = np.eye(4)
    base[:3, :3] = np.reshape(payload["base"], (3, 3))
    found = {"base": base}
    for body in payload["bodies"]:
        moved, seat = np.eye(4), np.vstack([np.reshape(body["seat"], (3, 4)), [0, 0, 0, 1]])
        at = 0.0 if body["column"] is None else tree[body["column"]]
        if body["joint"] == "prismatic":
            moved[2, 3] = at
        else:
            moved[:2, :2] = [[math.cos(at), -math.sin(at)], [math.sin(at), math.cos(at)]]
        found[body["name"]] = found[body["parent"]] @ seat @ moved
    return found


def point(poses: dict[str, np.ndarray], at: dict) -> np.ndarray:
    return (poses[at["body"]] @ np.array([*at["at"], 1.0]))[:3]


@pytest.mark.parametrize("name", machines())
def test_the_page_moves_the_machine_as_the_model_does(name: str) -> None:
    """The page's joint positions, seats and closure, against the model's kinematics and cylinder lengths."""
    machine = load_machine(name)
    model, payload = Model(machine), SceneView(SceneGraph(machine)).payload()
    limits = machine.ranges
    q = limits[:, 0] + (limits[:, 1] - limits[:, 0]) * np.random.default_rng(1).random((25, len(limits)))
    read = np.array([unpacked(packed(column)) for column in q.T], dtype=float).T
    ends = model.over(model.forward_kinematics, q)
    lengths = model.over(model.cylinder_kinematics, q, 0 * q, 0 * q)[0][:, :, 0] if machine.pinned else None
    script, closed = SceneGraph(machine).closure_script, 0
    for i, row in enumerate(read.tolist()):
        tree = run(script, row, payload["tree"])
        poses = places(payload, tree)
        for link, pose in zip(machine.links, ends, strict=True):
            far = poses[link.name] @ np.append(np.asarray(model.geometry.far_end(link.name).origin).ravel(), 1.0)
            np.testing.assert_allclose(far[:3], poses["base"][:3, :3] @ pose[i, :3, 3], atol=TOLERANCE)
        for loop in payload["closings"]:
            np.testing.assert_allclose(point(poses, loop["one"]), point(poses, loop["other"]), atol=TOLERANCE)
        for k, part in enumerate(machine.pinned):
            strut = next(each for each in payload["struts"] if each["name"] == part.name)
            apart = np.linalg.norm(point(poses, strut["start"]) - point(poses, strut["end"]))
            assert apart == pytest.approx(lengths[i, k], abs=TOLERANCE)
        closed += 1
    assert closed == len(q)


def test_samples_stand_one_after_the_other_with_gaps() -> None:
    some = [Recording("training", "a", np.arange(4.0), np.array([0, 0, 1, 1]), {"f": np.arange(4.0)}),
            Recording("validation", "b", 10 + np.arange(3.0), np.zeros(3, dtype=int), {"f": 7 + np.arange(3.0)})]
    made = joined(some)
    np.testing.assert_array_equal(made.columns["f"], [0, 1, np.nan, 2, 3, np.nan, 7, 8, 9, np.nan])
    assert np.all(np.diff(made.at) > 0)
    assert [(span.first, span.last, span.role) for span in made.spans] == [(0, 4, "training"), (6, 8, "validation")]


def test_of_long_recordings_the_worst_samples_are_kept() -> None:
    values = np.zeros(100_000)
    values[[12_345, 77_777]] = 5.0, -9.0
    rows = kept(len(values), 50, np.abs(values))
    assert len(rows) <= 2001 + 1
    assert {0, 12_345, 77_777, 99_999} <= set(rows.tolist())


@pytest.mark.parametrize("name", ["scissor_lift", "forestry_crane", "knuckle_boom_crane", "tampere_manipulator"])
def test_slides_touch_what_carries_them(name: str) -> None:
    """Sections of telescopes, shoes and rollers are drawn in contact with the link before, wherever they stand."""
    graph = SceneGraph(load_machine(name))
    bodies = {body.name: body for body in graph.bodies}
    low, high = graph.machine.ranges.T
    drawn = np.vstack([low, high, np.random.default_rng(2).uniform(low, high, (8, len(low)))])
    slides = [body for body in graph.bodies if body.joint == "prismatic"]
    assert slides
    for row in graph.tree_positions(drawn):
        poses = graph.poses(dict(zip(graph.columns, row, strict=True)))

        def lines(body: SceneBody, poses: dict[str, np.ndarray] = poses) -> np.ndarray:
            """Points (k, 3) on all lines between what a body joins."""
            found = [[body.points[i], body.points[j]] for i in range(len(body.points)) for j in range(i + 1)]
            found += [] if body.section is None else [list(body.section)]
            ends = np.array(found) @ poses[body.name][:3, :3].T + poses[body.name][:3, 3]
            along: np.ndarray = ends[:, :1] + np.linspace(0, 1, 400)[:, None] * (ends[:, 1:] - ends[:, :1])
            return along.reshape(-1, 3)

        for slide in slides:
            carrier = lines(bodies[slide.parent])
            own = lines(slide)[:: 1 if slide.section is None else 10]
            apart = min(np.min(np.linalg.norm(carrier - at, axis=1)) for at in own)
            assert apart < 0.01, slide.name
