"""What closed chains can tell: against Section 3.6.4, counts of Section 3.5.1, and set-ups that cannot work."""

from __future__ import annotations

import json
import time
from typing import Any

import numpy as np
import pytest

from hydroopt.estimation.kinematic.mobility import Mobility, grubler, mobility, obstacles
from hydroopt.machine.calibration_chain import Calibrator, Fixture, Stage
from hydroopt.machine.links import Note
from hydroopt.machine.machine import Machine
from hydroopt.machine.machine_file import load_machine
from hydroopt.machine.sensors import Sensor
from hydroopt.machine.survey import Tracker

CAT = load_machine("cat215b")
ANGLES = tuple(sensor for sensor in CAT.sensors if sensor.channels[0].endswith(".q"))
LOCKED = {"swing": 0.0, "boom": -0.485, "stick": 1.4, "grapple_swing": 0.75}
DRAWN = ("stick.a", "stick.alpha", "stick.beta")


@pytest.fixture(scope="module")
def excavator() -> Mobility:
    return mobility(CAT)


def changed(machine: Machine = CAT, *, notes: dict[str, Note] | None = None, **parts: Any) -> Machine:
    return machine.model_copy(update=parts | {"notes": {**machine.notes, **(notes or {})}})


def one_stage(*moves: str, **more: Any) -> Machine:
    """The excavator with one stage in which some joints move."""
    locked = {joint: angle for joint, angle in LOCKED.items() if joint not in moves}
    return changed(stages=(Stage(name="stage", moves=moves, locked=locked | more.pop("locked", {})),), **more)


def free_lengths(machine: Machine) -> dict[str, Note]:
    """Notes that make all lengths of a machine's chain unknown."""
    names = [f"{link.name}.joint.{key}" for link in machine.chain for key in ("a", "d")]
    return dict.fromkeys([*names, "calibrator.tip", *(f"{f.name}.position" for f in machine.fixtures)], Note(sigma=0.1))


def planar(axis: float = 0.0, play: float = 0.0) -> Machine:
    """An arm of one joint with a calibrator of three; the third one's axis can be turned across."""
    turn = {"type": "revolute", "lower": -3.0, "upper": 3.0}
    links = [{"name": f"c{k}", "parent": f"c{k - 1}" if k else "arm", "joint": turn | {
        "a": 0.8, "alpha": axis * (k == 1)}} for k in range(3)]
    return Machine.model_validate({
        "name": "planar", "links": [{"name": "arm", "parent": "base", "joint": turn | {"a": 1.0}}],
        "drives": [{"name": "drive", "joint": "arm"}], "calibrator": {"parent": "arm", "links": links},
        "fixtures": [{"name": "ball", "position": (1.2, 0.5, 0.0), "play": play}],
        "sensors": [{"channels": ["c0.q", "c1.q", "c2.q"], "accuracy": 1e-3}],
        "stages": [{"name": "moves", "moves": ["arm"]}], "notes": {"arm.joint.a": Note(sigma=0.1),
                                                                   "c0.joint.a": Note(sigma=0.1)}})


@pytest.mark.parametrize(("n", "p", "d", "extra", "m"), [
    (6, 4, 1, 3, 3), (4, 3, 0, 3, 1), (3, 3, 1, 3, 1), (4, 4, 1, 4, 2), (6, 6, 6, 0, 3), (4, 0, 0, 0, 1)])
def test_counting_joints(n: int, p: int, d: int, extra: int, m: int) -> None:
    """Sections 3.5.1 and 3.3.2; with four joints, three locked, link 4 held and the grapple in the calibrator, two."""
    assert grubler(n, p=p, d=d, extra=extra) == m


def test_excavator_moves(excavator: Mobility) -> None:
    for stage, joint in zip(excavator.stages, ("stick", "boom", "swing"), strict=True):
        assert stage.moves == (joint,)
        assert stage.sensed == ("grapple", "yoke", "upper_arm", "forearm")
        assert set(stage.locked) == {*CAT.joints, "grapple_swing"} - {joint}
        assert (stage.grubler, stage.rank_mobility, stage.unsensed) == (2, 2, 4)
    assert excavator.obstacles == ()


def test_section_3_6_4(excavator: Mobility) -> None:
    stick, boom, swing = excavator.stages
    assert set(stick.full) == {*DRAWN, "grapple_swing.locked.stick_moves"}
    assert set(boom.full) == {"boom.a", "boom.alpha", "boom.beta", "stick.locked.boom_moves"}
    assert set(swing.full) == {"swing.a", "swing.alpha", "boom.d", "boom.locked.swing_moves", "ball.x", "ball.z"}
    assert swing.none == ("ball.y",)
    assert {"boom.d", "ball.z", "swing.locked.stick_moves"} <= {name for group in stick.combinations for name in group}
    assert excavator.together is not None
    assert excavator.together.combinations == (("ball.y", "swing.locked.stick_moves"),)
    assert excavator.together.none == ()


def test_d_along_the_moving_axis_cannot_be_told() -> None:
    found = mobility(changed(notes={"stick.joint.d": Note(sigma=0.02)}))
    assert set(found.stages[0].full) == {*DRAWN, "grapple_swing.locked.stick_moves"}
    assert any({"stick.d", "boom.d", "ball.y"} <= {*group} for group in found.stages[0].combinations)
    assert found.together is not None
    assert {"stick.d", "boom.d"} in [{*group} for group in found.together.combinations]  # their axes are parallel


def test_no_length_scale() -> None:
    loose = changed(notes=free_lengths(CAT))
    sentence = ("machine 'cat215b': there is no length scale: the same angles fit a chain with all its lengths doubled"
                "; take a length as exact")
    assert [text[:len(sentence)] for text in obstacles(loose)] == [sentence]
    together = mobility(loose).together
    assert together is not None
    lengths = {"swing.a", "boom.a", "stick.a", "grapple.d", "upper_arm.d", "forearm.a", "forearm.d", "ball.x"}
    assert any(lengths <= {*group} for group in together.combinations)
    assert obstacles(changed(loose, notes={"forearm.joint.a": Note()})) == ()


@pytest.mark.slow
def test_what_gives_a_scale() -> None:
    loose = changed(notes=free_lengths(CAT))
    pins = {f"{name}_cylinder.{end}.pin": Note() for name in ("boom", "stick") for end in ("barrel", "rod")}
    assert obstacles(changed(loose, notes=pins)) == ()  # cylinders of known geometry whose lengths are read
    tape = Sensor(channels=("forearm.distance",), accuracy=1e-3), Sensor(channels=("stick.distance",), accuracy=1e-3)
    assert obstacles(changed(loose, sensors=(*CAT.sensors, *tape))) == ()
    panda = load_machine("panda_mukca")
    panda = changed(panda, notes=free_lengths(panda) | {"panda_joint1.joint.d": Note()})
    assert obstacles(panda) == ()
    assert len(found := obstacles(changed(panda, distances=()))) == 1  # d of the first joint only places the base
    assert "no length scale" in found[0]


def test_nothing_closes_the_chain() -> None:
    for machine in (load_machine("kr300"), changed(fixtures=(), stages=())):
        sentence, = obstacles(machine)
        assert sentence.endswith("nothing closes the chain, so that no pose identifies any of its links; state a "
                                 "calibrator with a fixture or a tracker.")
    assert mobility(load_machine("kr300")).lines() == []


@pytest.mark.parametrize(("machine", "sentence"), [
    (one_stage("stick", locked={"yoke": 0.0, "upper_arm": 0.0}),
     "stage 'stage': the chain cannot move: its mobility is 0 (Eq. 3.5); add a joint to the calibrator or free one "
     "that is locked."),
    (one_stage("stick", fixtures=(Fixture(name="ball", position=(30, 0, 0)),)),
     "stage 'stage': within the joints' limits the tip does not reach fixture 'ball'; move what is out of reach "
     "nearer, widen the limits or lock the joints elsewhere."),
    (one_stage("swing", "boom", "stick", sensors=ANGLES),
     "stage 'stage': its poses identify nothing: joints 'swing', 'boom', 'stick' and the fixture have more than five "
     "freedoms without a sensor; sense or lock one of them."),
    (one_stage("swing", "boom", "stick", "grapple_swing", sensors=ANGLES),
     "stage 'stage': with all readings held the chain can still move in 1 way, so that the position of joints "
     "'swing', 'boom', 'stick', 'grapple_swing' is not determined; sense or lock as many of them."),
    (one_stage("stick", "upper_arm", "grapple_swing", locked={"grapple": 0.1},
               sensors=(Sensor(channels=("yoke.q", "forearm.q"), accuracy=1e-3),)),
     "stage 'stage': too few joints are sensed: they do not move the tip in all directions, so that nothing weighs the "
     "loop's gap; sense three joints with axes across each other, or state the fixture's play."),
    (planar(),
     "stage 'moves': the axes of joints 'c0', 'c1', 'c2' are parallel and move the tip in planes only; turn one of "
     "them across, or sense another joint."),
    (changed(stages=(Stage(name="stage", moves=("stick",), locked={"swing": 0.0, "boom": -0.485}),)),
     "the joint 'grapple_swing' is neither sensed, nor locked or moving in stage 'stage'"),
])
def test_obstacles(machine: Machine, sentence: str) -> None:
    found = mobility(machine)
    assert any(sentence in text for text in found.obstacles), found.obstacles
    assert any(line.startswith("! ") and sentence in line for line in found.lines())


def test_cylinders_tell_where_their_joints_stand() -> None:
    assert obstacles(one_stage("swing", "boom", "stick")) == ()


@pytest.mark.slow
def test_stages_share_a_sentence() -> None:
    far = obstacles(changed(fixtures=(Fixture(name="ball", position=(30, 0, 0)),)))
    assert [text.partition(":")[0] for text in far] == ["stages 'stick_moves', 'boom_moves', 'swing_moves'"]


def test_planar_chain_moves_more_than_counted() -> None:
    stage, = mobility(planar()).stages
    assert (stage.grubler, stage.rank_mobility) == (1, 2)
    assert stage.remark == (", 2 by the loop's Jacobian: in this special geometry nothing moves the tip in 1 direction")
    crossed, = mobility(planar(np.pi / 2)).stages
    assert (crossed.grubler, crossed.rank_mobility, crossed.remark) == (1, 1, "")
    assert obstacles(planar(np.pi / 2)) == ()


def test_all_sensed_with_fixtures_that_move() -> None:
    found = mobility(load_machine("panda_mukca"))
    stage, = found.stages
    assert (stage.stage, stage.moves, len(stage.sensed), stage.locked) == ("poses", (), 7, ())
    assert (stage.grubler, stage.rank_mobility, stage.unsensed) == (4, 4, 3)
    assert stage.combinations == stage.none == ()
    assert {"panda_joint6.a", "tip.z", "hole_0.poses.x", "hole_1.poses.z"} <= {*stage.full}
    assert found.together is not None
    assert found.together.full == stage.full
    assert found.obstacles == ()


def test_tracker_instead_of_a_fixture() -> None:
    seen = Sensor(channels=("tip.x", "tip.y", "tip.z"), accuracy=1e-3)
    panda = load_machine("panda_mukca")
    found = mobility(changed(panda, fixtures=(), distances=(), tracker=Tracker(), sensors=(*panda.sensors, seen)))
    assert (found.stages[0].grubler, found.stages[0].rank_mobility, found.stages[0].unsensed) == (7, 7, 0)
    assert {"panda_joint6.a", "tip.z"} <= {*found.stages[0].full}
    assert found.obstacles == ()


def test_cylinders(excavator: Mobility) -> None:
    """Lengths over the joint tell l_c, l_u, l_l and the offset (Eqs. 3.26 and 3.27), not where the pins' axes lie."""
    for name, across in (("boom_cylinder", ("barrel.y", "rod.z")), ("stick_cylinder", ("barrel.z", "rod.z"))):
        told = excavator.cylinders[name]
        assert told.rank == 4
        assert told.full == (f"{name}.dead_length",)
        assert told.none == tuple(f"{name}.{pin}" for pin in across)
        assert [len(group) for group in told.combinations] == [4]
    lift = mobility(load_machine("patu655_lift"))
    assert [told.rank for told in lift.cylinders.values()] == [4]
    assert lift.lines()[0] == "lift_cylinder: lengths and joint angles identify 4 numbers of its geometry (Eq. 3.26)"
    assert not any(line.startswith("!") for line in lift.lines())


def test_lines_and_json(excavator: Mobility) -> None:
    lines = excavator.lines()
    assert lines[:3] == ["stage stick_moves: moves stick; senses grapple, yoke, upper_arm, forearm; locks swing, boom, "
                         "grapple_swing", "  mobility: 2 (Eq. 3.5); freedoms without a sensor: 4",
                         "  alone: stick.a, stick.alpha, stick.beta, grapple_swing.locked.stick_moves"]
    assert "  in combination: ball.y with swing.locked.stick_moves" in lines
    content = json.loads(json.dumps(excavator.as_dict()))
    assert content["stages"][2]["none"] == ["ball.y"]
    assert content["together"]["combinations"] == [["ball.y", "swing.locked.stick_moves"]]


@pytest.mark.parametrize("name", ["cat215b", "panda_mukca", "patu655_lift", "kr300"])
def test_takes_little_time(name: str) -> None:
    machine, began = load_machine(name), time.process_time()
    mobility(machine)
    assert time.process_time() - began < 2


def test_rigid_tool_on_a_planar_robot() -> None:
    """All joints of the robot are sensed and parallel."""
    turn = {"type": "revolute", "lower": -3.0, "upper": 3.0, "a": 1.0}
    machine = Machine.model_validate({
        "name": "flat", "links": [{"name": f"j{k}", "parent": f"j{k - 1}" if k else "base", "joint": turn}
                                  for k in range(4)],
        "drives": [{"name": f"drive{k}", "joint": f"j{k}"} for k in range(4)],
        "fixtures": [{"name": "ball", "position": (1.5, 0.5, 0.0)}], "calibrator": Calibrator(parent="j3"),
        "sensors": [{"channels": [f"j{k}.q" for k in range(4)], "accuracy": 1e-3}], "notes": {
            "j1.joint.a": Note(sigma=0.1)}})
    assert [text.partition(" are ")[0] for text in obstacles(machine)] == [
        "stage 'poses': the axes of joints 'j0', 'j1', 'j2', 'j3'"]
