"""The generated C of a machine with Stribeck friction, dead zones and friction by direction, against the model."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from fixtures import library
from fixtures.library import OK, Library, held
from hydroopt.errors import ProblemError
from hydroopt.machine.machine import Machine
from hydroopt.machine.machine_file import load_machine
from hydroopt.model.model import Model

ROUTINES = ("inverse_dynamics", "gravity_forces", "regressor", "reduced_regressor")


def sticking(**more: float) -> Machine:
    data = load_machine("patu655_lift").model_dump()
    data["cylinders"][0]["friction"] |= {
        "offset": 30.0, "coulomb_reverse": 150.0, "viscous_reverse": 700.0, "stribeck": 400.0, "stribeck_speed": 0.05,
        "dead_zone": 0.01} | more
    return Machine.model_validate(data)


@pytest.mark.parametrize(("real", "level"), [("double", "-O3"), ("float", "-O0")])
def test_the_controller_reckons_with_the_same_friction(real: str, level: str, tmp_path: Path) -> None:
    machine = sticking()
    model, rng = Model(machine), np.random.default_rng(4)
    made = Library(library.code(machine, routines=ROUTINES, single=real == "float"), tmp_path / "c", level)
    psi = held(model.parameters.nominal * rng.uniform(0.7, 1.3, len(model.parameters)))
    count = 200
    q = held(rng.uniform(*machine.link("lift").joint.range, (count, 1)))
    qd, qdd = held(rng.uniform(-0.3, 0.3, (count, 1))), held(rng.uniform(-1, 1, (count, 1)))
    speed = np.abs(model.over(model.cylinder_kinematics, q, qd, qdd)[1][:, 0, 0])
    assert np.sum(speed < 0.01) > 3
    assert np.sum((speed > 0.01) & (speed < 0.1)) > 20, "where the Stribeck effect is"
    K, force = model.over(model.linearised, q, qd, qdd, psi)
    constants, given = made.prepare({"psi": psi}), {"q": q, "qd": qd, "qdd": qdd}
    tolerance = 1e-12 if real == "double" else 2e-6

    status, found = made.call("inverse_dynamics", constants, given, count)
    assert np.all(status == OK)
    np.testing.assert_allclose(found["force"], force[:, :, 0], rtol=0, atol=tolerance * np.max(np.abs(force)))
    without = psi.copy()
    without[model.parameters.index("lift_cylinder.f_stribeck")] = 0.0
    part = force - model.over(model.inverse_dynamics, q, qd, qdd, without)[0]
    assert np.max(np.abs(part)) > 100 * tolerance * np.max(np.abs(force)), "a test that would not miss it"

    status, found = made.call("regressor", constants, given, count)
    assert np.all(status == OK)
    scale = np.max(np.abs(K), axis=0)
    np.testing.assert_allclose(found["K"] / np.maximum(scale, 1e-9), K / np.maximum(scale, 1e-9), rtol=0,
                               atol=1e-9 if real == "double" else 1e-4)
    reduced = Model(machine, actuator_inertia=False)
    status, found = made.call("reduced_regressor", constants, given, count)
    K = reduced.over(reduced.linearised, q, qd, qdd, psi[list(model.parameters.select(reduced.parameters.names))])[0]
    np.testing.assert_allclose(found["K"] / np.maximum(scale, 1e-9), K / np.maximum(scale, 1e-9), rtol=0,
                               atol=1e-9 if real == "double" else 1e-4)

    status, found = made.call("gravity_forces", constants, given, count)
    still = without.copy()
    still[model.parameters.index("lift_cylinder.f_offset")] = 0.0
    gravity = model.over(model.inverse_dynamics, q, 0 * q, 0 * q, still)[0][:, :, 0]
    np.testing.assert_allclose(found["force"], gravity, rtol=0, atol=tolerance * np.max(np.abs(gravity)))


def test_a_header_says_what_a_regressor_is() -> None:
    texts = [library.files(library.code(machine, routines=["regressor"]))["patu655_lift.h"]
             for machine in (load_machine("patu655_lift"), sticking())]
    assert "force = K * psi" in texts[0]
    assert "force = K * psi" not in texts[1]
    assert "K = d force / d psi" in texts[1]


def test_friction_of_seals_is_refused() -> None:
    with pytest.raises(ProblemError, match=r"codegen: .* lift_cylinder depends on pressures.*; remove 'seal'"):
        library.code(sticking(seal=1e-4))
