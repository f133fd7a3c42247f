"""Joint limits give way to strokes: to the angle at which the pins are as far apart as the cylinder can be."""

import numpy as np
import pytest

import hydroopt as ho
from hydroopt.machine import range_checks
from hydroopt.machine.geometry import Geometry
from hydroopt.machine.joint_limits import INSIDE, within_strokes
from hydroopt.machine.machine import Machine
from hydroopt.machine.quantity import ImpossibleError


def pin_distance(machine: Machine, joint: str, cylinder: str, angle: float) -> float:
    """Length of a cylinder [m] by the model's kinematics."""
    model = ho.Model(machine)
    q = np.zeros((1, len(machine.joints)))
    q[0, machine.joints.index(joint)] = angle
    names = [each.name for each in machine.pinned]
    return float(model.over(model.cylinder_kinematics, q, 0 * q, 0 * q)[0][0, names.index(cylinder), 0])


@pytest.mark.parametrize(("joint", "cylinder", "changed"), [
    ("boom", "boom_cylinder", {"boom_cylinder.dead_length": 1.3}),
    ("stick", "stick_cylinder", {"stick_cylinder.dead_length": 2.05}),
    ("stick", "stick_cylinder", {"stick_cylinder.dead_length": 1.70})])
def test_a_limit_is_the_end_of_the_stroke(joint: str, cylinder: str, changed: dict[str, float]) -> None:
    machine = ho.load_machine("cat215b").with_values(changed)
    narrower, changes = within_strokes(machine)
    assert [(change.joint, change.cylinder) for change in changes] == [(joint, cylinder)]
    change, part = changes[0], next(each for each in machine.cylinders if each.name == cylinder)
    moved = [k for k in (0, 1) if change.after[k] != change.before[k]]
    assert len(moved) == 1
    inward = 1 if moved == [0] else -1
    length = pin_distance(machine, joint, cylinder, change.after[moved[0]] - inward * INSIDE)
    assert min(abs(length - part.dead_length), abs(length - part.dead_length - part.stroke)) < 1e-9
    assert narrower.link(joint).joint.range == change.after
    range_checks.check(narrower)


def test_limits_within_strokes_stay() -> None:
    machine = ho.load_machine("cat215b")
    assert within_strokes(machine) == (machine, ())


def test_a_cylinder_that_fits_nowhere_keeps_the_limits() -> None:
    machine = ho.load_machine("cat215b").with_values({"boom_cylinder.dead_length": 9.0})
    assert within_strokes(machine)[1] == ()


def test_a_stroke_beyond_the_folded_triangle_ends_at_its_other_end() -> None:
    """The cylinder could be shorter than its pins ever are: the limits end at the dead point, where they fold."""
    machine = ho.load_machine("cat215b").with_values({"boom_cylinder.dead_length": 1.37}).with_joint_limits(
        {"boom": (-0.9, 1.8)})
    found = Geometry(machine).triangle(machine.cylinders[0])
    assert found is not None
    assert machine.cylinders[0].dead_length < float(found[1].moving - found[1].fixed)
    _, (change,) = within_strokes(machine)
    assert change.after[1] == pytest.approx(-float(found[1].offset), abs=2e-6)


def test_one_of_two_opposed_cylinders_may_pass_its_dead_point() -> None:
    """Its stroke limits the joint, its dead point does not."""
    backhoe = ho.load_machine("backhoe")
    assert within_strokes(backhoe)[1] == ()
    shorter, changes = within_strokes(backhoe.with_values({"swing_cylinder_left.dead_length": 0.76}))
    assert {change.cylinder for change in changes} == {"swing_cylinder_left"}
    (change,) = changes
    assert pin_distance(shorter, "swing", change.cylinder, min(change.after, key=abs)) == pytest.approx(0.76, abs=1e-5)


def test_a_cylinder_that_two_joints_move_narrows_the_one_it_is_there_for() -> None:
    """Its stroke then covers both ranges, and no more is given up than that takes."""
    loader = ho.load_machine("wheel_loader")
    longer = loader.with_values({"tilt_cylinder.dead_length": 0.99})
    with pytest.raises(ImpossibleError, match="'tilt_cylinder' would be"):
        range_checks.check(longer)
    narrower, (change,) = within_strokes(longer)
    assert (change.joint, change.cylinder, change.others) == ("bucket", "tilt_cylinder", ("lift",))
    range_checks.check(narrower)
    shortest = range_checks.over_range(Geometry(narrower), narrower.cylinders[1]).lengths.min()
    assert shortest == pytest.approx(0.99, abs=1e-5)


def test_a_joint_that_slides_is_narrowed_too() -> None:
    crane = ho.load_machine("knuckle_boom_crane").with_values({"telescope_cylinder.dead_length": 1.36})
    narrower, (change,) = within_strokes(crane)
    assert (change.joint, change.before) == ("telescope", (0.0, 1.1))
    assert 0 < change.after[0] < 0.02
    range_checks.check(narrower)


def test_two_cylinders_of_one_joint_both_narrow_it() -> None:
    backhoe = ho.load_machine("backhoe").with_values(
        {"swing_cylinder_left.dead_length": 0.76, "swing_cylinder_right.dead_length": 0.77})
    narrower, changes = within_strokes(backhoe)
    assert [change.cylinder for change in changes] == ["swing_cylinder_left", "swing_cylinder_right"]
    assert narrower.link("swing").joint.range == changes[1].after
    range_checks.check(narrower)
