"""Invariants that hold for any machine, however it is built."""

from __future__ import annotations

import copy
from typing import Any

import numpy as np
import pytest
from pydantic import ValidationError

from fixtures.tree import TREE, pin
from hydroopt.machine.actuators import Cylinder, GasCylinder
from hydroopt.machine.links import Body, Joint
from hydroopt.machine.machine import Machine
from hydroopt.machine.sensors import Sensor

INCH = 0.0254


@pytest.fixture
def tree() -> Machine:
    return Machine.model_validate(TREE)


def test_a_tree_knows_its_branches(tree: Machine) -> None:
    assert tree.joints == ("trunk", "left", "right", "twig")
    assert tree.ancestry("twig") == ("twig", "right", "stump", "trunk")
    assert tree.ancestry("base") == ()
    assert tree.joints_between("left", "twig") == ("left", "right", "twig")
    assert tree.joints_between("base", "stump") == ("trunk",)
    assert tree.joints_between("trunk", "stump") == ()


def test_actuators_stand_in_the_order_of_their_joints(tree: Machine) -> None:
    assert [actuator.name for actuator in tree.actuators] == [
        "trunk_motor",
        "left_drive",
        "right_cylinder",
        "twig_cylinder",
    ]
    assert [tree.axis_of(c) for c in tree.cylinders] == ["twig", "right"]


def test_channels_have_the_unit_of_their_joint(tree: Machine) -> None:
    units = tree.channel_units
    assert (units["trunk.q"], units["trunk.qd"], units["trunk.tau"]) == ("rad", "rad/s", "N*m")
    assert (units["left.q"], units["left.qd"], units["left.tau"]) == ("m", "m/s", "N")
    assert (units["twig_cylinder.p_rod"], units["twig_cylinder.length"], units["trunk_motor.p_b"]) == ("Pa", "m", "Pa")
    assert "stump.q" not in units
    assert tree.sensor("twig.q") is tree.sensors[0]
    assert tree.sensor("right.q") is None


def test_machines_are_frozen_and_equal_by_value(tree: Machine) -> None:
    assert tree == Machine.model_validate(copy.deepcopy(TREE))
    with pytest.raises(ValidationError):
        tree.name = "bush"  # type: ignore[misc]
    assert tree.sha256 == Machine.model_validate(tree.model_dump()).sha256
    assert tree.sha256 != Machine.model_validate(TREE | {"gravity": 1.62}).sha256


def test_a_changed_copy_knows_itself(tree: Machine) -> None:
    """What was computed of the original (joints, actuators, digest) must not stick to a copy that differs."""
    assert (tree.joints[0], len(tree.sha256)) == ("trunk", 64)
    moon = tree.model_copy(update={"gravity": 1.62})
    assert moon.sha256 == Machine.model_validate(TREE | {"gravity": 1.62}).sha256


def test_code_may_use_units_or_plain_numbers() -> None:
    joint = Joint(type="revolute", a="518 cm", alpha="-90 deg", lower="-60 deg", upper=0.5, max_speed="30 deg/s",
                  friction={"coulomb": "2 kN*m", "viscous": "3 kN*m*s/rad"})
    assert (joint.a, joint.alpha, joint.upper) == (pytest.approx(5.18), pytest.approx(-np.pi / 2), 0.5)
    assert (joint.lower, joint.max_speed) == (pytest.approx(-np.pi / 3), pytest.approx(np.pi / 6))
    assert (joint.friction.coulomb, joint.friction.viscous) == (pytest.approx(2000), pytest.approx(3000))
    slide = Joint(type="prismatic", lower="0 mm", upper="800 mm", max_speed="12 cm/s", max_acceleration="1 m/s^2",
                  friction={"coulomb": "2 kN", "viscous": "3 kN*s/m"})
    assert (slide.upper, slide.max_speed, slide.friction.coulomb) == (pytest.approx(0.8), pytest.approx(0.12), 2000)


@pytest.mark.parametrize(
    ("joint", "words"),
    [
        ({"type": "revolute", "lower": "0 m", "upper": 1}, "'m' is not a unit of the kind 'rad'"),
        ({"type": "prismatic", "lower": "0 deg", "upper": 1}, "'deg' is not a unit of the kind 'm'"),
        ({"type": "revolute", "lower": 1, "upper": 1}, "not below"),
        ({"type": "revolute", "lower": 0}, "needs 'lower' and 'upper'"),
        ({"type": "locked", "upper": 1}, "locked joint has"),
        ({"type": "revolute", "lower": 0, "upper": float("nan")}, ""),
        ({"type": "revolute", "lower": -float("inf"), "upper": 1}, ""),
        ({"type": "revolute", "lower": 0, "upper": 1, "a": float("inf")}, ""),
        ({"type": "sliding", "lower": 0, "upper": 1}, ""),
        ({"type": "revolute", "lower": 0, "upper": 1, "a": True}, ""),
        ({"type": "revolute", "lower": 0, "upper": 1, "length": 1}, ""),
    ],
)
def test_impossible_joints(joint: dict[str, Any], words: str) -> None:
    with pytest.raises(ValidationError, match=words or None):
        Joint.model_validate(joint)


def test_areas_of_all_jacks_together() -> None:
    ends = {"barrel": pin("base"), "rod": pin("boom"), "dead_length": 1.0, "stroke": 1.0}
    by_area = Cylinder(name="c", jacks=2, head_area="15.9 in^2", rod_area="9.96 in^2", **ends)
    np.testing.assert_allclose(by_area.areas, np.array([31.8, 19.92]) * INCH**2, rtol=1e-12)
    by_bore = Cylinder(name="c", jacks=3, bore="100 mm", rod_diameter="56 mm", **ends)
    np.testing.assert_allclose(by_bore.areas, 3 * np.pi * np.array([0.05**2, 0.05**2 - 0.028**2]), rtol=1e-12)


@pytest.mark.parametrize(
    "areas",
    [
        {},
        {"bore": 0.1},
        {"head_area": 0.01},
        {"bore": 0.1, "head_area": 0.01},
        {"bore": 0.1, "rod_area": 0.005},
        {"bore": 0.1, "rod_diameter": 0.06, "head_area": 0.01},
        {"bore": 0.06, "rod_diameter": 0.1},
        {"bore": 0.1, "rod_diameter": 0.1},
        {"head_area": 0.01, "rod_area": 0.01},
        {"head_area": 0.01, "rod_area": 0.02},
        {"bore": -0.1, "rod_diameter": 0.06},
    ],
)
def test_impossible_pistons(areas: dict[str, float]) -> None:
    with pytest.raises(ValidationError):
        Cylinder.model_validate(
            {"name": "c", "barrel": pin("base"), "rod": pin("boom"), "dead_length": 1.0, "stroke": 1.0} | areas
        )


def test_a_body_by_its_centre_is_the_same_about_the_origin() -> None:
    """Four point masses: their sums about the origin are the parallel axis theorem's answer."""
    rng = np.random.default_rng(0)
    masses, points = rng.uniform(1, 5, 4), rng.normal(0, 1, (4, 3))

    def inertia(about: np.ndarray) -> np.ndarray:
        arms = points - about
        return sum(m * (a @ a * np.eye(3) - np.outer(a, a)) for m, a in zip(masses, arms, strict=True))[
            np.triu_indices(3)
        ]

    m, com = masses.sum(), masses @ points / masses.sum()
    by_centre = Body(m=m, com=tuple(com), inertia_com=tuple(inertia(com)))
    by_origin = Body(m=m, mc=tuple(m * com), inertia=tuple(inertia(np.zeros(3))))
    np.testing.assert_allclose(by_centre.phi, by_origin.phi, rtol=1e-12)
    np.testing.assert_allclose(by_origin.phi, [m, *masses @ points, *inertia(np.zeros(3))], rtol=1e-12)


@pytest.mark.parametrize("body", [
    {"m": 1}, {"m": 1, "com": (0, 0, 0)}, {"m": 1, "com": (0, 0, 0), "inertia": (1,) * 6}, {"m": 1, "mc": (0, 0, 0)},
    {"m": -1, "mc": (0, 0, 0), "inertia": (1,) * 6}, {"m": 1, "mc": (0, 0), "inertia": (1,) * 6},
    {"m": 1, "mc": (0, 0, 0), "inertia": (1,) * 6, "com": (0, 0, 0), "inertia_com": (1,) * 6}])
def test_bodies_stated_halfway_or_twice(body: dict[str, Any]) -> None:
    with pytest.raises(ValidationError):
        Body.model_validate(body)


@pytest.mark.parametrize(("distribution", "accuracy", "resolution", "expected"), [
    ("uniform", 0.6, 0.0, 0.6 / 3**0.5), ("gaussian", 0.6, 0.0, 0.6), ("uniform", 0.0, 1.2, 1.2 / 12**0.5),
    ("gaussian", 0.3, 0.4 * 12**0.5, 0.5)])
def test_standard_deviation_of_a_reading(
    distribution: Any, accuracy: float, resolution: float, expected: float
) -> None:
    sensor = Sensor(channels=("boom.q",), accuracy=accuracy, resolution=resolution, distribution=distribution)
    assert sensor.std == pytest.approx(expected)


def test_sensors_read_the_unit_of_their_channels() -> None:
    assert Sensor(channels=("boom.q",), accuracy="0.1 deg").accuracy == pytest.approx(np.pi / 1800)
    assert Sensor(channels=("slide.q",), accuracy="2 mm").accuracy == pytest.approx(0.002)
    assert Sensor(channels=("c.p_head", "c.p_rod"), accuracy="25 psi").accuracy == pytest.approx(25 * 6894.757293)
    for channels, accuracy in (
        (("c.p_head", "boom.q"), "1 bar"),
        (("boom.q",), "-1 deg"),
        ((), 1.0),
    ):
        with pytest.raises(ValidationError):
            Sensor.model_validate({"channels": channels, "accuracy": accuracy})


def edited(**changes: Any) -> dict[str, Any]:
    data = copy.deepcopy(TREE)
    for path, value in changes.items():
        node: Any = data
        *steps, last = [int(s) if s.isdigit() else s for s in path.split("__")]
        for step in steps:
            node = node[step]
        node[last] = value
    return data


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (edited(links__1__name="trunk"), "'trunk' is used 2 times"),
        (edited(links__1__name="base"), "is the chassis"),
        (edited(links__1__name="left side"), ""),
        (edited(links__1__parent="root"), "'root', which does not exist"),
        (edited(links__0__parent="twig"), "before its parent"),
        (edited(links__2__parent="stump"), "its own ancestor"),
        (edited(cylinders__0__rod=pin("leaf")), "'leaf', which does not exist"),
        (edited(cylinders__1__barrel=pin("right")), "no moving joint lies between"),
        (edited(drives=[]), "nothing drives the joint 'left'"),
        (edited(drives=[{"name": "d", "joint": "stump"}]), "'stump', which is not a moving joint"),
        (edited(drives=[*TREE["drives"], {"name": "d", "joint": "left"}]),
         "'left_drive' and 'd' are both measured by 'left.tau'"),
        (edited(sensors__1__channels=("stump.q",)), "'stump.q', which this machine does not have"),
        (edited(sensors__1__channels=("twig.q",)), "two sensors"),
        (edited(links=[]), ""),
        (edited(sensors__1__channels=("left.q", "right.q")), "one sensor reads left.q, right.q, .* m and rad"),
        (edited(sensors__1__accuracy="0.1 deg"), r"'deg' is not a unit of the kind 'm'"),
        (edited(sensors__0__accuracy="1 mm"), r"'mm' is not a unit of the kind 'rad'"),
        (edited(sensors__0__resolution="1 mm"), r"'mm' is not a unit of the kind 'rad'"),
        (edited(links__1__joint__friction={"coulomb": "2 N*m"}), r"'N\*m' is not a unit of the kind 'N'"),
        (edited(links__1__joint__friction={"viscous": "2 N*m*s/rad"}), r"not a unit of the kind 'N\*s/m'"),
        (edited(links__3__joint__friction={"coulomb": "2 kN"}), r"'kN' is not a unit of the kind 'N\*m'"),
        (edited(drives__0__friction={"offset": "2 N*m"}), r"'N\*m' is not a unit of the kind 'N'"),
        (edited(motors__0__friction={"viscous": "2 N*s/m"}), r"'N\*s/m' is not a unit of the kind 'N\*m\*s/rad'"),
        (edited(gravity=-9.81), ""),
        (edited(colour="yellow"), ""),
    ],
)
def test_impossible_machines(data: dict[str, Any], words: str) -> None:
    with pytest.raises(ValidationError, match=words or None):
        Machine.model_validate(data)


def test_units_that_suit_their_joint_pass() -> None:
    made = Machine.model_validate(edited(
        sensors__1__accuracy="1 mm", sensors__0__accuracy="1 mrad",
        drives__0__friction={"offset": "2 kN", "coulomb": 5},
        links__1__joint__friction={"coulomb": "2 kN", "viscous": "3 kN*s/m"},
        links__3__joint__friction={"coulomb": "2 kN*m", "viscous": "1 N*m*s"}))
    assert made.sensors[1].accuracy == pytest.approx(1e-3)
    assert made.drives[0].friction.offset == 2000
    assert made.links[3].joint.friction.viscous == 1


def test_ends_of_a_gas_cylinder_carry_no_body() -> None:
    gas = {"name": "gas", "acts": "push", "area": 0.002, "volume": 0.004, "reference_length": 0.8, "precharge": 5e6,
           "barrel": pin("stump"), "rod": pin("right")}
    assert GasCylinder.model_validate(gas).gas_volume(0.9) == pytest.approx(0.0042)
    body = {"m": 5, "mc": (0, 0, 0), "inertia": (1, 0, 0, 1, 0, 1)}
    with pytest.raises(ValidationError, match="carry no body yet"):
        GasCylinder.model_validate(gas | {"rod": pin("right") | {"body": body}})
