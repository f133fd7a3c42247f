"""Positions that are read late show where friction turns, in samples that take no part in the identification."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import hydroopt as ho
from hydroopt.estimation.dynamic.reversals import late_positions

LATE = 0.05


def late(log: ho.Log, joint: str, by: float) -> ho.Log:
    """The log with one joint's positions read so much later [s], and without lengths that would contradict them."""
    channels = {name: x for name, x in log.channels.items() if not name.endswith(".length")}
    channels[f"{joint}.q"] = np.interp(log.t - by, log.t, channels[f"{joint}.q"])
    return replace(log, channels=channels)


@pytest.fixture(scope="module", params=[("cat215b", "stick"), ("knuckle_boom_crane", "telescope")])
def subject(request: pytest.FixtureRequest) -> tuple[ho.Model, str, ho.Log]:
    name, joint = request.param
    model = ho.Model(ho.load_machine(name))
    motion = ho.random_trajectory(model, duration=20.0, rate=50.0, seed=10)
    return model, joint, ho.simulate(model, motion, ho.random_truth(model, 0), seed=0)


@pytest.mark.slow
def test_late_positions_are_named_and_sound_ones_are_not(subject: tuple[ho.Model, str, ho.Log]) -> None:
    model, joint, log = subject
    sound = ho.solve(ho.identification_problem(model, [log]))
    assert not list(late_positions(sound))
    spoilt = ho.solve(ho.identification_problem(model, [late(log, joint, LATE)]))
    (one,) = late_positions(spoilt)
    assert one.joint == joint
    assert one.late == pytest.approx(LATE, abs=0.011)  # half a sample
    assert spoilt.status == "suspect"
    (said,) = [each for each in spoilt.diagnostics if each.kind == "friction turns before the velocity"]
    assert f"The positions of {joint} are read" in said.text


def test_forces_that_turn_late_are_no_late_positions(subject: tuple[ho.Model, str, ho.Log]) -> None:
    """Friction of seals that give before they slip does so, too."""
    model, joint, log = subject
    assert not list(late_positions(ho.solve(ho.identification_problem(model, [late(log, joint, -LATE)]))))
