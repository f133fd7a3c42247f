"""Models that are kept in process belong to what the machine file states, and to nothing else."""

from __future__ import annotations

import numpy as np

from hydroopt import load_machine
from hydroopt.model.model import KEPT, Model, recent_model

LIFT = load_machine("patu655_lift")


def test_a_machine_that_states_the_same_has_the_same_model() -> None:
    assert recent_model(load_machine("patu655_lift")) is recent_model(load_machine("patu655_lift"))


def test_a_machine_that_states_something_else_has_a_model_of_its_own() -> None:
    q = np.array([0.3])
    before = np.asarray(recent_model(LIFT).regressor(q, q, q))
    other = LIFT.model_copy(update={"gravity": 9.7})
    found = np.asarray(recent_model(other).regressor(q, q, q))
    assert recent_model(other).machine.gravity == 9.7
    np.testing.assert_array_equal(found, np.asarray(Model(other).regressor(q, q, q)))
    assert np.any(found != before)
    assert not recent_model(LIFT, actuator_inertia=False).actuator_inertia
    np.testing.assert_array_equal(np.asarray(recent_model(LIFT).regressor(q, q, q)), before)


def test_few_models_are_kept() -> None:
    first = recent_model(LIFT)
    for k in range(KEPT):
        recent_model(LIFT.model_copy(update={"gravity": 9.0 + k / 10}))
    assert recent_model(LIFT) is not first
