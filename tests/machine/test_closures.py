"""Loops in closed form and by Newton's method: what determines which joints, over the range, and what cannot be."""

import re

import numpy as np
import pytest
from pydantic import ValidationError

from fixtures.closures import (
    crank,
    five_bar,
    geared,
    made,
    scissor,
    six_bar,
    sleeve,
    spherical,
    steering,
    telescope,
    tripod,
)
from hydroopt.machine import range_checks
from hydroopt.machine.closures import closures
from hydroopt.machine.general_loops import GeneralAssembly, closure_equations
from hydroopt.machine.geometry import Geometry
from hydroopt.machine.machine_file import dump_machine, read_machine
from hydroopt.machine.mechanism import Mechanism
from hydroopt.machine.quantity import ImpossibleError
from hydroopt.machine.range_checks import loop_ranges
from hydroopt.model.model import Model

KINDS = {crank: ["slider"], sleeve: ["slider"], scissor: ["slider", "dyad", "slider"], six_bar: ["general"],
         steering: ["general", "general"], spherical: ["general"]}


@pytest.mark.parametrize(("make", "kinds"), KINDS.items(), ids=[each.__name__ for each in KINDS])
def test_structure_tells_which_loops_have_a_closed_form(make, kinds):
    machine = make()
    found = closures(machine.links, machine.loops)
    assert [("dyad" if machine.turns(each.joints[1]) else "slider") if each.planar else "general"
            for each in found] == kinds
    assert read_machine(dump_machine(machine)) == machine


@pytest.mark.parametrize("make", [telescope, geared, five_bar, tripod])
def test_loops_and_couplings_that_follow_several_joints_close_over_their_ranges(make):
    range_checks.check(make())


@pytest.mark.parametrize("make", [six_bar, steering, spherical])
def test_newtons_steps_close_loops_to_rounding_over_the_whole_range(make):
    machine = make()
    mechanism, geometry, rng = Mechanism(machine), Geometry(machine), np.random.default_rng(3)
    for assembly in mechanism.assemblies:
        assert isinstance(assembly, GeneralAssembly)
        assert 3 <= assembly.steps <= 5
    for share in [0.0, 1.0, *rng.random(20)]:
        q = {joint: lower + share * (upper - lower) for joint in machine.joints
             for lower, upper in [machine.link(joint).joint.range]}
        at = {joint: float(value) for joint, value in mechanism.positions(geometry, q).items()}
        assert np.max(np.abs(np.array(closure_equations(geometry, machine.loops, at)))) < 1e-13


def test_newtons_steps_close_other_geometry_of_a_calibration_as_well():
    machine = six_bar()
    other = machine.with_values({"bar.a": 1.12, "other.x": 0.88, "crank.a": 0.51})
    values = {number.name: number.value for number in other.geometry_numbers}
    mechanism, geometry = Mechanism(machine), Geometry(machine, values)
    for crank_angle in (0.4, 0.9, 1.6):
        at = {joint: float(value) for joint, value in mechanism.positions(geometry, {"crank": crank_angle}).items()}
        assert np.max(np.abs(np.array(closure_equations(geometry, machine.loops, at)))) < 1e-11


def test_where_newtons_steps_do_not_close_there_is_no_number():
    machine = six_bar()
    found = Mechanism(machine).positions(Geometry(machine), {"crank": 4.0})
    assert np.isnan(float(found["plate"]))
    model = Model(machine)
    assert np.isnan(np.asarray(model.inverse_dynamics(4.0, 0, 0, model.parameters.nominal).full())).all()


@pytest.mark.slow
def test_derivatives_of_newtons_positions_are_exact():
    model = Model(six_bar())
    q, qd, qdd = np.array([[1.1]]), np.array([[0.7]]), np.array([[-0.4]])
    psi = model.parameters.nominal[None] + 1.0
    by_q = model.over(model.force_by_motion, q, qd, qdd, psi)[0]
    step = 1e-5
    ahead, behind = (model.over(model.inverse_dynamics, q + h, qd, qdd, psi)[0] for h in (step, -step))
    assert by_q.ravel() == pytest.approx((ahead - behind).ravel() / (2 * step), rel=1e-7)


def test_margins_have_their_postures():
    found = {each.assembly.closure.statements[0].name: each for each in loop_ranges(scissor())}
    assert found["middle"].at == "left = 63.0 deg"
    assert np.degrees(found["middle"].angle) == pytest.approx(90 - 63.03, abs=0.01)
    assert found["middle"].ratios["shoe"] == pytest.approx((-2 * np.sin(1.1), -2 * np.sin(0.15)))
    assert found["middle"].ratios["right"] == pytest.approx((-1.0, -1.0))


def edited(machine, **loops):
    """The loops of a machine, some with other statements."""
    return [loop.model_dump() | loops.get(loop.name, {}) for loop in machine.loops]


def joints(machine, **limits):
    """The links of a machine, some joints with other numbers."""
    return [link.model_dump() | {"joint": link.joint.model_dump() | limits.get(link.name, {})}
            for link in machine.links]


FREE = {"dependent": False, "lower": -1.0, "upper": 1.0}


@pytest.mark.parametrize(("machine", "parts", "what"), [
    (crank, {"links": joints(crank(), crank={"a": 1.55})},
     r"'pin' cannot close at crank = .* deg: its bar reaches 1.1"),
    (crank, {"loops": edited(crank(), pin={"posture": {"crank": 1.0, "head": 9.0}})}, "not near one of the two ways"),
    (crank, {"loops": edited(crank(), pin={"posture": {"crank": 1.0}})}, "does not state where rod or head stands"),
    (crank, {"links": joints(crank(), crank={"a": 3.0})},
     "cannot close in its own posture, crank = 57.3 deg: its bar reach"),
    (crank, {"links": joints(crank(), head=FREE)}, "'pin' has only 'rod' to determine, but a pin determines two"),
    (crank, {"loops": [*edited(crank()), edited(crank())[0] | {"name": "again"}]},
     "'again' has no dependent joint|have 4"),
    (sleeve, {"links": joints(sleeve(), sleeve={"alpha": 0.0})}, "'strut' in the loop 'eye' slides out of the plane"),
    (six_bar, {"loops": edited(six_bar())[:1]}, "'one' cannot determine 3 dependent joints, bar, rod"),
    (six_bar, {"links": joints(six_bar(), crank={"upper": 2.6})},
     "the loops 'one' and 'other' cannot close, or only beyond a"),
    (six_bar, {"loops": edited(six_bar(), other={"posture": {"crank": 0.9, "lever": 1.9}})}, "two postures of 'crank'"),
    (six_bar, {"loops": edited(six_bar(), other={"posture": {"crank": 1.0}})}, "does not state where lever stand then"),
    (six_bar, {"loops": edited(six_bar(), other={"posture": {"crank": 1.0, "lever": -1.5}})},
     "would close away from its p"),
    (six_bar, {"links": joints(six_bar(), bar={"a": 9.0})}, "cannot close near the posture of 'one', crank = 57.3 deg"),
    (steering, {"loops": edited(steering(), tie={"length": None})}, "a rod has a length, a pin or ball has none"),
    (steering, {"loops": edited(steering(), tie={"closed_by": "ball", "length": None})},
     "only 'lever' to determine, but a b"),
    (spherical, {"loops": edited(spherical(), ball={"closed_by": "pin"})}, "cannot determine 3 dependent joints"),
])
def test_what_cannot_be_is_refused(machine, parts, what):
    stated = machine().model_dump(exclude={"links", "name"}) | parts
    with pytest.raises((ImpossibleError, ValidationError)) as caught:
        range_checks.check(
            made("wrong", stated.pop("links", None) or [link.model_dump() for link in machine().links], **stated))
    assert re.search(what, str(caught.value)), caught.value


def test_a_linkage_that_can_move_by_itself_is_named():
    """A ball in a planar linkage has only two equations, and three joints to hold."""
    machine = six_bar()
    parts = machine.model_dump(exclude={"links", "name", "loops"})
    loops = edited(machine, one={"closed_by": "ball"})[:1]
    with pytest.raises(ImpossibleError, match="'one' cannot hold rod, plate, bar: they can move while"):
        range_checks.check(made("mobile", joints(machine, lever={"type": "locked", "dependent": False, "friction": {}}),
                                **parts, loops=loops))
