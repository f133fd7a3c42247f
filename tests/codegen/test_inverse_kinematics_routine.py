"""Inverse kinematics in C: branches lead to their targets by a second derivation, and are those of Python."""

from __future__ import annotations

import itertools
from collections.abc import Callable

import numpy as np
import pytest

from fixtures import library
from fixtures.library import DEAD_POINT, OK, OUT_OF_STROKE, SINGULAR, UNREACHABLE, Library
from fixtures.tiers import tiered
from hydroopt.codegen.inverse_kinematics import no_arm
from hydroopt.codegen.symbols import Symbols
from hydroopt.errors import ProblemError
from hydroopt.machine.geometry import Geometry
from hydroopt.machine.machine_file import load_machine
from hydroopt.model.inverse_kinematics import inverse_kinematics
from hydroopt.model.model import Model
from oracles.complex_machine import ComplexMachine

Array = np.ndarray
Answer = tuple[tuple[float, ...], int, Array]


def place(second: ComplexMachine, q: Array) -> Array:
    return second.frames(q, 0 * q, 0 * q)[1][second.machine.tip].value[:3, 3].real


def turned(a: Array, b: Array) -> float:
    return float(np.max(np.abs(np.arctan2(np.sin(a - b), np.cos(a - b)))))


def answers(lib: Library, constants: Array, position: Array, held: Array) -> list[Answer]:
    """Signs, status and result of every branch."""
    signs = [name for name in ("reach", "elbow") if name in lib.interface.routines["inverse_kinematics"].reads]
    branches = list(itertools.product((1.0, -1.0), repeat=len(signs)))
    given = {"position": np.tile(position, (len(branches), 1)), "held": np.tile(held, (len(branches), 1))}
    given |= {name: np.array(branches)[:, [k]] for k, name in enumerate(signs)}
    status, results = lib.call("inverse_kinematics", constants, given, len(branches))
    return list(zip(branches, status.tolist(), results, strict=True))


def held_of(lib: Library) -> list[int]:
    return [lib.interface.machine.joints.index(joint) for joint in lib.interface.kinds["held"].names]


@pytest.mark.parametrize(("name", "real"), tiered(
    [("cat215b", "double"), ("cat215b", "float"), ("patu655_lift", "float"), ("kr300", "double")],
    lambda name, real: name == "patu655_lift"))
def test_branches_of_random_postures(name: str, real: str, libraries: Callable[..., Library]) -> None:
    """With a geometry whose axes are up to 0.03 rad from parallel where it is a parameter: each result is right, one
    is the posture itself, and nothing is outside the limits but what is said to be."""
    lib = libraries(name, real, "-O0")
    machine, rng = lib.interface.machine, np.random.default_rng(41)
    values = dict(lib.interface.values)
    if "geometry" in values:
        values["geometry"] = values["geometry"] + rng.uniform(-0.03, 0.03, len(values["geometry"]))
    constants = lib.prepare(values)
    geometry = dict(zip(lib.interface.kinds["geometry"].names, values.get("geometry", ()), strict=True))
    second = ComplexMachine(machine, geometry)
    lower, upper = machine.ranges.T
    tolerance, found, count = (1e-9 if real == "double" else 3e-5), 0, 40
    for q in library.subjects.states(machine, rng, count)[0]:
        target = place(second, q)
        for _, status, result in answers(lib, constants, target, q[held_of(lib)]):
            if status <= OUT_OF_STROKE:
                there = result["q"].astype(float)
                assert np.linalg.norm(place(second, there) - target) < tolerance
                expected = np.maximum(np.maximum(lower - there, there - upper), 0)
                assert np.allclose(result["outside"], expected, rtol=0, atol=1e-6)
                found += turned(there, q) < 100 * tolerance
    # that posture is missing where the arm is nearly stretched, or a cylinder near its dead point
    assert found >= count - 1


@pytest.mark.slow
def test_branches_are_those_of_python(libraries: Callable[..., Library]) -> None:
    """Of targets all over the workspace and beyond it: as many postures, the same ones, or none."""
    lib = libraries("cat215b", "double", "-O0")
    model, constants, rng = Model(lib.interface.machine), lib.prepare(), np.random.default_rng(42)
    counts = []
    for target in rng.uniform(-7, 7, (15, 3)) * [1, 1, 0.6]:
        made = answers(lib, constants, target, np.zeros(0))
        postures = [result["q"] for _, status, result in made if status <= OUT_OF_STROKE or status == DEAD_POINT]
        counts.append(len(postures))
        if not postures:
            assert all(status == UNREACHABLE for _, status, _ in made)
            with pytest.raises(ProblemError):
                inverse_kinematics(model, target)
            continue
        expected = [each.q for each in inverse_kinematics(model, target)]
        assert len(postures) == len(expected)
        assert all(min(turned(q, one) for one in postures) < 1e-8 for q in expected)
    assert {0, 4} <= set(counts)


def test_dead_points_limits_and_stretched_arms_have_a_status(libraries: Callable[..., Library]) -> None:
    lib = libraries("cat215b", "double", "-O0")
    machine, constants = lib.interface.machine, lib.prepare()
    second = ComplexMachine(machine)
    boom = machine.cylinders[0]
    offset = float(Geometry(machine).triangle(boom)[1].offset)

    def statuses(q: Array) -> list[int]:
        return [status for _, status, _ in answers(lib, constants, place(second, q), np.zeros(0))]

    assert DEAD_POINT in statuses(np.array([0.3, -offset, 1.4]))
    assert SINGULAR in statuses(np.array([0.3, -0.2, 0.0]))
    assert set(statuses(np.array([0.3, -0.2, 1e-5]))) <= {SINGULAR, UNREACHABLE}
    lower, upper = machine.link("boom").joint.range
    beyond = np.array([0.3, upper + 0.05, 1.4])
    (result,) = [result for _, status, result in answers(lib, constants, place(second, beyond), np.zeros(0))
                 if status <= OUT_OF_STROKE and turned(result["q"], beyond) < 1e-9]
    assert result["outside"] == pytest.approx([0, 0.05, 0], abs=1e-9)
    assert OK in statuses(np.array([0.3, (lower + upper) / 2, 1.4]))
    far = [status for _, status, _ in answers(lib, constants, np.array([20.0, 0, 0]), np.zeros(0))]
    assert set(far) == {UNREACHABLE}


@pytest.mark.slow
def test_arms_without_a_closed_form_say_why() -> None:
    for name, reason in (("panda", "are not one joint with two parallel ones across it"),
                         ("spatial", "are not one joint with two parallel ones across it")):
        assert reason in library.subject(name, "double").interface.impossible["inverse_kinematics"]


def test_an_arm_without_a_length_at_its_end_has_no_inverse_kinematics() -> None:
    """As one from a URDF file without the frame of a tool: its code held 'nan.0'."""
    for name, without, reason in (
            ("cat215b", "stick", "the tip, the far end of stick, lies on the axis of stick, which cannot move it"),
            ("cat215b", "boom", "the axes of boom and stick coincide"), ("cat215b", "", "")):
        machine = load_machine(name)
        joints = {link.name: link.joint.model_copy(update={"a": 0.0} if link.name == without else {})
                  for link in machine.links}
        shorter = machine.model_copy(update={"links": tuple(
            link.model_copy(update={"joint": joints[link.name]}) for link in machine.links)})
        assert no_arm(Symbols(shorter)) == reason
