"""Typical machines of every kind are accepted, plane and space agree, and answers are refused with a reason."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import pytest

from hydroopt import identification_problem, random_trajectory, random_truth, simulate, solve
from hydroopt.guided.drawing import HEIGHT, WIDTH, page, side, terminal
from hydroopt.guided.kinds import KINDS
from hydroopt.guided.machine_text import machine_text
from hydroopt.guided.plane import OpenError, by_distances, turned
from hydroopt.guided.question import AnswerError, Question
from hydroopt.guided.sketch import MARGIN, STOP, Sketch
from hydroopt.machine.machine_file import load_machine, read_machine
from hydroopt.model.model import Model
from hydroopt.results.status import Status
from hydroopt.results.verdict import Purpose, Usable


def answered(kind: str, **given: str) -> Sketch:
    """A sketch with all questions answered, by what is given or typically."""
    sketch = Sketch(KINDS[kind], {})
    answers = {key.replace("__", "."): text for key, text in given.items()}
    while (question := sketch.open) is not None:
        sketch = sketch.answered(question, answers.get(question.key, ""))
    return sketch


@pytest.mark.parametrize("kind", KINDS)
def test_a_typical_machine_is_accepted_and_marked_as_assumed(kind: str) -> None:
    machine = read_machine(machine_text(answered(kind)))
    assert machine.name == f"my_{kind}"
    notes = machine.notes.values()
    assert all((note.source or "").startswith("assumed") or note.source == "level ground" for note in notes)
    assert sum(note.sigma is not None for note in notes) >= 8
    bodies = [body for part in (*machine.links, *(end for each in machine.cylinders for end in (each.barrel, each.rod)))
              if (body := part.body) is not None and body.inertia_com is not None]
    assert bodies
    for body in bodies:
        xx, xy, xz, yy, yz, zz = body.inertia_com
        small, middle, large = np.linalg.eigvalsh([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        assert small > 0
        assert small + middle > 1.001 * large, "rounding must leave a body that can be"


@pytest.mark.parametrize("kind", [kind for kind in KINDS if kind != "arm"])
def test_lengths_of_cylinders_in_space_are_those_of_the_tape(kind: str) -> None:
    """The model in space is the witness of the plane triangles: at joint limits strokes end."""
    sketch = answered(kind, **{f"{KINDS[kind].members[0].name}__length": "3.1 m"} if kind != "empty" else {})
    machine = read_machine(machine_text(sketch))
    model = Model(machine)
    middle = machine.ranges.mean(axis=1)
    for k, member in enumerate(sketch.members):
        joint = machine.joints.index(member.name)
        stands_on_lift = member.linkage is not None and member.cylinder is not None and member.cylinder.on_ground
        found = []
        for limit in machine.link(member.name).joint.range:
            q = middle.copy()
            q[joint] = limit
            length = model.over(model.cylinder_kinematics, q[None], 0 * q[None], 0 * q[None])[0][0, k, 0]
            found.append(float(length))
        low, high = sorted(found)
        short, long = sketch.stroke(k)
        lever = 3.0 * (STOP if stands_on_lift else MARGIN)
        assert short <= low + 1e-9
        assert high <= long + 1e-9
        if not stands_on_lift:
            assert low - short < lever
            assert long - high < lever


@pytest.mark.parametrize("sections", [1, 2])
def test_a_telescope_slides_along_its_boom_as_its_cylinder_says(sections: int) -> None:
    """The model in space is the witness: the hook moves along the boom, the second section as far as its chain says."""
    given = {"telescope__sections": str(sections), "telescope__travel": "1.3 m", "outer_boom__length": "2.4 m",
             "telescope_stroke__retracted": "1.6 m", "telescope_cylinder__barrel_forward": "0.2 m",
             "telescope_cylinder__barrel_up": "0.25 m", "telescope_second__travel": "0.65 m"}
    sketch = answered("crane", **given)
    machine = read_machine(machine_text(sketch))
    model = Model(machine)
    assert machine.joints == ("slew", "main_boom", "outer_boom", "telescope")
    low, high = machine.link("telescope").joint.range
    assert (low, high) == pytest.approx((0.002, 1.298))
    q = np.zeros((5, 4))
    q[:, 1:3], q[:, 3] = (0.3, -0.8), np.linspace(low, high, 5)
    pivot, *_, tip = (pose[:, :3, 3] for pose in model.over(model.forward_kinematics, q)[1:])
    direction = np.array([math.cos(0.3 - 0.8), 0.0, math.sin(0.3 - 0.8)])
    out = 2.4 + (1.5 if sections == 2 else 1.0) * q[:, 3]
    np.testing.assert_allclose(tip - pivot, out[:, None] * direction, atol=1e-12)
    lengths = model.over(model.cylinder_kinematics, q, 0 * q, 0 * q)[0][:, -1, 0]
    np.testing.assert_allclose(lengths, 1.6 + q[:, 3], atol=1e-9)
    note = machine.notes["telescope_cylinder.barrel.pin"]
    assert note.source == "tape measure"
    seen = side(sketch)
    assert seen is not None
    assert {part.name for part in seen.first.parts if part.name.startswith("telescope")} == {
        *["telescope", "telescope_second"][:sections], "telescope_cylinder"}


def test_a_telescope_whose_cylinder_cannot_hold_its_stroke_is_refused() -> None:
    sketch = Sketch(KINDS["crane"], {})
    given = {"telescope.sections": "1", "telescope.travel": "1.5 m"}
    while (question := sketch.open) is not None and question.key != "telescope_stroke.retracted":
        sketch = sketch.answered(question, given.get(question.key, ""))
    assert question is not None
    with pytest.raises(AnswerError, match=r"outside what is possible here: 1\.50 m"):
        sketch.answered(question, "1.2 m")


def test_an_excavator_from_tape_measurements() -> None:
    """A pin by its two distances, with the accuracy of the tape; limits from the stroke."""
    sketch = answered("excavator", boom__length="5.2 m", boom_cylinder__rod_pin__from_first="2.7 m",
                      boom_cylinder__rod_pin__from_last="3.4 m")
    machine = read_machine(machine_text(sketch))
    pin = np.array(next(c for c in machine.cylinders if c.name == "boom_cylinder").rod.pin)
    assert np.linalg.norm(pin) == pytest.approx(2.7, abs=1e-4)
    assert np.linalg.norm(pin - [5.2, 0, 0]) == pytest.approx(3.4, abs=1e-4)
    note = machine.notes["boom_cylinder.rod.pin"]
    assert (note.source or "").startswith("tape measure")
    assert note.sigma is not None
    assert 0.005 <= note.sigma <= 0.025


def test_a_length_may_be_in_any_unit_but_needs_one() -> None:
    question = Question("boom.length", "From pin to pin?", "m", 5.0, most=60)
    assert question.read("5200 mm") == question.read("5.2 m") == 5.2
    assert question.read("") == 5.0
    assert question.read("5,2 m") == question.read("5,20 m") == 5.2
    assert question.read("0,125 m") == 0.125
    for text, reason in (("5200", "no unit"), ("5,200 mm", "write a point"), ("5,200,000 mm", "unit"),
                         ("5 kg", "unit"), ("900 m", "outside"), ("long", "unit")):
        with pytest.raises(AnswerError, match=reason):
            question.read(text)


def test_distances_that_no_pin_has_are_refused_with_what_would_be_possible() -> None:
    sketch = Sketch(KINDS["excavator"], {})
    while (question := sketch.open) is not None and question.key != "boom_cylinder.rod_pin.from_last":
        sketch = sketch.answered(question, "")
    assert question is not None
    with pytest.raises(AnswerError, match="must lie between"):
        sketch.answered(question, "1 m")


def test_a_cylinder_too_short_or_too_long_for_its_pins_is_refused() -> None:
    sketch = Sketch(KINDS["crane"], {})
    while (question := sketch.open) is not None and question.key != "main_boom_stroke.retracted":
        sketch = sketch.answered(question, "")
    assert question is not None
    with pytest.raises(AnswerError, match="from the main boom pivot"):
        sketch.answered(question, "3 m")
    sketch = sketch.answered(question, "")
    question = sketch.open
    assert question is not None
    with pytest.raises(AnswerError, match="outside what is possible"):
        sketch.answered(question, "0.5 m")


def test_an_answer_that_no_longer_fits_is_asked_again() -> None:
    sketch = answered("crane", main_boom_stroke__extended="1.3 m")
    changed = Sketch(sketch.kind, {**sketch.answers, "main_boom_stroke.retracted": "0.6 m"})
    assert changed.open is not None
    assert changed.open.key == "main_boom_stroke.extended"


@pytest.mark.parametrize("kind", KINDS)
def test_drawings_fit_and_show_every_part(kind: str) -> None:
    for sketch in (Sketch(KINDS[kind], {}), answered(kind)):
        lines = terminal(sketch).splitlines()
        assert 0 < len(lines) <= HEIGHT
        assert max(map(len, lines)) <= WIDTH
        html = page(sketch)
        for member in sketch.members:
            assert member.name in html
    assert 'http-equiv="refresh"' in html
    assert 'http-equiv="refresh"' not in page(sketch, finished=True)


def test_lengths_of_no_machine_are_said_instead_of_drawn() -> None:
    open_ = Sketch(KINDS["crane"], {"main_boom_stroke.retracted": "3 m"})
    assert side(open_) is None
    assert terminal(open_) in page(open_)


def test_triangles() -> None:
    point = by_distances(2.0, 3.0, 4.0, -1.0)
    assert (abs(point), abs(point - 4), point.imag < 0) == (pytest.approx(2.0), pytest.approx(3.0), True)
    for sign in (1.0, -1.0):
        angle = turned(0.7 + 0.2j, 0.5 - 0.1j, 0.9, sign)
        longer = turned(0.7 + 0.2j, 0.5 - 0.1j, 0.91, sign)
        turn = (0.5 - 0.1j) * complex(math.cos(angle), math.sin(angle))
        assert abs(turn - (0.7 + 0.2j)) == pytest.approx(0.9)
        assert (longer - angle) * sign > 0
    with pytest.raises(OpenError, match="between 1500 mm and 2500 mm"):
        by_distances(3.0, 0.5, 2.0, 1.0)


def tape(pin: Sequence[float], length: float) -> dict[str, str]:
    """What a tape reads of a pin on a link of this length."""
    x, y = pin[:2]
    return {"from_first": f"{1e3 * math.hypot(x, y):.2f} mm", "from_last": f"{1e3 * math.hypot(x - length, y):.2f} mm",
            "side": "above" if y >= 0 else "below"}


def taped() -> dict[str, str]:
    """Distances between the pins of a bundled mini-excavator, none of whose numbers the guided start knows."""
    known = load_machine("mini_excavator")
    cylinders = {each.name: each for each in known.cylinders}
    length = {name: known.link(name).joint.a for name in ("boom", "stick", "bucket", "rocker", "coupler", "boom_swing")}
    (loop,) = known.loops
    answers = {f"{name}.length": f"{1e3 * length[name]:.2f} mm" for name in length if name != "boom_swing"}
    foot = cylinders["boom_cylinder"].barrel.pin
    answers |= {"boom_cylinder.barrel_forward": f"{foot[0] - length['boom_swing']:.5f} m",
                "boom_cylinder.barrel_up": f"{foot[2]:.5f} m"}
    pins = {"boom_cylinder.rod_pin": (cylinders["boom_cylinder"].rod.pin, "boom"),
            "stick_cylinder.barrel_pin": (cylinders["stick_cylinder"].barrel.pin, "boom"),
            "stick_cylinder.rod_pin": (cylinders["stick_cylinder"].rod.pin, "stick"),
            "bucket_cylinder.barrel_pin": (cylinders["bucket_cylinder"].barrel.pin, "stick"),
            "rocker.pin": (known.link("rocker").pin or (), "stick"), "coupler.pin": (loop.to.pin, "bucket")}
    for key, (pin, link) in pins.items():
        answers |= {f"{key}.{what}": text for what, text in tape(pin, length[link]).items()}
    for name in ("boom", "stick", "bucket"):
        part = cylinders[f"{name}_cylinder"]
        answers |= {f"{name}_stroke.retracted": f"{part.dead_length:.5f} m",
                    f"{name}_stroke.extended": f"{part.dead_length + part.stroke:.5f} m"}
    return answers


def excavator(answers: dict[str, str]) -> Sketch:
    """An excavator with these answers, all others typical."""
    sketch = Sketch(KINDS["excavator"], {})
    while (question := sketch.open) is not None:
        sketch = sketch.answered(question, answers.get(question.key, ""))
    return sketch


def test_a_published_excavator_measured_by_tape_moves_as_its_file_says() -> None:
    known, sketch = load_machine("mini_excavator"), excavator(taped())
    made = read_machine(machine_text(sketch))
    swept = []
    for machine in (known, made):
        model = Model(machine)
        q = np.zeros((9, len(machine.joints)))
        for name in ("boom", "stick", "bucket"):
            low, high = known.link(name).joint.range
            q[:, machine.joints.index(name)] = np.linspace(low + 0.05, high - 0.05, 9)
        lengths = model.over(model.cylinder_kinematics, q, 0 * q, 0 * q)[0][:, :, 0]
        names = [each.name for each in machine.pinned]
        swept.append(lengths[:, [names.index(f"{name}_cylinder") for name in ("boom", "stick", "bucket")]])
    assert swept[0] == pytest.approx(swept[1], abs=2e-4)


@pytest.mark.parametrize(("wrong", "said"), [
    ({"rocker.length": "24 mm"}, "from the pivot of the rocker; of the answers that count here, rocker.length is the "
     "furthest from what is typical, 24 mm instead of 319 mm"),
    ({"coupler.length": "0.5 m"}, "the coupler of 500 mm does not close"),
    ({"coupler.length": "0.5 m"}, "coupler.length is the furthest from what is typical, 0.5 m instead of 253 mm, with "
     "which it would close"),
    ({"bucket_stroke.retracted": "0.52 m"}, "bucket_stroke.retracted is the furthest"),
    ({"rocker.length": "300 mm"}, "its two pins from the bucket pin, the rocker standing as the cylinder holds it")])
def test_a_wrong_dimension_of_a_bucket_linkage_is_named(wrong: dict[str, str], said: str) -> None:
    """Of a real machine whose right dimensions differ from the typical ones by up to a third."""
    with pytest.raises(AnswerError) as refused:
        excavator(taped() | wrong)
    assert said in str(refused.value)
    assert "it must lie between" in str(refused.value)


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["excavator", "loader", "crane"])
def test_a_machine_of_the_guided_start_is_identified_from_its_first_log(kind: str) -> None:
    """Its wide confidences of slender bodies made sampling slow, which was taken for a failure of every answer."""
    machine = read_machine(machine_text(answered(kind)))
    model = Model(machine)
    motions = [random_trajectory(model, duration=40, rate=25, seed=seed) for seed in (1, 2)]
    truth = random_truth(model, seed=3)
    train, unseen = (simulate(model, motion, truth, seed=k) for k, motion in enumerate(motions))
    estimate = solve(identification_problem(machine, [train], [unseen]))
    assert estimate.status is Status.OK
    assert any(claim.usable is Usable.YES for claim in estimate.claims if claim.purpose is Purpose.FORCE)
