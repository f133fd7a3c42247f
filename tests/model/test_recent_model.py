"""Models that are kept in process belong to what the machine file states, and to nothing else."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from hydroopt import dump_machine, load_machine
from hydroopt.model.closed_chain import recent_chain
from hydroopt.model.model import Model, recent_model
from hydroopt.model.recent import KEPT

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


def test_the_same_machine_from_elsewhere_keeps_its_path(tmp_path: Path) -> None:
    sources = []
    for name in ("one", "other"):
        (tmp_path / f"{name}.toml").write_bytes(dump_machine(LIFT).encode())
        machine = load_machine(tmp_path / f"{name}.toml")
        sources += [recent_model(machine).machine.source, recent_chain(machine).machine.source]
    assert [Path(source.strip("'")).stem for source in sources] == ["one", "one", "other", "other"]


def test_few_models_are_kept() -> None:
    first = recent_model(LIFT)
    for k in range(KEPT):
        recent_model(LIFT.model_copy(update={"gravity": 9.0 + k / 10}))
    assert recent_model(LIFT) is not first
