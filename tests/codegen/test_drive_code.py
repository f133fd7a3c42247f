"""Generated C of machines with several, unmeasured or no actuators on a joint."""

from pathlib import Path

import numpy as np
import pytest

from fixtures import library
from fixtures.drives import crane, twin
from fixtures.library import DEAD_POINT, OK, OUT_OF_STROKE, Library
from fixtures.tiers import tiered
from hydroopt.machine.machine import Machine
from hydroopt.model.model import Model


def test_header_says_what_each_balance_and_actuator_is() -> None:
    header = library.files(library.code(crane("swing_right"), routines=("actuator_forces",)))["crane.h"]
    for line in ("CRANE_BALANCE_BOOM = 0, /* boom [N*m]: what boom_left and boom_right do at boom together */",
                 "CRANE_BALANCE_REACH = 1, /* reach [N]: the actuator's force */",
                 "CRANE_BALANCE_GRAPPLE = 2, /* grapple [N*m]: nothing drives grapple: measured is zero */",
                 "CRANE_ACTUATOR_SWING_RIGHT = 1, /* swing_right: not measured */",
                 "0 for swing_left, swing_right, which no balance contains */",
                 "double balance[CRANE_BALANCE_COUNT]; /* [N or N*m] measured force of each balance, with offsets */"):
        assert line in header
    assert "CRANE_READING_SWING_LEFT" not in header


@pytest.mark.parametrize(("subject", "real"), tiered(
    [(subject, real) for subject in (*library.BALANCED, *library.LOOPED) for real in ("double", "float")],
    lambda subject, real: (subject, real) in (("twin", "double"), ("eliminated", "float"))))
def test_self_test_passes(subject: str, real: str, tmp_path: Path) -> None:
    folder = library.write(library.files(library.subject(subject, real)), tmp_path / "c")
    done = library.run(["make", "CFLAGS=-O0 -Werror", "check"], folder)
    assert done.returncode == 0, done.stdout + done.stderr


def test_valves_are_left_out_with_the_reason() -> None:
    assert library.code(twin()).missing["the machine file does not state the valves of all actuators"] == [
        "valve_feedforward", "valve_refit", "position_feedback"]


def test_one_of_two_cylinders_at_its_dead_point_leaves_the_load_to_the_other(libraries) -> None:
    lib, model = libraries("twin", "double", "-O0"), Model(twin())
    boom = np.linspace(-np.pi, np.pi, 100001)
    q = np.column_stack([boom, 0 * boom])
    arms = model.over(model.transmission, q)[0][:, :, 0]
    dead = q[np.argmin(np.abs(arms), axis=0)]
    assert np.max(np.min(np.abs(arms), axis=0)) < 1e-4
    status, found = lib.call("inverse_dynamics", lib.prepare(), {"q": dead, "qd": 0 * dead, "qdd": 0 * dead}, 2)
    assert set(status) <= {OK, OUT_OF_STROKE}
    # friction has no sign at rest and nothing has an offset: the other one carries all of it
    for k in range(2):
        assert abs(found["actuator_force"][k, k]) < 1e-3 * abs(found["actuator_force"][k, 1 - k])
    torque = model.over(model.inverse_dynamics, dead, 0 * dead, 0 * dead, np.tile(model.parameters.nominal, (2, 1)))[0]
    np.testing.assert_allclose(found["force"], torque[:, :, 0], rtol=1e-9)


@pytest.mark.slow
def test_both_cylinders_at_their_dead_point_cannot_share_a_load(tmp_path) -> None:
    data = twin().model_dump()
    data["cylinders"][1]["rod"]["pin"] = data["cylinders"][0]["rod"]["pin"]
    data["cylinders"][1]["barrel"]["pin"] = data["cylinders"][0]["barrel"]["pin"]
    machine = Machine.model_validate(data)
    made = library.code(machine, routines=("actuator_forces", "inverse_dynamics", "regressor"))
    lib, model = Library(made, tmp_path / "c", "-O0"), Model(machine)
    low, high = -0.3, -0.3 - np.pi
    for _ in range(60):
        middle = (low + high) / 2
        arm = float(model.transmission(np.array([middle, 0.0]))[0, 0])
        low, high = (middle, high) if arm > 0 else (low, middle)
    q = np.array([[low, 0.0], [low + 0.01, 0.0]])
    given = {"q": q, "qd": 0 * q, "qdd": 0 * q}
    constants = lib.prepare()
    assert lib.call("inverse_dynamics", constants, given, 2)[0].tolist()[0] == DEAD_POINT
    assert lib.call("inverse_dynamics", constants, given, 2)[0].tolist()[1] in (OK, OUT_OF_STROKE)
    for routine in ("actuator_forces", "regressor"):  # what both do together is measured all the same
        assert DEAD_POINT not in lib.call(routine, constants, given, 2)[0]
