"""Residuals in C against a derivation of their own: jets of matrices in numpy, and complex steps through them."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from fixtures import library
from fixtures.library import OK, Library
from fixtures.tiers import tiered
from oracles.complex_machine import ComplexMachine, complex_step

Array = np.ndarray
ROUTINES = ("residual", "residual_by_motion", "residual_by_parameters", "residual_by_geometry", "wrench_forces")
STATES = 2


class Subject:
    """A machine with random parameters and geometry, a few states, and the oracle's numbers for them."""

    def __init__(self, lib: Library, name: str) -> None:
        self.lib, interface = lib, lib.interface
        self.machine, rng = interface.machine, np.random.default_rng(31)
        self.values = dict(interface.values)
        psi = self.values["psi"]
        self.values["psi"] = psi + rng.uniform(-0.3, 0.3, len(psi)) * np.maximum(np.abs(psi), 100.0)
        if "geometry" in self.values:
            self.values["geometry"] = self.values["geometry"] + rng.uniform(-0.01, 0.01, len(self.values["geometry"]))
        q, qd, qdd = library.subjects.states(self.machine, rng, STATES)
        self.given = {"q": q, "qd": qd, "qdd": qdd, "wrench": rng.uniform(-2e4, 2e4, (STATES, 6)),
                      "reading": rng.uniform(1e5, 2e7, (STATES, len(self.values["effort"])))}

    def call(self, routine: str) -> Array:
        status, results = self.lib.call(routine, self.lib.prepare(self.values), self.given, STATES)
        assert np.all(status <= OK + 1)
        return results

    def oracle(self, k: int, **changed: Array) -> Array:
        """The residual at state k, with some inputs changed, by the second derivation."""
        at = {key: array[k] for key, array in self.given.items()} | self.values | changed
        kinds = self.lib.interface.kinds
        second = ComplexMachine(self.machine, dict(zip(kinds["geometry"].names, at.get("geometry", ()), strict=True)))
        psi = dict(zip(kinds["psi"].names, at["psi"], strict=True))
        measured = second.measured(dict(zip(kinds["reading"].names, at["reading"], strict=True)))
        return measured - second.forces(at["q"], at["qd"], at["qdd"], psi, at["wrench"])

    def derivative(self, k: int, by: str) -> Array:
        return complex_step(lambda x: self.oracle(k, **{by: x}), self.values[by] if by in self.values
                            else self.given[by][k])


@pytest.fixture(scope="session")
def subjects_of(libraries: Callable[..., Library]) -> Callable[[str], Subject]:
    return lambda name: Subject(libraries(name, "double", "-O0"), name)


CASES = tiered(["cat215b", "patu655_lift", "kr300", "panda_mukca", "spatial"],
               lambda name: name == "patu655_lift")


def off(found: Array, expected: Array) -> float:
    """Largest deviation, each row by its largest entry."""
    scale = np.max(np.abs(expected), axis=-1, keepdims=True)
    return float(np.max(np.abs(found - expected) / np.where(scale > 0, scale, 1.0)))


@pytest.mark.parametrize("name", CASES)
def test_residual_is_that_of_the_second_derivation(name: str, subjects_of) -> None:
    subject = subjects_of(name)
    found = subject.call("residual")["residual"]
    expected = np.array([subject.oracle(k) for k in range(STATES)]).real
    measured = np.array([subject.oracle(k, psi=0 * subject.values["psi"], wrench=np.zeros(6)) for k in range(STATES)])
    # a residual is a difference of forces, whose sizes are the scale of its rounding
    scale = np.maximum(np.abs(measured.real), np.abs(measured.real - expected))
    assert np.max(np.abs(found - expected) / scale) < 1e-12


@pytest.mark.parametrize("name", CASES)
def test_jacobians_are_those_of_complex_steps(name: str, subjects_of) -> None:
    subject = subjects_of(name)
    found = {"q": "by_q", "qd": "by_qd", "qdd": "by_qdd"}
    motion, parameters = subject.call("residual_by_motion"), subject.call("residual_by_parameters")
    for k in range(STATES):
        for by, member in found.items():
            expected = subject.derivative(k, by)
            scale = np.abs(subject.derivative(k, "qdd")).max() * np.abs(subject.given["qd"]).max() if by == "qd" else 0
            assert np.max(np.abs(motion[member][k] - expected)) < 1e-10 * max(np.abs(expected).max(), scale)
        assert off(parameters["by_psi"][k], subject.derivative(k, "psi")) < 1e-10


@pytest.mark.parametrize("name", tiered(["cat215b", "panda_mukca", "spatial"], lambda name: name == "cat215b"))
def test_jacobian_by_geometry_is_that_of_complex_steps(name: str, subjects_of) -> None:
    subject = subjects_of(name)
    made = subject.call("residual_by_geometry")["by_geometry"]
    for k in range(STATES):
        expected = subject.derivative(k, "geometry")
        assert np.count_nonzero(np.any(expected != 0, axis=0)) >= 10
        assert off(made[k], expected) < 1e-10


def test_reading_enters_by_its_effort_and_wrench_by_virtual_work(subjects_of) -> None:
    subject = subjects_of("cat215b")
    expected = subject.derivative(0, "wrench")
    second = ComplexMachine(subject.machine, dict(zip(subject.lib.interface.kinds["geometry"].names,
                                                      subject.values["geometry"], strict=True)))
    q = subject.given["q"][0]
    by_work = np.linalg.solve(second.transmission(q).T, second.tip_jacobian(q).T).real
    assert off(by_work, expected) < 1e-12
    found = subject.call("wrench_forces")["force"][0]
    assert off(found, -by_work @ subject.given["wrench"][0]) < 1e-12
    by_reading = subject.derivative(0, "reading")
    assert np.allclose(by_reading[by_reading != 0], subject.values["effort"], rtol=1e-12)
