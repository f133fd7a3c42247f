"""A slave cylinder that follows a master: positions and forces by the lengths of both; files that contradict."""

from __future__ import annotations

import tomllib
from pathlib import Path

import casadi as ca
import numpy as np
import pytest
from scipy.optimize import brentq

from hydroopt.errors import MachineError
from hydroopt.machine.file_tables import build_machine
from hydroopt.machine.geometry import Geometry
from hydroopt.machine.machine import Machine
from hydroopt.machine.machine_file import load_machine, read_machine
from hydroopt.machine.mechanism import Mechanism
from hydroopt.model.model import Model

FILE = (Path(__file__).parents[2] / "models/level_keeping_lift.toml").read_text("utf-8")
REACH = 6.0
MASTER = (np.array([0.274, -0.752]), np.array([0.246, -0.043]))
SLAVE = (np.array([5.081, -0.771]), np.array([0.197, -0.138]))
OIL = 0.8387 + 1.1608
"""Length of both cylinders together: their areas are equal."""


@pytest.fixture(scope="module")
def machine() -> Machine:
    return load_machine("level_keeping_lift")


def turned(angle: float, point: np.ndarray) -> np.ndarray:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([c * point[0] - s * point[1], s * point[0] + c * point[1]])


def basket_angle(boom: float) -> float:
    """Where the slave has the length that the master leaves it, by a search."""
    left = OIL - float(np.linalg.norm(turned(boom, MASTER[1]) - MASTER[0]))
    line = np.array([REACH, 0]) - SLAVE[0]
    return float(brentq(lambda basket: np.linalg.norm(line + turned(basket, SLAVE[1])) - left, -boom - 0.4, -boom + 0.4,
                        xtol=1e-14))


def heights(machine: Machine, boom: float) -> float:
    """Potential energy of all bodies over gravity, in the direction of gravity's z, by points alone [kg·m]."""
    basket = basket_angle(boom)
    total = 0.0
    places = {"boom": (np.zeros(2), boom), "basket": (turned(boom, np.array([REACH, 0])), boom + basket)}
    cylinders = {"compensator": (MASTER, None, "boom"), "leveller": (SLAVE, "boom", "basket")}
    for name, (pins, link, far) in cylinders.items():
        origin, angle = places[link] if link else (np.zeros(2), 0.0)
        start = origin + turned(angle, pins[0])
        end = places[far][0] + turned(places[far][1], pins[1])
        line = float(np.arctan2(*(end - start)[::-1]))
        places |= {f"{name}_barrel": (start, line), f"{name}_rod": (end, line)}
    for name, (origin, angle) in places.items():
        body = machine.link(name).body
        assert body is not None
        total += body.m * (origin + turned(angle, np.array(body.com[:2])))[1]
    return total


def test_slave_has_the_oil_that_its_master_gives(machine: Machine) -> None:
    mechanism, geometry = Mechanism(machine), Geometry(machine)
    for boom in np.radians([-5, 10, 30, 50, 65]):
        at = mechanism.positions(geometry, {"boom": ca.DM(boom)})
        assert float(at["basket"]) == pytest.approx(basket_angle(boom), abs=1e-11)
        assert abs(float(at["basket"]) + boom) < np.radians(3.0)
        assert float(at["compensator_length"]) + float(at["leveller_length"]) == pytest.approx(OIL, abs=1e-12)


def test_shut_in_oil_does_no_work(machine: Machine) -> None:
    """The boom cylinder alone carries the weight of boom, basket and both cylinders: the derivative of their height."""
    model, step = Model(machine), 1e-4
    q = np.radians([[-5.0], [20.0], [60.0]])
    (found,) = model.over(model.gravity_torques, q, np.tile(model.parameters.nominal, (3, 1)))
    for boom, torque in zip(q[:, 0], found[:, 0, 0], strict=True):
        high = [heights(machine, boom + k * step) for k in (-2, -1, 1, 2)]
        slope = (high[0] - 8 * high[1] + 8 * high[2] - high[3]) / (12 * step)
        assert torque == pytest.approx(machine.gravity * slope, rel=1e-8)


@pytest.mark.parametrize(("old", "new", "words"), [
    ('"rod to rod"', '"rod to head"', r"oil_links\[levelling\].lines: the two lines contradict .*-1.000 m by"),
    ('"rod to rod"', '"oil to rod"', "lines.1.: must be 'head to head', 'head to rod', .* not 'oil to rod'"),
    ('link = "basket"', 'link = "bucket"', r"slave.rod.link: 'bucket' does not exist"),
    ('link = "basket"', 'link = "boom"', "slave: no moving joint lies between the two ends"),
    ('rod_diameter = { value = "40 mm"', 'rod_diameter = { value = "80 mm"', "the rod is not thinner than the bore"),
    ('length = { value = "1.1608 m"', 'length = { value = "1.1608"', "slave.length: .*no unit"),
    ('length = { value = "1.1608 m"', 'length = { value = "1.9 m"', r"oil_links\[levelling\].*cannot close"),
    ('lines = ["head to head", "rod to rod"]\n', '', "lines: this key is missing"),
    ('dependent = true, a', 'lower = "-60 deg", upper = "10 deg", a', r"'leveller' has only 'leveller_barrel'"),
])
def test_bad_oil_links(old: str, new: str, words: str) -> None:
    with pytest.raises(MachineError, match=words):
        read_machine(FILE.replace(old, new, 1))


@pytest.mark.parametrize(("stated", "words"), [
    (3, r"oil_links: must be a list of tables; write \[\[oil_links\]\]"),
    ([3], r"oil_links\[0\]: must be a table")])
def test_oil_links_that_are_no_tables(stated: object, words: str) -> None:
    with pytest.raises(MachineError, match=words):
        build_machine(tomllib.loads(FILE) | {"oil_links": stated}, "machine")


def test_strokes_that_are_too_short_are_all_named_at_once() -> None:
    """The lengths that both need by the positions of their pins alone."""
    boom = np.linspace(*load_machine("level_keeping_lift").link("boom").joint.range, 99)
    needed = [np.linalg.norm(turned(angle, MASTER[1]) - MASTER[0]) for angle in boom]
    short = FILE.replace('"0.67 m"', '"0.75 m"').replace('"1.01 m"', '"1.2 m"').replace('"1.12 m"', '"0.9 m"')
    with pytest.raises(MachineError) as refusal:
        read_machine(short)
    said = str(refusal.value)
    assert f"'compensator_length' needs {min(needed):.3f} to {max(needed):.3f} m, not 0.750 to 1.070 m" in said
    assert f"'leveller_length' needs {OIL - max(needed):.3f} to {OIL - min(needed):.3f} m, not 1.200 to" in said
    lifted = [np.linalg.norm(turned(angle, np.array([1.6, -0.1])) - np.array([0.55, -0.9])) for angle in boom]
    assert f"'boom_cylinder' needs {min(lifted):.3f} to {max(lifted):.3f} m, not 1.210 to 2.110 m" in said


def test_half_a_stroke_is_refused() -> None:
    with pytest.raises(MachineError, match=r"master: 'dead_length' is missing"):
        read_machine(FILE.replace('dead_length = { value = "0.67 m"', '#'))
