"""Friction by direction, Stribeck's, of seals, without in dead zones: against formulas written out branch by branch."""

from __future__ import annotations

import math

import numpy as np
import pytest

from hydroopt.errors import ProblemError
from hydroopt.estimation.inference.identifiability import COMBINATION, FULL, random_states, structural
from hydroopt.machine.machine import Machine
from hydroopt.machine.machine_file import dump_machine, load_machine, read_machine
from hydroopt.model.model import Model

CYLINDER = {"offset": 120.0, "coulomb": 900.0, "coulomb_reverse": 500.0, "viscous": 4000.0, "viscous_reverse": 2500.0,
            "stribeck": 700.0, "stribeck_speed": 0.05, "seal": 2e-4}
ROTARY = {"offset": -3.0, "coulomb": 90.0, "coulomb_reverse": 60.0, "viscous": 40.0, "viscous_reverse": 70.0,
          "stribeck": 55.0, "stribeck_speed": 0.3, "dead_zone": 0.1}


def everything(**cylinder: float) -> Machine:
    """A turret on a motor, a boom on a cylinder and a slide on a drive, each with friction of every kind."""
    body = {"m": 200.0, "mc": (150.0, 20.0, 5.0), "inertia": (40.0, 3.0, 1.0, 180.0, 2.0, 190.0)}
    return Machine.model_validate({
        "name": "everything", "links": [
            {"name": "turret", "parent": "base", "body": body,
             "joint": {"type": "revolute", "alpha": -1.5, "lower": -2.0, "upper": 2.0, "max_speed": 0.7}},
            {"name": "boom", "parent": "turret", "body": body,
             "joint": {"type": "revolute", "a": 2.0, "lower": 0.2, "upper": 1.2, "max_speed": 0.3}},
            {"name": "slide", "parent": "boom", "body": body,
             "joint": {"type": "prismatic", "lower": 0.0, "upper": 1.0, "max_speed": 0.4}}],
        "motors": [{"name": "motor", "joint": "turret", "torque_per_pressure": 1e-4, "friction": ROTARY}],
        "drives": [{"name": "drive", "joint": "slide", "friction": ROTARY}],
        "cylinders": [{"name": "lift", "head_area": 8e-3, "rod_area": 5e-3, "dead_length": 0.3, "stroke": 2.0,
                       "barrel": {"link": "turret", "pin": (0.4, 0.1, 0.0)},
                       "rod": {"link": "boom", "pin": (1.0, 0.2, 0.0)}, "friction": {**CYLINDER, **cylinder}}]})


def written_out(friction: dict[str, float], v: float, pressure: float = 0.0) -> float:
    """Friction force at one speed, case by case."""
    force = friction["offset"]
    if v > 0:
        force += friction["viscous"] * v
    elif v < 0:
        force += friction["viscous_reverse"] * v
    if v == 0 or abs(v) < friction.get("dead_zone", 0.0):
        return force
    dry = friction["coulomb"] if v > 0 else friction["coulomb_reverse"]
    dry += friction["stribeck"] * math.exp(-(v * v) / friction["stribeck_speed"] ** 2)
    dry += friction.get("seal", 0.0) * pressure
    return force + math.copysign(dry, v)


def states(model: Model, count: int = 60) -> tuple[np.ndarray, ...]:
    rng = np.random.default_rng(7)
    return (*random_states(model, count, rng), rng.uniform(1e6, 3e7, (count, len(model.machine.actuators))))


def speeds(model: Model, q: np.ndarray, qd: np.ndarray, qdd: np.ndarray) -> np.ndarray:
    """Of motor, cylinder and drive (N, 3)."""
    stroke = model.over(model.cylinder_kinematics, q, qd, qdd)[1][:, :, 0]
    return np.column_stack([qd[:, 0], stroke[:, 0], qd[:, 2]])


@pytest.mark.parametrize("dead_zone", [None, 0.03])
def test_forces_are_those_of_the_formulas_branch_by_branch(dead_zone: float | None) -> None:
    extra = {} if dead_zone is None else {"dead_zone": dead_zone}
    model = Model(everything(**extra))
    names, psi = model.parameters.names, model.parameters.nominal
    smooth = np.where([name.partition(".")[0] in ("motor", "lift", "drive") and ".v_" not in name for name in names],
                      0.0, psi)
    *motion, pressure = states(model)
    found = (model.over(model.inverse_dynamics, *motion, pressure, psi)[0]
             - model.over(model.inverse_dynamics, *motion, pressure, smooth)[0])[:, :, 0]
    v = speeds(model, *motion)
    frictions = (ROTARY, {**CYLINDER, **extra}, ROTARY)
    expected = np.array([[written_out(friction, v[s, k], pressure[s, k] * (k == 1))
                          for k, friction in enumerate(frictions)] for s in range(len(v))])
    np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-6)
    inside = [np.abs(v[:, k]) < (friction.get("dead_zone") or 0) for k, friction in enumerate(frictions)]
    assert all(any(here) and not all(here) for k, here in enumerate(inside) if "dead_zone" in frictions[k])
    assert np.all(np.abs(np.sum(np.sign(v), axis=0)) < 0.7 * len(v)), "both directions"


def test_linearised_gives_the_forces_and_their_exact_derivatives() -> None:
    model = Model(everything(dead_zone=0.02))
    assert (model.linear, model.needs_pressure) == (False, True)
    inputs = states(model)
    rng = np.random.default_rng(8)
    psi = model.parameters.nominal * rng.uniform(0.5, 1.5, len(model.parameters))
    K, force = model.over(model.linearised, *inputs, psi)
    assert K.shape == (60, 3, len(psi))
    np.testing.assert_allclose(force, model.over(model.inverse_dynamics, *inputs, psi)[0], rtol=1e-12, atol=1e-9)
    for k, name in enumerate(model.parameters.names):
        h = 1e-3 * (abs(psi[k]) or 1.0)

        def at(step: float, k: int = k) -> np.ndarray:
            moved = psi.copy()
            moved[k] += step
            return model.over(model.inverse_dynamics, *inputs, moved)[0][:, :, 0]

        # Richardson's extrapolation of central differences: an error of the sixth order
        slope = (45 * (at(h) - at(-h)) - 9 * (at(2 * h) - at(-2 * h)) + at(3 * h) - at(-3 * h)) / (60 * h)
        np.testing.assert_allclose(K[:, :, k], slope, rtol=1e-8, atol=1e-13 * np.max(np.abs(force)) / h, err_msg=name)


def test_the_regressor_is_the_derivative_at_nominal_values() -> None:
    model = Model(everything())
    inputs = states(model)
    K = model.over(model.regressor, *inputs)[0]
    np.testing.assert_allclose(K, model.over(model.linearised, *inputs, model.parameters.nominal)[0], rtol=1e-12)
    # a Stribeck force of zero would hide its speed: it counts as one newton then
    hidden = Model(everything(stribeck=0.0))
    assert np.any(hidden.over(hidden.regressor, *inputs)[0][:, 1, hidden.parameters.index("lift.v_stribeck")])


@pytest.mark.slow
def test_other_machines_keep_their_functions() -> None:
    model = Model(load_machine("cat215b"))
    assert (model.linear, model.needs_pressure) == (True, False)
    assert model.regressor.name_in() == ["q", "qd", "qdd"]
    assert model.inverse_dynamics.name_in() == ["q", "qd", "qdd", "psi"]
    assert model.residual.name_in() == ["q", "qd", "qdd", "force", "psi"]
    sealed = Model(everything())
    assert sealed.regressor.name_in() == ["q", "qd", "qdd", "pressure"]
    assert sealed.linearised.name_in() == ["q", "qd", "qdd", "pressure", "psi"]
    assert sealed.residual.name_in() == ["q", "qd", "qdd", "pressure", "force", "psi"]
    with pytest.raises(ProblemError, match=r"friction of lift depends on pressures.*remove 'seal'"):
        sealed.refuse_seals("a test")


def test_friction_takes_power() -> None:
    model = Model(everything(offset=0.0))
    motion = states(model)
    K = model.over(model.regressor, *motion)[0]
    power = np.einsum("sa,sap->ps", speeds(model, *motion[:3]), K)
    for k, name in enumerate(model.parameters.names):
        if name.partition(".")[0] == "lift" and not name.endswith(("_offset", "v_stribeck")):
            assert np.all(power[k] >= 0), name


@pytest.mark.parametrize(("stated", "category"), [
    ({"coulomb_reverse": None}, FULL), ({}, COMBINATION), ({"dead_zone": 0.05}, FULL)])
def test_an_offset_and_coulomb_friction_of_either_direction_are_one_too_many(
        stated: dict[str, float | None], category: str) -> None:
    """Offset = forward − reverse wherever something moves; only standstill in a dead zone tells them apart."""
    data = everything().model_dump()
    data["cylinders"][0]["friction"] |= {"stribeck": None, "stribeck_speed": None} | stated
    found = structural(Model(Machine.model_validate(data)))
    three = [f"lift.f_{key}" for key in ("offset", "coulomb", "coulomb_reverse")]
    said = {name: kind for name, kind in zip(found.names, found.category, strict=True) if name in three}
    assert set(said.values()) == {category}
    if category == COMBINATION:
        expressions = [found.expression(k) for k in range(found.rank)]
        assert "lift.f_offset − lift.f_coulomb_reverse" in expressions
        assert "lift.f_coulomb + lift.f_coulomb_reverse" in expressions


def test_a_file_keeps_every_term_with_units_and_confidence() -> None:
    machine = everything(dead_zone=0.01)
    text = dump_machine(machine)
    assert read_machine(text) == machine
    assert 'stribeck_speed = "0.05 m/s"' in text
    assert 'stribeck_speed = "0.3 rad/s"' in text
    assert 'dead_zone = "0.1 m/s"' in text  # of the slide's drive
    assert 'seal = "0.0002 m^2"' in text
    units = dict(zip((p := Model(machine).parameters).names, p.units, strict=True))
    assert (units["motor.v_stribeck"], units["drive.v_stribeck"], units["lift.v_stribeck"]) == ("rad/s", "m/s", "m/s")
    assert (units["lift.f_seal"], units["drive.tau_viscous_reverse"]) == ("m^2", "N*s/m")
    k = p.index("lift.v_stribeck")
    assert 0 < p.lower[k] < p.nominal[k] < p.upper[k] < np.inf
