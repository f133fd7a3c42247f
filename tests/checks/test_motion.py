"""What a motion breaks is found with time, place and amount."""

from __future__ import annotations

import numpy as np
import pytest

from hydroopt import Log, Model, load_machine
from hydroopt.checks.motion import check_motion
from hydroopt.limits.reserves import Reserves
from hydroopt.results.status import Status

CAT = load_machine("cat215b")


def swept(boom: np.ndarray, stick: np.ndarray, seconds: float) -> Log:
    t = np.linspace(0, seconds, len(boom))
    return Log("sweep", t, {"swing.q": 0 * t, "boom.q": boom, "stick.q": stick},
               units=dict.fromkeys(("swing.q", "boom.q", "stick.q"), "rad"))


def test_a_tip_in_the_ground_is_found_where_it_is() -> None:
    boom = np.linspace(-0.2, 0.2, 201)
    found = check_motion(CAT, swept(boom, np.full(201, 1.4), 20.0))
    ground = next(each for each in found.table if each.use.name == "stick above ground")
    model = Model(CAT)
    depth = CAT.ground - model.over(model.forward_kinematics, np.column_stack(
        [0 * boom, boom, np.full(201, 1.4)]))[-1][:, 2, 3]
    assert ground.beyond == pytest.approx(np.max(depth), abs=0.02)
    assert ground.at == pytest.approx(20 * np.argmax(depth) / 200, abs=0.3)
    assert found.status is Status.SUSPECT
    assert any("stick above ground" in each.text for each in found.diagnostics)


def test_reserves_alone_make_no_motion_suspect() -> None:
    """What keeps the limits but not a reserve is said, and is no contradiction."""
    log = swept(np.linspace(-0.4, -0.3, 101), np.linspace(1.9, 2.0, 101), 20.0)
    calm, strict = check_motion(CAT, log), check_motion(CAT, log, reserves=Reserves(tipping=0.9))
    assert calm.status is strict.status is Status.OK
    assert not calm.diagnostics
    assert any("reserve" in each.text and "tipping" in each.text for each in strict.diagnostics)
    assert not strict.verdict.serves


def test_own_parts_that_only_a_reserve_watches_are_checked() -> None:
    """The payload of the log crane comes near to its lift cylinder, but never touches it."""
    t = np.linspace(0, 20, 61)
    log = Log("still", t, {"lift.q": 0.5 + 0 * t, "tilt.q": -1.0 + 0 * t}, units={"lift.q": "rad", "tilt.q": "rad"})
    found = {each.use.name: each for each in check_motion(load_machine("patu655"), log).table}
    assert not found["distance of payload to lift_cylinder"].broken


def test_degrees_that_are_taken_for_radians_are_named() -> None:
    """The first thing that is wrong is the unit, not a limit, and its correction is stated once."""
    degrees = swept(np.linspace(-30, -20, 101), np.linspace(60, 80, 101), 20.0)
    found = check_motion(CAT, degrees)
    assert found.diagnostics[0].subject == ("boom.q", "stick.q")
    assert "boom.q, stick.q in deg" in found.verdict.cause
    assert found.refuted
    texts = [step.text for step in found.verdict.next_steps]
    assert len(texts) == len(set(texts)) >= 3
    assert not check_motion(CAT, swept(np.linspace(-0.4, -0.3, 101), np.linspace(1.9, 2.0, 101), 20.0)).refuted
