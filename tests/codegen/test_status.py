"""What the generated C says of inputs that it cannot reckon with, and that it then leaves alone what it was given."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
import pytest

from fixtures import library
from fixtures.library import (
    CONSTANTS,
    DEAD_POINT,
    NO_GAS_VOLUME,
    NOT_FINITE,
    NULL_POINTER,
    OK,
    OPEN_TRIANGLE,
    OUT_OF_STROKE,
    STALE,
    Library,
    held,
    over,
)
from fixtures.tiers import tiered
from hydroopt.codegen import self_test
from hydroopt.machine.geometry import Geometry
from hydroopt.machine.machine import Machine
from hydroopt.model.model import Model

Array = np.ndarray

BUILDS = (("cat215b", "double"), ("cat215b", "float"), ("kr300", "double"), ("patu655_lift", "float"))
PATTERN = 0xA5
BAD = (np.nan, np.inf, -np.inf)
EXCAVATOR = Model(library.machine("cat215b"))
BOOM, STICK = EXCAVATOR.machine.cylinders


@pytest.fixture(params=tiered(map(" ".join, BUILDS), lambda build: build in ("cat215b double", "patu655_lift float")))
def lib(request: pytest.FixtureRequest, libraries) -> Library:
    return libraries(*request.param.split(), "-O0")


@pytest.fixture(params=tiered(["double", "float"], lambda real: real == "double"))
def excavator(request: pytest.FixtureRequest, libraries) -> Library:
    return libraries("cat215b", request.param, "-O0")


def good(lib: Library, name: str) -> Array:
    """One input of a routine that it can reckon with."""
    states = self_test.states(lib.interface, 1, seed=3)
    given = {key: array[0] for key, array in states.items() if array.ndim == 2}
    return lib.filled(lib.interface.routines[name].takes, given, 1)


def fresh(lib: Library, struct: str) -> Array:
    """A struct full of a pattern of bits that is a finite number."""
    made = lib.zeros(struct)
    made.view(np.uint8)[:] = PATTERN
    return made


def untouched(record: Array) -> bool:
    return bool(np.all(record.view(np.uint8) == PATTERN))


def elements(record: Array, members: tuple[str, ...]) -> Iterator[tuple[str, Array, tuple[int, ...]]]:
    """Every number in some members of one struct: name, array and place in it."""
    for member in members:
        for place in np.ndindex(record[member].shape):
            yield member, record[member], place


def test_good_inputs_are_good(lib: Library) -> None:
    constants = lib.prepare()
    for name in lib.code.routines:
        out = fresh(lib, lib.interface.routines[name].gives)
        assert lib.routine(name, constants, good(lib, name), out) == OK
        for field in out.dtype.names:
            assert np.all(np.isfinite(out[field]))
            assert not np.any(out[field] == fresh(lib, lib.interface.routines[name].gives)[field])


def test_null_pointers(lib: Library) -> None:
    constants, params = lib.prepare(), lib.params()
    blank = np.full(CONSTANTS, PATTERN, np.uint8)
    assert lib.routine("prepare", None, blank) == NULL_POINTER
    assert lib.routine("prepare", params, None) == NULL_POINTER
    assert np.all(blank == PATTERN)
    for name in lib.code.routines:
        out = fresh(lib, lib.interface.routines[name].gives)
        arguments = [constants, good(lib, name), out]
        for k in range(3):
            assert lib.routine(name, *(None if i == k else each for i, each in enumerate(arguments))) == NULL_POINTER
        assert untouched(out)


def test_not_finite_inputs(lib: Library) -> None:
    constants = lib.prepare()
    for name in lib.code.routines:
        routine = lib.interface.routines[name]
        out, given = fresh(lib, routine.gives), good(lib, name)
        for member, array, place in elements(given, routine.reads):
            for bad in BAD:
                before, array[place] = array[place], bad
                assert lib.routine(name, constants, given, out) == NOT_FINITE, (name, member, place, bad)
                array[place] = before
        assert untouched(out)
        for _, array, place in elements(given, tuple(set(given.dtype.names) - set(routine.reads))):
            array[place] = np.nan  # what is not read may be anything
        assert lib.routine(name, constants, given, out) == OK


def test_inputs_of_absurd_size(lib: Library) -> None:
    """What is at its limit is taken as it is, what is beyond is not."""
    constants = lib.prepare()
    for name in lib.code.routines:
        routine = lib.interface.routines[name]
        out, given = fresh(lib, routine.gives), good(lib, name)
        for member, array, place in elements(given, routine.reads):
            limit = lib.real.type(lib.code.largest(member))
            before = array[place]
            for size, refused in ((np.nextafter(limit, lib.real.type(np.inf)), True), (limit, False)):
                for sign in (-1, 1):
                    array[place] = sign * size
                    status = lib.routine(name, constants, given, out)
                    assert (status == NOT_FINITE) == refused, (name, member, place, size)
                    assert not refused or untouched(out)
                    out = fresh(lib, routine.gives)
            array[place] = before


def test_not_finite_parameters(lib: Library) -> None:
    blank, params = np.full(CONSTANTS, PATTERN, np.uint8), lib.params()
    for member, array, place in elements(params, tuple(lib.interface.values)):
        for bad in BAD:
            before, array[place] = array[place], bad
            assert lib.routine("prepare", params, blank) == NOT_FINITE, (member, place, bad)
            array[place] = before
    assert np.all(blank == PATTERN)
    assert lib.routine("prepare", params, blank) == OK


def test_parameters_of_other_code_and_constants_not_prepared_are_stale(lib: Library) -> None:
    blank, params = np.full(CONSTANTS, PATTERN, np.uint8), lib.params()
    params["interface"] += 1
    assert lib.routine("prepare", params, blank) == STALE
    assert np.all(blank == PATTERN)
    for constants in (blank, np.zeros(CONSTANTS, np.uint8)):
        for name in lib.code.routines:
            out = fresh(lib, lib.interface.routines[name].gives)
            assert lib.routine(name, constants, good(lib, name), out) == STALE
            assert untouched(out)


def test_constants_of_parameters_that_were_rejected_are_stale(excavator: Library) -> None:
    """Also where they were good before: a triangle without sides shows only in what is prepared."""
    params = excavator.params()
    params["geometry"][:] = 0.0
    constants = excavator.prepare()
    assert excavator.routine("prepare", params, constants) == OPEN_TRIANGLE
    out = fresh(excavator, "efforts")
    assert excavator.routine("inverse_dynamics", constants, good(excavator, "inverse_dynamics"), out) == STALE
    assert untouched(out)


def test_triangles_that_cannot_close(excavator: Library) -> None:
    constants = excavator.prepare()
    for k, cylinder in enumerate((BOOM, STICK)):
        fixed, moving = sides(cylinder)
        for length in (0.0, -1.0, -2.0, abs(fixed - moving) - 1e-3, fixed + moving + 1e-3, 1e3):
            given = good(excavator, "joint_state")
            given["length"][0, k] = length
            out = excavator.zeros("joints")
            assert excavator.routine("joint_state", constants, given, out) == OPEN_TRIANGLE, (cylinder.name, length)


def sides(cylinder) -> tuple[float, float]:
    found = Geometry(EXCAVATOR.machine).triangle(cylinder)
    assert found is not None
    return float(found[1].fixed), float(found[1].moving)


LEVERLESS = ("cylinder_state", "actuator_forces", "mass_matrix", "closure")
"""Routines that need no lever arm."""
MOTIONS = (*LEVERLESS, "inverse_dynamics", "gravity_forces", "regressor", "reduced_regressor", "wrench_forces",
           "tip_wrench", "residual", "residual_by_motion", "residual_by_parameters", "residual_by_geometry",
           "tilted_regressor", "force_by_motion")


def call(lib: Library, constants: Array, name: str, q: Array) -> tuple[int, Array]:
    """Status and result of a routine at joint angles q."""
    given = good(lib, name)
    if name == "closure":
        given["chain_q"][0, :3] = q
    else:
        given["q"][0] = q
    out = fresh(lib, lib.interface.routines[name].gives)
    return lib.routine(name, constants, given, out), out


def test_pins_that_coincide(excavator: Library) -> None:
    """The boom's rod pin is where its barrel pin is, exactly, as all turns between them are none."""
    values = dict(zip(excavator.interface.kinds["geometry"].names, excavator.interface.values["geometry"].tolist(),
                      strict=True))
    values |= {"swing.a": 0.0, "swing.alpha": 0.0, "boom.d": 0.0}
    values |= {f"boom_cylinder.rod.{axis}": values[f"boom_cylinder.barrel.{axis}"] for axis in "xyz"}
    for dead in (1.423, 1.5, 1.3):
        # the dead length tells how far the rod is out, and nothing about the pins
        values["boom_cylinder.dead_length"] = dead
        constants = excavator.prepare({"geometry": np.array(list(values.values()))})
        for name in MOTIONS:
            status, out = call(excavator, constants, name, np.array([0.5, 0.0, 1.5]))
            assert status == OPEN_TRIANGLE, (name, dead, status, out)


def test_a_cylinder_parallel_to_its_joint_has_a_status(excavator: Library, libraries) -> None:
    """Its bodies are turned by the joint's axis, which leaves them undetermined; in float the result was not finite."""
    names, nominal = excavator.interface.kinds["geometry"].names, excavator.interface.values["geometry"]
    single = libraries("cat215b", "float", "-O0", "mass_matrix")
    for sideways, expected in ((1.0, {OK, OUT_OF_STROKE}), (150.0, {DEAD_POINT}), (34527.0, {DEAD_POINT})):
        geometry = np.where([name == "boom_cylinder.rod.z" for name in names], sideways, nominal)
        for lib, routines in ((excavator, MOTIONS), (single, ("mass_matrix",))):
            constants = lib.prepare({"geometry": geometry})
            for name in set(routines) - {"closure"}:  # which has no bodies
                status, out = call(lib, constants, name, held(np.array([0.5, -0.5, 1.5])))
                assert status in expected, (name, sideways)
                assert status == DEAD_POINT or all(np.all(np.isfinite(out[member])) for member in out.dtype.names)


@pytest.mark.parametrize("turns", [0.0, np.pi])
@pytest.mark.parametrize("cylinder", [BOOM, STICK], ids=lambda each: each.name)
def test_dead_points(excavator: Library, cylinder, turns: float) -> None:
    joint, triangle = Geometry(EXCAVATOR.machine).triangle(cylinder)
    q = np.array([0.5, -0.5, 1.5])
    middle = sum(EXCAVATOR.machine.link(joint).joint.range) / 2
    q[EXCAVATOR.machine.joints.index(joint)] = middle + math.remainder(turns - float(triangle.offset) - middle,
                                                                       2 * math.pi)
    q = held(q)
    constants = excavator.prepare()
    for name in MOTIONS:
        status, out = call(excavator, constants, name, q)
        if name in LEVERLESS:
            assert status == OUT_OF_STROKE
            assert all(np.all(np.isfinite(out[member])) for member in out.dtype.names)
        else:
            assert status == DEAD_POINT, name
    # the same by the length: exactly there rounding may open the triangle, and next to there single precision sees none
    k, (fixed, moving) = EXCAVATOR.machine.cylinders.index(cylinder), sides(cylinder)
    for inwards in (0.0, 1e-9) if excavator.real == np.float64 else ():
        given = good(excavator, "joint_state")
        given["length"][0, k] = fixed + moving - inwards if turns else abs(fixed - moving) + inwards
        status = excavator.routine("joint_state", constants, given, excavator.zeros("joints"))
        assert status == DEAD_POINT or (inwards == 0.0 and status == OPEN_TRIANGLE)


@pytest.mark.parametrize("end", ["short", "long"])
@pytest.mark.parametrize("cylinder", [BOOM, STICK], ids=lambda each: each.name)
def test_beyond_the_stroke_the_result_holds_for_the_triangle(excavator: Library, cylinder, end: str) -> None:
    k, j = EXCAVATOR.machine.cylinders.index(cylinder), EXCAVATOR.machine.joints.index(cylinder.name.partition("_")[0])
    limit = cylinder.dead_length + (end == "long") * cylinder.stroke
    outwards = 1.0 if end == "long" else -1.0
    constants = excavator.prepare()
    tolerance = 1e-9 if excavator.real == np.float64 else 3e-4
    for beyond, status in ((0.3e-6, OK), (2e-6, OUT_OF_STROKE), (0.005, OUT_OF_STROKE)):
        length = limit + outwards * beyond
        angle = float(EXCAVATOR.triangles[cylinder.name][1](length))
        q = np.array([0.5, -0.5, 1.5])
        q[j] = angle
        for name in MOTIONS:
            found, out = call(excavator, constants, name, q)
            # single precision cannot tell a third of a micrometre from two at an angle that it has rounded
            assert found == status or (excavator.real == np.float32 and beyond < 0.001), (name, beyond)
            assert found in (OK, OUT_OF_STROKE)
            if name == "cylinder_state":
                assert out["length"][0, k] == pytest.approx(length, rel=tolerance)
            if name == "inverse_dynamics":
                given = good(excavator, name)
                state = (held(q) if excavator.real == np.float32 else q, given["qd"][0], given["qdd"][0])
                psi = excavator.interface.values["psi"]
                said = np.array(EXCAVATOR.inverse_dynamics(*(each.astype(float) for each in state), psi)).ravel()
                assert out["force"][0] == pytest.approx(said, rel=tolerance)
        given, out = good(excavator, "joint_state"), excavator.zeros("joints")
        given["length"][0, k] = length
        assert excavator.routine("joint_state", constants, given, out) == status
        assert out["q"][0, j] == pytest.approx(angle, rel=tolerance)


def small_accumulator() -> Machine:
    """The KR300 with so little gas that its cylinder takes all of it beyond the second joint's range."""
    described = library.machine("kr300")
    gas = described.gas_cylinders[0].model_copy(update={"volume": 6e-4})
    return described.model_copy(update={"gas_cylinders": (gas,)})


@pytest.mark.slow
def test_a_gas_cylinder_without_gas(tmp_path) -> None:
    """No result holds where the gas would have no volume: none may be taken for one, no load may be learnt from it."""
    described = small_accumulator()
    model, (gas,) = Model(described), described.gas_cylinders
    q = np.zeros((361, 6))
    q[:, 1] = np.linspace(-np.pi, np.pi, 361)
    volume = gas.gas_volume(over(model.cylinder_kinematics, q, 0 * q, 0 * q)[0][:, 0, 0])
    lower, upper = described.link(described.joints[1]).joint.range
    assert volume[(q[:, 1] >= lower) & (q[:, 1] <= upper)].min() > 0
    assert volume.min() < 0
    routines = ("inverse_dynamics", "gravity_forces", "regressor", "reduced_regressor", "tilted_regressor")
    lib = Library(library.code(described, routines=routines), tmp_path / "kr300", "-O0")
    constants = lib.prepare()
    for name in routines:
        status, _ = call(lib, constants, name, q[np.argmin(volume)])
        assert status == NO_GAS_VOLUME
