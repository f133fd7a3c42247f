"""Forward dynamics and parts of forces in C, against a derivation of the forces by jets of matrices in numpy."""

from __future__ import annotations

from collections.abc import Callable
from types import SimpleNamespace

import casadi as ca
import numpy as np
import pytest

from fixtures import library
from fixtures.library import OK, SINGULAR, Library
from fixtures.tiers import tiered
from hydroopt import Model, load_machine
from hydroopt.codegen import self_test
from hydroopt.spatial.inertia import smallest_eigenvalue
from oracles.complex_machine import ComplexMachine

Array = np.ndarray
STATES = 4
CASES = tiered(["cat215b", "patu655_lift", "kr300", "panda_mukca", "spatial"], lambda name: name == "patu655_lift")
SHARING = tiered(["shared", "backhoe", "forestry_crane"], lambda name: name == "shared")


class Subject:
    """A machine with parameters a little off its own, and states with forces and a wrench."""

    def __init__(self, lib: Library) -> None:
        self.lib, interface, rng = lib, lib.interface, np.random.default_rng(7)
        self.machine = interface.machine
        psi = interface.values["psi"]
        self.values = {**interface.values, "psi": psi * rng.uniform(1.0, 1.3, len(psi))}
        self.psi = dict(zip(interface.kinds["psi"].names, self.values["psi"], strict=True))
        q, qd, qdd = library.subjects.states(self.machine, rng, STATES)
        self.given = {"q": q, "qd": qd, "qdd": qdd, "wrench": rng.uniform(-1e4, 1e4, (STATES, 6)),
                      "actuator_force": rng.uniform(-2e5, 2e5, (STATES, len(self.machine.actuators)))}
        self.second = ComplexMachine(self.machine, dict(zip(interface.kinds["geometry"].names,
                                                            interface.values.get("geometry", ()), strict=True)))

    def call(self, routine: str) -> Array:
        status, results = self.lib.call(routine, self.lib.prepare(self.values), self.given, STATES)
        assert np.all(status <= OK + 1)
        return results

    def forces(self, k: int, qdd: Array, psi: dict[str, float], wrench: Array, *, still: bool = False) -> Array:
        """Measured forces of state k by the second derivation."""
        return np.real(self.second.forces(self.given["q"][k], self.given["qd"][k] * (not still), qdd, psi, wrench))


@pytest.fixture
def subjects_of(libraries: Callable[..., Library]) -> Callable[[str], Subject]:
    return lambda name: Subject(libraries(name, "double", "-O0"))


@pytest.mark.parametrize("name", CASES)
def test_accelerations_need_the_forces_that_gave_them(name: str, subjects_of) -> None:
    subject = subjects_of(name)
    found = subject.call("forward_dynamics")["qdd"]
    for k in range(STATES):
        force = subject.given["actuator_force"][k]
        needed = subject.forces(k, found[k], subject.psi, subject.given["wrench"][k])
        assert np.allclose(needed, force, rtol=1e-9, atol=1e-9 * np.max(np.abs(force)))


@pytest.mark.parametrize("name", CASES)
def test_parts_are_the_forces_of_their_parameters(name: str, subjects_of) -> None:
    subject = subjects_of(name)
    parts, names = subject.call("force_parts"), subject.lib.interface.complete.parameters
    kinds = dict(zip(names.names, names.kinds, strict=True))
    owners = {"friction": lambda kind: kind.is_friction, "elastic": lambda kind: kind.is_elastic,
              "offset": lambda kind: "offset" in kind.name.lower()}

    def only(part: str) -> dict[str, float]:
        return {each: value * (owners[part](kinds[each]) if part in owners else
                               not any(owns(kinds[each]) for owns in owners.values()))
                for each, value in subject.psi.items()}

    for k in range(STATES):
        qdd, none = subject.given["qdd"][k], np.zeros(6)
        size = 1e-9 * np.max(np.abs(subject.forces(k, qdd, subject.psi, none)))
        gravity = subject.forces(k, 0 * qdd, only("bodies"), none, still=True)
        assert np.allclose(parts["gravity"][k], gravity, atol=size)
        assert np.allclose(parts["inertia"][k], subject.forces(k, qdd, only("bodies"), none) - gravity, atol=size)
        for part in owners:
            assert np.allclose(parts[part][k], subject.forces(k, qdd, only(part), none), atol=size), part


@pytest.mark.slow
@pytest.mark.parametrize("name", SHARING)
def test_accelerations_of_shared_and_passive_joints_balance(name: str, subjects_of) -> None:
    """The balances then measure what the actuators do, and nothing at joints that nothing drives."""
    subject = subjects_of(name)
    interface, readings = subject.lib.interface, np.zeros((STATES, len(subject.values["effort"])))
    assert all(each.measured for each in interface.machine.actuators)
    symbols = [interface.inputs[key] for key in ("q", "geometry") if key in interface.inputs]
    numbers = [subject.values["geometry"]] if len(symbols) > 1 else []
    shares = ca.Function("shares", symbols, [interface.dynamics.shares])
    measured = [np.asarray(shares(q, *numbers)) @ force
                for q, force in zip(subject.given["q"], subject.given["actuator_force"], strict=True)]
    subject.given |= {"qdd": subject.call("forward_dynamics")["qdd"], "reading": readings}
    needed = -subject.call("residual")["residual"]
    assert np.allclose(needed, measured, atol=1e-8 * np.max(np.abs(measured)))


def test_a_machine_without_mass_gives_no_acceleration(subjects_of) -> None:
    subject = subjects_of("patu655_lift")
    empty = subject.lib.prepare({"psi": np.zeros(len(subject.values["psi"]))})
    status, _ = subject.lib.call("forward_dynamics", empty, subject.given, STATES)
    assert np.all(status == SINGULAR)


def test_bodies_of_the_self_test_can_exist() -> None:
    """Light arms once had masses below zero there, and forward dynamics no answer."""
    model, rng = Model(load_machine("ur10")), np.random.default_rng(0)
    interface = SimpleNamespace(complete=model, values={"psi": model.parameters.nominal})
    for _ in range(8):
        psi = self_test._possible(rng.uniform(-100, 100, len(model.parameters)), interface, rng)
        assert min(smallest_eigenvalue(psi[body]) for body in model.parameters.bodies.values()) > 0
